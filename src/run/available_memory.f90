!> Memory: bytes that a plan and parts of a run need, bytes that this process can still allocate,
!> and whether these suffice.
!>
!> The bytes of each part are upper bounds of measurements: the peak of the process less that of a
!> run without the part, divided by the number of its elements.
module battery_available_memory
  use battery_kinds, only: wp, dp, pi
  use battery_engines, only: bytes_per_particle
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_keys, only: key_radius
  use battery_plan, only: plan_type, point_type, point_of, table_of, is_scanned
  use battery_process, only: text_after
  use battery_table, only: table_type, channel1, channel2
  use battery_text, only: to_text, new_line_character
  implicit none (type, external)
  private
  public :: free_memory_type, available_memory, need_type, check_memory, size_text
  public :: estimate_type, estimate_memory, check_memory_for_mpi

  !> Largest number of series entries, of events, and of stored states of one task: up to eight
  !> numbers of each are counted by default integers.
  integer, parameter, public :: most_kept = 2**28 - 1

  !> Bytes that every process needs besides, and may still allocate after its start; of a rank
  !> without tasks, with what a process has allocated when it reads the available memory.
  real(dp), parameter :: base_bytes = 16.0e6_dp, every_rank = 30.0e6_dp + base_bytes

  !> Requests up to this are not checked: `base_bytes` includes them, and a very short task would
  !> spend most of its time on reading the state of the system's memory.
  real(dp), parameter :: little = 1.0e6_dp

  !> Address space that MPI needs while it starts: Open MPI 4.1 has large parts of 54 MB. With less,
  !> some versions crash.
  real(dp), parameter :: start_bytes = 64.0e6_dp

  !> Bytes on rank 0 at the end of a series entry and of a state, if there are many tasks: the
  !> results file is made in memory, where these are compressed.
  real(dp), parameter :: merged_entry = 40.0_dp, merged_state = 35.0_dp

  !> What needs memory: bytes of particles in an engine; numbers of entries of the series, of stored
  !> states of a particle (of a snapshot, or the final one), of events, and of tasks that are
  !> finished.
  type :: need_type
    real(dp) :: bytes = 0.0_dp, entries = 0.0_dp, states = 0.0_dp, events = 0.0_dp, tasks = 0.0_dp
  end type need_type

  !> Bytes that can still be allocated, and the text for what limits them.
  type :: free_memory_type
    real(dp) :: bytes = huge(1.0_dp)
    character(len=:), allocatable :: limit
  end type free_memory_type

  !> Memory for a plan, at the largest point that fits.
  type :: estimate_type
    !> What is available to a rank.
    type(free_memory_type) :: available
    !> Bytes of a rank for a task, and of rank 0 at the end for the results of all tasks. The length
    !> of an event log is not known beforehand, nor that of a series without a duration: `task` has
    !> estimates of them.
    real(dp) :: task = every_rank, merge = every_rank
    !> Bytes of `task` that are events.
    real(dp) :: events = 0.0_dp
    !> Number of particles of the largest point, and of the largest that fits; number of points that
    !> do not fit.
    integer :: greatest = 0, number = 0, too_large = 0
  end type estimate_type

  !> Bytes. `none` is a missing number: as a number of kilobytes, its bytes are still finite.
  real(dp), parameter :: kilobyte = 1024.0_dp, none = huge(1.0_dp)/kilobyte

