!> Numbers as people write them: one way to read them for namelists and for initial files.
!>
!> Fortran's own input is too kind: it reads `3-2` as 0.03, `2*1` as two numbers, `1,,2` as one that
!> stays what it was, and what is too large or too small as infinite or 0.
module battery_numbers
  use battery_kinds, only: wp, int64
  use battery_text, only: to_text, lower_case
  implicit none (type, external)
  private
  public :: read_whole, read_decimal

  !> Digits of a whole number that always fits.
  integer, parameter :: most_digits = 18

  character(len=*), parameter :: digits = '0123456789'

contains

  !> A whole number: digits, with or without a sign.
  pure subroutine read_whole(text, number, wrong)
    !> Without blanks.
    character(len=*), intent(in) :: text
    !> 0 if something is wrong.
    integer(int64), intent(out) :: number
    !> What is wrong with it; empty: nothing.
    character(len=:), allocatable, intent(out) :: wrong
    integer :: first

    number = 0
    wrong = ''
    first = 1 + sign_length(text)
    if (len(text) < first .or. verify(text(first:), digits) > 0) then
      wrong = 'is not a whole number'
    else if (len(text) - first + 1 > most_digits) then
      wrong = 'has more than '//to_text(most_digits)//' digits'
    else
      read (text, *) number
    end if
  end subroutine read_whole

  !> A number: a sign or none, digits with a point or without, and an exponent or none: e or d, a
  !> sign or none, digits. It must be neither too large nor so small that it would become 0.
  pure subroutine read_decimal(text, number, wrong)
    !> Without blanks.
    character(len=*), intent(in) :: text
    !> 0 if something is wrong.
    real(wp), intent(out) :: number
    !> What is wrong with it; empty: nothing.
    character(len=:), allocatable, intent(out) :: wrong
    integer :: first, last, mark, power, status

    number = 0.0_wp
    wrong = ''
    first = 1 + sign_length(text)
    mark = scan(text, 'eEdD')
    last = merge(mark - 1, len(text), mark > 0)
    if (is_endless(text(first:))) then
      wrong = 'is not finite'
    else if (.not. is_mantissa(text(first:last)) .or. mark == len(text)) then
      wrong = 'is not a number'
    else if (mark > 0) then
      if (.not. is_exponent(text(mark + 1:))) wrong = 'is not a number'
    end if
    if (wrong /= '') return
    ! Zero, however it is written.
    if (scan(text(first:last), '123456789') == 0) then
      if (text(1:1) == '-') number = -number
      return
    end if
    power = power_of(text(first:last))
    if (mark > 0) power = power + exponent_of(text(mark + 1:))
    if (is_beyond(text(first:last), power)) then
      wrong = 'is not finite: the largest number is '//to_text(huge(number))
      return
    end if
    if (power >= least_power()) then
      read (text, *, iostat=status) number
      if (status /= 0) wrong = 'is not a number'
    end if
    if (wrong == '' .and. .not. abs(number) > 0.0_wp) &
      wrong = 'is too near 0: the least number above 0 is '//to_text(tiny(number))
  end subroutine read_decimal

  !> 1 if a text begins with a sign, else 0.
  pure function sign_length(text) result(length)
    character(len=*), intent(in) :: text
    integer :: length

    length = 0
    if (len(text) > 0) length = merge(1, 0, scan(text(1:1), '+-') == 1)
  end function sign_length

  !> Whether this stands for what is not finite.
  pure function is_endless(text) result(yes)
    character(len=*), intent(in) :: text
    logical :: yes
    character(len=3) :: word

    word = lower_case(text(:min(len(text), 3)))
    yes = word == 'nan' .or. word == 'inf'
  end function is_endless

  !> Whether these are digits with at most one point among them.
  pure function is_mantissa(text) result(yes)
    character(len=*), intent(in) :: text
    logical :: yes

    yes = scan(text, digits) > 0 .and. verify(text, digits//'.') == 0 .and. &
      index(text, '.') == index(text, '.', back=.true.)
  end function is_mantissa

  !> Whether these are digits, with or without a sign.
  pure function is_exponent(text) result(yes)
    character(len=*), intent(in) :: text
    logical :: yes

    yes = .false.
    if (len(text) > sign_length(text)) yes = verify(text(1 + sign_length(text):), digits) == 0
  end function is_exponent

  !> The exponent in digits with a sign; beyond a million, some number beyond every real.
  pure function exponent_of(text) result(power)
    character(len=*), intent(in) :: text
    integer :: power
    integer, parameter :: enough = 10**8
    integer :: at

    power = 0
    do at = 1 + sign_length(text), len(text)
      power = min(10*power + index(digits, text(at:at)) - 1, enough)
    end do
    if (text(1:1) == '-') power = -power
  end function exponent_of

  !> The power of ten of the first digit that is not 0.
  pure function power_of(mantissa) result(power)
    character(len=*), intent(in) :: mantissa
    integer :: power
    integer :: point, first

    point = index(mantissa//'.', '.')
    first = scan(mantissa, '123456789')
    power = point - first
    if (first < point) power = power - 1
  end function power_of

  !> Whether a number, whose first digit stands for this power of ten, is beyond the largest real.
  pure function is_beyond(mantissa, power) result(beyond)
    character(len=*), intent(in) :: mantissa
    integer, intent(in) :: power
    logical :: beyond
    character(len=60) :: largest
    integer :: at, next, most

    write (largest, '(es60.35e4)') huge(1.0_wp)
    largest = adjustl(largest)
    read (largest(index(largest, 'E') + 1:), *) most
    beyond = power > most
    if (power /= most) return
    ! Digit by digit.
    next = 1
    do at = scan(mantissa, '123456789'), len(mantissa)
      if (mantissa(at:at) == '.') cycle
      if (largest(next:next) == '.') next = next + 1
      if (largest(next:next) == 'E') exit
      beyond = mantissa(at:at) > largest(next:next)
      if (mantissa(at:at) /= largest(next:next)) exit
      next = next + 1
    end do
  end function is_beyond

  !> The least power of ten of which any digit can be told from 0.
  pure function least_power() result(power)
    integer :: power

    power = -range(1.0_wp) - precision(1.0_wp) - 4
  end function least_power

end module battery_numbers
