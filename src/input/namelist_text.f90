!> Reads the text of a namelist file entry by entry: groups, and keys with their values.
!>
!> The syntax is that of Fortran's own namelist input (comments, both quotes, lists, repeat counts,
!> `/` or `&end`, any case), but line numbers are stored, and parsing continues after an error. A
!> `/` right before a text, as in a path, does not end a group: that is a mistake.
module battery_namelist_text
  use battery_text, only: to_text, lower_case
  use battery_foreign_bytes, only: text_start
  use battery_findings, only: findings_type, finding_of, add_finding, displayable_text
  implicit none (type, external)
  private
  public :: value_type, entry_type, reader_type, reader_of, read_next, written_text

  !> Largest number of values of one key, including repeats.
  integer, parameter, public :: most_values = 100000
  !> Largest total number of letters of a repeated text.
  integer, parameter :: most_letters = 10000000

  !> In place of the last index of a list: any, none that is allowed.
  integer, parameter :: any_index = -1, no_index = -2

  !> One value as written, without its quotes.
  type :: value_type
    character(len=:), allocatable :: text
    logical :: quoted = .false.
  end type value_type

  !> An entry `key = values`, or the beginning of a group, `&group`: then key and values are not
  !> allocated.
  type :: entry_type
    !> Group and key in small letters.
    character(len=:), allocatable :: group, key
    integer :: line = 0
    type(value_type), allocatable :: values(:)
    !> Whether a problem of the key itself is reported already; its values are not used then.
    logical :: refused = .false.
  end type entry_type

  !> Position of the reader in a text.
  type :: reader_type
    private
    character(len=:), allocatable :: text
    integer :: at = 1, line = 1
    !> The group that is being read, which has not ended, and its line; not allocated outside of
    !> groups.
    character(len=:), allocatable :: group
    integer :: group_line = 0
    !> Group and name of the last key of which a part was given, which is one problem however many
    !> parts there are.
    character(len=:), allocatable :: key_in_parts
    !> Whether text could not be read, and was skipped up to a group: what it sets is not known.
    logical, public :: has_skipped_text = .false.
    !> Whether there is no such group: what is in it is not judged.
    logical, public :: is_in_unknown_group = .false.
    !> Values of the key that is being read.
    type(value_type), allocatable :: values(:)
  end type reader_type

  character(len=1), parameter :: tab = achar(9), line_end = achar(10), return_sign = achar(13)
  character(len=*), parameter :: letters = 'abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ'
  character(len=*), parameter :: name_signs = letters//'0123456789_'
  !> Characters that end a value without quotes.
  character(len=*), parameter :: value_ends = ' ,/!&='//tab//line_end//return_sign//achar(39)//'"'

