!> Report on a plan before it is run: tasks, parameters, time from a short calibration, memory.
module battery_plan_report
  use battery_kinds, only: wp, dp, int64
  use battery_clocks, only: cpu_seconds
  use battery_error, only: error_type
  use battery_findings, only: findings_type, findings_text
  use battery_json_report, only: write_json
  use battery_available_memory, only: estimate_type, size_text
  use battery_merge, only: sources_type, close_sources
  use battery_startup, only: progress_type, inspect_output, set_pending, further_text, &
    check_writable
  use battery_plan, only: plan_type, point_type, point_of
  use battery_plan_remarks, only: remarks_of
  use battery_precision, only: decide_replicas
  use battery_results, only: results_type, new_results
  use battery_signals, only: stop_requested, set_stop_error
  use battery_simulation, only: simulation_type, advance_simulation
  use battery_table, only: channel1, channel2
  use battery_task_loop, only: advance_some_windows
  use battery_tasks, only: task_type, task_count, task_of, begin_task
  use battery_terminal, only: print_line
  use battery_text, only: duration_text, rate_text, to_text, count_text, numbers_text
  implicit none (type, external)
  private
  public :: print_plan_report

  !> Columns of the names.
  integer, parameter :: name_columns = 12

  !> Largest number of tasks run for the calibration, and seconds spent on each.
  integer, parameter :: most_tries = 5
  real(dp), parameter :: try_seconds = 0.4_dp

