!> Every key of the namelist, declared once: one line a key, in the order of the documentation.
!>
!> A new key is its line here and the line of the plan that uses it.
module battery_keys
  use battery_kinds, only: wp, int64
  use battery_engines, only: engine_choices
  use battery_key, only: key_type, find_key, whole_key, real_key, text_key, logical_key
  use battery_namelist_text, only: most_values
  use battery_corners, only: most_corners
  implicit none (type, external)
  private
  public :: all_keys

  !> Places of the keys that a scan can vary, those of a channel by its index.
  integer, parameter, public :: key_threshold = 1, key_threshold_fraction = 2, key_number = 3, &
    key_width(2) = [4, 5], key_length(2) = [6, 7], key_radius = 8, key_urn1_fraction = 9
  integer, parameter, public :: scannable = key_urn1_fraction

  !> Names of the keys of the corners of urn 1 and urn 2.
  character(len=*), parameter, public :: corner_keys(2) = [character(len=13) :: 'urn_vertices', &
    'urn2_vertices']

  !> Greatest number of particles: the engines store up to ten numbers per particle in one array,
  !> whose indices have 32 bits.
  integer(int64), parameter :: most_particles = 200000000_int64

  !> Greatest value of a key that may need more than 32 bits: 18 digits, so that sums of a few such
  !> values do not overflow.
  integer(int64), parameter :: long = 999999999999999999_int64

