!> A key of a namelist: its type, allowed values, default, unit and meaning.
!>
!> The program declares its keys in one list (`battery_keys`); reading, checking, comparing and
!> the help text use that list.
module battery_key
  use battery_kinds, only: wp, int64
  use battery_text, only: string_type, to_text, is_one_of, new_line_character
  implicit none (type, external)
  private
  public :: key_type, find_key, distinct_names, is_beyond, allowed_text
  public :: choices_text, keys_text
  public :: whole_key, real_key, text_key, logical_key

  !> Types of keys.
  integer, parameter :: whole_key = 1, real_key = 2, text_key = 3, logical_key = 4

  !> Longest text of a key, about the longest path of the system; largest number of points of a
  !> range.
  integer, parameter, public :: longest_text = 4000, longest_range = 100000

  !> One key of a namelist: group, name, meaning and allowed values.
  type :: key_type
    character(len=32) :: group = '', name = ''
    integer :: kind = whole_key
    !> Default value, as a user would write it; empty if there is none.
    character(len=16) :: default = ''
    !> Meaning, one line of the help text.
    character(len=80) :: meaning = ''
    !> Least number, and whether it is itself forbidden; greatest number, for reals only if it is
    !> below `huge(1)`.
    real(wp) :: least = -huge(1.0_wp)
    logical :: above = .false.
    integer(int64) :: greatest = huge(1)
    !> Greatest number of values.
    integer :: most_values = 1
    !> Whether its three values are `first, last, how many`.
    logical :: is_range = .false.
    !> Allowed words, separated by blanks; empty: any text.
    character(len=80) :: choices = ''
    !> Unit, and symbol in the paper; empty if there is none.
    character(len=8) :: unit = '', symbol = ''
    !> Place among the keys that a scan can vary, the slowest first, 0: it cannot; whose the second
    !> value is if a scan can vary that alone, such as `urn 2`; whether a list has second values.
    integer :: place = 0
    character(len=8) :: second = ''
    logical :: is_second = .false.
    !> Whether the key changes the results; if not, a run may be resumed with another value.
    logical :: changes_results = .true.
  end type key_type

contains

  !> Place of a key in a list of keys; 0 if the list does not have it.
  pure integer function find_key(keys, group, name) result(place)
    !> List of all keys.
    type(key_type), intent(in) :: keys(:)
    !> Group and key in small letters.
    character(len=*), intent(in) :: group, name

    place = findloc(keys%group == group .and. keys%name == name, .true., dim=1)
  end function find_key

  !> The different names of a list, in their order, without the blanks at their ends.
  pure function distinct_names(list) result(names)
    !> Groups, or keys of a group.
    character(len=*), intent(in) :: list(:)
    type(string_type), allocatable :: names(:)
    type(string_type) :: name
    integer :: at

    allocate (names(0))
    do at = 1, size(list)
      name%text = trim(list(at))
      if (.not. is_one_of(name%text, names)) names = [names, name]
    end do
  end function distinct_names

  !> Whether a number is greater than a key allows.
  elemental logical function is_beyond(key, number)
    type(key_type), intent(in) :: key
    !> The number; `huge`: whether there is a greatest number.
    real(wp), intent(in) :: number

    is_beyond = number > key%greatest .and. (key%kind == whole_key .or. key%greatest < huge(1))
  end function is_beyond

  !> Text for the allowed values of a key.
  pure function allowed_text(key) result(text)
    type(key_type), intent(in) :: key
    character(len=:), allocatable :: text

    select case (key%kind)
    case (whole_key)
      text = value_count_text(key, 'whole number')//bound_text(key)
    case (real_key)
      text = value_count_text(key, 'number')//bound_text(key)
    case (logical_key)
      text = '.true. or .false.'
    case default
      text = 'one text in quotes'
      if (key%choices /= '') text = choices_text(trim(key%choices), '''')
    end select
  end function allowed_text

  !> Text for the allowed number of values: `one number`, `one number or two`, `numbers`, or the
  !> three numbers of a range.
  pure function value_count_text(key, what) result(text)
    type(key_type), intent(in) :: key
    character(len=*), intent(in) :: what
    character(len=:), allocatable :: text

    if (key%is_range) then
      text = 'first, last, how many; first and last'
    else if (key%most_values == 1) then
      text = 'one '//what
    else if (key%most_values == 2) then
      text = 'one '//what//' or two'
    else
      text = what//'s'
    end if
  end function value_count_text

  !> Text for the bounds of a number.
  pure function bound_text(key) result(text)
    type(key_type), intent(in) :: key
    character(len=:), allocatable :: text

    text = ''
    if (.not. key%least > -huge(1.0_wp)) return
    text = ' from '//to_text(key%least)//' up'
    if (key%above) text = ' above '//to_text(key%least)
    if (key%greatest < huge(1)) text = ' from '//to_text(key%least)//' to '//to_text(key%greatest)
  end function bound_text

  !> `a b c` as `'a', 'b', 'c'`.
  pure function choices_text(choices, quote) result(text)
    !> Words separated by single blanks.
    character(len=*), intent(in) :: choices
    !> Quotation mark around each word.
    character(len=1), intent(in) :: quote
    character(len=:), allocatable :: text
    integer :: at

    text = quote
    do at = 1, len(choices)
      if (choices(at:at) == ' ') then
        text = text//quote//', '//quote
      else
        text = text//choices(at:at)
      end if
    end do
    text = text//quote
  end function choices_text

  !> All groups and keys with defaults and meanings, for the help text.
  pure function keys_text(keys) result(text)
    !> List of all keys.
    type(key_type), intent(in) :: keys(:)
    character(len=:), allocatable :: text
    character(len=16) :: default
    integer :: at

    text = ''
    do at = 1, size(keys)
      if (all(keys(:at - 1)%group /= keys(at)%group)) &
        text = text//'&'//trim(keys(at)%group)//new_line_character
      default = keys(at)%default
      if (default == '') default = 'none'
      text = text//'  '//padded_to(trim(keys(at)%name), 26)//padded_to(trim(default), 13) &
        //'! '//trim(keys(at)%meaning)//'; '//allowed_text(keys(at))//new_line_character
      if (all(keys(at + 1:)%group /= keys(at)%group)) text = text//'/'//new_line_character
    end do
  end function keys_text

  !> A word with blanks up to a width.
  pure function padded_to(word, width) result(text)
    character(len=*), intent(in) :: word
    integer, intent(in) :: width
    character(len=:), allocatable :: text

    text = word//repeat(' ', max(1, width - len(word)))
  end function padded_to

end module battery_key
