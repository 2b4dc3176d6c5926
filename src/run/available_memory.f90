!> Available memory: bytes that the parts of a run need, bytes that this process can still allocate,
!> and whether these suffice.
!>
!> The bytes of each part are upper bounds of measurements: the peak of the process less that of a
!> run without the part, divided by the number of its elements (docs/ensembles.md has the method).
!> `battery_memory_estimate` has the total of a plan.
module battery_available_memory
  use, intrinsic :: iso_c_binding, only: c_int, c_double
  use battery_c_shapes, only: action
  use battery_kinds, only: dp
  use battery_error, only: error_type, fatal_error
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: free_memory_type, available_memory, spare_address_space
  public :: bytes_per_entry, bytes_per_state, bytes_per_event, bytes_per_task
  public :: merged_entry, merged_state, base_bytes, most_numbers
  public :: check_memory, enough_memory, size_text

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

  !> Reduces the address space that threads reserve, if it is limited; to be called before there are
  !> threads.
  procedure(action), bind(c, name='spare_address_space_of_threads') :: spare_address_space

  interface
    real(c_double) function process_memory_limit(of_data) bind(c)
      import :: c_int, c_double
      implicit none (type, external)
      integer(c_int), value, intent(in) :: of_data
    end function process_memory_limit
  end interface

contains

  !> Whether this process can allocate `bytes`, and `base_bytes` besides.
  logical function enough_memory(bytes) result(enough)
    !> Bytes in addition to those allocated already.
    real(dp), intent(in) :: bytes
    type(free_memory_type) :: available

    if (bytes > little) available = available_memory(1)
    enough = bytes <= little .or. bytes + base_bytes <= available%bytes
  end function enough_memory

  !> An error if `bytes` for `what` cannot be allocated: a failed allocation would end the program,
  !> and if the system overcommits memory, it would kill the process.
  subroutine check_memory(bytes, what, error)
    !> Bytes in addition to those allocated already.
    real(dp), intent(in) :: bytes
    character(len=*), intent(in) :: what
    type(error_type), allocatable, intent(out) :: error
    type(free_memory_type) :: available

    if (enough_memory(bytes)) return
    available = available_memory(1)
    call fatal_error(error, 'no memory for '//what//': '//size_text(bytes + base_bytes) &
      //' are needed, '//size_text(available%bytes)//' are available ('//available%limit//')')
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
    call reduce_to_limit(available, kilobyte*number_after('/proc/meminfo', 'MemAvailable:') &
      /sharing, 'free memory')
    call reduce_to_limit(available, bytes_in_groups()/sharing, 'memory of the control group')
    call reduce_to_limit(available, bytes_under_limit(0_c_int, 'VmSize:'), &
      'address space, ulimit -v')
    call reduce_to_limit(available, bytes_under_limit(1_c_int, 'VmData:'), 'data, ulimit -d')
  end function available_memory

  !> Reduces the available memory to `bytes` if that is less.
  pure subroutine reduce_to_limit(available, bytes, limit)
    type(free_memory_type), intent(inout) :: available
    real(dp), intent(in) :: bytes
    character(len=*), intent(in) :: limit

    if (bytes >= available%bytes) return
    available%bytes = max(bytes, 0.0_dp)
    available%limit = limit
  end subroutine reduce_to_limit

  !> Bytes left below a limit of this process; `used` names the used bytes in its status.
  real(dp) function bytes_under_limit(of_data, used) result(bytes)
    integer(c_int), intent(in) :: of_data
    character(len=*), intent(in) :: used

    bytes = process_memory_limit(of_data)
    if (bytes < 0.0_dp) then
      bytes = huge(1.0_dp)
    else
      bytes = bytes - kilobyte*number_after('/proc/self/status', used)
    end if
  end function bytes_under_limit

  !> Bytes left in the control groups of this process, and in all groups above them.
  real(dp) function bytes_in_groups() result(bytes)
    character(len=1024) :: line
    integer :: unit, status, colon

    bytes = huge(1.0_dp)
    open (newunit=unit, file='/proc/self/cgroup', action='read', status='old', iostat=status)
    if (status /= 0) return
    do
      read (unit, '(a)', iostat=status) line
      if (status /= 0) exit
      colon = index(line, ':', back=.true.)
      if (index(line, '0::') == 1) then
        bytes = min(bytes, bytes_in_group_and_parents('/sys/fs/cgroup', trim(line(4:)), &
          'memory.max', 'memory.current', 'inactive_file '))
      else if (index(line, ':memory:') > 0) then
        bytes = min(bytes, bytes_in_group_and_parents('/sys/fs/cgroup/memory', &
          trim(line(colon + 1:)), 'memory.limit_in_bytes', 'memory.usage_in_bytes', &
          'total_inactive_file '))
      end if
    end do
    close (unit)
  end function bytes_in_groups

  !> Least number of bytes left in a control group and the groups above it; within a container only
  !> the beginning of the path may exist. Cached pages of files that are not in use count as
  !> available.
  function bytes_in_group_and_parents(root, path, limit, used, idle) result(bytes)
    character(len=*), intent(in) :: root, path, limit, used, idle
    real(dp) :: bytes, most, now, spare
    integer :: length

    bytes = huge(1.0_dp)
    length = len(path)
    do
      if (path(:length) == '/') length = 0
      most = number_after(root//path(:length)//'/'//limit, '')
      now = number_after(root//path(:length)//'/'//used, '')
      spare = number_after(root//path(:length)//'/memory.stat', idle)
      if (most < none .and. now < none) &
        bytes = min(bytes, most - now + merge(spare, 0.0_dp, spare < most))
      if (length == 0) exit
      length = index(path(:length), '/', back=.true.) - 1
      if (length < 0) exit
    end do
  end function bytes_in_group_and_parents

  !> Number after a name at the beginning of a line of a file, such as `MemAvailable:  123 kB`;
  !> `none` if there is no number, as in `max`.
  real(dp) function number_after(file, name) result(number)
    character(len=*), intent(in) :: file, name
    character(len=256) :: line
    integer :: unit, status

    number = none
    open (newunit=unit, file=file, action='read', status='old', iostat=status)
    if (status /= 0) return
    do
      read (unit, '(a)', iostat=status) line
      if (status /= 0) exit
      if (index(line, name) /= 1) cycle
      read (line(len(name) + 1:), *, iostat=status) number
      if (status /= 0) number = none
      exit
    end do
    close (unit)
  end function number_after

end module battery_available_memory