contains

  !> All keys. For each key that a scan can vary, &scan has a list and a range, and the same for its
  !> second value alone if that belongs to something else; the slowest come first.
  pure function all_keys() result(keys)
    type(key_type), allocatable :: keys(:), scans(:)
    integer :: k, at

    keys = declared_keys()
    allocate (scans(0))
    do k = 1, scannable
      at = findloc(keys%place, k, dim=1)
      scans = [scans, scan_keys_of(keys(at), .false.)]
      if (keys(at)%second /= '') scans = [scans, scan_keys_of(keys(at), .true.)]
    end do
    at = find_key(keys, 'scan', 'replicas')
    keys = [keys(:at - 1), scans, keys(at:)]
  end function all_keys

  !> The keys that are written in their own groups.
  pure function declared_keys() result(keys)
    type(key_type), allocatable :: keys(:)

    keys = [ &
      key_type('table', 'shape', text_key, '''circuit''', 'the circuit, or one urn with one gate', &
      choices='circuit urn'), &
      key_type('table', 'urn_radius', real_key, '1', &
      'radius of both urns, or of urn 1 and of urn 2', least=0.0_wp, above=.true., most_values=2, &
      unit='length', symbol='r', place=key_radius, second='urn 2'), &
      key_type('table', 'channel1_width', real_key, '0.3', 'width of channel 1, below 2 r', &
      least=0.0_wp, above=.true., unit='length', symbol='w', place=key_width(1)), &
      key_type('table', 'channel1_length', real_key, '1', &
      'length of channel 1, both gates together', least=0.0_wp, above=.true., unit='length', &
      symbol='l', place=key_length(1)), &
      key_type('table', 'channel2_width', real_key, '0.01', &
      'width of channel 2, below 2 r; 0 closes it', least=0.0_wp, unit='length', symbol='w''', &
      place=key_width(2)), &
      key_type('table', 'channel2_length', real_key, '1', &
      'length of channel 2, both halves together', least=0.0_wp, above=.true., unit='length', &
      symbol='l''', place=key_length(2)), &
      key_type('table', 'urn_shape', text_key, '''disc''', 'shape of the urns', &
      choices='disc polygon'), &
      key_type('table', 'urn_sides', whole_key, '', &
      'number of sides of regular polygons, even; urn_radius: from centre to corner', &
      least=4.0_wp, greatest=int(most_corners, int64)), &
      key_type('table', 'urn_vertices', real_key, '', &
      'corners x1, y1, x2, y2, ... of urn 1, counterclockwise, x towards channel 1', &
      most_values=2*most_corners, unit='length'), &
      key_type('table', 'urn2_vertices', real_key, '', &
      'corners of urn 2, x towards channel 1 as well; if not given: mirror image', &
      most_values=2*most_corners, unit='length'), &
      key_type('table', 'scatterers', real_key, '', &
      'fixed discs in channel 2: z, y, radius of each; z = 0 is the periodic line', &
      most_values=30000, unit='length'), &
      key_type('particles', 'number', whole_key, '', 'number of particles', least=1.0_wp, &
      greatest=most_particles, symbol='N', place=key_number), &
      key_type('particles', 'urn1_number', whole_key, '', &
      'how many start in urn 1; if not given: half of number', least=0.0_wp, symbol='N1'), &
      key_type('particles', 'urn1_fraction', real_key, '', &
      'fraction of the particles that starts in urn 1', least=0.0_wp, greatest=1_int64, &
      symbol='N1/N', place=key_urn1_fraction), &
      key_type('particles', 'seed', whole_key, '1', 'base seed of the random numbers', &
      least=0.0_wp, greatest=long), &
      key_type('particles', 'initial_file', text_key, '''''', &
      'file with x y ux uy of each particle; x = 0 is the middle of channel 1'), &
      key_type('gate', 'threshold', whole_key, '', &
      'a gate that counts more than T reverses; one T for both gates, or two', least=0.0_wp, &
      most_values=2, symbol='T', place=key_threshold, second='gate 2'), &
      key_type('gate', 'threshold_fraction', real_key, '', 'T as a fraction of number', &
      least=0.0_wp, most_values=2, symbol='T/N', place=key_threshold_fraction), &
      key_type('run', 'engine', text_key, '''excursion''', 'method of the simulation', &
      choices=engine_choices()), &
      key_type('run', 'collisions', whole_key, '100000000', &
      'wall collisions in all, the transient included', least=1.0_wp, greatest=long), &
      key_type('run', 'transient_collisions', whole_key, '', &
      'wall collisions before the averages begin; if not given: half of all', least=0.0_wp, &
      greatest=long), &
      key_type('run', 'duration', real_key, '0', &
      'length of the run in time, instead of collisions; 0: none', least=0.0_wp, unit='time'), &
      key_type('run', 'transient_duration', real_key, '0', 'time before the averages begin', &
      least=0.0_wp, unit='time'), &
      key_type('run', 'start_time', real_key, '0', 'time at the start of the run', &
      least=0.0_wp, unit='time'), &
      key_type('run', 'time_step', real_key, '', 'step of the engine timestep', least=0.0_wp, &
      above=.true., unit='time'), &
      key_type('scan', 'replicas', whole_key, '1', 'runs of each point, with different seeds', &
      least=1.0_wp), &
      key_type('precision', 'chi_replica_error', real_key, '', &
      'required standard error of chi over replicas', least=0.0_wp, above=.true.), &
      key_type('precision', 'polarised_current_replica_error', real_key, '', &
      'required standard error of polarised_current over replicas', least=0.0_wp, &
      above=.true., unit='1/time'), &
      key_type('precision', 'largest_replicas', whole_key, '64', &
      'largest number of replicas of a point', least=1.0_wp), &
      key_type('output', 'file', text_key, '''battery.h5''', 'name of the results file', &
      changes_results=.false.), &
      key_type('output', 'series_interval', real_key, '0', 'time between series entries; 0: none', &
      least=0.0_wp, unit='time'), &
      key_type('output', 'snapshot_times', real_key, '', &
      'times at which positions and velocities are stored', least=0.0_wp, most_values=most_values, &
      unit='time'), &
      key_type('output', 'snapshot_times_range', real_key, '', 'the same, evenly spaced', &
      least=0.0_wp, most_values=3, is_range=.true., unit='time'), &
      key_type('output', 'event_log', logical_key, '.false.', &
      'whether events are stored (one task)'), &
      key_type('output', 'final_state', logical_key, '.false.', &
      'whether the final state is stored'), &
      key_type('limits', 'wall_minutes', real_key, '0', &
      'the run stops cleanly before this time; 0: no limit', least=0.0_wp, unit='min', &
      changes_results=.false.), &
      key_type('limits', 'checkpoint_minutes', real_key, '10', &
      'interval at which long tasks save their state', least=0.0_wp, unit='min', &
      changes_results=.false.)]
  end function declared_keys

  !> The list and the range of a key that a scan can vary, with its bounds and unit; or those of its
  !> second value alone.
  pure function scan_keys_of(key, is_second) result(keys)
    type(key_type), intent(in) :: key
    logical, intent(in) :: is_second
    type(key_type) :: keys(2)

    keys = key
    keys%group = 'scan'
    keys%default = ''
    keys%is_second = is_second
    if (is_second) keys%name = trim(key%name)//'2'
    keys(2)%name = trim(keys(1)%name)//'_range'
    keys%most_values = [most_values, 3]
    keys(2)%is_range = .true.
    keys(2)%kind = real_key
    keys%meaning = [character(len=80) :: 'values of &'//trim(key%group)//' '//key%name, &
      'the same, evenly spaced']
    if (is_second) keys(1)%meaning = 'values for '//trim(key%second)//', in pairs with ' &
      //trim(key%name)//' if that is a list'
  end function scan_keys_of

end module battery_keys
