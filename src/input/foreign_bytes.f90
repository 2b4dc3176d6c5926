!> Bytes that do not belong into an input file, though they may look as if they did: no-break
!> spaces and minus signs of word processors, files in UTF-16, line ends of old systems. They are
!> named with their place, since they cannot be seen.
module battery_foreign_bytes
  use battery_findings, only: findings_type, finding_of, add_finding, findings_text
  use battery_text, only: to_text, new_line_character
  implicit none (type, external)
  private
  public :: text_start, namelist_problem, foreign_byte_text, unseen_bytes_text, is_other_dash, &
    is_results_file

  character(len=1), parameter :: tab = achar(9), return_sign = achar(13)

  !> Sequences of bytes that occur in files, in hexadecimal, and what they are. The first ones
  !> cannot be seen, the next ones look like a dash.
  integer, parameter :: unseen = 6, dashes(5) = [7, 8, 9, 10, 11]
  character(len=9), parameter :: sequence(18) = [character(len=9) :: 'C2 A0', 'E2 80 AF', &
    'C2 AD', 'E2 80 8B', 'E2 81 A0', 'EF BB BF', 'E2 88 92', 'E2 80 90', 'E2 80 91', 'E2 80 93', &
    'E2 80 94', 'E2 80 98', 'E2 80 99', 'E2 80 9C', 'E2 80 9D', 'FF FE', 'FE FF', '0D']
  character(len=32), parameter :: meaning(18) = [character(len=32) :: 'a no-break space', &
    'a no-break space', 'a soft hyphen', 'a space of no width', 'a space of no width', &
    'a byte order mark', 'a minus sign, U+2212', 'a hyphen, U+2010', 'a hyphen, U+2011', &
    'a dash', 'a dash', 'a typographic quote', &
    'a typographic quote', 'a typographic quote', 'a typographic quote', &
    'the file is UTF-16 or UTF-32', 'the file is UTF-16 or UTF-32', 'a carriage return alone']

contains

  !> Where a text begins: after its byte order mark, which some editors write.
  pure integer function text_start(text) result(first)
    !> Text of a whole file.
    character(len=*), intent(in) :: text

    first = 1
    if (index(text, char(239)//char(187)//char(191)) == 1) first = 4
  end function text_start

  !> The first foreign byte of a namelist, outside of comments and texts in quotes: a message with
  !> its line and column; empty if there is none. A carriage return alone, after which a comment
  !> would go on, is not allowed in comments either.
  pure function namelist_problem(text, name) result(message)
    !> Text of the whole file, and its name.
    character(len=*), intent(in) :: text, name
    character(len=:), allocatable :: message
    type(findings_type) :: problems
    character(len=1) :: quote, sign
    logical :: comment
    integer :: at, line, line_start

    quote = ''
    comment = .false.
    line = 1
    line_start = text_start(text)
    do at = line_start, len(text)
      sign = text(at:at)
      if (sign == new_line_character) then
        quote = ''
        comment = .false.
        line = line + 1
        line_start = at + 1
      else if (quote /= '') then
        if (sign == quote) quote = ''
      else if (is_foreign(text, at) .and. (sign == return_sign .or. .not. comment)) then
        call add_finding(problems, finding_of(line, foreign_byte_text(text(line_start:)), &
          'ASCII outside of comments and texts in quotes'))
        exit
      else if (.not. comment) then
        comment = sign == '!'
        if (sign == '"' .or. sign == achar(39)) quote = sign
      end if
    end do
    message = findings_text(problems, name)
  end function namelist_problem

  !> Whether the byte at a position is neither printable ASCII nor a blank, nor part of a line end.
  pure logical function is_foreign(text, at) result(yes)
    character(len=*), intent(in) :: text
    integer, intent(in) :: at
    integer, parameter :: first_visible = 32, delete = 127

    select case (text(at:at))
    case (tab, new_line_character)
      yes = .false.
    case (return_sign)
      yes = at < len(text)
      if (yes) yes = text(at + 1:at + 1) /= new_line_character
    case default
      yes = iachar(text(at:at)) < first_visible .or. iachar(text(at:at)) >= delete
    end select
  end function is_foreign

  !> The first foreign byte of a line, with the others of its sign, what they are, and the column;
  !> empty: there is none.
  pure function foreign_byte_text(line) result(message)
    !> Text of a line, with its line end; more lines may follow.
    character(len=*), intent(in) :: line
    character(len=:), allocatable :: message
    integer :: at, last, k

    message = ''
    do at = 1, len(line)
      if (is_foreign(line, at)) exit
    end do
    if (at > len(line)) return
    ! Of a sign in UTF-8 the bytes after the first are 80 to BF; UTF-16 begins with FF FE or FE FF.
    last = at
    do while (last < min(len(line), at + 3) .and. iachar(line(at:at)) >= 192)
      k = iachar(line(last + 1:last + 1))
      if (.not. (k >= 128 .and. k < 192) .and. .not. (at == 1 .and. last == 1 .and. k >= 254)) exit
      last = last + 1
    end do
    message = hexadecimal(line(at:last))
    k = findloc(sequence == message, .true., dim=1)
    if (k > 0) message = message//' ('//trim(meaning(k))//')'
    message = 'has the byte'//trim(merge('s', ' ', last > at))//' '//message//' in column ' &
      //to_text(at)
  end function foreign_byte_text

  !> The bytes of a sign that cannot be seen, such as a no-break space, with which a text begins or
  !> ends, and what they are; empty: none. Within names of files there may be any sign of UTF-8.
  pure function unseen_bytes_text(text) result(message)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: message
    integer :: k, length

    message = ''
    do k = 1, unseen
      length = (len_trim(sequence(k)) + 1)/3
      if (length > len(text)) cycle
      if (hexadecimal(text(:length)) == sequence(k)) message = 'begins with'
      if (hexadecimal(text(len(text) - length + 1:)) == sequence(k)) message = 'ends with'
      if (message == '') cycle
      message = message//' the bytes '//trim(sequence(k))//' ('//trim(meaning(k))//')'
      return
    end do
  end function unseen_bytes_text

  !> Whether a text begins with a sign that looks like the dash of an option.
  pure logical function is_other_dash(text) result(yes)
    character(len=*), intent(in) :: text

    yes = len(text) >= 3
    if (yes) yes = any(sequence(dashes) == hexadecimal(text(:3)))
  end function is_other_dash

  !> Bytes as numbers in hexadecimal, with blanks between.
  pure function hexadecimal(bytes) result(text)
    character(len=*), intent(in) :: bytes
    character(len=3*len(bytes) - 1) :: text
    integer :: at

    write (text, '(*(z2.2, :, 1x))') (iachar(bytes(at:at)), at=1, len(bytes))
  end function hexadecimal

  !> Whether the bytes of a file are those of an HDF5 file, such as a results file.
  pure logical function is_results_file(text) result(yes)
    !> The first bytes of the file, or all.
    character(len=*), intent(in) :: text

    yes = index(text, char(137)//'HDF'//return_sign//new_line_character) == 1
  end function is_results_file

end module battery_foreign_bytes
