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
  public :: estimate_type, estimate_memory, every_rank, check_memory_for_mpi

  !> Address space that MPI needs while it starts: Open MPI 4.1 has large parts of 54 MB. With less,
  !> some versions crash.
  real(dp), parameter :: start_bytes = 64.0e6_dp

  !> Bytes that a process has allocated when it reads the available memory.
  real(dp), parameter :: taken = 30.0e6_dp

  !> Bytes of a rank without tasks.
  real(dp), parameter :: every_rank = taken + base_bytes

  !> Memory for a plan, at the largest point that fits.
  type :: estimate_type
    !> What is available to a rank.
    type(free_memory_type) :: available
    !> Bytes of a rank for a task, and of rank 0 at the end for the results of all tasks, besides
    !> `every_rank`. The length of an event log is not known beforehand, nor that of a series
    !> without a duration: `task` has estimates of them.
    real(dp) :: task = 0.0_dp, merge = 0.0_dp
    !> Bytes of `task` that are events.
    real(dp) :: events = 0.0_dp
    !> Number of particles of the largest point, and of the largest that fits; number of points that
    !> do not fit.
    integer :: greatest = 0, number = 0, too_large = 0
  end type estimate_type

contains

  !> Memory that a plan needs. A task that does not fit is an error only if none of the plan does:
  !> else it fails when it begins.
  subroutine estimate_memory(plan, sharing, estimate, error)
    type(plan_type), intent(in) :: plan
    !> Ranks that share the machine's memory.
    integer, intent(in) :: sharing
    type(estimate_type), intent(out) :: estimate
    !> One task, or rank 0 at the end, does not fit, or has more numbers than default integers
    !> count: a line for each key that asks for too much, code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error
    type(point_type) :: point
    type(table_type) :: table
    real(dp) :: bytes_each, particles, others, entries
    integer, allocatable :: number(:)
    integer :: at

    estimate%available = available_memory(sharing)
    bytes_each = bytes_per_particle(plan%engine, plan%urn_shape == 'polygon')
    allocate (number(plan%point_count))
    do at = 1, plan%point_count
      point = point_of(plan, at)
      number(at) = point%number
    end do
    estimate%greatest = maxval(number)
    estimate%too_large = count(.not. fits(bytes_each*number))
    estimate%number = maxval(number, mask=fits(bytes_each*number))
    if (estimate%too_large == plan%point_count) estimate%number = minval(number)
    particles = bytes_each*estimate%number
    estimate%task = particles
    estimate%merge = bytes_per_task*real(task_count(plan), dp)
    if (estimate%too_large == plan%point_count) then
      call add_problem(trim(merge('scan     ', 'particles', is_scanned(plan, 'number'))) &
        //' number', to_text(estimate%number)//' particles', particles)
      return
    end if
    others = real(plan%point_count - estimate%too_large, dp)*plan%replicas - 1.0_dp
    if (plan%series_interval > 0.0_wp) then
      entries = 1.0_dp + real(length_of(plan, estimate%number)/plan%series_interval, dp)
      if (plan%duration > 0.0_wp) then
        call add_results('series_interval', 'a series of '//to_text(nint(min(entries, &
          most_numbers)))//' entries', entries, bytes_per_entry, merged_entry, 'entries', '')
      else
        estimate%task = estimate%task + bytes_per_entry*entries
      end if
    end if
    call add_results('snapshot_times', to_text(size(plan%snapshot_times))//' snapshots', &
      real(size(plan%snapshot_times), dp)*estimate%number, bytes_per_state, merged_state, &
      'states', ', snapshots times particles')
    if (plan%final_state) call add_results('final_state', 'final states', &
      real(estimate%number, dp), bytes_per_state, merged_state, 'states', '')
    if (plan%event_log) then
      ! If urns are well mixed, each particle enters a gate at the rate w/(pi A), and crosses a line
      ! at most as often as it enters a channel.
      point = point_of(plan, 1)
      table = table_of(plan, point)
      estimate%events = bytes_per_event*point%number*real(length_of(plan, point%number) &
        *(2.0_wp*point%channel(channel1)%width + point%channel(channel2)%width) &
        /(pi*table%urn(1)%area), dp)
      estimate%task = estimate%task + estimate%events
    end if
    if (.not. (allocated(error) .or. fits(estimate%merge))) call add_problem('scan replicas', &
      'the results of '//to_text(task_count(plan))//' tasks', estimate%merge)

  contains

    !> Whether a process can allocate `bytes` besides what every process needs.
    elemental logical function fits(bytes)
      real(dp), intent(in) :: bytes

      fits = bytes + base_bytes <= estimate%available%bytes
    end function fits

    !> Adds the bytes of series or states, and a problem if there are too many of them.
    subroutine add_results(key, what, count, bytes, merged_bytes, noun, of_what)
      !> Key that asks for them; text for those of one task; what is counted, and in what unit.
      character(len=*), intent(in) :: key, what, noun, of_what
      !> How many a task has; bytes of each in the task, and on rank 0 for each task but the first.
      real(dp), intent(in) :: count, bytes, merged_bytes
      real(dp) :: all_tasks

      all_tasks = bytes*count + merged_bytes*count*others
      estimate%task = estimate%task + bytes*count
      estimate%merge = estimate%merge + all_tasks
      if (count > most_numbers) then
        call add_line('output '//key//' asks for more '//noun//' than can be counted; allowed: ' &
          //to_text(nint(most_numbers))//of_what)
      else if (.not. fits(particles + bytes*count)) then
        call add_problem('output '//key, what//' beside '//to_text(estimate%number) &
          //' particles', particles + bytes*count)
      else if (estimate%too_large == 0 .and. .not. fits(all_tasks)) then
        call add_problem('output '//key, what//' of each of '//to_text(task_count(plan)) &
          //' tasks', all_tasks)
      end if
    end subroutine add_results

    !> Adds the problem that `bytes` for `what` are too many.
    subroutine add_problem(key, what, bytes)
      !> Group and key; what needs the bytes.
      character(len=*), intent(in) :: key, what
      real(dp), intent(in) :: bytes

      call add_line(key//': '//what//' need '//size_text(bytes + base_bytes)//' of memory; ' &
        //size_text(estimate%available%bytes)//' a rank are available (' &
        //estimate%available%limit//')')
    end subroutine add_problem

    !> Adds a line to the error.
    subroutine add_line(text)
      character(len=*), intent(in) :: text
      character(len=:), allocatable :: before

      before = ''
      if (allocated(error)) before = error%message//new_line_character
      call fatal_error(error, before//plan%input_file//': &'//text, exit_bad_input)
    end subroutine add_line

  end subroutine estimate_memory

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

end module battery_memory_estimate
