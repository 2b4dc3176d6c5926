!> The memory that a plan needs, compared with the available memory before anything is run.
module battery_memory_estimate
  use battery_kinds, only: wp, dp, pi
  use battery_engines, only: bytes_per_particle
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_available_memory, only: free_memory_type, available_memory, bytes_per_entry, &
    bytes_per_state, bytes_per_event, bytes_per_task, merged_entry, merged_state, base_bytes, &
    most_numbers, size_text
  use battery_keys, only: key_radius
  use battery_plan, only: plan_type, point_type, point_of, table_of, is_scanned
  use battery_table, only: table_type, channel1, channel2
  use battery_tasks, only: task_count
  use battery_text, only: to_text, new_line_character
  implicit none (type, external)
  private
  public :: estimate_type, estimate_of, bytes_per_rank, bytes_at_the_end, check_estimate, &
    check_memory_for_mpi

  !> Address space that MPI needs while it starts: Open MPI 4.1 has large parts of 54 MB. With less,
  !> some versions crash.
  real(dp), parameter :: start_bytes = 64.0e6_dp

  !> Bytes that a process has allocated when it reads the available memory.
  real(dp), parameter :: taken = 30.0e6_dp

  !> Bytes by purpose, for a task at the largest point that fits into memory.
  type :: estimate_type
    real(dp) :: particles = 0.0_dp, series = 0.0_dp, snapshots = 0.0_dp, final_state = 0.0_dp
    !> Events are not known beforehand, nor is a series without a duration: these are estimates.
    real(dp) :: events = 0.0_dp, estimated_series = 0.0_dp
    !> Bytes that rank 0 needs at the end, for the merge.
    real(dp) :: merge = 0.0_dp
    !> Number of particles of the smallest point, of the largest, and of the largest that fits;
    !> number of points that do not fit.
    integer :: least = 0, greatest = 0, number = 0, too_large = 0
    !> Number of entries of the series, if known.
    real(dp) :: entries = 0.0_dp
  end type estimate_type

