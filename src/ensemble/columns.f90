!> Numbers and rates as a run prints them: in the columns of its tables, and in its lines.
module battery_columns
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use battery_kinds, only: dp
  use battery_terminal, only: print_line
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: print_row, whole_text, number_text, rate_text

contains

  !> Prints a name and, from the same column on in all lines, what there is to say of it.
  subroutine print_row(name, text)
    !> Name of at most 11 characters; empty: the line belongs to the one before.
    character(len=*), intent(in) :: name
    !> Text without a line end.
    character(len=*), intent(in) :: text
    integer, parameter :: first_column = 12

    call print_line(name//repeat(' ', first_column - len(name))//text)
  end subroutine print_row

  !> An integer in `width` columns, or, if it does not fit, a blank and the integer.
  pure function whole_text(number, width) result(text)
    !> Any integer; number of columns.
    integer, intent(in) :: number, width
    character(len=:), allocatable :: text

    text = repeat(' ', max(1, width - len(to_text(number))))//to_text(number)
  end function whole_text

  !> A number in `width` columns with `digits` decimals; with an exponent if it is too large for
  !> that, or so small that no digit would be visible; a dash if it is not known.
  pure function number_text(number, width, digits) result(text)
    !> Any number, or NaN.
    real(dp), intent(in) :: number
    !> Number of columns, and of decimals.
    integer, intent(in) :: width, digits
    character(len=width) :: text

    text = repeat(' ', width - 1)//'-'
    if (ieee_is_nan(number)) return
    write (text, '(f'//to_text(width)//'.'//to_text(digits)//')') number
    if (index(text, '*') == 0 .and. .not. (abs(number) > 0.0_dp .and. abs(number) &
      < 1.0e-3_dp*0.1_dp**digits)) return
    write (text, '(es'//to_text(width)//'.'//to_text(min(width - 7, digits))//')') number
  end function number_text

  !> A rate with three digits, such as `2.13e8`.
  pure function rate_text(rate) result(text)
    !> Rate in any unit, not negative.
    real(dp), intent(in) :: rate
    character(len=:), allocatable :: text
    character(len=32) :: buffer
    integer :: power

    power = 0
    if (rate > 0.0_dp) power = floor(log10(rate))
    write (buffer, '(f4.2, a, i0)') rate/10.0_dp**power, 'e', power
    text = trim(buffer)
  end function rate_text

end module battery_columns
