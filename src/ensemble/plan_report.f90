!> Report on a plan before it is run: tasks, parameters, time from a short calibration, memory.
module battery_plan_report
  use battery_kinds, only: wp, dp, int64
  use battery_clocks, only: cpu_seconds
  use battery_engine, only: particles_type
  use battery_error, only: error_type
  use battery_json_report, only: write_plan_json
  use battery_memory_estimate, only: estimate_type, estimate_of, bytes_per_rank, bytes_at_the_end
  use battery_available_memory, only: free_memory_type, available_memory, size_text
  use battery_journal, only: journal_type
  use battery_merge, only: sources_type, close_sources
  use battery_startup, only: progress_type, inspect_output, further_text
  use battery_plan, only: plan_type, point_type, point_of
  use battery_plan_remarks, only: remarks_of
  use battery_progress_line, only: duration_text, rate_text
  use battery_signals, only: stop_requested, set_stop_error
  use battery_simulation, only: simulation_type, begin_simulation, advance_simulation
  use battery_table, only: channel1, channel2
  use battery_tasks, only: task_type, task_count, task_of, initial_particles
  use battery_terminal, only: print_line
  use battery_text, only: string_type, to_text, count_text
  implicit none (type, external)
  private
  public :: print_plan_report

  !> Largest number of tasks run for the calibration, and seconds spent on each.
  integer, parameter :: most_tries = 5
  real(dp), parameter :: try_seconds = 0.4_dp

