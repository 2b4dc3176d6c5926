!> The machine that this process runs on.
module battery_machine
  use, intrinsic :: iso_c_binding, only: c_int
  use battery_c_shapes, only: number_of_text
  implicit none (type, external)
  private
  public :: host_name, machine_text

  procedure(number_of_text), bind(c, name='battery_host_name') :: c_host_name
  procedure(number_of_text), bind(c, name='battery_processor') :: c_processor

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
    character(len=128) :: text
    integer(c_int) :: length

    if (.not. allocated(known)) then
      length = c_processor(text, len(text, c_int))
      known = host_name()//' ('//text(:length)//')'
    end if
    name = known
  end function machine_text

end module battery_machine
