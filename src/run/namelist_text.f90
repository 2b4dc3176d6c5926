!> Splits the text of a namelist file into groups, keys and values.
!>
!> Fortran's own namelist input takes a misspelt group or a missing `/` for the end of the file and
!> the last of two equal keys for the right one, and it stops at the first mistake. This reads the
!> same syntax (comments, both quotes, lists, repeat counts, `/` or `&end`, any case), but remembers
!> the lines and goes on after a mistake. It does not know which groups and keys there should be.
module battery_namelist_text
  use battery_text, only: to_text, lower_case
  implicit none (type, external)
  private
  public :: value_type, entry_type, group_type, remark_type, split_namelist

  !> Most values of one key, repeats counted.
  integer, parameter, public :: most_values = 100000

  !> One value as it is written, without its quotes.
  type :: value_type
    character(len=:), allocatable :: text
    logical :: quoted = .false.
  end type value_type

  !> `key = values`.
  type :: entry_type
    !> In small letters.
    character(len=:), allocatable :: group, key
    integer :: line = 0
    type(value_type), allocatable :: values(:)
  end type entry_type

  !> `&group ... /`.
  type :: group_type
    character(len=:), allocatable :: name
    integer :: line = 0
  end type group_type

  !> A mistake in the syntax, and where.
  type :: remark_type
    integer :: line = 0
    character(len=:), allocatable :: text
  end type remark_type

  !> Where the reading is.
  type :: reader_type
    character(len=:), allocatable :: text
    integer :: at = 1, line = 1
  end type reader_type

  character(len=1), parameter :: tab = achar(9), line_end = achar(10), return_sign = achar(13)
  character(len=*), parameter :: letters = 'abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ'
  character(len=*), parameter :: name_signs = letters//'0123456789_'
  !> What ends a value that has no quotes.
  character(len=*), parameter :: value_ends = ' ,/!&='//tab//line_end//return_sign//achar(39)//'"'

