!> Strict parsing of numbers, for namelists and initial files.
!>
!> Fortran's own input is too tolerant: it reads `3-2` as 0.03, `2*1` as two numbers, the empty
!> value in `1,,2` as no change, and a number that is too large or too small as infinity or 0.
module battery_numbers
  use, intrinsic :: ieee_exceptions, only: ieee_status_type, ieee_overflow, ieee_get_status, &
    ieee_set_halting_mode, ieee_set_status
  use battery_kinds, only: wp, int64
  use battery_text, only: to_text, lower_case
  implicit none (type, external)
  private
  public :: read_whole, read_decimal

  !> Number of digits up to which any integer fits.
  integer, parameter :: most_digits = 18

  character(len=*), parameter :: digits = '0123456789'

contains

  !> Parses an integer: digits, with or without a sign.
  pure subroutine read_whole(text, number, wrong)
    !> Text of a number, without blanks.
    character(len=*), intent(in) :: text
    !> The number; 0 if the text is invalid.
    integer(int64), intent(out) :: number
    !> Problem of the text; empty: none.
    character(len=:), allocatable, intent(out) :: wrong

    number = 0
    wrong = ''
    if (.not. is_whole(text)) then
      wrong = 'is not a whole number'
    else if (len(text) - sign_length(text) > most_digits) then
      wrong = 'has more than '//to_text(most_digits)//' digits'
    else
      read (text, *) number
    end if
  end subroutine read_whole

  !> Parses a real: an optional sign, digits with an optional point, and an optional exponent (e or
  !> d, an optional sign, digits). It must be neither too large nor so small that it would become 0.
  subroutine read_decimal(text, number, wrong)
    !> Text of a number, without blanks.
    character(len=*), intent(in) :: text
    !> The number; 0 if the text is invalid.
    real(wp), intent(out) :: number
    !> Problem of the text; empty: none.
    character(len=:), allocatable, intent(out) :: wrong
    type(ieee_status_type) :: before
    integer :: first, last, mark, status

    number = 0.0_wp
    wrong = ''
    first = 1 + sign_length(text)
    mark = scan(text, 'eEdD')
    last = merge(mark - 1, len(text), mark > 0)
    if (any(lower_case(text(first:min(first + 2, len(text)))) == ['inf', 'nan'])) then
      wrong = 'is not finite'
    else if (.not. is_mantissa(text(first:last))) then
      wrong = 'is not a number'
    else if (mark > 0) then
      if (.not. is_whole(text(mark + 1:))) wrong = 'is not a number'
    end if
    if (wrong /= '') return
    ! A number that is too large becomes infinity with one compiler, which must not end a program
    ! that traps overflows; with another it is an error of the read.
    call ieee_get_status(before)
    call ieee_set_halting_mode(ieee_overflow, .false.)
    read (text, *, iostat=status) number
    call ieee_set_status(before)
    if (status /= 0 .or. abs(number) > huge(number)) then
      wrong = 'is not finite: the largest number is '//to_text(huge(number))
    else if (.not. abs(number) > 0.0_wp .and. scan(text(first:last), '123456789') > 0) then
      wrong = 'is too near 0: the least number above 0 is '//to_text(nearest(0.0_wp, 1.0_wp))
    end if
    if (wrong /= '') number = 0.0_wp
  end subroutine read_decimal

  !> 1 if a text begins with a sign, else 0.
  pure integer function sign_length(text) result(length)
    character(len=*), intent(in) :: text

    length = 0
    if (len(text) > 0) length = merge(1, 0, scan(text(1:1), '+-') == 1)
  end function sign_length

  !> Whether a text consists of digits and at most one point.
  pure logical function is_mantissa(text) result(yes)
    character(len=*), intent(in) :: text

    yes = scan(text, digits) > 0 .and. verify(text, digits//'.') == 0 .and. &
      index(text, '.') == index(text, '.', back=.true.)
  end function is_mantissa

  !> Whether a text consists of digits, with or without a sign.
  pure logical function is_whole(text) result(yes)
    character(len=*), intent(in) :: text

    yes = .false.
    if (len(text) > sign_length(text)) yes = verify(text(1 + sign_length(text):), digits) == 0
  end function is_whole

end module battery_numbers
