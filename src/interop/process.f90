!> This process, the machine that it runs on, and what the system's files say of both.
module battery_process
  use, intrinsic :: iso_c_binding, only: c_int
  use battery_c_shapes, only: action, returns_number, number_of_text
  implicit none (type, external)
  private
  public :: exit_process, exit_after, set_home, process_number, host_name, machine_text, text_after

  interface
    !> Ends the program, without the message `STOP` of Fortran.
    subroutine exit_process(code) bind(c, name='exit')
      import :: c_int
      implicit none (type, external)
      !> Exit code, 0 to 255.
      integer(c_int), value, intent(in) :: code
    end subroutine exit_process

    !> Ends the program after a time, even if it is blocked.
    subroutine exit_after(seconds, code) bind(c, name='process_leave_after')
      import :: c_int
      implicit none (type, external)
      !> Time from now on.
      integer(c_int), value, intent(in) :: seconds
      !> Exit code, 0 to 255.
      integer(c_int), value, intent(in) :: code
    end subroutine exit_after
  end interface

  !> Sets the variable HOME of a user whom the machine does not know.
  procedure(action), bind(c, name='process_set_home') :: set_home

  !> Process identifier of this process.
  procedure(returns_number), bind(c, name='getpid') :: process_number

  procedure(number_of_text), bind(c, name='battery_host_name') :: c_host_name

contains

  !> Name of this machine, without blanks.
  function host_name() result(name)
    character(len=:), allocatable :: name
    character(len=128) :: text
    integer(c_int) :: length

    length = c_host_name(text, len(text, c_int))
    name = text(:length)
  end function host_name

  !> Name of this machine and model of its processor, `name (model)`; determined once.
  function machine_text() result(name)
    character(len=:), allocatable :: name
    character(len=:), allocatable, save :: known
    character(len=:), allocatable :: model

    if (.not. allocated(known)) then
      model = text_after('/proc/cpuinfo', 'model name')
      known = host_name()//' ('//model(index(model, ': ') + 2:)//')'
    end if
    name = known
  end function machine_text

  !> Rest of the first line of a file in which a name begins the line or follows a colon, such as
  !> `  123 kB` after `MemAvailable:`; empty if there is none, or no such file.
  function text_after(file, name) result(text)
    !> File of the system, such as `/proc/meminfo`; only the first 1024 bytes of a line are read.
    character(len=*), intent(in) :: file
    !> Text before what is returned.
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: text
    character(len=1024) :: line
    integer :: unit, status, at

    text = ''
    open (newunit=unit, file=file, action='read', status='old', iostat=status)
    if (status /= 0) return
    do
      read (unit, '(a)', iostat=status) line
      if (status /= 0) exit
      at = index(':'//line, ':'//name)
      if (at == 0) cycle
      text = trim(line(at + len(name):))
      exit
    end do
    close (unit)
  end function text_after

end module battery_process
