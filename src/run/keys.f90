!> Every key of the namelist, declared once: one line a key, in the order of the documentation.
!>
!> A new key is its line here and the line of the plan that uses it.
module battery_keys
  use battery_kinds, only: wp, int64
  use battery_engines, only: engine_choices
  use battery_key, only: key_type, find_key, whole_key, real_key, text_key, logical_key
  use battery_namelist_text, only: most_values
  implicit none (type, external)
  private
  public :: all_keys

  !> Most particles: the engines keep up to ten numbers a particle in one array, whose indices have
  !> 32 bits.
  integer(int64), parameter :: most_particles = 200000000_int64

  !> Greatest whole number of a key that may be beyond 32 bits: 18 digits, so that sums of a few
  !> fit.
  integer(int64), parameter :: long = 999999999999999999_int64

contains

  !> All keys; those of &scan are twins of keys of other groups.
  pure function all_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [table_keys(), particles_keys(), gate_keys(), run_keys()]
    keys = [keys, scan_keys(keys), output_keys(), limits_keys()]
  end function all_keys

  pure function table_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key('table', 'shape', text_key, '''circuit''', 'the circuit, or one urn with one gate', &
      choices='circuit urn'), &
      key('table', 'urn_radius', real_key, '1', 'radius of both urns, or of urn 1 and of urn 2', &
      above=0.0_wp, most=2, unit='length', symbol='r'), &
      key('table', 'channel1_width', real_key, '0.3', 'width of channel 1, below 2 r', &
      above=0.0_wp, unit='length', symbol='w'), &
      key('table', 'channel1_length', real_key, '1', 'length of channel 1, both gates together', &
      above=0.0_wp, unit='length', symbol='l'), &
      key('table', 'channel2_width', real_key, '0.01', &
      'width of channel 2, below 2 r; 0 closes it', least=0.0_wp, unit='length', symbol='w'''), &
      key('table', 'channel2_length', real_key, '1', 'length of channel 2, both halves together', &
      above=0.0_wp, unit='length', symbol='l''')]
  end function table_keys

  pure function particles_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key('particles', 'number', whole_key, '', 'how many particles', least=1.0_wp, &
      greatest=most_particles, symbol='N'), &
      key('particles', 'urn1_number', whole_key, '', 'how many start in urn 1; else half', &
      least=0.0_wp, symbol='N1'), &
      key('particles', 'urn1_fraction', real_key, '', 'share that starts in urn 1 instead', &
      least=0.0_wp, symbol='N1/N'), &
      key('particles', 'seed', whole_key, '1', 'base seed of the random numbers', &
      least=0.0_wp, greatest=long), &
      key('particles', 'initial_file', text_key, '''''', 'file with x y ux uy of each particle')]
  end function particles_keys

  pure function gate_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key('gate', 'threshold', whole_key, '', &
      'more turn a gate back: both gates, or that of urn 1 and that of urn 2', &
      least=0.0_wp, most=2, symbol='T'), &
      key('gate', 'threshold_fraction', real_key, '', 'the same as a share of number', &
      least=0.0_wp, most=2, symbol='T/N')]
  end function gate_keys

  pure function run_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key('run', 'engine', text_key, '''excursion''', 'how the particles are moved', &
      choices=engine_choices()), &
      key('run', 'collisions', whole_key, '100000000', 'wall collisions in all', &
      least=1.0_wp, greatest=long), &
      key('run', 'transient_collisions', whole_key, '', &
      'those before the averages begin; else half', least=0.0_wp, greatest=long), &
      key('run', 'duration', real_key, '0', 'length in time instead of collisions; 0: none', &
      least=0.0_wp, unit='time'), &
      key('run', 'transient_duration', real_key, '0', 'time before the averages begin', &
      least=0.0_wp, unit='time'), &
      key('run', 'start_time', real_key, '0', 'what the clock shows at the start', &
      least=0.0_wp, unit='time'), &
      key('run', 'time_step', real_key, '', 'step of the engine timestep', &
      above=0.0_wp, unit='time')]
  end function run_keys

  !> What can be scanned, the slowest first: each key as a list and as a range.
  pure function scan_keys(others) result(keys)
    !> The keys of the other groups.
    type(key_type), intent(in) :: others(:)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      twins(others, 'gate', 'threshold'), &
      twins(others, 'gate', 'threshold_fraction'), &
      twins(others, 'particles', 'number'), &
      twins(others, 'table', 'channel1_width'), &
      twins(others, 'table', 'channel2_width'), &
      twins(others, 'table', 'channel1_length'), &
      twins(others, 'table', 'channel2_length'), &
      twins(others, 'table', 'urn_radius'), &
      twins(others, 'particles', 'urn1_fraction'), &
      key('scan', 'replicas', whole_key, '1', 'runs of each point, with other seeds', &
      least=1.0_wp)]
  end function scan_keys

  pure function output_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key('output', 'file', text_key, '''battery.h5''', 'where the results go', decides=.false.), &
      key('output', 'series_interval', real_key, '0', 'time between series entries; 0: none', &
      least=0.0_wp, unit='time'), &
      key('output', 'snapshot_times', real_key, '', &
      'times at which positions and velocities are kept', least=0.0_wp, most=most_values, &
      unit='time'), &
      key('output', 'event_log', logical_key, '.false.', 'whether events are kept (one task)'), &
      key('output', 'final_state', logical_key, '.false.', 'whether the final state is kept')]
  end function output_keys

  pure function limits_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key('limits', 'wall_minutes', real_key, '0', 'the run stops cleanly before; 0: never', &
      least=0.0_wp, unit='min', decides=.false.), &
      key('limits', 'checkpoint_minutes', real_key, '10', 'how often long tasks save their state', &
      least=0.0_wp, unit='min', decides=.false.)]
  end function limits_keys

  !> The list and the range of a key that can be scanned, with the bounds and the unit of the key.
  pure function twins(others, group, name) result(pair)
    type(key_type), intent(in) :: others(:)
    character(len=*), intent(in) :: group, name
    type(key_type) :: pair(2)

    pair = others(find_key(others, group, name))
    pair(1)%group = 'scan'
    pair(2)%group = 'scan'
    pair(2)%name = name//'_range'
    pair(1)%most_values = most_values
    pair(2)%most_values = 3
    pair(2)%is_range = .true.
    pair(2)%kind = real_key
    pair(1)%default = ''
    pair(2)%default = ''
    pair(1)%meaning = 'values of &'//group//' '//name
    pair(2)%meaning = 'the same, evenly spaced'
  end function twins

  !> One key; `least` is the least number allowed, `above` a bound that is not allowed itself,
  !> `most` how many values it takes.
  pure function key(group, name, kind, default, meaning, least, above, greatest, most, choices, &
      unit, symbol, decides)
    character(len=*), intent(in) :: group, name, default, meaning
    integer, intent(in) :: kind
    real(wp), intent(in), optional :: least, above
    integer(int64), intent(in), optional :: greatest
    integer, intent(in), optional :: most
    character(len=*), intent(in), optional :: choices, unit, symbol
    logical, intent(in), optional :: decides
    type(key_type) :: key

    key%group = group
    key%name = name
    key%kind = kind
    key%default = default
    key%meaning = meaning
    key%choices = ''
    key%unit = ''
    key%symbol = ''
    if (present(least)) key%least = least
    if (present(above)) key%least = above
    key%above = present(above)
    if (present(greatest)) key%greatest = greatest
    if (present(most)) key%most_values = most
    if (present(choices)) key%choices = choices
    if (present(unit)) key%unit = unit
    if (present(symbol)) key%symbol = symbol
    if (present(decides)) key%decides = decides
  end function key

end module battery_keys