contains

  !> Splits `text`; mistakes of the syntax come back in `remarks`, the rest is read all the same.
  subroutine split_namelist(text, groups, entries, remarks)
    character(len=*), intent(in) :: text
    type(group_type), allocatable, intent(out) :: groups(:)
    type(entry_type), allocatable, intent(out) :: entries(:)
    type(remark_type), allocatable, intent(out) :: remarks(:)
    type(reader_type) :: reader

    allocate (groups(0), entries(0), remarks(0))
    reader%text = text
    ! A mark of the byte order that some editors put first.
    if (index(text, char(239)//char(187)//char(191)) == 1) reader%at = 4
    do
      call skip_blanks(reader)
      if (at_end(reader)) exit
      if (next_sign(reader) == '&') then
        call read_group(reader, groups, entries, remarks)
      else
        call remark(remarks, reader%line, 'text outside of any group: '//rest_of_line(reader) &
          //'; a group begins with &name and ends with /')
        call skip_line(reader)
      end if
    end do
  end subroutine split_namelist

  !> Reads from the `&` of a group to behind its end.
  subroutine read_group(reader, groups, entries, remarks)
    type(reader_type), intent(inout) :: reader
    type(group_type), allocatable, intent(inout) :: groups(:)
    type(entry_type), allocatable, intent(inout) :: entries(:)
    type(remark_type), allocatable, intent(inout) :: remarks(:)
    type(group_type) :: group

    reader%at = reader%at + 1
    group%line = reader%line
    call read_name(reader, group%name)
    group%name = lower_case(group%name)
    groups = [groups, group]
    do
      call skip_blanks(reader, commas=.true.)
      if (at_end(reader)) exit
      select case (next_sign(reader))
      case ('/')
        reader%at = reader%at + 1
        return
      case ('&')
        if (lower_case(peek(reader, 4)) /= '&end') exit
        reader%at = reader%at + 4
        return
      case default
        call read_entry(reader, group%name, entries, remarks)
      end select
    end do
    call remark(remarks, group%line, '&'//group%name//': the / that ends the group is missing')
  end subroutine read_group

  !> Reads `key = values`.
  subroutine read_entry(reader, group, entries, remarks)
    type(reader_type), intent(inout) :: reader
    character(len=*), intent(in) :: group
    type(entry_type), allocatable, intent(inout) :: entries(:)
    type(remark_type), allocatable, intent(inout) :: remarks(:)
    type(entry_type) :: entry

    entry%group = group
    entry%line = reader%line
    call read_name(reader, entry%key)
    entry%key = lower_case(entry%key)
    allocate (entry%values(0))
    if (entry%key == '') then
      call remark(remarks, reader%line, &
        '&'//group//': a key was expected at: '//rest_of_line(reader))
      call skip_line(reader)
      return
    end if
    call skip_blanks(reader)
    if (next_sign(reader) == '(' .or. next_sign(reader) == '%') then
      call remark(remarks, reader%line, '&'//group//' '//entry%key &
        //': parts of a key cannot be set; allowed: the whole list, '//entry%key//' = 1, 2, ...')
      call skip_line(reader)
      return
    end if
    if (next_sign(reader) /= '=') then
      call remark(remarks, entry%line, '&'//group//' '//entry%key//': = is missing')
      return
    end if
    reader%at = reader%at + 1
    call read_values(reader, entry, remarks)
    entries = [entries, entry]
  end subroutine read_entry

  !> Reads the values of a key, up to the next key or the end of the group.
  subroutine read_values(reader, entry, remarks)
    type(reader_type), intent(inout) :: reader
    type(entry_type), intent(inout) :: entry
    type(remark_type), allocatable, intent(inout) :: remarks(:)
    type(value_type) :: value
    integer :: repeats
    character(len=:), allocatable :: problem
    logical :: after_comma

    after_comma = .true.
    do
      call skip_blanks(reader)
      if (at_end(reader)) exit
      select case (next_sign(reader))
      case ('/', '&')
        exit
      case (',')
        if (after_comma) call complain('a value is missing before a comma')
        after_comma = .true.
        reader%at = reader%at + 1
        cycle
      case default
        if (key_follows(reader)) exit
      end select
      call read_value(reader, value, repeats, problem)
      after_comma = .false.
      if (problem /= '') then
        call complain(problem)
      else if (size(entry%values) + repeats > most_values) then
        call complain('too many values; allowed: '//to_text(most_values))
      else
        entry%values = [entry%values, spread(value, 1, repeats)]
      end if
    end do

  contains

    subroutine complain(text)
      character(len=*), intent(in) :: text

      call remark(remarks, reader%line, '&'//entry%group//' '//entry%key//': '//text)
    end subroutine complain

  end subroutine read_values

  !> Reads one value, with how often it is repeated.
  subroutine read_value(reader, value, repeats, problem)
    type(reader_type), intent(inout) :: reader
    type(value_type), intent(out) :: value
    integer, intent(out) :: repeats
    character(len=:), allocatable, intent(out) :: problem
    character(len=:), allocatable :: word
    integer :: star

    problem = ''
    repeats = 1
    call read_word(reader, word)
    star = index(word, '*')
    if (star > 1) then
      if (verify(word(:star - 1), '0123456789') == 0) then
        if (star > 8) then
          problem = 'too many values: '//word
          return
        end if
        read (word(:star - 1), *) repeats
        word = word(star + 1:)
      end if
    end if
    value%text = word
    if (word == '' .and. scan(next_sign(reader), '"'//achar(39)) == 1) then
      value%quoted = .true.
      call read_quoted(reader, value%text, problem)
    else if (word == '') then
      problem = 'a value was expected at: '//rest_of_line(reader)
      if (.not. at_end(reader)) reader%at = reader%at + 1
    end if
    if (repeats == 0) problem = 'a value is repeated 0 times'
  end subroutine read_value

  !> Reads a text in quotes; a doubled quote stands for itself.
  subroutine read_quoted(reader, text, problem)
    type(reader_type), intent(inout) :: reader
    character(len=:), allocatable, intent(out) :: text
    character(len=:), allocatable, intent(inout) :: problem
    character(len=1) :: quote

    quote = next_sign(reader)
    reader%at = reader%at + 1
    text = ''
    do
      if (at_end(reader) .or. next_sign(reader) == line_end) then
        problem = 'the quote that ends '//quote//text//' is missing in its line'
        return
      end if
      if (next_sign(reader) == quote) then
        reader%at = reader%at + 1
        if (next_sign(reader) /= quote) return
      end if
      text = text//next_sign(reader)
      reader%at = reader%at + 1
    end do
  end subroutine read_quoted

  !> Whether a name and = come next: then the values have ended.
  function key_follows(reader) result(follows)
    type(reader_type), intent(in) :: reader
    logical :: follows
    type(reader_type) :: ahead
    character(len=:), allocatable :: name

    follows = .false.
    if (scan(next_sign(reader), letters) == 0) return
    ahead%text = reader%text(reader%at:min(len(reader%text), reader%at + 1000))
    call read_name(ahead, name)
    call skip_blanks(ahead)
    follows = next_sign(ahead) == '=' .or. next_sign(ahead) == '(' .or. next_sign(ahead) == '%'
  end function key_follows

  !> Passes over blanks, ends of lines and comments, and over commas if asked to.
  pure subroutine skip_blanks(reader, commas)
    type(reader_type), intent(inout) :: reader
    logical, intent(in), optional :: commas
    logical :: also_commas

    also_commas = .false.
    if (present(commas)) also_commas = commas
    do
      if (at_end(reader)) return
      select case (next_sign(reader))
      case (' ', tab, return_sign)
        reader%at = reader%at + 1
      case (line_end)
        reader%at = reader%at + 1
        reader%line = reader%line + 1
      case ('!')
        call skip_line(reader)
      case (',')
        if (.not. also_commas) return
        reader%at = reader%at + 1
      case default
        return
      end select
    end do
  end subroutine skip_blanks

  !> Passes over the rest of a line, but not over its end.
  pure subroutine skip_line(reader)
    type(reader_type), intent(inout) :: reader
    integer :: length

    length = index(reader%text(reader%at:), line_end)
    if (length == 0) then
      reader%at = len(reader%text) + 1
    else
      reader%at = reader%at + length - 1
    end if
  end subroutine skip_line

  pure function rest_of_line(reader) result(rest)
    type(reader_type), intent(in) :: reader
    character(len=:), allocatable :: rest
    type(reader_type) :: ahead
    integer, parameter :: shown = 60

    ahead = reader
    call skip_line(ahead)
    rest = reader%text(reader%at:min(ahead%at - 1, reader%at + shown))
    if (rest == '') rest = 'the end of the line'
  end function rest_of_line

  !> Takes a name; empty if none comes next.
  subroutine read_name(reader, name)
    type(reader_type), intent(inout) :: reader
    character(len=:), allocatable, intent(out) :: name
    integer :: length

    length = 0
    if (.not. at_end(reader)) length = verify(reader%text(reader%at:)//' ', name_signs) - 1
    name = reader%text(reader%at:reader%at + length - 1)
    reader%at = reader%at + length
  end subroutine read_name

  !> Takes what stands before the next sign that ends a value.
  subroutine read_word(reader, word)
    type(reader_type), intent(inout) :: reader
    character(len=:), allocatable, intent(out) :: word
    integer :: length

    length = scan(reader%text(reader%at:)//' ', value_ends) - 1
    word = reader%text(reader%at:reader%at + length - 1)
    reader%at = reader%at + length
  end subroutine read_word

  !> The next sign; a null sign at the end.
  pure function next_sign(reader) result(sign)
    type(reader_type), intent(in) :: reader
    character(len=1) :: sign

    sign = achar(0)
    if (.not. at_end(reader)) sign = reader%text(reader%at:reader%at)
  end function next_sign

  pure function peek(reader, length) result(ahead)
    type(reader_type), intent(in) :: reader
    integer, intent(in) :: length
    character(len=:), allocatable :: ahead

    ahead = reader%text(reader%at:min(len(reader%text), reader%at + length - 1))
  end function peek

  pure function at_end(reader) result(ended)
    type(reader_type), intent(in) :: reader
    logical :: ended

    ended = reader%at > len(reader%text)
  end function at_end

  pure subroutine remark(remarks, line, text)
    type(remark_type), allocatable, intent(inout) :: remarks(:)
    integer, intent(in) :: line
    character(len=*), intent(in) :: text
    type(remark_type) :: one

    one%line = line
    one%text = text
    remarks = [remarks, one]
  end subroutine remark

end module battery_namelist_text
