!> Available memory: bytes that the parts of a run need, bytes that this process can still allocate,
!> and whether these suffice.
!>
!> The bytes of each part are upper bounds of measurements: the peak of the process less that of a
!> run without the part, divided by the number of its elements.
!> `battery_memory_estimate` has the total of a plan.
module battery_available_memory
  use battery_kinds, only: dp
  use battery_error, only: error_type, fatal_error
  use battery_process, only: text_after
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: free_memory_type, available_memory
  public :: bytes_per_entry, bytes_per_state, bytes_per_event, bytes_per_task
  public :: merged_entry, merged_state, base_bytes, most_numbers
  public :: check_memory, size_text

  !> Bytes of an entry of the series, of a particle's stored state (of a snapshot, or the final one)
  !> and of an event, at the peak, when the result of the task is written.
  real(dp), parameter :: bytes_per_entry = 130.0_dp, bytes_per_state = 140.0_dp, &
    bytes_per_event = 160.0_dp

  !> Bytes on rank 0 at the end: of each task, and of a series entry and a state if there are many
  !> tasks. The results file is made in memory, where these are compressed.
  real(dp), parameter :: bytes_per_task = 800.0_dp, merged_entry = 40.0_dp, merged_state = 35.0_dp

  !> Bytes that every process needs besides, and may still allocate after its start.
  real(dp), parameter :: base_bytes = 16.0e6_dp

  !> Requests up to this are not checked: `base_bytes` includes them, and a very short task would
  !> spend most of its time on reading the state of the system's memory.
  real(dp), parameter :: little = 1.0e6_dp

  !> Largest number of series entries, and of states of one task: four numbers of each are counted
  !> by default integers.
  real(dp), parameter :: most_numbers = 0.25_dp*real(huge(1), dp)

  !> Bytes that can still be allocated, and the text for what limits them.
  type :: free_memory_type
    real(dp) :: bytes = huge(1.0_dp)
    character(len=:), allocatable :: limit
  end type free_memory_type

  real(dp), parameter :: kilobyte = 1024.0_dp

  !> Stands for a missing number; as a number of kilobytes, its bytes are still finite.
  real(dp), parameter :: none = huge(1.0_dp)/kilobyte

contains

  !> An error if `bytes` for `what`, and `base_bytes` besides, cannot be allocated: a failed
  !> allocation would end the program, and if the system overcommits memory, it would kill the
  !> process.
  subroutine check_memory(bytes, what, error)
    !> Bytes in addition to those allocated already.
    real(dp), intent(in) :: bytes
    character(len=*), intent(in) :: what
    type(error_type), allocatable, intent(out) :: error
    type(free_memory_type) :: available

    if (bytes <= little) return
    available = available_memory(1)
    if (bytes + base_bytes > available%bytes) call fatal_error(error, 'no memory for '//what//': ' &
      //size_text(bytes + base_bytes)//' are needed, '//size_text(available%bytes) &
      //' are available ('//available%limit//')')
  end subroutine check_memory

  !> A number of bytes with a unit, rounded up: `35 MB`, `12 GB`.
  pure function size_text(bytes) result(text)
    !> Not negative.
    real(dp), intent(in) :: bytes
    character(len=:), allocatable :: text
    character(len=32) :: buffer

    if (bytes < 9.995e9_dp) then
      text = to_text(ceiling(bytes/1.0e6_dp))//' MB'
    else if (bytes < 9.995e15_dp) then
      text = to_text(ceiling(bytes/1.0e9_dp))//' GB'
    else
      write (buffer, '(es8.1, a)') bytes, ' bytes'
      text = trim(adjustl(buffer))
    end if
  end function size_text

  !> Memory that this process can still allocate, if `sharing` processes on the machine need equal
  !> amounts.
  type(free_memory_type) function available_memory(sharing) result(available)
    integer, intent(in) :: sharing

    available%limit = 'no limit'
    call reduce(kilobyte*number_after('/proc/meminfo', 'MemAvailable:')/sharing, 'free memory')
    call reduce(bytes_in_groups('/sys/fs/cgroup', '0::', 'memory.max', 'memory.current', &
      'inactive_file ')/sharing, 'memory of the control group')
    call reduce(bytes_in_groups('/sys/fs/cgroup/memory', 'memory:', 'memory.limit_in_bytes', &
      'memory.usage_in_bytes', 'total_inactive_file ')/sharing, 'memory of the control group')
    call reduce(bytes_left(number_after('/proc/self/limits', 'Max address space'), &
      kilobyte*number_after('/proc/self/status', 'VmSize:')), 'address space, ulimit -v')
    call reduce(bytes_left(number_after('/proc/self/limits', 'Max data size'), &
      kilobyte*number_after('/proc/self/status', 'VmData:')), 'data, ulimit -d')

  contains

    !> Reduces the available memory to `bytes` if that is less.
    subroutine reduce(bytes, limit)
      real(dp), intent(in) :: bytes
      character(len=*), intent(in) :: limit

      if (bytes >= available%bytes) return
      available%bytes = max(bytes, 0.0_dp)
      available%limit = limit
    end subroutine reduce

  end function available_memory

  !> Least number of bytes left in the control group of this process and the groups above it; within
  !> a container only the beginning of the path may exist. Cached pages of files that are not in use
  !> count as available.
  real(dp) function bytes_in_groups(root, controller, limit, used, idle) result(bytes)
    !> Folder of all groups; what stands before the path in the list of the process' groups; names
    !> of the limit, and of used bytes and bytes of idle pages.
    character(len=*), intent(in) :: root, controller, limit, used, idle
    character(len=:), allocatable :: group
    real(dp) :: most, spare

    bytes = huge(1.0_dp)
    group = text_after('/proc/self/cgroup', controller)
    if (group == '') return
    group = root//group
    do while (len(group) >= len(root))
      most = number_after(group//'/'//limit, '')
      spare = number_after(group//'/memory.stat', idle)
      bytes = min(bytes, bytes_left(most, number_after(group//'/'//used, '')) &
        + merge(spare, 0.0_dp, spare < most))
      group = group(:index(group, '/', back=.true.) - 1)
    end do
  end function bytes_in_groups

  !> Bytes below a limit that are not in use yet; any number of them if either is `none`.
  pure real(dp) function bytes_left(limit, used)
    real(dp), intent(in) :: limit, used

    bytes_left = huge(1.0_dp)
    if (max(limit, used) < none) bytes_left = limit - used
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

end module battery_available_memory
