!> All groups and keys of the namelist, each declared once: its type, what is allowed, its default
!> and what it means. Reading, checking, the help text and the comparison of inputs all use this.
module battery_namelist_keys
  use battery_kinds, only: wp, int64
  use battery_text, only: string_type, to_text, new_line_character
  implicit none (type, external)
  private
  public :: key_type, namelist_keys, group_names, keys_of_group, find_key, allowed_text, keys_text
  public :: integer_key, real_key, text_key, logical_key, integer_list_key, real_list_key, range_key

  !> Types of keys; a range is `first, last, how many`.
  integer, parameter :: integer_key = 1, real_key = 2, text_key = 3, logical_key = 4, &
    integer_list_key = 5, real_list_key = 6, range_key = 7

  !> Most particles: the engines keep up to ten numbers a particle in one array, whose indices have
  !> 32 bits.
  integer(int64), parameter, public :: most_particles = 200000000_int64

  !> Most of whole numbers that may be long: they have 18 digits, so that sums of a few fit.
  integer(int64), parameter :: most_long = 999999999999999999_int64

  type :: key_type
    character(len=:), allocatable :: group, name
    integer :: kind = integer_key
    !> As it would be written; `none` if there is no default.
    character(len=:), allocatable :: default
    !> Least number that is allowed, and whether it is itself forbidden.
    real(wp) :: least = -huge(1.0_wp)
    logical :: above = .false.
    !> Most of a whole number.
    integer(int64) :: most = huge(1)
    !> Words that are allowed, set apart by blanks; empty: any.
    character(len=:), allocatable :: choices
    !> What it means.
    character(len=:), allocatable :: meaning
    !> Whether it changes the results; if not, a run may go on with another value.
    logical :: decides = .true.
  end type key_type