contains

  !> Prints the plan, and its time and memory on `ranks` ranks.
  subroutine print_plan_report(plan, ranks, estimate, overwrite, json, error)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: ranks
    !> Memory that the plan needs.
    type(estimate_type), intent(in) :: estimate
    !> Whether existing results would be discarded.
    logical, intent(in) :: overwrite
    !> JSON file for tasks, time and memory; empty: none.
    character(len=*), intent(in) :: json
    type(error_type), allocatable, intent(out) :: error
    type(sources_type) :: sources
    type(progress_type) :: progress
    type(results_type) :: results
    character(len=:), allocatable :: message
    type(findings_type) :: remarks
    real(dp) :: seconds, rate

    message = ''
    if (overwrite) then
      call check_writable(plan, error)
      call new_results(results, plan%point_count, plan%replicas)
      call decide_replicas(plan, results)
      call set_pending(plan, results, progress)
    else
      call inspect_output(plan, sources, progress, message, error)
      call close_sources(sources)
    end if
    if (allocated(error)) return
    if (message /= '') call print_line(message)
    call print_parameters(plan)
    call calibrate(plan, progress%pending, estimate%number, seconds, rate, error)
    if (allocated(error)) return
    remarks = remarks_of(plan, seconds*ceiling(real(task_count(plan), dp)/ranks))
    if (remarks%count > 0) call print_line(findings_text(remarks, 'remark', name_columns))
    call print_row('finished:', count_text(progress%finished, 'task')//'; to be done: ' &
      //to_text(size(progress%pending))//further_text(progress))
    if (rate > 0.0_dp) &
      call print_row('speed:', rate_text(rate)//' collisions/s a rank (calibrated)')
    if (size(progress%pending) > 0) call print_row('time:', trim(merge('at most', 'about  ', &
      progress%begun > 0))//' '//time_text(0.0_dp)//' on ' &
      //count_text(ranks, 'rank')//further_time())
    call print_memory(estimate)
    call print_row('results:', plan%file)
    call print_line('nothing was written')
    call write_json(json, '"tasks": '//to_text(task_count(plan))//', "pending": ' &
      //to_text(size(progress%pending))//', "seconds_a_task": '//to_text(seconds) &
      //', "memory_a_rank": '//to_text(estimate%task), error)

  contains

    !> Text for the duration of the pending tasks and `more` further tasks.
    function time_text(more) result(text)
      real(dp), intent(in) :: more
      character(len=:), allocatable :: text

      text = duration_text(seconds*real(ceiling((size(progress%pending) + more)/ranks), dp))
    end function time_text

    !> Text for the duration of tasks whose number is not known yet, if a precision is required.
    function further_time() result(text)
      character(len=:), allocatable :: text

      text = ''
      if (progress%further == 0) return
      if (progress%expected >= 0.0_dp) text = '; '//time_text(progress%expected) &
        //' if the other points get as many replicas as those that are known'
      text = text//'; at most '//time_text(real(progress%further, dp))
    end function further_time

  end subroutine print_plan_report

  !> Prints the memory that a rank needs for tasks, that rank 0 needs at the end, and that is
  !> available.
  subroutine print_memory(estimate)
    type(estimate_type), intent(in) :: estimate

    call print_row('memory:', 'about '//size_text(estimate%task)//' a rank; rank 0 ' &
      //'about '//size_text(estimate%merge)//' at the end; ' &
      //size_text(estimate%available%bytes)//' a rank are available (' &
      //estimate%available%limit//')')
    if (estimate%events > 0.0_dp) call print_row('', 'events take about ' &
      //size_text(estimate%events) //' of it; a run whose events outgrow the memory fails')
    if (estimate%too_large > 0) call print_row('', count_text(estimate%too_large, 'point') &
      //' with up to '//to_text(estimate%greatest) &
      //' particles need more: their tasks will fail')
  end subroutine print_memory

  !> Prints the parameters of a plan, scanned ones as ranges.
  subroutine print_parameters(plan)
    type(plan_type), intent(in) :: plan
    type(point_type), allocatable :: points(:)
    character(len=:), allocatable :: outline
    integer :: at

    points = [(point_of(plan, at), at=1, plan%point_count)]
    call print_row('tasks:', to_text(task_count(plan))//' ('//count_text(plan%point_count, &
      'point')//', '//count_text(plan%replicas, 'replica')//' each)')
    if (plan%first_replicas < plan%replicas) call print_row('precision:', 'the first ' &
      //to_text(plan%first_replicas)//' replicas of a point determine its number, up to ' &
      //to_text(plan%replicas))
    do at = 1, size(plan%scanned)
      associate (one => plan%scanned(at))
        call print_row(trim(merge('scan:', '     ', at == 1)), one%key//' = ' &
          //list_text(one%values))
      end associate
    end do
    call print_row('engine:', plan%engine)
    outline = ''
    if (plan%urn_shape /= 'disc') outline = ', '//outline_text(plan)
    call print_row('shape:', plan%shape//outline//', urn radius '//range_text( &
      points%urn_radius(1), points%urn_radius(2)))
    call print_row('channel 1:', 'w = '//range_text(points%channel(channel1)%width)//', l = ' &
      //range_text(points%channel(channel1)%length))
    if (plan%shape /= 'urn') call print_row('channel 2:', 'w'' = ' &
      //range_text(points%channel(channel2)%width)//', l'' = ' &
      //range_text(points%channel(channel2)%length))
    if (size(plan%scatterers) > 0) &
      call print_row('', 'with '//count_text(size(plan%scatterers)/3, 'scatterer'))
    call print_row('N:', range_text(real(points%number, wp)))
    call print_row('T:', range_text(real(points%threshold(1), wp), real(points%threshold(2), wp)))
    call print_row('urn 1:', range_text(real(points%urn1_number, wp))//' particles at the start')
    if (plan%duration > 0.0_wp) then
      call print_row('length:', to_text(plan%duration)//' time units each, the first ' &
        //to_text(plan%transient_duration)//' not averaged')
    else
      call print_row('length:', rate_text(real(plan%collisions, dp))//' collisions each, the ' &
        //'first '//rate_text(real(plan%transient_collisions, dp))//' not averaged')
    end if

  contains

    !> All values of a list, or of a long one the first, the last and their number.
    function list_text(values) result(text)
      real(wp), intent(in) :: values(:)
      character(len=:), allocatable :: text
      integer, parameter :: most = 25, first = 3

      text = numbers_text(values, ', ')
      if (size(values) > most) text = numbers_text(values(:first), ', ')//' ... ' &
        //to_text(values(size(values)))//' ('//to_text(size(values))//' values)'
    end function list_text

    !> Least and greatest value of a quantity; of one of both urns, unless they are equal, those of
    !> the other as well.
    pure recursive function range_text(values, others) result(text)
      real(wp), intent(in) :: values(:)
      real(wp), intent(in), optional :: others(:)
      character(len=:), allocatable :: text

      text = to_text(minval(values))
      if (maxval(values) > minval(values)) text = text//' ... '//to_text(maxval(values))
      if (plan%shape == 'urn' .or. .not. present(others)) return
      if (range_text(others) /= text) text = text//' and '//range_text(others)
    end function range_text

  end subroutine print_parameters

  !> Prints a name and, from the same column on in all lines, what there is to say of it.
  subroutine print_row(name, text)
    !> Name of at most 11 characters; empty: the line belongs to the one before.
    character(len=*), intent(in) :: name
    !> Text without a line end.
    character(len=*), intent(in) :: text

    call print_line(name//repeat(' ', name_columns - len(name))//text)
  end subroutine print_row

  !> Text for the kind of polygons that the urns are.
  function outline_text(plan) result(text)
    type(plan_type), intent(in) :: plan
    character(len=:), allocatable :: text
    integer :: urn

    if (plan%urn_sides > 0) then
      text = 'regular polygons of '//count_text(plan%urn_sides, 'side')
      return
    end if
    text = 'polygons of '//count_text(size(plan%outline(1)%corner, 2), 'side')
    if (size(plan%outline(1)%corner, 2) /= size(plan%outline(2)%corner, 2)) text = text//' and ' &
      //to_text(size(plan%outline(2)%corner, 2))
    do urn = 1, merge(1, 2, plan%shape == 'urn')
      if (plan%outline(urn)%was_clockwise) text = text//', urn '//to_text(urn) &
        //' turned round to run counterclockwise'
    end do
  end function outline_text

  !> Estimates the mean seconds per task, and collisions per second, from short runs of a few tasks
  !> spread over the plan. Seconds are processor time, so that other work on the machine has no
  !> effect.
  subroutine calibrate(plan, pending, most, seconds, rate, error)
    type(plan_type), intent(in) :: plan
    !> Numbers of the pending tasks.
    integer, intent(in) :: pending(:)
    !> Number of particles of the largest task that fits into memory; larger tasks are skipped.
    integer, intent(in) :: most
    !> Processor seconds per task; wall collisions per second.
    real(dp), intent(out) :: seconds, rate
    type(error_type), allocatable, intent(out) :: error
    type(task_type) :: task
    type(simulation_type) :: simulation
    integer :: tries, tried, k
    real(dp) :: launched, began, spent, collisions, share

    tries = min(most_tries, size(pending))
    tried = 0
    seconds = 0.0_dp
    rate = 0.0_dp
    do k = 1, tries
      task = task_of(plan, pending(1 + int(int(size(pending) - 1, int64)*(k - 1) &
        /max(tries - 1, 1))))
      if (task%setup%number > most) cycle
      launched = cpu_seconds()
      call begin_task(task, plan%file_particles, simulation, error)
      if (allocated(error)) return
      began = cpu_seconds()
      ! One window may take seconds.
      call advance_simulation(simulation)
      do
        spent = max(cpu_seconds() - began, 1.0e-9_dp)
        if (stop_requested()) call set_stop_error(error)
        if (allocated(error)) return
        if (spent > try_seconds .or. simulation%done) exit
        call advance_some_windows(simulation)
      end do
      tried = tried + 1
      collisions = real(simulation%engine%collisions(), dp)
      share = collisions/real(plan%collisions, dp)
      if (plan%duration > 0.0_wp) share = real(simulation%elapsed/plan%duration, dp)
      rate = rate + collisions/spent
      seconds = seconds + began - launched + spent/max(share, 1.0e-18_dp)
    end do
    seconds = seconds/max(tried, 1)
    rate = rate/max(tried, 1)
  end subroutine calibrate

end module battery_plan_report
