!> Values of all keys of a namelist: checks groups, keys, types and bounds, and sets the defaults of
!> keys that are not given. All problems are collected, each with its line.
!>
!> The list of keys is an argument.
module battery_settings
  use battery_archive, only: archive_type
  use battery_kinds, only: wp, int32, int64
  use battery_text, only: string_type, to_text, lower_case, join, closest_word
  use battery_numbers, only: read_whole, read_decimal
  use battery_findings, only: findings_type, finding_of, add_finding, suggestion, of_group
  use battery_foreign_bytes, only: foreign_byte_text, unseen_bytes_text
  use battery_namelist_text, only: value_type, entry_type, reader_type, reader_of, read_next, &
    written_text
  use battery_key, only: key_type, distinct_names, find_key, allowed_text, is_beyond, whole_key, &
    real_key, text_key, logical_key, longest_text, longest_range
  implicit none (type, external)
  private
  public :: settings_type, read_settings, serialize_settings, find_setting
  public :: is_given, is_refused, get_value

  !> The value of one key; the type of the key determines the component that is used.
  type :: setting_type
    type(key_type) :: key
    logical :: given = .false.
    !> Whether there is a value at all, given or by default.
    logical :: known = .false.
    integer :: line = 0
    integer(int64), allocatable :: integers(:)
    real(wp), allocatable :: reals(:)
    character(len=:), allocatable :: text
    logical :: flag = .false.
    !> The values in a canonical notation, so that settings can be compared.
    character(len=:), allocatable :: canonical
  end type setting_type

  !> All keys with their values, and the problems.
  type :: settings_type
    type(setting_type), allocatable :: all(:)
    type(findings_type) :: problems
    !> Whether text could not be read: what it sets is not known.
    logical :: has_skipped_text = .false.
    !> Whether a problem may be of a length of the table, of a known or an unknown name.
    logical :: may_lack_a_length = .false.
  end type settings_type

