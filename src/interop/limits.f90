!> How much memory can still be had: by this process, and by all processes of the machine together.
module battery_limits
  use, intrinsic :: iso_c_binding, only: c_int, c_double
  use battery_kinds, only: dp
  implicit none (type, external)
  private
  public :: memory_type, memory_left, spare_address_space

  !> Bytes that can still be had, and what limits them, in words.
  type :: memory_type
    real(dp) :: bytes = huge(1.0_dp)
    character(len=:), allocatable :: limit
  end type memory_type

  real(dp), parameter :: kilobyte = 1024.0_dp

  interface
    function limits_memory(of_data) result(bytes) bind(c)
      import :: c_int, c_double
      implicit none (type, external)
      integer(c_int), value, intent(in) :: of_data
      real(c_double) :: bytes
    end function limits_memory

    subroutine limits_spare() bind(c)
      implicit none (type, external)
    end subroutine limits_spare
  end interface

contains

  !> To be called before there are threads: where address space is limited, they take less of it.
  subroutine spare_address_space()
    call limits_spare()
  end subroutine spare_address_space

  !> What this process can still have, if `sharing` processes of the machine want as much as it.
  function memory_left(sharing) result(left)
    integer, intent(in) :: sharing
    type(memory_type) :: left

    left%limit = 'no limit'
    call limit_by(left, entry_of('/proc/meminfo', 'MemAvailable:')/sharing, 'free memory')
    call limit_by(left, group_left()/sharing, 'memory of the control group')
    call limit_by(left, under_limit(0_c_int, 'VmSize:'), 'address space, ulimit -v')
    call limit_by(left, under_limit(1_c_int, 'VmData:'), 'data, ulimit -d')
  end function memory_left

  pure subroutine limit_by(left, bytes, limit)
    type(memory_type), intent(inout) :: left
    real(dp), intent(in) :: bytes
    character(len=*), intent(in) :: limit

    if (bytes >= left%bytes) return
    left%bytes = max(bytes, 0.0_dp)
    left%limit = limit
  end subroutine limit_by

  !> What a limit of this process leaves, beside what `used` in its status says.
  function under_limit(of_data, used) result(bytes)
    integer(c_int), intent(in) :: of_data
    character(len=*), intent(in) :: used
    real(dp) :: bytes

    bytes = real(limits_memory(of_data), dp)
    if (bytes < 0.0_dp) then
      bytes = huge(1.0_dp)
    else
      bytes = bytes - entry_of('/proc/self/status', used)
    end if
  end function under_limit

  !> An entry such as `MemAvailable:  123 kB` of a file, in bytes; huge if it is not there.
  function entry_of(file, name) result(bytes)
    character(len=*), intent(in) :: file, name
    real(dp) :: bytes
    character(len=256) :: line
    real(dp) :: kilobytes
    integer :: unit, status

    bytes = huge(1.0_dp)
    open (newunit=unit, file=file, action='read', status='old', iostat=status)
    if (status /= 0) return
    do
      read (unit, '(a)', iostat=status) line
      if (status /= 0) exit
      if (index(line, name) /= 1) cycle
      read (line(len(name) + 1:), *, iostat=status) kilobytes
      if (status == 0) bytes = kilobyte*kilobytes
      exit
    end do
    close (unit)
  end function entry_of

  !> What the control groups that this process is in, and all above them, leave.
  function group_left() result(bytes)
    real(dp) :: bytes
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
        bytes = min(bytes, up_from('/sys/fs/cgroup', trim(line(4:)), 'memory.max', &
          'memory.current', 'inactive_file'))
      else if (index(line, ':memory:') > 0) then
        bytes = min(bytes, up_from('/sys/fs/cgroup/memory', trim(line(colon + 1:)), &
          'memory.limit_in_bytes', 'memory.usage_in_bytes', 'total_inactive_file'))
      end if
    end do
    close (unit)
  end function group_left

  !> The least that a group or one above it leaves; within a container the path may not be there,
  !> but its beginning is. Pages of files that nobody reads can be taken.
  function up_from(root, path, limit, used, idle) result(bytes)
    character(len=*), intent(in) :: root, path, limit, used, idle
    real(dp) :: bytes, most, now, spare
    integer :: length

    bytes = huge(1.0_dp)
    length = len(path)
    do
      if (path(:length) == '/') length = 0
      most = number_in(root//path(:length)//'/'//limit)
      now = number_in(root//path(:length)//'/'//used)
      spare = entry_of(root//path(:length)//'/memory.stat', idle//' ')/kilobyte
      if (most < huge(1.0_dp) .and. now < huge(1.0_dp)) &
        bytes = min(bytes, most - now + merge(spare, 0.0_dp, spare < most))
      if (length == 0) exit
      length = index(path(:length), '/', back=.true.) - 1
      if (length < 0) exit
    end do
  end function up_from

  !> The number that a file holds; huge if there is none, as where it says `max`.
  function number_in(file) result(number)
    character(len=*), intent(in) :: file
    real(dp) :: number
    character(len=64) :: line
    integer :: unit, status

    number = huge(1.0_dp)
    open (newunit=unit, file=file, action='read', status='old', iostat=status)
    if (status /= 0) return
    read (unit, '(a)', iostat=status) line
    close (unit)
    if (status /= 0 .or. verify(trim(line), '0123456789') > 0 .or. line == '') return
    read (line, *, iostat=status) number
    if (status /= 0) number = huge(1.0_dp)
  end function number_in

end module battery_limits