contains

  !> A reader at the beginning of a text.
  pure type(reader_type) function reader_of(text) result(reader)
    !> Text of the whole file.
    character(len=*), intent(in) :: text

    reader%text = text
    reader%at = text_start(text)
    reader%key_in_parts = ''
    allocate (reader%values(most_values))
  end function reader_of

  !> Reads the next entry: the beginning of a group, or a key with its values. Syntax errors are
  !> added to `problems`, and what follows is parsed nevertheless.
  subroutine read_next(reader, entry, problems)
    type(reader_type), intent(inout) :: reader
    !> The entry; at the end of the text its group is not allocated.
    type(entry_type), intent(out) :: entry
    type(findings_type), intent(inout) :: problems

    do while (.not. allocated(entry%group))
      call skip_blanks(reader, allocated(reader%group))
      if (allocated(reader%group)) then
        call read_in_group(reader, entry, problems)
      else if (at_end(reader)) then
        exit
      else if (begins_group(reader)) then
        reader%at = reader%at + 1
        entry%line = reader%line
        call read_before(reader, verify(reader%text(reader%at:), name_signs), entry%group)
        entry%group = lower_case(entry%group)
        reader%group = entry%group
        reader%group_line = entry%line
        reader%is_in_unknown_group = .false.
      else
        call add_finding(problems, finding_of(reader%line, 'text outside of any group: ' &
          //rest_of_line(reader)//'; a group begins with &name and ends with /'))
        call skip_to_group(reader)
      end if
    end do
  end subroutine read_next

  !> Text of values as written, shortened if there are many.
  pure function written_text(values) result(text)
    !> Values of one key.
    type(value_type), intent(in) :: values(:)
    character(len=:), allocatable :: text
    integer, parameter :: shown = 80
    integer :: at

    text = ''
    do at = 1, size(values)
      if (at > 1) text = text//', '
      if (values(at)%quoted) then
        text = text//''''//values(at)%text//''''
      else
        text = text//values(at)%text
      end if
      if (len(text) > shown) then
        text = text(:shown)//' ...'
        return
      end if
    end do
  end function written_text

  !> Reads the end of a group, which may be missing, or a key with its values.
  subroutine read_in_group(reader, entry, problems)
    type(reader_type), intent(inout) :: reader
    !> Its group is allocated if there is a key.
    type(entry_type), intent(inout) :: entry
    type(findings_type), intent(inout) :: problems

    if (ends_group(reader)) then
      reader%at = reader%at + merge(1, 4, next_sign(reader) == '/')
    else if (at_end(reader) .or. begins_group(reader)) then
      if (.not. (reader%has_skipped_text .or. reader%is_in_unknown_group)) call add_finding( &
        problems, finding_of(reader%group_line, 'the / that ends the group is missing', &
        group=reader%group))
    else
      call read_entry(reader, entry, problems)
      return
    end if
    deallocate (reader%group)
  end subroutine read_in_group

  !> Parses an entry `key = values`.
  subroutine read_entry(reader, entry, problems)
    type(reader_type), intent(inout) :: reader
    !> Does not change if there is no key.
    type(entry_type), intent(inout) :: entry
    type(findings_type), intent(inout) :: problems
    character(len=:), allocatable :: key, name
    integer :: line, last_index, before

    line = reader%line
    call read_before(reader, verify(reader%text(reader%at:), name_signs), key)
    key = lower_case(key)
    name = '&'//displayable_text(reader%group)//' '//displayable_text(key)
    if (key == '' .or. key == 'end') then
      if (key == '') key = rest_of_line(reader)
      call add_form_finding(reader, 'a key was expected at: '//key//'; a group ends with &end, ' &
        //'or with a / without text right after it', problems)
      call skip_to_group(reader)
      return
    end if
    call skip_blanks(reader, .false.)
    last_index = any_index
    if (next_sign(reader) == '(') call read_index(reader, last_index)
    before = problems%count
    allocate (entry%values(0))
    if (next_sign(reader) == '=') then
      reader%at = reader%at + 1
      call read_values(reader, name, entry%values, problems)
    else
      if (next_sign(reader) == '%') then
        call add_form_finding(reader, name//': keys have no parts, and no %', problems, line)
      else
        call add_form_finding(reader, name//': = is missing', problems, line)
      end if
      call skip_to_group(reader)
    end if
    entry%refused = problems%count > before
    if (last_index /= any_index .and. last_index /= size(entry%values) .and. &
      .not. entry%refused) then
      entry%refused = .true.
      if (name /= reader%key_in_parts) call add_form_finding(reader, name &
        //': parts of a key cannot be set; allowed: '//displayable_text(key) &
        //' = ..., with all its values and no index', problems, line)
      reader%key_in_parts = name
    end if
    entry%group = reader%group
    entry%key = key
    entry%line = line
  end subroutine read_entry

  !> Parses what follows the name of a key up to its =: an index from 1, as f90nml writes it, such
  !> as `(1:n)` for all n values, `(1:)` or `(1)`.
  subroutine read_index(reader, last)
    type(reader_type), intent(inout) :: reader
    !> n; `any_index` if there is none, `no_index` if this is no index from 1.
    integer, intent(out) :: last
    character(len=:), allocatable :: index_text
    integer :: length, at

    length = scan(reader%text(reader%at:reader%at + line_length(reader) - 1), '=') - 1
    if (length < 0) length = line_length(reader)
    associate (written => reader%text(reader%at:reader%at + length - 1))
      allocate (character(len=0) :: index_text)
      do at = 1, length
        if (scan(written(at:at), ' '//tab) == 0) index_text = index_text//written(at:at)
      end do
    end associate
    reader%at = reader%at + length
    last = no_index
    at = len(index_text)
    if (index_text == '(1)' .or. index_text == '(1:)') then
      last = any_index
    else if (index(index_text, '(1:') == 1 .and. index_text(at:) == ')') then
      ! More digits than `most_values` has are no number of values.
      if (at - 4 <= 6 .and. verify(index_text(4:at - 1), '0123456789') == 0) &
        read (index_text(4:at - 1), *) last
    end if
  end subroutine read_index

  !> Parses the values of a key, up to the next key or the end of the group.
  subroutine read_values(reader, name, values, problems)
    type(reader_type), intent(inout) :: reader
    !> Group and key.
    character(len=*), intent(in) :: name
    type(value_type), allocatable, intent(out) :: values(:)
    type(findings_type), intent(inout) :: problems
    type(value_type) :: value
    integer :: repeats, count, line, last_line
    character(len=:), allocatable :: problem, rest
    logical :: after_comma

    count = 0
    last_line = reader%line
    after_comma = .true.
    do
      call skip_blanks(reader, .false.)
      if (at_end(reader)) exit
      line = reader%line
      select case (next_sign(reader))
      case ('/')
        if (ends_group(reader)) exit
        call add_mistake('a / that ends a group has no text right after it; texts are written in ' &
          //'quotes, comments begin with !')
        call skip_to_group(reader)
        exit
      case ('&')
        if (begins_group(reader) .or. ends_group(reader)) exit
        rest = rest_of_line(reader)
        if (index(lower_case(adjustl(rest(2:))), 'end') == 1) then
          call add_mistake('&end is one word')
        else
          call add_mistake('it goes on in the next line without &')
        end if
        call skip_to_group(reader)
        exit
      case (',')
        if (after_comma) call add_mistake('a value is missing before a comma')
        after_comma = .true.
        reader%at = reader%at + 1
        cycle
      case default
        if (key_follows(reader, count > 0 .and. line > last_line)) exit
      end select
      last_line = line
      call read_value(reader, value, repeats, problem)
      after_comma = .false.
      if (problem /= '') then
        call add_mistake(problem)
      else if (count + repeats > most_values) then
        if (count <= most_values) &
          call add_mistake('too many values; allowed: '//to_text(most_values))
        count = most_values + 1
      else if (repeats > 1 .and. len(value%text) > most_letters/repeats) then
        call add_mistake('too long to repeat; letters allowed in all: '//to_text(most_letters))
      else
        reader%values(count + 1:count + repeats) = value
        count = count + repeats
      end if
    end do
    values = reader%values(:min(count, most_values))

  contains

    !> Adds a problem on the values of this key.
    subroutine add_mistake(text)
      character(len=*), intent(in) :: text

      call add_form_finding(reader, name//': '//text, problems, line)
    end subroutine add_mistake

  end subroutine read_values

  !> Parses one value and its repeat count.
  subroutine read_value(reader, value, repeats, problem)
    type(reader_type), intent(inout) :: reader
    type(value_type), intent(out) :: value
    integer, intent(out) :: repeats
    character(len=:), allocatable, intent(out) :: problem
    character(len=:), allocatable :: word
    integer :: star

    problem = ''
    repeats = 1
    call read_before(reader, scan(reader%text(reader%at:), value_ends), word)
    star = index(word, '*')
    if (star > 1 .and. verify(word(:star - 1), '0123456789') == 0) then
      if (star > 8) then
        problem = 'too many values: '//displayable_text(word)
        return
      end if
      read (word(:star - 1), *) repeats
      word = word(star + 1:)
    end if
    value%text = word
    if (word == '(' .and. next_sign(reader) == '/') then
      problem = 'a list is written without (/ and /)'
      call skip_to_group(reader)
    else if (word == '' .and. scan(next_sign(reader), '"'//achar(39)) == 1) then
      value%quoted = .true.
      call read_quoted(reader, value%text, problem)
    else if (word == '') then
      problem = 'a value was expected at: '//rest_of_line(reader)
      call skip_to_group(reader)
    end if
    if (repeats == 0) problem = 'a value is repeated 0 times'
  end subroutine read_value

  !> Parses a text in quotes, in which a doubled quote is one quote.
  subroutine read_quoted(reader, text, problem)
    type(reader_type), intent(inout) :: reader
    character(len=:), allocatable, intent(out) :: text
    character(len=:), allocatable, intent(inout) :: problem
    character(len=1) :: quote
    integer :: length

    quote = next_sign(reader)
    text = ''
    do
      reader%at = reader%at + 1
      length = index(reader%text(reader%at:reader%at + line_length(reader) - 1), quote) - 1
      if (length < 0) exit
      text = text//reader%text(reader%at:reader%at + length - 1)
      reader%at = reader%at + length + 1
      if (next_sign(reader) /= quote) return
      text = text//quote
    end do
    text = text//reader%text(reader%at:reader%at + line_length(reader) - 1)
    call skip_to_group(reader)
    problem = 'the quote that ends '//quote//displayable_text(text)//' is missing in its line'
  end subroutine read_quoted

  !> Adds a problem of the form, unless there is no such group.
  pure subroutine add_form_finding(reader, text, problems, line)
    type(reader_type), intent(in) :: reader
    !> What is wrong.
    character(len=*), intent(in) :: text
    type(findings_type), intent(inout) :: problems
    !> The line, if it is not that of the reader.
    integer, intent(in), optional :: line
    integer :: at

    if (reader%is_in_unknown_group) return
    at = reader%line
    if (present(line)) at = line
    call add_finding(problems, finding_of(at, text))
  end subroutine add_form_finding

  !> Whether the next characters are & and a name, which is not `end`.
  pure logical function begins_group(reader) result(begins)
    type(reader_type), intent(in) :: reader

    begins = next_sign(reader) == '&' .and. reader%at < len(reader%text)
    if (begins) begins = scan(reader%text(reader%at + 1:reader%at + 1), name_signs) == 1 &
      .and. .not. ends_group(reader)
  end function begins_group

  !> Whether the next characters are `&end`, or / with no text right after it, as in a path.
  pure logical function ends_group(reader) result(ends)
    type(reader_type), intent(in) :: reader
    character(len=5) :: next

    next = lower_case(reader%text(reader%at:min(len(reader%text), reader%at + 4)))
    ends = next(:4) == '&end' .and. scan(next(5:), name_signs) == 0
    if (next(1:1) == '/') ends = scan(next(2:2), name_signs//'./~') == 0
  end function ends_group

  !> Whether the next characters are a name and =, so that the values have ended. In a line after
  !> that of a value, a name and a number or a quote are a key that lacks its =.
  logical function key_follows(reader, in_new_line) result(follows)
    type(reader_type), intent(in) :: reader
    !> Whether these characters are in a line after that of a value.
    logical, intent(in) :: in_new_line
    type(reader_type) :: ahead
    character(len=:), allocatable :: name, rest
    logical :: is_end

    ! The end of a group in old programs.
    follows = lower_case(reader%text(reader%at:min(len(reader%text), reader%at + 3))) == '$end'
    if (scan(next_sign(reader), letters) == 0) return
    ahead%text = reader%text(reader%at:min(len(reader%text), reader%at + 1000))
    call read_before(ahead, verify(ahead%text(ahead%at:), name_signs), name)
    name = lower_case(name)
    ! A path may begin with it.
    is_end = name == 'end' .and. scan(next_sign(ahead), './') == 0
    call skip_blanks(ahead, .false.)
    follows = next_sign(ahead) == '=' .or. is_end .or. (in_new_line .and. &
      scan(next_sign(ahead), '0123456789+-.:"'//achar(39)) == 1 .and. &
      all(name /= [character(len=8) :: 'nan', 'inf', 'infinity', 'end']))
    ! A value such as range(1, 9) is no key.
    rest = rest_of_line(ahead)
    if (next_sign(ahead) == '(') follows = index(adjustl(rest(index(rest, ')') + 1:)), '=') == 1
    if (next_sign(ahead) == '%') follows = index(rest, '=') > 0
  end function key_follows

  !> Skips blanks, line ends and comments, and commas if `commas`.
  pure subroutine skip_blanks(reader, commas)
    type(reader_type), intent(inout) :: reader
    logical, intent(in) :: commas

    do while (.not. at_end(reader))
      select case (next_sign(reader))
      case (line_end)
        reader%line = reader%line + 1
        reader%at = reader%at + 1
      case (' ', tab, return_sign)
        reader%at = reader%at + 1
      case ('!')
        call skip_line(reader)
      case (',')
        if (.not. commas) return
        reader%at = reader%at + 1
      case default
        return
      end select
    end do
  end subroutine skip_blanks

  !> Skips what cannot be read, which is one problem, up to a line that begins with a group.
  pure subroutine skip_to_group(reader)
    type(reader_type), intent(inout) :: reader

    reader%has_skipped_text = .true.
    do
      call skip_line(reader)
      call skip_blanks(reader, .false.)
      if (at_end(reader) .or. begins_group(reader)) return
    end do
  end subroutine skip_to_group

  !> Skips the rest of a line; the line end itself is not skipped.
  pure subroutine skip_line(reader)
    type(reader_type), intent(inout) :: reader

    reader%at = reader%at + line_length(reader)
  end subroutine skip_line

  !> The rest of a line, for a message.
  pure function rest_of_line(reader) result(rest)
    type(reader_type), intent(in) :: reader
    character(len=:), allocatable :: rest

    rest = displayable_text(trim(reader%text(reader%at:reader%at + line_length(reader) - 1)))
    if (rest == '') rest = 'the end of the line'
  end function rest_of_line

  !> Number of characters up to the end of the line.
  pure integer function line_length(reader) result(length)
    type(reader_type), intent(in) :: reader

    length = index(reader%text(reader%at:), line_end) - 1
    if (length < 0) length = len(reader%text) - reader%at + 1
  end function line_length

  !> Reads the text from the present position up to the character before `next`, counted from here;
  !> 0: the whole rest.
  subroutine read_before(reader, next, text)
    type(reader_type), intent(inout) :: reader
    integer, intent(in) :: next
    character(len=:), allocatable, intent(out) :: text
    integer :: last

    last = len(reader%text)
    if (next > 0) last = reader%at + next - 2
    text = reader%text(reader%at:last)
    reader%at = last + 1
  end subroutine read_before

  !> The next character; a null character at the end.
  pure function next_sign(reader) result(sign)
    type(reader_type), intent(in) :: reader
    character(len=1) :: sign

    sign = achar(0)
    if (.not. at_end(reader)) sign = reader%text(reader%at:reader%at)
  end function next_sign

  !> Whether the whole text has been read.
  pure logical function at_end(reader)
    type(reader_type), intent(in) :: reader

    at_end = reader%at > len(reader%text)
  end function at_end

end module battery_namelist_text