contains

  !> Memory that a plan needs if `available` is available to a rank.
  function estimate_of(plan, available) result(estimate)
    type(plan_type), intent(in) :: plan
    type(free_memory_type), intent(in) :: available
    type(estimate_type) :: estimate
    type(point_type) :: point
    real(dp) :: others, tasks, per_particle
    integer :: at

    per_particle = bytes_per_particle(plan%engine, plan%urn_shape == 'polygon')
    estimate%least = huge(1)
    do at = 1, plan%point_count
      point = point_of(plan, at)
      estimate%least = min(estimate%least, point%number)
      estimate%greatest = max(estimate%greatest, point%number)
      if (per_particle*point%number + base_bytes > available%bytes) then
        estimate%too_large = estimate%too_large + 1
      else
        estimate%number = max(estimate%number, point%number)
      end if
    end do
    if (estimate%number == 0) estimate%number = estimate%least
    tasks = real(task_count(plan), dp)
    others = real(plan%point_count - estimate%too_large, dp)*plan%replicas - 1.0_dp
    others = max(others, 0.0_dp)
    estimate%particles = per_particle*estimate%number
    estimate%snapshots = bytes_per_state*size(plan%snapshot_times)*estimate%number
    if (plan%final_state) estimate%final_state = bytes_per_state*estimate%number
    estimate%merge = bytes_per_task*tasks + (estimate%snapshots + estimate%final_state) &
      *(1.0_dp + others*merged_state/bytes_per_state)
    if (plan%series_interval > 0.0_wp) then
      estimate%entries = 1.0_dp + real(length_of(plan, estimate%number), &
        dp)/real(plan%series_interval, dp)
      if (plan%duration > 0.0_wp) then
        estimate%series = bytes_per_entry*estimate%entries
      else
        estimate%estimated_series = bytes_per_entry*estimate%entries
      end if
      estimate%merge = estimate%merge + estimate%series*(1.0_dp &
        + others*merged_entry/bytes_per_entry)
    end if
    if (plan%event_log) estimate%events = bytes_per_event*events_of(plan)
  end function estimate_of

  !> Bytes that a rank needs while it runs tasks.
  pure real(dp) function bytes_per_rank(estimate) result(bytes)
    !> Memory estimate of the plan.
    type(estimate_type), intent(in) :: estimate

    bytes = taken + base_bytes + estimate%particles + estimate%series + estimate%estimated_series &
      + estimate%snapshots + estimate%final_state + estimate%events
  end function bytes_per_rank

  !> Bytes that rank 0 needs at the end.
  pure real(dp) function bytes_at_the_end(estimate) result(bytes)
    !> Memory estimate of the plan.
    type(estimate_type), intent(in) :: estimate

    bytes = taken + base_bytes + estimate%merge
  end function bytes_at_the_end

  !> Duration of a run: as given, or from the mean time between the wall collisions of a particle in
  !> an urn, pi r/2.
  pure function length_of(plan, number) result(length)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: number
    real(wp) :: length

    length = plan%duration
    if (.not. length > 0.0_wp) length = real(plan%collisions, wp)*0.5_wp*pi &
      *maxval(plan%base%of(key_radius)%real)/number
  end function length_of

  !> Number of events of a run, if urns are well mixed: each particle enters a gate at the rate
  !> w/(pi A), and crosses a line at most as often as it enters a channel.
  function events_of(plan) result(events)
    type(plan_type), intent(in) :: plan
    real(dp) :: events
    type(point_type) :: point
    type(table_type) :: table

    point = point_of(plan, 1)
    table = table_of(plan, point)
    events = real(point%number, dp)*real(length_of(plan, &
      point%number)*(2.0_wp*point%channel(channel1)%width + point%channel(channel2)%width) &
      /(pi*table%urn(1)%area), dp)
  end function events_of

  !> An error if there is not enough memory for MPI to start; to be called by every rank before
  !> MPI_Init.
  subroutine check_memory_for_mpi(error)
    type(error_type), allocatable, intent(out) :: error
    type(free_memory_type) :: available

    available = available_memory(1)
    if (available%bytes < start_bytes) call fatal_error(error, 'battery: MPI needs ' &
      //size_text(start_bytes)//' of memory to start; there are '//size_text(available%bytes) &
      //' ('// available%limit//')', exit_bad_input)
  end subroutine check_memory_for_mpi

  !> An error that names the keys for which the memory does not suffice: for one task, or for rank 0
  !> at the end; or whose numbers are too large for default integers. If only some points of a scan
  !> are too large, it is no error here: their tasks fail.
  subroutine check_estimate(plan, sharing, error)
    type(plan_type), intent(in) :: plan
    !> Ranks that share the machine's memory.
    integer, intent(in) :: sharing
    type(error_type), allocatable, intent(out) :: error
    type(free_memory_type) :: available
    type(estimate_type) :: estimate
    character(len=:), allocatable :: problems

    available = available_memory(sharing)
    estimate = estimate_of(plan, available)
    problems = ''
    if (estimate%too_large == plan%point_count) then
      call add(merge('scan     ', 'particles', is_scanned(plan, 'number')), 'number', &
        to_text(estimate%least)//' particles', estimate%particles + base_bytes)
    else
      if (estimate%entries > most_numbers .and. estimate%series > 0.0_dp) then
        call append_line('&output series_interval asks for more entries than can be counted; ' &
          //'allowed: '//to_text(nint(most_numbers)))
      else
        call check('series_interval', 'a series of '//to_text(nint(min(estimate%entries, &
          most_numbers)))//' entries', estimate%series, merged_entry/bytes_per_entry)
      end if
      if (real(size(plan%snapshot_times), dp)*estimate%number > most_numbers) then
        call append_line('&output snapshot_times asks for more states than can be counted; ' &
          //'allowed: '//to_text(nint(most_numbers))//', snapshots times particles')
      else
        call check('snapshot_times', to_text(size(plan%snapshot_times))//' snapshots', &
          estimate%snapshots, merged_state/bytes_per_state)
      end if
      call check('final_state', 'final states', estimate%final_state, merged_state/bytes_per_state)
      if (problems == '' .and. estimate%merge + base_bytes > available%bytes) &
        call add('scan', 'replicas', 'the results of '//to_text(task_count(plan))//' tasks', &
        estimate%merge + base_bytes)
    end if
    if (problems /= '') call fatal_error(error, problems, exit_bad_input)

  contains

    !> Checks the bytes of one part of a task, and of all tasks on rank 0, where each task after the
    !> first needs the fraction `share`.
    subroutine check(key, what, bytes, share)
      character(len=*), intent(in) :: key, what
      real(dp), intent(in) :: bytes, share
      real(dp) :: all_tasks

      if (.not. bytes > 0.0_dp) return
      all_tasks = bytes*(1.0_dp + share*(real(task_count(plan), dp) - 1.0_dp))
      if (estimate%too_large > 0) all_tasks = bytes
      if (estimate%particles + bytes + base_bytes > available%bytes) then
        call add('output', key, what//' beside '//to_text(estimate%number)//' particles', &
          estimate%particles + bytes + base_bytes)
      else if (all_tasks + base_bytes > available%bytes) then
        call add('output', key, what//' of each of '//to_text(task_count(plan))//' tasks', &
          all_tasks + base_bytes)
      end if
    end subroutine check

    !> Adds the problem that `bytes` for `what` are too many.
    subroutine add(group, key, what, bytes)
      character(len=*), intent(in) :: group, key, what
      real(dp), intent(in) :: bytes

      call append_line('&'//trim(group)//' '//key//': '//what//' need '//size_text(bytes) &
        //' of memory; '//size_text(available%bytes)//' a rank are available ('//available%limit &
        //')')
    end subroutine add

    !> Adds a line to the problems.
    subroutine append_line(text)
      character(len=*), intent(in) :: text

      if (problems /= '') problems = problems//new_line_character
      problems = problems//plan%input_file//': '//text
    end subroutine append_line

  end subroutine check_estimate

end module battery_memory_estimate