contains

  !> Prints the plan, and its time and memory on `ranks` ranks, `sharing` of which are on one
  !> machine.
  subroutine print_plan_report(plan, ranks, sharing, overwrite, json, error)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: ranks, sharing
    !> Whether existing results would be discarded.
    logical, intent(in) :: overwrite
    !> JSON file for tasks, time and memory; empty: none.
    character(len=*), intent(in) :: json
    type(error_type), allocatable, intent(out) :: error
    type(free_memory_type) :: available
    type(estimate_type) :: estimate
    type(journal_type) :: journal
    type(sources_type) :: sources
    type(progress_type) :: progress
    character(len=:), allocatable :: message
    type(string_type), allocatable :: remarks(:)
    real(dp) :: seconds, rate
    integer :: at

    message = ''
    if (overwrite) then
      progress = initial_progress(plan)
    else
      call inspect_output(plan, journal, sources, progress, message, error)
      call close_sources(sources)
    end if
    if (allocated(error)) return
    if (message /= '') call print_line(message)
    available = available_memory(sharing)
    estimate = estimate_of(plan, available)
    call print_parameters(plan)
    remarks = remarks_of(plan)
    do at = 1, size(remarks)
      call print_line('remark:     '//remarks(at)%text)
    end do
    call print_line('finished:   '//count_text(progress%finished, 'task')//'; to be done: ' &
      //to_text(size(progress%pending))//further_text(progress))
    call calibrate(plan, progress%pending, estimate%number, seconds, rate, error)
    if (allocated(error)) return
    if (rate > 0.0_dp) &
      call print_line('speed:      '//rate_text(rate)//' collisions/s a rank (calibrated)')
    if (size(progress%pending) > 0) call print_line('time:       about '//time_text(0.0_dp) &
      //' on ' //count_text(ranks, 'rank')//further_time())
    call print_memory(estimate, available)
    call print_line('results:    '//plan%file)
    call print_line('nothing was written')
    call write_plan_json(json, task_count(plan), size(progress%pending), seconds, &
      bytes_per_rank(estimate), error)

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

  !> Progress of an ensemble that has no results yet: all tasks are pending.
  function initial_progress(plan) result(progress)
    type(plan_type), intent(in) :: plan
    type(progress_type) :: progress
    integer :: k

    progress%pending = pack([(k, k=1, task_count(plan))], [(modulo(k - 1, plan%replicas) &
      < plan%first_replicas, k=1, task_count(plan))])
    progress%further = task_count(plan) - size(progress%pending)
  end function initial_progress

  !> Prints the memory that a rank needs for tasks, that rank 0 needs at the end, and that is
  !> available.
  subroutine print_memory(estimate, available)
    type(estimate_type), intent(in) :: estimate
    type(free_memory_type), intent(in) :: available

    call print_line('memory:     about '//size_text(bytes_per_rank(estimate)) &
      //' a rank; rank 0 about ' //size_text(bytes_at_the_end(estimate))//' at the end; ' &
      //size_text(available%bytes)//' a rank are available ('//available%limit//')')
    if (estimate%events > 0.0_dp) call print_line('            events take about ' &
      //size_text(estimate%events) //' of it; a run whose events outgrow the memory fails')
    if (estimate%too_large > 0) call print_line('            '//count_text(estimate%too_large, &
      'point') //' with up to '//to_text(estimate%greatest) &
      //' particles need more: their tasks will fail')
  end subroutine print_memory

  !> Prints the parameters of a plan, scanned ones as ranges.
  subroutine print_parameters(plan)
    type(plan_type), intent(in) :: plan
    type(point_type) :: point
    real(wp) :: extent(2, 10)
    integer :: at

    extent(1, :) = huge(1.0_wp)
    extent(2, :) = -huge(1.0_wp)
    do at = 1, plan%point_count
      point = point_of(plan, at)
      call widen_range([real(point%number, wp), real(point%threshold, wp), point%urn_radius, &
        point%channel(channel1)%width, point%channel(channel1)%length, &
        point%channel(channel2)%width, point%channel(channel2)%length, real(point%urn1_number, wp)])
    end do
    call print_line('tasks:      '//to_text(task_count(plan))//' (' &
      //count_text(plan%point_count, 'point')//', '//count_text(plan%replicas, 'replica')//' each)')
    if (plan%first_replicas < plan%replicas) call print_line('precision:  the first ' &
      //to_text(plan%first_replicas)//' replicas of a point determine its number, up to ' &
      //to_text(plan%replicas)//'')
    call print_line('engine:     '//plan%engine)
    if (plan%urn_shape == 'disc') then
      call print_line('shape:      '//plan%shape//', urn radius '//pair_text(4))
    else
      call print_line('shape:      '//plan%shape//', '//outline_text(plan)//', urn radius ' &
        //pair_text(4))
    end if
    call print_line('channel 1:  w = '//range_text(6)//', l = '//range_text(7))
    if (plan%shape /= 'urn') &
      call print_line('channel 2:  w'' = '//range_text(8)//', l'' = '//range_text(9))
    if (size(plan%scatterers) > 0) &
      call print_line('            with '//count_text(size(plan%scatterers)/3, 'scatterer'))
    call print_line('N:          '//range_text(1))
    call print_line('T:          '//pair_text(2))
    call print_line('urn 1:      '//range_text(10)//' particles at the start')
    if (plan%duration > 0.0_wp) then
      call print_line('length:     '//to_text(plan%duration) &
        //' time units each, the first ' //to_text(plan%transient_duration)//' not averaged')
    else
      call print_line('length:     '//rate_text(real(plan%collisions, dp)) &
        //' collisions each, the first ' &
        //rate_text(real(plan%transient_collisions, dp))//' not averaged')
    end if

  contains

    !> Extends the ranges by the values of one point.
    subroutine widen_range(values)
      real(wp), intent(in) :: values(:)

      extent(1, :) = min(extent(1, :), values)
      extent(2, :) = max(extent(2, :), values)
    end subroutine widen_range

    !> Least and greatest value of one quantity.
    function range_text(k) result(text)
      integer, intent(in) :: k
      character(len=:), allocatable :: text

      text = to_text(extent(1, k))
      if (extent(2, k) > extent(1, k)) text = text//' ... '//to_text(extent(2, k))
    end function range_text

    !> A pair of quantities, once if they are equal.
    function pair_text(k) result(text)
      integer, intent(in) :: k
      character(len=:), allocatable :: text

      text = range_text(k)
      if (plan%shape /= 'urn' .and. range_text(k + 1) /= text) &
        text = text//' and '//range_text(k + 1)
    end function pair_text

  end subroutine print_parameters

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
    type(particles_type) :: particles
    integer :: tries, tried, k
    integer(int64) :: before
    real(dp) :: began, spent, elapsed, one_rate

    tries = min(most_tries, size(pending))
    tried = 0
    seconds = 0.0_dp
    rate = 0.0_dp
    do k = 1, tries
      task = task_of(plan, pending(1 + int(int(size(pending) - 1, int64)*(k - 1) &
        /max(tries - 1, 1))))
      if (task%number > most) cycle
      call initial_particles(task, plan%file_particles, particles, error)
      if (.not. allocated(error)) call begin_simulation(simulation, task%setup, particles, error)
      if (allocated(error)) return
      began = cpu_seconds()
      before = simulation%engine%collisions()
      elapsed = real(simulation%elapsed, dp)
      do
        call advance_simulation(simulation)
        spent = cpu_seconds() - began
        if (stop_requested()) call set_stop_error(error)
        if (allocated(error)) return
        if (spent > try_seconds .or. simulation%done) exit
      end do
      tried = tried + 1
      one_rate = real(simulation%engine%collisions() - before, dp)/max(spent, 1.0e-9_dp)
      rate = rate + one_rate
      if (plan%duration > 0.0_wp) then
        seconds = seconds + spent*real(plan%duration, dp)/max(real(simulation%elapsed, dp) &
          - elapsed, tiny(1.0_dp))
      else
        seconds = seconds + real(plan%collisions, dp)/max(one_rate, 1.0e-9_dp)
      end if
    end do
    seconds = seconds/max(tried, 1)
    rate = rate/max(tried, 1)
  end subroutine calibrate

end module battery_plan_report
