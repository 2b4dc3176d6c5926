!> Single values of a namelist: numbers and logicals, none of them in quotes.
module battery_namelist_values
  use battery_kinds, only: wp, int64
  use battery_text, only: lower_case
  use battery_numbers, only: read_whole, read_decimal
  use battery_namelist_text, only: value_type
  implicit none (type, external)
  private
  public :: read_integer, read_real, read_logical

contains

  !> A whole number; `wrong` says what is wrong with it, or is empty.
  pure subroutine read_integer(value, number, wrong)
    type(value_type), intent(in) :: value
    !> 0 if something is wrong.
    integer(int64), intent(out) :: number
    character(len=:), allocatable, intent(out) :: wrong

    call read_whole(value%text, number, wrong)
    if (value%quoted) wrong = 'is not a whole number'
  end subroutine read_integer

  !> A finite number; `wrong` says what is wrong with it, or is empty.
  pure subroutine read_real(value, number, wrong)
    type(value_type), intent(in) :: value
    !> 0 if something is wrong.
    real(wp), intent(out) :: number
    character(len=:), allocatable, intent(out) :: wrong

    call read_decimal(value%text, number, wrong)
    if (value%quoted) wrong = 'is not a number'
  end subroutine read_real

  !> True or false, with or without points, whole or as T and F.
  pure subroutine read_logical(value, flag, wrong)
    type(value_type), intent(in) :: value
    !> False if something is wrong.
    logical, intent(out) :: flag
    !> What is wrong with it; empty: nothing.
    character(len=:), allocatable, intent(out) :: wrong

    wrong = ''
    flag = .false.
    select case (lower_case(value%text))
    case ('.true.', 'true', '.t.', 't')
      flag = .true.
    case ('.false.', 'false', '.f.', 'f')
      flag = .false.
    case default
      wrong = 'is neither true nor false'
    end select
    if (value%quoted) wrong = 'is a text'
  end subroutine read_logical

end module battery_namelist_values