contains

  !> Parses the text of a namelist file.
  subroutine read_settings(text, keys, settings)
    !> Text of the whole file.
    character(len=*), intent(in) :: text
    !> List of all keys.
    type(key_type), intent(in) :: keys(:)
    type(settings_type), intent(out) :: settings
    type(reader_type) :: reader
    type(entry_type) :: entry
    !> Groups, and the line in which each is first; 0: none.
    type(string_type), allocatable :: groups(:)
    integer, allocatable :: first_line(:)
    integer :: at, before
    logical :: is_repeated

    groups = distinct_names(keys%group)
    allocate (first_line(size(groups)), source=0)
    allocate (settings%all(size(keys)))
    do at = 1, size(keys)
      call set_default(keys(at), settings%all(at))
    end do
    reader = reader_of(text)
    is_repeated = .false.
    do
      before = settings%problems%count
      call read_next(reader, entry, settings%problems)
      if (.not. allocated(entry%group)) exit
      if (allocated(entry%key)) then
        call use_entry(entry, is_repeated, settings)
      else
        call check_group(groups, entry, first_line, reader%is_in_unknown_group, is_repeated, &
          settings%problems)
      end if
      if (settings%problems%count > before .and. (reader%is_in_unknown_group .or. &
        may_be_length(entry, keys))) settings%may_lack_a_length = .true.
    end do
    settings%has_skipped_text = reader%has_skipped_text
    ! A misspelt key, or one with an index, counts as given and refused, so it is not reported as
    ! missing as well.
    associate (all => settings%all)
      where (all%line > 0 .and. .not. all%given) all%known = .false.
      all%given = all%line > 0
    end associate
  end subroutine read_settings

  !> Whether an entry may be meant for a length of the table.
  pure logical function may_be_length(entry, keys) result(may)
    type(entry_type), intent(in) :: entry
    !> List of all keys.
    type(key_type), intent(in) :: keys(:)

    may = entry%group == 'table'
    if (entry%group == 'scan' .and. allocated(entry%key)) may = .not. any(keys%group == 'scan' &
      .and. keys%name == entry%key .and. keys%unit /= 'length')
  end function may_be_length

  !> Sets the key that an entry names, or reports why it cannot be set. The key that it probably
  !> means gets its line then, unless it has one.
  subroutine use_entry(entry, is_repeated, settings)
    type(entry_type), intent(in) :: entry
    !> Whether its group is given again, which is reported for all its keys.
    logical, intent(in) :: is_repeated
    type(settings_type), intent(inout) :: settings
    integer :: place

    place = find_key(settings%all%key, entry%group, entry%key)
    if (place == 0) then
      place = meant_key(settings%all%key, entry)
      if (.not. entry%refused) call refuse_key(settings%all%key, entry, place, settings%problems)
    else if (settings%all(place)%given) then
      if (.not. (entry%refused .or. is_repeated)) call refuse_entry(entry, 'is given again', &
        'once (line '//to_text(settings%all(place)%line)//')', settings%problems)
    else if (.not. entry%refused) then
      call set_from_entry(entry, settings%all(place), settings%problems)
    end if
    if (place == 0) return
    if (settings%all(place)%line == 0) settings%all(place)%line = entry%line
  end subroutine use_entry

  !> Saves or restores the values of all keys, so that others need not parse the text.
  pure subroutine serialize_settings(settings, archive)
    !> On reading, its keys must be there, as `read_settings` leaves them after an empty text.
    type(settings_type), intent(inout) :: settings
    type(archive_type), intent(inout) :: archive
    integer :: at, items

    do at = 1, size(settings%all)
      associate (setting => settings%all(at))
        call archive%serialize('given', setting%given)
        call archive%serialize('known', setting%known)
        call archive%serialize('flag', setting%flag)
        items = size(setting%integers)
        call archive%serialize('items', items)
        if (archive%reading) setting%integers = spread(0_int64, 1, items)
        call archive%serialize('integers', setting%integers)
        call archive%serialize_list('reals', setting%reals)
        call archive%serialize_text('text', setting%text)
        call archive%serialize_text('canonical', setting%canonical)
      end associate
    end do
  end subroutine serialize_settings

  !> Reports a group that is unknown or repeated.
  subroutine check_group(groups, entry, first_line, is_unknown, is_repeated, problems)
    !> All groups.
    type(string_type), intent(in) :: groups(:)
    !> The beginning of a group.
    type(entry_type), intent(in) :: entry
    !> Line in which each group is first; 0: none so far.
    integer, intent(inout) :: first_line(:)
    !> Whether there is no such group; whether it was there before.
    logical, intent(out) :: is_unknown, is_repeated
    type(findings_type), intent(inout) :: problems
    integer :: at

    do at = 1, size(groups)
      if (groups(at)%text == entry%group) exit
    end do
    is_unknown = at > size(groups)
    is_repeated = .false.
    if (.not. is_unknown) is_repeated = first_line(at) > 0
    if (is_unknown) then
      call add_finding(problems, finding_of(entry%line, 'there is no such group'//suggestion('&', &
        closest_word(entry%group, groups)), '&'//join(groups, ', &'), entry%group, kind=of_group))
    else if (is_repeated) then
      call add_finding(problems, finding_of(entry%line, 'is given again', 'once (line ' &
        //to_text(first_line(at))//')', entry%group, kind=of_group))
    else
      first_line(at) = entry%line
    end if
  end subroutine check_group

  !> Place of the key that was probably meant by an unknown key: one with this name in another
  !> group, with this symbol in the paper, or with a similar name. 0: none.
  pure integer function meant_key(keys, entry) result(place)
    type(key_type), intent(in) :: keys(:)
    type(entry_type), intent(in) :: entry
    logical :: is_symbol(size(keys))
    character(len=:), allocatable :: group
    integer :: at

    group = entry%group
    if (all(keys%group /= group)) group = closest_word(group, distinct_names(keys%group))
    place = find_key(keys, group, entry%key)
    if (place == 0) place = findloc(keys%name == entry%key, .true., dim=1)
    is_symbol = keys%symbol /= '' .and. [(written_symbol(keys(at)) == entry%key, at=1, size(keys))]
    if (place == 0) place = findloc(is_symbol .and. keys%group == group, .true., dim=1)
    if (place == 0) place = findloc(is_symbol, .true., dim=1)
    if (place == 0) place = find_key(keys, group, closest_word(entry%key, &
      distinct_names(pack(keys%name, keys%group == group))))
  end function meant_key

  !> The symbol of a key as a user may write it in a namelist, to recognise it: `n` for N, `w_prime`
  !> for w'.
  pure function written_symbol(key) result(name)
    type(key_type), intent(in) :: key
    character(len=:), allocatable :: name

    name = lower_case(trim(key%symbol))
    if (index(name, '''') > 0) name = name(:index(name, '''') - 1)//'_prime'
  end function written_symbol

  !> Reports an unknown key, unless its group is unknown.
  subroutine refuse_key(keys, entry, meant, problems)
    type(key_type), intent(in) :: keys(:)
    type(entry_type), intent(in) :: entry
    !> Place of the key that was probably meant; 0: unknown.
    integer, intent(in) :: meant
    type(findings_type), intent(inout) :: problems
    character(len=:), allocatable :: hint

    if (all(keys%group /= entry%group)) return
    hint = ''
    if (meant > 0) then
      if (keys(meant)%name == entry%key) then
        hint = ' (it belongs to &'//trim(keys(meant)%group)//')'
      else if (keys(meant)%group == entry%group) then
        hint = suggestion('', trim(keys(meant)%name))
      else
        hint = suggestion('&', trim(keys(meant)%group)//' '//trim(keys(meant)%name))
      end if
    end if
    call refuse_entry(entry, 'there is no such key'//hint, &
      join(distinct_names(pack(keys%name, keys%group == entry%group)), ', '), problems)
  end subroutine refuse_key

  !> Adds a problem of an entry.
  subroutine refuse_entry(entry, wrong, allowed, problems)
    type(entry_type), intent(in) :: entry
    !> What is wrong with its values, and what is allowed.
    character(len=*), intent(in) :: wrong, allowed
    type(findings_type), intent(inout) :: problems

    call add_finding(problems, finding_of(entry%line, written_text(entry%values)//': '//wrong, &
      allowed, entry%group, entry%key))
  end subroutine refuse_entry

  !> Sets a key to its default, which is parsed like an input.
  subroutine set_default(key, setting)
    type(key_type), intent(in) :: key
    type(setting_type), intent(out) :: setting
    type(entry_type) :: entry
    type(findings_type) :: problems

    setting%key = key
    allocate (setting%integers(0), setting%reals(0))
    setting%text = ''
    setting%canonical = ''
    if (key%default == '') return
    entry%group = trim(key%group)
    entry%key = trim(key%name)
    allocate (entry%values(1))
    entry%values(1)%quoted = key%kind == text_key
    entry%values(1)%text = trim(key%default)
    if (key%kind == text_key) entry%values(1)%text = key%default(2:len_trim(key%default) - 1)
    call set_from_entry(entry, setting, problems)
    setting%given = .false.
  end subroutine set_default

  !> Sets a key to the values that an entry of the namelist assigns to it; adds what is wrong with
  !> them to `problems`.
  subroutine set_from_entry(entry, setting, problems)
    type(entry_type), intent(in) :: entry
    type(setting_type), intent(inout) :: setting
    type(findings_type), intent(inout) :: problems
    character(len=:), allocatable :: wrong
    type(string_type), allocatable :: written(:)
    integer :: at

    setting%given = .true.
    setting%line = entry%line
    associate (key => setting%key, count => size(entry%values))
      wrong = wrong_count(key, count)
      if (wrong == '') then
        setting%integers = [(0_int64, at=1, merge(count, 0, key%kind == whole_key))]
        setting%reals = [(0.0_wp, at=1, merge(count, 0, key%kind == real_key))]
        allocate (written(count))
        do at = 1, count
          call set_value_at(entry%values(at), at, setting, written(at)%text, wrong)
          if (wrong /= '') exit
        end do
      end if
      if (wrong == '') setting%canonical = join(written, ' ')
      if (wrong == '' .and. key%is_range) wrong = wrong_range(setting%reals)
      setting%known = wrong == ''
      if (wrong /= '') call refuse_entry(entry, wrong, allowed_text(key), problems)
    end associate
  end subroutine set_from_entry

  !> Problem of the number of values; empty: none.
  pure function wrong_count(key, count) result(wrong)
    type(key_type), intent(in) :: key
    integer, intent(in) :: count
    character(len=:), allocatable :: wrong
    integer :: least

    wrong = ''
    least = merge(key%most_values, 1, key%is_range)
    if (count == 0) then
      wrong = 'has no value'
    else if (count < least .or. count > key%most_values) then
      wrong = 'has '//to_text(count)//' values, not '//to_text(key%most_values)
      if (key%most_values > 3) wrong = 'has '//to_text(count)//' values, more than ' &
        //to_text(key%most_values)
    end if
  end function wrong_count

  !> Sets value number `at` of a setting; `written` is its canonical text, `wrong` its problem
  !> (empty: none).
  subroutine set_value_at(value, at, setting, written, wrong)
    type(value_type), intent(in) :: value
    integer, intent(in) :: at
    type(setting_type), intent(inout) :: setting
    character(len=:), allocatable, intent(out) :: written, wrong

    associate (key => setting%key)
      select case (key%kind)
      case (whole_key)
        call read_whole(value%text, setting%integers(at), wrong)
        if (value%quoted) wrong = 'is not a whole number'
        written = to_text(setting%integers(at))
        if (wrong == '') wrong = out_of_bounds(key, real(setting%integers(at), wp))
      case (real_key)
        call read_decimal(value%text, setting%reals(at), wrong)
        if (value%quoted) wrong = 'is not a number'
        written = to_text(setting%reals(at))
        if (wrong == '' .and. at > 1 .and. has_leading_zero(value%text)) wrong = 'number ' &
          //to_text(at)//', '//value%text//', begins with 0, as behind a decimal comma'
        if (wrong == '') wrong = out_of_bounds(key, setting%reals(at))
      case (logical_key)
        call read_logical(value, setting%flag, wrong)
        written = to_text(setting%flag)
      case default
        ! Trailing blanks are no part of a text: Fortran pads with blanks.
        written = ''''//trim(value%text)//''''
        wrong = wrong_text(key, value)
        if (wrong == '') setting%text = trim(value%text)
      end select
    end associate
  end subroutine set_value_at

  !> Whether a number is digits only, of which the first is a 0 that need not be there.
  pure logical function has_leading_zero(number) result(yes)
    character(len=*), intent(in) :: number

    yes = len(number) > 1 .and. index(number, '0') == 1 .and. verify(number, '0123456789') == 0
  end function has_leading_zero

  !> Problem of a number outside the bounds of its key; empty: none.
  pure function out_of_bounds(key, number) result(wrong)
    type(key_type), intent(in) :: key
    real(wp), intent(in) :: number
    character(len=:), allocatable :: wrong

    wrong = ''
    if (number < key%least .or. (key%above .and. number <= key%least)) wrong = 'is too small'
    ! The number of values of a range has a bound of its own.
    if (is_beyond(key, number) .and. .not. key%is_range) &
      wrong = 'is beyond '//to_text(key%greatest)
  end function out_of_bounds

  !> Parses a logical value: true or false, with or without points, or T or F.
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

  !> Problem of the value of a text key; empty: none.
  pure function wrong_text(key, value) result(wrong)
    type(key_type), intent(in) :: key
    type(value_type), intent(in) :: value
    character(len=:), allocatable :: wrong

    wrong = ''
    if (.not. value%quoted) then
      wrong = 'is not a text in quotes'
    else if (len_trim(value%text) > longest_text) then
      wrong = 'has '//to_text(len_trim(value%text))//' letters, more than '//to_text(longest_text)
    else if (has_control_sign(value%text)) then
      wrong = 'has a control character'
    else if (unseen_bytes_text(trim(value%text)) /= '') then
      wrong = unseen_bytes_text(trim(value%text))
    else if (index(value%text, ' ') == 1 .and. value%text /= '') then
      wrong = 'begins with a blank'
    else if (value%text == '' .and. key%default /= '''''') then
      wrong = 'is empty'
    else if (key%choices /= '') then
      if (index(trim(value%text), ' ') > 0 .or. &
        index(' '//key%choices, ' '//trim(value%text)//' ') == 0) wrong = 'is not known'
      if (foreign_byte_text(value%text) /= '') wrong = &
        foreign_byte_text(value%text)//' of the text'
    end if
  end function wrong_text

  !> Whether a text has a control character: a tab, a line end, a delete.
  pure logical function has_control_sign(text) result(yes)
    character(len=*), intent(in) :: text
    integer, parameter :: first_visible = 32, delete = 127
    integer :: at

    associate (code => [(iachar(text(at:at)), at=1, len(text))])
      yes = any(code < first_visible .or. code == delete)
    end associate
  end function has_control_sign

  !> Problem of a range whose third number is not how many values it has; empty: none.
  pure function wrong_range(range) result(wrong)
    real(wp), intent(in) :: range(3)
    character(len=:), allocatable :: wrong

    wrong = ''
    if (range(3) < 1.0_wp .or. range(3) > longest_range .or. &
      abs(range(3) - anint(range(3))) > 0.0_wp) &
      wrong = 'how many is not a whole number from 1 to '//to_text(longest_range)
    if (wrong == '' .and. range(3) < 2.0_wp .and. abs(range(2) - range(1)) > 0.0_wp) &
      wrong = 'one value cannot have two ends (the third number is how many, not a step)'
  end function wrong_range

  !> Place of a key, which must be declared, in the settings: in its own group, also if a scan can
  !> vary it.
  pure integer function find_setting(settings, name) result(place)
    type(settings_type), intent(in) :: settings
    !> Name of the key in small letters.
    character(len=*), intent(in) :: name

    place = findloc(settings%all%key%name == name, .true., dim=1)
    if (place == 0) error stop 'a key is not declared'
  end function find_setting

  !> Whether a key is given, rightly or not.
  pure logical function is_given(settings, name)
    type(settings_type), intent(in) :: settings
    !> Name of the key.
    character(len=*), intent(in) :: name

    is_given = settings%all(find_setting(settings, name))%given
  end function is_given

  !> Whether a key is given wrongly.
  pure logical function is_refused(settings, name)
    type(settings_type), intent(in) :: settings
    !> Name of the key.
    character(len=*), intent(in) :: name

    associate (setting => settings%all(find_setting(settings, name)))
      is_refused = setting%given .and. .not. setting%known
    end associate
  end function is_refused

  !> Gets the value of a key that is no text, of several the first.
  pure subroutine get_value(settings, name, value)
    type(settings_type), intent(in) :: settings
    !> Name of the key.
    character(len=*), intent(in) :: name
    !> Value of the key; if it has none, `value` does not change.
    class(*), intent(inout) :: value

    associate (setting => settings%all(find_setting(settings, name)))
      if (.not. setting%known) return
      select type (value)
      type is (integer(int32))
        value = int(setting%integers(1))
      type is (integer(int64))
        value = setting%integers(1)
      type is (real(wp))
        value = setting%reals(1)
      type is (logical)
        value = setting%flag
      class default
        error stop 'no key has a value of this type'
      end select
    end associate
  end subroutine get_value

end module battery_settings
