!> Texts: numbers and durations as texts, lists of words, printable characters.
module battery_text
  use, intrinsic :: iso_fortran_env, only: int32, int64, real32, real64, real128
  use battery_kinds, only: wp, dp
  implicit none (type, external)
  private
  public :: string_type, to_text, lower_case, join, numbers_text, lines_of, closest_word, is_one_of
  public :: new_line_character, printable, count_text, duration_text, rate_text

  character(len=1), parameter :: new_line_character = achar(10)

  !> Kind of the widest reals: 128 bits, or 80 if a compiler has none of 128. It must differ from
  !> the other kinds, or `to_text` would have two procedures for one kind.
  integer, parameter :: widest = merge(real128, selected_real_kind(18), real128 > 0)

  !> A text of any length, for lists of them.
  type :: string_type
    character(len=:), allocatable :: text
  end type string_type

  !> Text of a `number` (integer or real), or of a logical `value`; reals with as few digits as are
  !> needed to read the same number back.
  interface to_text
    module procedure :: int32_text, int64_text, real32_text, real64_text, widest_text, &
      logical_text
  end interface to_text

contains

  !> Text of an integer of 32 bits.
  pure function int32_text(number) result(text)
    integer(int32), intent(in) :: number
    character(len=:), allocatable :: text

    text = int64_text(int(number, int64))
  end function int32_text

  !> Text of an integer of 64 bits.
  pure function int64_text(number) result(text)
    integer(int64), intent(in) :: number
    character(len=:), allocatable :: text
    character(len=24) :: buffer

    write (buffer, '(i0)') number
    text = trim(buffer)
  end function int64_text

  !> Text of a real of 32 bits.
  pure function real32_text(number) result(text)
    real(real32), intent(in) :: number
    character(len=:), allocatable :: text

    text = shortest_text(real(number, real64), 9, precision(number), real(tiny(number), real64), &
      1.0e38_real64)
  end function real32_text

  !> Text of a real of 64 bits.
  pure function real64_text(number) result(text)
    real(real64), intent(in) :: number
    character(len=:), allocatable :: text

    text = shortest_text(number, 17, precision(number), tiny(number), 1.0e307_real64)
  end function real64_text

  !> The shortest text that is read as the same number. The least number of digits tried is
  !> `safe_digits`, the number of decimal digits that reals preserve (trailing zeros are dropped
  !> later); 1 for numbers below `least_normal`, which have fewer digits; and `max_digits` above
  !> `rounding_limit`, since rounding to fewer digits could overflow.
  pure function shortest_text(number, max_digits, safe_digits, least_normal, &
    rounding_limit) result(text)
    real(real64), intent(in) :: number
    !> Number of digits that distinguishes any two numbers; fewer than 17: the number has 32 bits.
    integer, intent(in) :: max_digits
    integer, intent(in) :: safe_digits
    real(real64), intent(in) :: least_normal, rounding_limit
    character(len=:), allocatable :: text
    character(len=40) :: buffer, layout
    real(real64) :: again
    integer :: digits

    digits = merge(safe_digits, 1, abs(number) >= least_normal)
    if (.not. abs(number) < rounding_limit) digits = max_digits
    do digits = digits, max_digits
      write (layout, '(a, i0, a)') '(es40.', digits - 1, 'e3)'
      write (buffer, layout) number
      if (.not. abs(number) <= huge(number)) exit
      read (buffer, *) again
      if (max_digits < 17) again = real(real(again, real32), real64)
      if (.not. abs(again - number) > 0.0_real64) exit
    end do
    text = plain_notation(trim(adjustl(buffer)))
  end function shortest_text

  !> Text of a real of the widest kind.
  pure function widest_text(number) result(text)
    real(widest), intent(in) :: number
    character(len=:), allocatable :: text
    character(len=60) :: buffer

    if (.not. abs(real(real(number, real64), widest) - number) > 0.0_widest) then
      text = real64_text(real(number, real64))
    else
      write (buffer, '(es60.34e4)') number
      text = plain_notation(trim(adjustl(buffer)))
    end if
  end function widest_text

  !> Text of a logical value.
  pure function logical_text(value) result(text)
    logical, intent(in) :: value
    character(len=:), allocatable :: text

    text = trim(merge('.true. ', '.false.', value))
  end function logical_text

  !> Plain notation of a number in scientific notation: 12.5 for `1.25E+001`; far from 1, 1.25e+9.
  pure function plain_notation(scientific) result(text)
    character(len=*), intent(in) :: scientific
    character(len=:), allocatable :: text, sign, digits
    integer :: mark, exponent, count

    mark = scan(scientific, 'Ee')
    if (mark == 0 .or. scan(scientific, '0123456789') == 0) then
      text = scientific
      return
    end if
    read (scientific(mark + 1:), *) exponent
    sign = ''
    if (scientific(1:1) == '-') sign = '-'
    digits = scientific(len(sign) + 1:len(sign) + 1)//scientific(len(sign) + 3:mark - 1)
    count = max(verify(digits, '0', back=.true.), 1)
    digits = digits(:count)
    if (exponent < -4 .or. exponent > 8) then
      text = sign//digits(1:1)
      if (count > 1) text = text//'.'//digits(2:)
      text = text//'e'//int32_text(int(exponent, int32))
    else if (exponent < 0) then
      text = sign//'0.'//repeat('0', -exponent - 1)//digits
    else if (count <= exponent + 1) then
      text = sign//digits//repeat('0', exponent + 1 - count)
    else
      text = sign//digits(:exponent + 1)//'.'//digits(exponent + 2:)
    end if
  end function plain_notation

  !> The text with A to Z in lower case.
  pure function lower_case(text) result(lower)
    !> Text of any letters.
    character(len=*), intent(in) :: text
    character(len=len(text)) :: lower
    integer :: at

    lower = text
    do at = 1, len(text)
      if (text(at:at) < 'A' .or. text(at:at) > 'Z') cycle
      lower(at:at) = achar(iachar(text(at:at)) + 32)
    end do
  end function lower_case

  !> The lines of a text; the last may lack its end.
  pure function lines_of(text) result(lines)
    !> Any text; an empty one has no lines.
    character(len=*), intent(in) :: text
    type(string_type), allocatable :: lines(:)
    type(string_type) :: line
    integer :: at, last

    allocate (lines(0))
    at = 1
    do while (at <= len(text))
      last = index(text(at:)//new_line_character, new_line_character) + at - 2
      line%text = text(at:last)
      lines = [lines, line]
      at = last + 2
    end do
  end function lines_of

  !> Text for a terminal: every control character except tab and line feed becomes `\x` and two
  !> hexadecimal digits. Text of a file might contain sequences that move the cursor or send input
  !> to the shell. In UTF-8 the bytes 80 to 9F continue a character; alone, or after C2, they are
  !> control characters too.
  pure function printable(text) result(clean)
    !> Text of any origin, in ASCII or UTF-8.
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: clean
    logical :: control(len(text))
    integer :: at, length, code, before, next

    before = 0
    do at = 1, len(text)
      code = iachar(text(at:at))
      next = 0
      if (at < len(text)) next = iachar(text(at + 1:at + 1))
      select case (code)
      case (9, 10)
        control(at) = .false.
      case (0:8, 11:31, 127)
        control(at) = .true.
      case (128:159)
        control(at) = before < 128 .or. before == 194
      case default
        control(at) = code == 194 .and. next >= 128 .and. next < 160
      end select
      before = code
    end do
    allocate (character(len=len(text) + 3*count(control)) :: clean)
    length = 0
    do at = 1, len(text)
      if (control(at)) then
        write (clean(length + 1:length + 4), '(a, z2.2)') '\x', iachar(text(at:at))
        length = length + 4
      else
        clean(length + 1:length + 1) = text(at:at)
        length = length + 1
      end if
    end do
  end function printable

  !> Numbers as texts, with a separator between them.
  pure function numbers_text(numbers, separator) result(text)
    real(wp), intent(in) :: numbers(:)
    !> Text between each two of them.
    character(len=*), intent(in) :: separator
    character(len=:), allocatable :: text
    type(string_type) :: words(size(numbers))
    integer :: k

    do k = 1, size(numbers)
      words(k)%text = to_text(numbers(k))
    end do
    text = join(words, separator)
  end function numbers_text

  !> All texts of a list, with a separator between them.
  pure function join(list, separator) result(text)
    !> Texts to join, in this order.
    type(string_type), intent(in) :: list(:)
    !> Text between each two of them.
    character(len=*), intent(in) :: separator
    character(len=:), allocatable :: text
    integer :: at, length

    length = max(size(list) - 1, 0)*len(separator)
    do at = 1, size(list)
      length = length + len(list(at)%text)
    end do
    allocate (character(len=length) :: text)
    length = 0
    do at = 1, size(list)
      if (at > 1) then
        text(length + 1:length + len(separator)) = separator
        length = length + len(separator)
      end if
      text(length + 1:length + len(list(at)%text)) = list(at)%text
      length = length + len(list(at)%text)
    end do
  end function join

  !> Whether `word` is in `list`, trailing blanks included.
  pure logical function is_one_of(word, list) result(found)
    character(len=*), intent(in) :: word
    type(string_type), intent(in) :: list(:)
    integer :: at

    found = .false.
    do at = 1, size(list)
      if (list(at)%text == word .and. len(list(at)%text) == len(word)) found = .true.
    end do
  end function is_one_of

  !> The word of a list that is most similar to a misspelt one; empty if none is similar.
  pure function closest_word(word, list) result(closest)
    !> Word as it was written.
    character(len=*), intent(in) :: word
    !> Candidates.
    type(string_type), intent(in) :: list(:)
    character(len=:), allocatable :: closest
    integer :: at, distance, least

    closest = ''
    least = max(1, len(word)/3) + 1
    do at = 1, size(list)
      distance = edit_distance(word, list(at)%text)
      if (distance < least) then
        least = distance
        closest = list(at)%text
      end if
    end do
  end function closest_word

  !> Levenshtein distance: least number of letters inserted, deleted or replaced from one word to
  !> the other.
  pure integer function edit_distance(one, other) result(distance)
    character(len=*), intent(in) :: one, other
    integer :: row(0:len(other)), diagonal, above, first, second

    row = [(second, second=0, len(other))]
    do first = 1, len(one)
      diagonal = row(0)
      row(0) = first
      do second = 1, len(other)
        above = row(second)
        row(second) = min(above + 1, row(second - 1) + 1, &
          diagonal + merge(0, 1, one(first:first) == other(second:second)))
        diagonal = above
      end do
    end do
    distance = row(len(other))
  end function edit_distance

  !> A number with a noun: `1 point`, `2 points`.
  pure function count_text(number, noun) result(text)
    !> Number of things counted.
    integer, intent(in) :: number
    !> Noun in the singular; its plural ends with s.
    character(len=*), intent(in) :: noun
    character(len=:), allocatable :: text

    text = to_text(number)//' '//noun
    if (number /= 1) text = text//'s'
  end function count_text

  !> A duration in the largest suitable units: `8 s`, `3 min 20 s`, `2 h 05 min`.
  pure function duration_text(seconds) result(text)
    !> Time in seconds; a negative one is shown as 0.
    real(dp), intent(in) :: seconds
    character(len=:), allocatable :: text
    character(len=32) :: buffer
    integer(int64) :: whole

    whole = nint(min(max(seconds, 0.0_dp), 1.0e12_dp), int64)
    if (seconds < 0.095_dp) then
      write (buffer, '(f5.3, a)') max(seconds, 0.0_dp), ' s'
    else if (seconds < 9.95_dp) then
      write (buffer, '(f3.1, a)') max(seconds, 0.0_dp), ' s'
    else if (whole < 60) then
      write (buffer, '(i0, a)') whole, ' s'
    else if (whole < 3600) then
      write (buffer, '(i0, a, i0, a)') whole/60, ' min ', mod(whole, 60_int64), ' s'
    else
      write (buffer, '(i0, a, i2.2, a)') whole/3600, ' h ', mod(whole, 3600_int64)/60, ' min'
    end if
    text = trim(buffer)
  end function duration_text

  !> A rate with three digits, such as `2.13e8`.
  pure function rate_text(rate) result(text)
    !> Rate in any unit, not negative.
    real(dp), intent(in) :: rate
    character(len=:), allocatable :: text
    character(len=32) :: buffer
    integer :: power

    power = 0
    if (rate > 0.0_dp) power = floor(log10(rate))
    if (rate/10.0_dp**power >= 9.995_dp) power = power + 1  ! its digits are 10.00
    write (buffer, '(f4.2, a, i0)') rate/10.0_dp**power, 'e', power
    text = trim(buffer)
  end function rate_text

end module battery_text