contains

  !> Every key, in the order of the documentation.
  function namelist_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [table_keys(), particles_keys(), gate_keys(), run_keys(), scan_keys(), output_keys(), &
      limits_keys()]
  end function namelist_keys

  function table_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key('table', 'shape', text_key, '''circuit''', 'the circuit, or one urn with one gate', &
      choices='circuit urn'), &
      key('table', 'urn_radius', real_key, '1', 'radius r of the urns', above=0.0_wp), &
      key('table', 'channel1_width', real_key, '0.3', 'width w of channel 1, below 2 r', &
      above=0.0_wp), &
      key('table', 'channel1_length', real_key, '1', 'length l of channel 1', above=0.0_wp), &
      key('table', 'channel2_width', real_key, '0.01', 'width w'' of channel 2, below 2 r', &
      least=0.0_wp), &
      key('table', 'channel2_length', real_key, '1', 'length l'' of channel 2', above=0.0_wp)]
  end function table_keys

  function particles_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key('particles', 'number', integer_key, 'none', 'how many particles', least=1.0_wp, &
      most=most_particles), &
      key('particles', 'urn1_number', integer_key, 'none', 'how many start in urn 1; else half', &
      least=0.0_wp), &
      key('particles', 'seed', integer_key, '1', 'base seed of the random numbers', &
      least=0.0_wp, most=most_long), &
      key('particles', 'initial_file', text_key, '''''', 'file with x y ux uy of each particle')]
  end function particles_keys

  function gate_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key('gate', 'threshold', integer_key, 'none', 'more than T turn a gate back', least=0.0_wp), &
      key('gate', 'threshold_fraction', real_key, 'none', 'T/N instead', least=0.0_wp)]
  end function gate_keys

  function run_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key('run', 'engine', text_key, '''excursion''', 'how the particles are moved', &
      choices='excursion collision synchronous timestep reservoir'), &
      key('run', 'collisions', integer_key, '100000000', 'wall collisions in all', least=1.0_wp, &
      most=most_long), &
      key('run', 'transient_collisions', integer_key, 'none', &
      'those before the averages begin; else half', least=0.0_wp, most=most_long), &
      key('run', 'duration', real_key, '0', 'length in time instead of collisions; 0: none', &
      least=0.0_wp), &
      key('run', 'transient_duration', real_key, '0', 'time before the averages begin', &
      least=0.0_wp), &
      key('run', 'start_time', real_key, '0', 'what the clock shows at the start', least=0.0_wp), &
      key('run', 'time_step', real_key, 'none', 'step of the engine timestep', above=0.0_wp)]
  end function run_keys

  function scan_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key('scan', 'threshold', integer_list_key, 'none', 'thresholds', least=0.0_wp), &
      key('scan', 'threshold_range', range_key, 'none', 'the same, evenly spaced', least=0.0_wp), &
      key('scan', 'threshold_fraction', real_list_key, 'none', 'thresholds as T/N', &
      least=0.0_wp), &
      key('scan', 'threshold_fraction_range', range_key, 'none', 'the same, evenly spaced', &
      least=0.0_wp), &
      key('scan', 'number', integer_list_key, 'none', 'numbers of particles', least=1.0_wp, &
      most=most_particles), &
      key('scan', 'number_range', range_key, 'none', 'the same, evenly spaced', least=1.0_wp, &
      most=most_particles), &
      key('scan', 'channel1_width', real_list_key, 'none', 'widths of channel 1', above=0.0_wp), &
      key('scan', 'channel1_width_range', range_key, 'none', 'the same, evenly spaced', &
      above=0.0_wp), &
      key('scan', 'channel2_width', real_list_key, 'none', 'widths of channel 2', least=0.0_wp), &
      key('scan', 'channel2_width_range', range_key, 'none', 'the same, evenly spaced', &
      least=0.0_wp), &
      key('scan', 'urn1_fraction', real_list_key, 'none', 'shares that start in urn 1', &
      least=0.0_wp), &
      key('scan', 'urn1_fraction_range', range_key, 'none', 'the same, evenly spaced', &
      least=0.0_wp), &
      key('scan', 'replicas', integer_key, '1', 'runs of each point, with other seeds', &
      least=1.0_wp)]
  end function scan_keys

  function output_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key('output', 'file', text_key, '''battery.h5''', 'where the results go', decides=.false.), &
      key('output', 'series_interval', real_key, '0', 'time between series entries; 0: none', &
      least=0.0_wp), &
      key('output', 'snapshot_times', real_list_key, 'none', &
      'times at which positions and velocities are kept', least=0.0_wp), &
      key('output', 'event_log', logical_key, '.false.', 'whether events are kept (one task)'), &
      key('output', 'final_state', logical_key, '.false.', 'whether the final state is kept')]
  end function output_keys

  function limits_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key('limits', 'wall_minutes', real_key, '0', 'the run stops cleanly before; 0: never', &
      least=0.0_wp, decides=.false.), &
      key('limits', 'checkpoint_minutes', real_key, '10', 'how often long tasks save their state', &
      least=0.0_wp, decides=.false.)]
  end function limits_keys

  !> One key; `least` is the least number allowed, `above` a bound that is not allowed itself,
  !> `most` the most of a whole number.
  pure function key(group, name, kind, default, meaning, least, above, most, choices, decides)
    character(len=*), intent(in) :: group, name, default, meaning
    integer, intent(in) :: kind
    real(wp), intent(in), optional :: least, above
    integer(int64), intent(in), optional :: most
    character(len=*), intent(in), optional :: choices
    logical, intent(in), optional :: decides
    type(key_type) :: key

    key%group = group
    key%name = name
    key%kind = kind
    key%default = default
    key%meaning = meaning
    key%choices = ''
    if (present(least)) key%least = least
    if (present(above)) key%least = above
    key%above = present(above)
    if (present(most)) key%most = most
    if (present(choices)) key%choices = choices
    if (present(decides)) key%decides = decides
  end function key

  !> Place of a key in a list of keys; 0 if it is not there.
  pure function find_key(keys, group, name) result(place)
    type(key_type), intent(in) :: keys(:)
    character(len=*), intent(in) :: group, name
    integer :: place
    integer :: at

    place = 0
    do at = 1, size(keys)
      if (keys(at)%group == group .and. keys(at)%name == name) place = at
    end do
  end function find_key

  !> The names of all groups.
  pure function group_names(keys) result(names)
    type(key_type), intent(in) :: keys(:)
    type(string_type), allocatable :: names(:)
    type(string_type) :: name
    integer :: at

    allocate (names(0))
    do at = 1, size(keys)
      if (keys(at)%group == keys(max(at - 1, 1))%group .and. at > 1) cycle
      name%text = keys(at)%group
      names = [names, name]
    end do
  end function group_names

  !> The names of the keys of a group.
  pure function keys_of_group(keys, group) result(names)
    type(key_type), intent(in) :: keys(:)
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
    case (integer_key)
      text = 'one whole number'//bound_text(key)
    case (real_key)
      text = 'one number'//bound_text(key)
    case (integer_list_key)
      text = 'whole numbers'//bound_text(key)
    case (real_list_key)
      text = 'numbers'//bound_text(key)
    case (range_key)
      text = 'first, last, how many; first and last'//bound_text(key)
    case (logical_key)
      text = '.true. or .false.'
    case default
      text = 'one text in quotes'
      if (key%choices /= '') text = choices_text(key%choices)
    end select
  end function allowed_text

  pure function bound_text(key) result(text)
    type(key_type), intent(in) :: key
    character(len=:), allocatable :: text

    text = ''
    if (key%least > -huge(1.0_wp)) then
      text = ' from '//to_text(key%least)//' up'
      if (key%above) text = ' above '//to_text(key%least)
    end if
    if (key%most < huge(1)) text = text(:len(text) - 3)//' to '//to_text(key%most)
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
  function keys_text() result(text)
    character(len=:), allocatable :: text
    type(key_type), allocatable :: keys(:)
    type(string_type), allocatable :: groups(:)
    integer :: at, group

    keys = namelist_keys()
    groups = group_names(keys)
    text = ''
    do group = 1, size(groups)
      text = text//'&'//groups(group)%text//new_line_character
      do at = 1, size(keys)
        if (keys(at)%group /= groups(group)%text) cycle
        text = text//'  '//padded(keys(at)%name, 26)//padded(keys(at)%default, 13) &
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

end module battery_namelist_keys
