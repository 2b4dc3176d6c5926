!> Single values of a namelist: numbers and logicals, as strictly as the standard has them.
module battery_namelist_values
  use battery_kinds, only: wp, int64
  use battery_text, only: to_text, lower_case
  use battery_namelist_text, only: value_type
  implicit none (type, external)
  private
  public :: read_integer, read_real, read_logical

  !> Digits of a whole number that always fits.
  integer, parameter :: most_digits = 18

contains

  !> A whole number; `wrong` says what is wrong with it, or is empty.
  pure subroutine read_integer(value, number, wrong)
    type(value_type), intent(in) :: value
    integer(int64), intent(out) :: number
    character(len=:), allocatable, intent(out) :: wrong
    character(len=:), allocatable :: digits

    wrong = ''
    number = 0
    digits = unsigned(value%text)
    if (value%quoted .or. digits == '' .or. verify(digits, '0123456789') > 0) then
      wrong = 'is not a whole number'
    else if (len(digits) > most_digits) then
      wrong = 'has more than '//to_text(most_digits)//' digits'
    else
      read (value%text, *) number
    end if
  end subroutine read_integer

  pure function unsigned(text) result(rest)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: rest

    rest = text
    if (scan(text(1:min(1, len(text))), '+-') == 1) rest = text(2:)
  end function unsigned

  !> A finite number, with a point, an exponent (e, d or q) or neither.
  pure subroutine read_real(value, number, wrong)
    type(value_type), intent(in) :: value
    real(wp), intent(out) :: number
    character(len=:), allocatable, intent(out) :: wrong
    character(len=:), allocatable :: digits, mantissa, exponent
    integer :: mark, power, status

    number = 0.0_wp
    wrong = ''
    digits = unsigned(lower_case(value%text))
    if (index(digits, 'nan') == 1 .or. index(digits, 'inf') == 1) then
      wrong = 'is not finite'
      return
    end if
    mark = scan(digits//'e', 'edq')
    mantissa = digits(:mark - 1)
    exponent = unsigned(digits(mark + 1:))
    if (value%quoted .or. scan(mantissa, '0123456789') == 0 .or. &
      verify(mantissa, '0123456789.') > 0 .or. index(mantissa, '.') /= &
      index(mantissa, '.', back=.true.) .or. verify(exponent, '0123456789') > 0 .or. &
      (exponent == '' .and. mark <= len(digits))) then
      wrong = 'is not a number'
      return
    end if
    power = 0
    if (len(exponent) > 6) then
      power = 100000000
    else if (exponent /= '') then
      read (exponent, *) power
    end if
    if (mark < len(digits)) then
      if (digits(mark + 1:mark + 1) == '-') power = -power
    end if
    if (power + index(mantissa//'.', '.') - 1 > range(number) .and. &
      scan(mantissa, '123456789') > 0) then
      wrong = 'is not finite'
    else if (power >= -range(number)) then
      digits = sign_of(value%text)//mantissa//'e'//to_text(power)
      read (digits, *, iostat=status) number
      if (status /= 0) wrong = 'is not a number'
    end if
  end subroutine read_real

  pure function sign_of(text) result(sign_text)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: sign_text

    sign_text = ''
    if (text(1:1) == '-') sign_text = '-'
  end function sign_of

  !> True or false, with or without points, whole or as T and F.
  pure subroutine read_logical(value, flag, wrong)
    type(value_type), intent(in) :: value
    logical, intent(out) :: flag
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
