!> A key of a namelist: its type, what it may hold, its default, its unit and its meaning.
!>
!> Which keys there are is for the program to say, in one list; reading, checking, comparing and
!> the help text all go by that list.
module battery_key
  use battery_kinds, only: wp, int64
  use battery_text, only: string_type, to_text, is_one_of, new_line_character
  implicit none (type, external)
  private
  public :: key_type, find_key, group_names, keys_of_group, allowed_text, keys_text
  public :: whole_key, real_key, text_key, logical_key

  !> Types of keys.
  integer, parameter :: whole_key = 1, real_key = 2, text_key = 3, logical_key = 4

  !> One key of a namelist: where it stands, what may be its value, what it means.
  type :: key_type
    character(len=:), allocatable :: group, name
    integer :: kind = whole_key
    !> How many values it takes at the most.
    integer :: most_values = 1
    !> Whether its three values are `first, last, how many`.
    logical :: is_range = .false.
    !> As it would be written; empty if there is none.
    character(len=:), allocatable :: default
    !> Least number that is allowed, and whether it is itself forbidden; greatest whole number.
    real(wp) :: least = -huge(1.0_wp)
    logical :: above = .false.
    integer(int64) :: greatest = huge(1)
    !> Words that are allowed, set apart by blanks; empty: any.
    character(len=:), allocatable :: choices
    !> Unit, and symbol in the paper; empty if there is none.
    character(len=:), allocatable :: unit, symbol
    !> What it means.
    character(len=:), allocatable :: meaning
    !> Whether it changes the results; if not, a run may go on with another value.
    logical :: decides = .true.
  end type key_type

contains

  !> Place of a key in a list of keys; 0 if it is not there.
  pure function find_key(keys, group, name) result(place)
    !> All there are.
    type(key_type), intent(in) :: keys(:)
    !> In small letters.
    character(len=*), intent(in) :: group, name
    integer :: place

    do place = size(keys), 1, -1
      if (keys(place)%group == group .and. keys(place)%name == name) return
    end do
  end function find_key

  !> The names of all groups, in the order of their first keys.
  pure function group_names(keys) result(names)
    !> All there are.
    type(key_type), intent(in) :: keys(:)
    type(string_type), allocatable :: names(:)
    type(string_type) :: name
    integer :: at

    allocate (names(0))
    do at = 1, size(keys)
      if (is_one_of(keys(at)%group, names)) cycle
      name%text = keys(at)%group
      names = [names, name]
    end do
  end function group_names

  !> The names of the keys of a group.
  pure function keys_of_group(keys, group) result(names)
    !> All there are.
    type(key_type), intent(in) :: keys(:)
    !> Its name, in small letters, without &.
    character(len=*), intent(in) :: group
    type(string_type), allocatable :: names(:)
    type(string_type) :: name
    integer :: at

    allocate (names(0))
    do at = 1, size(keys)
      if (keys(at)%group /= group) cycle
      name%text = keys(at)%name
      names = [names, name]
    end do
  end function keys_of_group

  !> What is allowed for a key, in words.
  pure function allowed_text(key) result(text)
    type(key_type), intent(in) :: key
    character(len=:), allocatable :: text

    select case (key%kind)
    case (whole_key)
      text = counted(key, 'whole number')//bound_text(key)
    case (real_key)
      text = counted(key, 'number')//bound_text(key)
    case (logical_key)
      text = '.true. or .false.'
    case default
      text = 'one text in quotes'
      if (key%choices /= '') text = choices_text(key%choices)
    end select
  end function allowed_text

  !> `one number`, `one number or two`, `numbers`, or what a range holds.
  pure function counted(key, what) result(text)
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
  end function counted

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
  pure function choices_text(choices) result(text)
    character(len=*), intent(in) :: choices
    character(len=:), allocatable :: text
    integer :: at

    text = ''''
    do at = 1, len(choices)
      if (choices(at:at) == ' ') then
        text = text//''', '''
      else
        text = text//choices(at:at)
      end if
    end do
    text = text//''''
  end function choices_text

  !> All groups and keys with defaults and meanings, for the help text.
  pure function keys_text(keys) result(text)
    !> All there are.
    type(key_type), intent(in) :: keys(:)
    character(len=:), allocatable :: text
    type(string_type), allocatable :: groups(:)
    character(len=:), allocatable :: default
    integer :: at, group

    groups = group_names(keys)
    text = ''
    do group = 1, size(groups)
      text = text//'&'//groups(group)%text//new_line_character
      do at = 1, size(keys)
        if (keys(at)%group /= groups(group)%text) cycle
        default = keys(at)%default
        if (default == '') default = 'none'
        text = text//'  '//padded(keys(at)%name, 26)//padded(default, 13) &
          //'! '//keys(at)%meaning//'; '//allowed_text(keys(at))//new_line_character
      end do
      text = text//'/'//new_line_character
    end do
  end function keys_text

  pure function padded(word, width) result(text)
    character(len=*), intent(in) :: word
    integer, intent(in) :: width
    character(len=:), allocatable :: text

    text = word//repeat(' ', max(1, width - len(word)))
  end function padded

end module battery_key