contains

  !> Bytes at the peak, when the result of a task, or of all tasks, is written.
  pure real(dp) function bytes_of(need) result(bytes)
    type(need_type), intent(in) :: need

    bytes = need%bytes + 130.0_dp*need%entries + 140.0_dp*need%states + 160.0_dp*need%events &
      + 800.0_dp*need%tasks
  end function bytes_of

  !> An error if what is needed, and `base_bytes` besides, cannot be allocated: a failed allocation
  !> would end the program, and if the system overcommits memory, it would kill the process.
  subroutine check_memory(need, what, error)
    !> Needed in addition to what is allocated already; text for it.
    type(need_type), intent(in) :: need
    character(len=*), intent(in) :: what
    type(error_type), allocatable, intent(out) :: error
    type(free_memory_type) :: available

    if (bytes_of(need) <= little) return
    available = available_memory(1)
    if (bytes_of(need) + base_bytes > available%bytes) call fatal_error(error, 'no memory for ' &
      //what//': '//size_text(bytes_of(need) + base_bytes)//' are needed, ' &
      //size_text(available%bytes)//' are available ('//available%limit//')')
  end subroutine check_memory

  !> A number of bytes with a unit, rounded up: `35 MB`, `12 GB`.
  pure function size_text(bytes) result(text)
    !> Not negative.
    real(dp), intent(in) :: bytes
    character(len=:), allocatable :: text
    character(len=32) :: buffer

    write (buffer, '(es8.1, a)') bytes, ' bytes'
    text = trim(adjustl(buffer))
    if (bytes < 9.995e15_dp) text = to_text(ceiling(bytes/1.0e9_dp))//' GB'
    if (bytes < 9.995e9_dp) text = to_text(ceiling(bytes/1.0e6_dp))//' MB'
  end function size_text

  !> Memory that this process can still allocate, if `sharing` processes on the machine need equal
  !> amounts.
  type(free_memory_type) function available_memory(sharing) result(available)
    integer, intent(in) :: sharing

    character(len=*), parameter :: limits(6) = [character(len=27) :: 'no limit', 'free memory', &
      'memory of the control group', 'memory of the control group', 'address space, ulimit -v', &
      'data, ulimit -d']
    real(dp) :: left(size(limits))

    left = [huge(1.0_dp), kilobyte*number_after('/proc/meminfo', 'MemAvailable:')/sharing, &
      bytes_in_groups('/sys/fs/cgroup', '0::', 'memory.max', 'memory.current', &
      '')/sharing, bytes_in_groups('/sys/fs/cgroup/memory', 'memory:', &
      'memory.limit_in_bytes', 'memory.usage_in_bytes', 'total_')/sharing, &
      bytes_left(number_after('/proc/self/limits', 'Max address space'), &
      kilobyte*number_after('/proc/self/status', 'VmSize:')), &
      bytes_left(number_after('/proc/self/limits', 'Max data size'), &
      kilobyte*number_after('/proc/self/status', 'VmData:'))]
    available%bytes = max(minval(left), 0.0_dp)
    available%limit = trim(limits(minloc(left, dim=1)))
  end function available_memory

  !> Least number of bytes left in the control group of this process and the groups above it; within
  !> a container only the beginning of the path may exist. Cached pages of files and the system's
  !> own tables, in older groups all its memory, count as available: most of it is given back.
  real(dp) function bytes_in_groups(root, controller, limit, used, total) result(bytes)
    !> Folder of all groups; what stands before the path in the list of the process' groups; names
    !> of the limit and of used bytes; what stands before the names of cached bytes.
    character(len=*), intent(in) :: root, controller, limit, used, total
    character(len=:), allocatable :: group
    real(dp) :: most, cached

    bytes = huge(1.0_dp)
    group = text_after('/proc/self/cgroup', controller)
    if (group == '') return
    group = root//group
    do while (len(group) >= len(root))
      most = number_after(group//'/'//limit, '')
      cached = counted(number_after(group//'/memory.stat', total//'inactive_file ')) &
        + counted(number_after(group//'/memory.stat', total//'active_file ')) &
        + counted(number_after(group//'/memory.stat', 'slab_reclaimable ')) &
        + counted(number_after(group//'/memory.kmem.usage_in_bytes', ''))
      bytes = min(bytes, bytes_left(most, number_after(group//'/'//used, '')) &
        + merge(cached, 0.0_dp, cached < most))
      group = group(:index(group, '/', back=.true.) - 1)
    end do
  end function bytes_in_groups

  !> A number of bytes; 0 if it is `none`.
  pure real(dp) function counted(bytes)
    real(dp), intent(in) :: bytes

    counted = merge(bytes, 0.0_dp, bytes < none)
  end function counted

  !> Bytes below a limit that are not in use yet; any number of them if either is `none`.
  pure real(dp) function bytes_left(limit, used)
    real(dp), intent(in) :: limit, used

    bytes_left = merge(limit - used, huge(1.0_dp), max(limit, used) < none)
  end function bytes_left

  !> Number after a name in a file of the system; `none` if there is no number, as in `max` or
  !> `unlimited`.
  real(dp) function number_after(file, name) result(number)
    character(len=*), intent(in) :: file, name
    character(len=:), allocatable :: text
    integer :: status

    text = text_after(file, name)
    read (text, *, iostat=status) number
    if (status /= 0) number = none
  end function number_after

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
    real(dp) :: bytes_each, particles, room, others, entries, states
    real(wp) :: length
    integer, allocatable :: number(:)
    integer :: at, tasks

    tasks = plan%point_count*plan%replicas
    estimate%available = available_memory(sharing)
    room = estimate%available%bytes - base_bytes
    bytes_each = bytes_per_particle(plan%engine, plan%urn_shape == 'polygon')
    allocate (number(plan%point_count))
    do at = 1, plan%point_count
      point = point_of(plan, at)
      number(at) = point%number
    end do
    if (bytes_each*minval(number) > room) then
      call add_problem(trim(merge('scan     ', 'particles', is_scanned(plan, 'number'))) &
        //' number: '//to_text(minval(number))//' particles', bytes_each*minval(number))
      return
    end if
    estimate%greatest = maxval(number)
    estimate%too_large = count(bytes_each*number > room)
    estimate%number = maxval(number, mask=bytes_each*number <= room)
    particles = bytes_each*estimate%number
    estimate%task = estimate%task + particles
    estimate%merge = estimate%merge + bytes_of(need_type(tasks=tasks))
    others = real(plan%point_count - estimate%too_large, dp)*plan%replicas - 1.0_dp
    ! The mean time between the wall collisions of a particle in an urn is pi r/2.
    length = plan%duration
    if (.not. length > 0.0_wp) length = real(plan%collisions, wp)*0.5_wp*pi &
      *maxval(plan%base%of(key_radius)%real)/estimate%number
    entries = 0.0_dp
    if (plan%series_interval > 0.0_wp) entries = 1.0_dp + real(length/plan%series_interval, dp)
    if (plan%duration > 0.0_wp) then
      call add_results('series_interval', 'a series of '//to_text(nint(min(entries, &
        real(most_kept, dp))))//' entries', need_type(entries=entries), 'entries', '')
    else
      estimate%task = estimate%task + bytes_of(need_type(entries=entries))
    end if
    states = real(estimate%number, dp)
    call add_results('snapshot_times', to_text(size(plan%snapshot_times))//' snapshots', &
      need_type(states=states*size(plan%snapshot_times)), 'states', ', snapshots times particles')
    if (plan%final_state) call add_results('final_state', 'final states', &
      need_type(states=states), 'states', '')
    if (plan%event_log) then
      ! There is one point. If urns are well mixed, each particle enters a gate at the rate
      ! w/(pi A), and crosses a line at most as often as it enters a channel.
      table = table_of(plan, point)
      estimate%events = bytes_of(need_type(events=states*real(length*(2.0_wp*point%channel( &
        channel1)%width + point%channel(channel2)%width)/(pi*table%urn(1)%area), dp)))
      estimate%task = estimate%task + estimate%events
    end if
    if (.not. allocated(error) .and. estimate%merge - every_rank > room) call add_problem( &
      'scan replicas: the results of '//to_text(tasks)//' tasks', estimate%merge - every_rank)

  contains

    !> Adds the bytes of series or states, and a problem if there are too many of them.
    subroutine add_results(key, what, need, noun, of_what)
      !> Key that asks for them; text for those of one task; how many it has.
      character(len=*), intent(in) :: key, what
      type(need_type), intent(in) :: need
      !> What is counted, and in what unit.
      character(len=*), intent(in) :: noun, of_what
      real(dp) :: all_tasks

      all_tasks = bytes_of(need) + (merged_entry*need%entries + merged_state*need%states)*others
      estimate%task = estimate%task + bytes_of(need)
      estimate%merge = estimate%merge + all_tasks
      if (need%entries + need%states > most_kept) then
        call add_problem('output '//key//' asks for more '//noun//' than can be counted; ' &
          //'allowed: '//to_text(most_kept)//of_what)
      else if (particles + bytes_of(need) > room) then
        call add_problem('output '//key//': '//what//' beside '//to_text(estimate%number) &
          //' particles', particles + bytes_of(need))
      else if (estimate%too_large == 0 .and. all_tasks > room) then
        call add_problem('output '//key//': '//what//' of each of '//to_text(tasks)//' tasks', &
          all_tasks)
      end if
    end subroutine add_results

    !> Adds a line to the error.
    subroutine add_problem(text, bytes)
      !> Group and key, and what is wrong, or what needs too many bytes.
      character(len=*), intent(in) :: text
      real(dp), intent(in), optional :: bytes
      character(len=:), allocatable :: line

      line = plan%input_file//': &'//text
      if (present(bytes)) line = line//' need '//size_text(bytes + base_bytes)//' of memory; ' &
        //size_text(estimate%available%bytes)//' a rank are available (' &
        //estimate%available%limit//')'
      if (allocated(error)) line = error%message//new_line_character//line
      call fatal_error(error, line, exit_bad_input)
    end subroutine add_problem

  end subroutine estimate_memory

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

end module battery_available_memory
