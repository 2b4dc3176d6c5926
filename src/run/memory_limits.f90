!> Memory: what the parts of a run take, how much can still be had, by this process and by all
!> processes of the machine together, and whether that is enough.
!>
!> What parts take are bounds of what was measured: the peak of the process over that of a run
!> without the part, divided by how many there were (docs/ensembles.md says how). What a plan takes
!> in all is `battery_memory_estimate`'s.
module battery_memory_limits
  use, intrinsic :: iso_c_binding, only: c_int, c_double
  use battery_c_shapes, only: action
  use battery_kinds, only: dp
  use battery_error, only: error_type, fatal_error
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: free_memory_type, memory_left, spare_address_space
  public :: bytes_an_entry, bytes_a_state, bytes_an_event, bytes_a_task
  public :: merged_entry, merged_state, base_bytes, most_numbers
  public :: check_memory, enough_memory, size_text

  !> Bytes of an entry of the series, of a particle's state that is kept (a snapshot's or the final
  !> one) and of an event, at the peak, when the result of the task is written.
  real(dp), parameter :: bytes_an_entry = 130.0_dp, bytes_a_state = 140.0_dp, &
    bytes_an_event = 160.0_dp

  !> Bytes of each task on rank 0 at the end, and of an entry and a state of one task of many there:
  !> these are in the results file, which is made in memory, where they are compressed more or less.
  real(dp), parameter :: bytes_a_task = 800.0_dp, merged_entry = 40.0_dp, merged_state = 35.0_dp

  !> Bytes that every process takes beside all these, and may still take once it has started.
  real(dp), parameter :: base_bytes = 16.0e6_dp

  !> So little is not asked for: it is among `base_bytes`, and a task of next to no work would spend
  !> more time on reading what the system says of its memory than on all else.
  real(dp), parameter :: little = 1.0e6_dp

  !> Most entries of a series, and most states of one task: four numbers of each are counted by
  !> default integers.
  real(dp), parameter :: most_numbers = 0.25_dp*real(huge(1), dp)

  !> Bytes that can still be had, and what limits them, in words.
  type :: free_memory_type
    real(dp) :: bytes = huge(1.0_dp)
    character(len=:), allocatable :: limit
  end type free_memory_type

  real(dp), parameter :: kilobyte = 1024.0_dp

  !> Stands for a number that is not there; in kilobytes it is still a number of bytes.
  real(dp), parameter :: none = huge(1.0_dp)/kilobyte

  !> To be called before there are threads: where address space is limited, they take less of it.
  procedure(action), bind(c, name='limits_spare') :: spare_address_space

  interface
    real(c_double) function limits_memory(of_data) bind(c)
      import :: c_int, c_double
      implicit none (type, external)
      integer(c_int), value, intent(in) :: of_data
    end function limits_memory
  end interface

contains

  !> Whether this process can have so many bytes, and then some to work with.
  logical function enough_memory(bytes) result(enough)
    !> Beside those that the process has already.
    real(dp), intent(in) :: bytes
    type(free_memory_type) :: left

    if (bytes > little) left = memory_left(1)
    enough = bytes <= little .or. bytes + base_bytes <= left%bytes
  end function enough_memory

  !> An error if so many bytes for `what` cannot be had: allocating without asking would end the
  !> program, and where memory is promised that is not there, the system would.
  subroutine check_memory(bytes, what, error)
    !> Beside those that the process has already.
    real(dp), intent(in) :: bytes
    character(len=*), intent(in) :: what
    type(error_type), allocatable, intent(out) :: error
    type(free_memory_type) :: left

    if (enough_memory(bytes)) return
    left = memory_left(1)
    call fatal_error(error, 'no memory for '//what//': '//size_text(bytes + base_bytes) &
      //' are needed, there are '//size_text(left%bytes)//' ('//left%limit//')')
  end subroutine check_memory

  !> A number of bytes as a reader would say it: `35 MB`, `1.2 GB`.
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

  !> What this process can still have, if `sharing` processes of the machine want as much as it.
  type(free_memory_type) function memory_left(sharing) result(left)
    integer, intent(in) :: sharing

    left%limit = 'no limit'
    call limit_by(left, kilobyte*number_after('/proc/meminfo', 'MemAvailable:')/sharing, &
      'free memory')
    call limit_by(left, group_left()/sharing, 'memory of the control group')
    call limit_by(left, under_limit(0_c_int, 'VmSize:'), 'address space, ulimit -v')
    call limit_by(left, under_limit(1_c_int, 'VmData:'), 'data, ulimit -d')
  end function memory_left

  pure subroutine limit_by(left, bytes, limit)
    type(free_memory_type), intent(inout) :: left
    real(dp), intent(in) :: bytes
    character(len=*), intent(in) :: limit

    if (bytes >= left%bytes) return
    left%bytes = max(bytes, 0.0_dp)
    left%limit = limit
  end subroutine limit_by

  !> What a limit of this process leaves, beside what `used` in its status says.
  real(dp) function under_limit(of_data, used) result(bytes)
    integer(c_int), intent(in) :: of_data
    character(len=*), intent(in) :: used

    bytes = limits_memory(of_data)
    if (bytes < 0.0_dp) then
      bytes = huge(1.0_dp)
    else
      bytes = bytes - kilobyte*number_after('/proc/self/status', used)
    end if
  end function under_limit

  !> What the control groups that this process is in, and all above them, leave.
  real(dp) function group_left() result(bytes)
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
        bytes = min(bytes, group_and_parents_left('/sys/fs/cgroup', trim(line(4:)), 'memory.max', &
          'memory.current', 'inactive_file '))
      else if (index(line, ':memory:') > 0) then
        bytes = min(bytes, group_and_parents_left('/sys/fs/cgroup/memory', trim(line(colon + 1:)), &
          'memory.limit_in_bytes', 'memory.usage_in_bytes', 'total_inactive_file '))
      end if
    end do
    close (unit)
  end function group_left

  !> The least memory that a control group or one above it leaves; within a container only the
  !> beginning of the path may exist. Cached pages of files that are not in use count as available.
  function group_and_parents_left(root, path, limit, used, idle) result(bytes)
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
  end function group_and_parents_left

  !> The number that follows a name at the beginning of a line, such as `MemAvailable:  123 kB`;
  !> `none` if there is none, as where it says `max`.
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

end module battery_memory_limits
