!> Measurements while an engine runs: mass spread, flows, and their time series.
!>
!> An observer reads the event record of each window. It updates N1 at each crossing, so time
!> averages are exact integrals over the windows. Averages start at `begin_measuring`, the series at
!> the start of the run. Source: mass spread eq. (mass), net current eq. (netJ), with its sign:
!> (n12 - n21)/t.
!>
!> **Polarised current.** A crossing of channel 2 counts with the sign of the mean of N1 - N2 before
!> and after it: 1 from the fuller half to the emptier one, -1 in the other direction, and 0 if the
!> crossing changes N1 - N2 from 1 to -1 or back. So a crossing changes
!> |N1 - N2| by -2 times its count, and over any time the counts of both channels add up to (|N1 -
!> N2| at the start less that at the end)/2: up to that, the current down the polarisation through
!> channel 2 equals the one up through channel 1.
!>
!> **Standard errors** come from the run itself (`battery_blocks`). They are NaN if the run is known
!> to be too short:
!> - for all averages, if it is shorter than ten times `relaxation_time` of the table;
!> - for chi, near equal densities, if N1, whose variance is about N/4 there (less in unequal urns),
!>   changed too little: in a relaxation time the squares of its changes in short times add up to
!>   twice its variance;
!> - for chi, if few particles came to the emptier half: those that stay long decide its mean, and a
!>   run that lacks them does not show how much they matter;
!> - for currents, in a polarised state in which the gate of the sparse urn hardly ever reverses:
!>   particles that circulate along the axis carry part of the current until that gate reverses
!>   them, so the run must have several such reversals;
!> - for currents from urn 1 to urn 2, if N1 - N2 changed its sign only a few times: their mean is
!>   over both polarities. The polarised current still has an error.
module battery_observer
  use battery_kinds, only: wp, dp, int64
  use battery_blocks, only: blocks_type, add_block, standard_error, serialize_blocks
  use battery_channel, only: channel1, channel2
  use battery_event_record, only: event_record_type, channel1_12, channel2_12, channel_of
  use battery_quantities, only: measured_type, set_average, set_count, flow_names, &
    unknown_real
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: observer_type, new_observer, observe_window, begin_measuring, end_series
  public :: get_measured, measured_time, serialize_observer

  !> Averages that have a standard error from blocks.
  integer, parameter, public :: of_chi = 1, of_current1 = 2, of_current2 = 3, of_polarised = 4, &
    of_difference = 5

  !> Least numbers that an error requires: of relaxation times in the run, of reversals of the
  !> sparse urn's gate, and of sign changes of N1 - N2.
  real(wp), parameter :: least_relaxations = 10.0_wp
  integer(int64), parameter :: least_reversals = 4
  integer, parameter :: least_changes = 6
  !> Least sum of the squares of the changes of N1 in the blocks, over four times its variance,
  !> where densities are equal: there the square of the deviation of N1 - N2 from its value is at
  !> most `equal_densities` times its variance.
  real(wp), parameter :: least_changes_of_number = 5.0_wp
  real(wp), parameter :: equal_densities = 16.0_wp
  !> Least time that all particles together spent in the emptier half, in relaxation times: the
  !> few of them that stay long decide.
  real(wp), parameter :: least_stay = 30.0_wp
  !> The state counts as polarised if one gate reverses this many times as often as the other.
  integer(int64), parameter :: unlike = 10

  !> Relative rounding error of a ratio of two times.
  real(wp), parameter :: rounding = 8.0_wp*epsilon(1.0_wp)

  !> State of the measurements of a run.
  type :: observer_type
    !> Number of particles.
    integer :: number = 0
    !> Number of particles in half 1 now.
    integer :: urn1_number = 0
    !> False for the single urn: it has one half, and a crossing does not change N1.
    logical :: has_two_urns = .true.
    !> Whether channel 2 is open, so that a current can flow through it.
    logical :: channel2_open = .true.
    !> Relaxation time of the directions of motion.
    real(wp) :: relaxation = 0.0_wp
    !> (N1 - N2)/N of equal densities, 0 for equal urns. Not saved: set by who makes or restores it.
    real(wp) :: even_difference = 0.0_wp
    !> Since the start: reversals of each gate, particles reversed, wall collisions reported.
    integer(int64) :: reversals(2) = 0, bounce_backs = 0, collisions = 0
    !> Reversals of each gate before measuring began.
    integer(int64) :: transient_reversals(2) = 0

    logical :: measuring = .false.
    !> Sums since measuring began; those of `time`, `spread` and `downward` exclude the present
    !> block.
    real(wp) :: time = 0.0_wp, spread = 0.0_wp
    integer(int64) :: crossings(4) = 0
    !> Crossings of channel 2 from the fuller half to the emptier one, less those in the other
    !> direction.
    integer(int64) :: downward = 0
    integer(int64) :: collision_spread_sum = 0, collisions_seen = 0
    !> The present block: time left, its time, integrals of |N1 - N2| and of N1 - N2, net crossings,
    !> and crossings of channel 2 down the polarisation.
    real(wp) :: block_left = huge(1.0_wp), block_time = 0.0_wp, block_spread = 0.0_wp
    real(wp) :: block_difference = 0.0_wp
    integer(int64) :: block_net(2) = 0, block_downward = 0
    type(blocks_type) :: blocks(5)

    !> The series: interval (0: none), time left until the next entry, number of entries.
    real(wp) :: series_interval = 0.0_wp, series_left = huge(1.0_wp)
    integer :: entries = 0
    !> Whether memory for a longer series was refused; then no entries are added.
    logical :: out_of_room = .false.
    integer(int64) :: series_crossings(4) = 0
    !> N1 at each entry; flows since the previous entry, (4, entry).
    integer, allocatable :: series_urn1_number(:)
    real(wp), allocatable :: series_flow(:, :)
  end type observer_type

contains

  !> Makes an observer of `number` particles, `urn1_number` of them in half 1 of the table (urn 1
  !> and its half channels). If `series_interval` > 0 it records a series, whose first entry is the
  !> start. The initial duration of blocks is `first_block_length` (if absent, 1): a length of the
  !> table over the speed 1, so that a table scaled by a power of two has the same blocks.
  pure function new_observer(number, urn1_number, has_two_urns, series_interval, &
    first_block_length, channel2_open, relaxation) result(observer)
    integer, intent(in) :: number, urn1_number
    !> Whether the table has two urns.
    logical, intent(in) :: has_two_urns
    real(wp), intent(in) :: series_interval
    real(wp), intent(in), optional :: first_block_length
    !> Whether channel 2 is open; true if absent.
    logical, intent(in), optional :: channel2_open
    !> Relaxation time of the directions of motion; 0 if absent.
    real(wp), intent(in), optional :: relaxation
    type(observer_type) :: observer

    observer%number = number
    observer%urn1_number = urn1_number
    observer%has_two_urns = has_two_urns
    observer%series_interval = series_interval
    if (present(first_block_length)) observer%blocks%length = first_block_length
    if (present(channel2_open)) observer%channel2_open = channel2_open
    if (present(relaxation)) observer%relaxation = relaxation
    allocate (observer%series_urn1_number(0), observer%series_flow(4, 0))
    if (series_interval > 0.0_wp) then
      observer%series_left = series_interval
      call add_series_entry(observer)
    end if
  end function new_observer

  !> Starts the averages, at the end of the transient.
  pure subroutine begin_measuring(observer)
    type(observer_type), intent(inout) :: observer

    observer%measuring = .true.
    observer%transient_reversals = observer%reversals
    observer%block_left = observer%blocks(of_chi)%length
  end subroutine begin_measuring

  !> Ends the series at the end of a run of `duration`: adds the last entry if it is missing because
  !> its time is above `duration` by rounding, as 3*0.1 is above 0.3.
  pure subroutine end_series(observer, duration)
    type(observer_type), intent(inout) :: observer
    real(wp), intent(in) :: duration
    real(wp) :: due

    if (.not. observer%series_interval > 0.0_wp) return
    due = 1.0_wp + aint(duration/observer%series_interval*(1.0_wp + rounding))
    if (real(observer%entries, wp) < due .and. &
      observer%series_left < 0.5_wp*observer%series_interval) call add_series_entry(observer)
  end subroutine end_series

  !> Adds the event record of one window to the measurements. An entry of the series at the time of
  !> a crossing comes before it.
  pure subroutine observe_window(observer, event_record, until_entry)
    type(observer_type), intent(inout) :: observer
    type(event_record_type), intent(in) :: event_record
    !> Time from the start of the window until the next entry of the series, by the engine's clock,
    !> which does not drift as the sum of windows does; if absent, that is taken.
    real(wp), intent(in), optional :: until_entry
    real(wp) :: last
    integer :: k, crossing, channel, way, down, added

    if (present(until_entry)) observer%series_left = until_entry
    last = 0.0_wp
    added = 0
    do k = 1, event_record%crossings
      call add_entries_until(observer, event_record%crossing_time(k), added)
      call integrate_interval(observer, event_record%crossing_time(k) - last)
      last = event_record%crossing_time(k)
      crossing = event_record%crossing(k)
      observer%series_crossings(crossing) = observer%series_crossings(crossing) + 1
      way = merge(1, -1, crossing == channel1_12 .or. crossing == channel2_12)
      ! Sign of the mean of N1 - N2 over before and after the crossing.
      down = way*max(-1, min(1, 2*observer%urn1_number - observer%number - way))
      if (observer%has_two_urns) observer%urn1_number = observer%urn1_number - way
      if (observer%measuring) then
        observer%crossings(crossing) = observer%crossings(crossing) + 1
        channel = channel_of(crossing)
        observer%block_net(channel) = observer%block_net(channel) + way
        if (channel == channel2) observer%block_downward = observer%block_downward + down
      end if
    end do
    call add_entries_until(observer, event_record%duration, added)
    observer%series_left = observer%series_left + (added*observer%series_interval &
      - event_record%duration)
    call integrate_interval(observer, event_record%duration - last)
    observer%reversals = observer%reversals + event_record%reversals
    observer%bounce_backs = observer%bounce_backs + event_record%bounce_backs
    observer%collisions = observer%collisions + event_record%collisions
    if (observer%measuring) then
      observer%collision_spread_sum = observer%collision_spread_sum &
        + event_record%collision_spread_sum
      observer%collisions_seen = observer%collisions_seen + event_record%collisions_seen
    end if
  end subroutine observe_window

  !> Adds the entries of the series that are due until a time since the start of the window.
  pure subroutine add_entries_until(observer, time, added)
    type(observer_type), intent(inout) :: observer
    real(wp), intent(in) :: time
    !> Number of entries since the start of the window.
    integer, intent(inout) :: added

    do while (observer%series_left + added*observer%series_interval <= time)
      call add_series_entry(observer)
      added = added + 1
    end do
  end subroutine add_entries_until

  !> Integrates over `duration`, in which there is no crossing; ends the blocks that end within it.
  pure subroutine integrate_interval(observer, duration)
    type(observer_type), intent(inout) :: observer
    real(wp), intent(in) :: duration
    real(wp) :: rest, step, difference

    rest = duration
    difference = real(2*observer%urn1_number - observer%number, wp)
    do
      step = min(rest, observer%block_left)
      if (observer%measuring) then
        observer%block_spread = observer%block_spread + abs(difference)*step
        observer%block_difference = observer%block_difference + difference*step
        observer%block_time = observer%block_time + step
        observer%block_left = observer%block_left - step
        if (observer%block_left <= 0.0_wp) call end_block(observer)
      end if
      rest = rest - step
      if (rest <= 0.0_wp) exit
    end do
  end subroutine integrate_interval

  !> Ends a block: adds its averages to the blocks, and its sums to those of the run.
  pure subroutine end_block(observer)
    type(observer_type), intent(inout) :: observer

    call add_block(observer%blocks(of_chi), &
      observer%block_spread/(observer%block_time*real(observer%number, wp)))
    call add_block(observer%blocks(of_current1), &
      real(observer%block_net(channel1), wp)/observer%block_time)
    call add_block(observer%blocks(of_current2), &
      real(observer%block_net(channel2), wp)/observer%block_time)
    call add_block(observer%blocks(of_polarised), &
      real(observer%block_downward, wp)/observer%block_time)
    call add_block(observer%blocks(of_difference), &
      observer%block_difference/(observer%block_time*real(observer%number, wp)))
    observer%time = observer%time + observer%block_time
    observer%spread = observer%spread + observer%block_spread
    observer%downward = observer%downward + observer%block_downward
    observer%block_downward = 0
    observer%block_time = 0.0_wp
    observer%block_spread = 0.0_wp
    observer%block_difference = 0.0_wp
    observer%block_net = 0
    observer%block_left = observer%blocks(of_chi)%length
  end subroutine end_block

  !> Adds an entry to the series.
  pure subroutine add_series_entry(observer)
    type(observer_type), intent(inout) :: observer

    if (observer%entries == size(observer%series_urn1_number)) call lengthen_series(observer)
    if (observer%out_of_room) return
    observer%entries = observer%entries + 1
    observer%series_urn1_number(observer%entries) = observer%urn1_number
    observer%series_flow(:, observer%entries) = &
      real(observer%series_crossings, wp)/observer%series_interval
    observer%series_crossings = 0
  end subroutine add_series_entry

  !> Doubles the capacity of the series, if there is memory for it.
  pure subroutine lengthen_series(observer)
    type(observer_type), intent(inout) :: observer
    integer, allocatable :: urn1_number(:)
    real(wp), allocatable :: flow(:, :)
    integer :: capacity, status

    capacity = observer%entries + max(256, observer%entries)
    allocate (urn1_number(capacity), stat=status)
    if (status == 0) allocate (flow(4, capacity), stat=status)
    observer%out_of_room = status /= 0
    if (observer%out_of_room) return
    urn1_number(:observer%entries) = observer%series_urn1_number
    flow(:, :observer%entries) = observer%series_flow
    call move_alloc(urn1_number, observer%series_urn1_number)
    call move_alloc(flow, observer%series_flow)
  end subroutine lengthen_series

  !> Sets the averages and counts of the observer in `measured`; quantities that others measure
  !> (collisions, times) do not change.
  pure subroutine get_measured(observer, measured)
    type(observer_type), intent(in) :: observer
    type(measured_type), intent(inout) :: measured
    real(wp) :: time
    integer :: k

    call set_count(measured, 'reversals', sum(observer%reversals))
    call set_count(measured, 'bounce_backs', observer%bounce_backs)
    time = measured_time(observer)
    if (.not. time > 0.0_wp) return
    associate (o => observer, number => real(observer%number, wp))
      do k = 1, 4
        call set_average(measured, flow_names(k), real(real(o%crossings(k), wp)/time, dp))
      end do
      call set_average(measured, 'current1', &
        real(real(o%crossings(1) - o%crossings(2), wp)/time, dp), &
        error_of(o, of_current1))
      call set_average(measured, 'current2', &
        real(real(o%crossings(3) - o%crossings(4), wp)/time, dp), &
        error_of(o, of_current2))
      if (.not. o%has_two_urns) return
      if (o%channel2_open) call set_average(measured, 'polarised_current', &
        real(real(o%downward + o%block_downward, wp)/time, dp), &
        error_of(o, of_polarised))
      call set_average(measured, 'chi', real((o%spread + o%block_spread)/(time*number), dp), &
        error_of(o, of_chi))
      if (o%collisions_seen > 0) call set_average(measured, 'chi_collision', &
        real(real(o%collision_spread_sum, wp)/(real(o%collisions_seen, wp)*number), dp))
    end associate
  end subroutine get_measured

  !> Time since measuring began.
  pure real(wp) function measured_time(observer)
    type(observer_type), intent(in) :: observer

    measured_time = observer%time + observer%block_time
  end function measured_time

  !> Standard error of an average; NaN if the run is known to be too short for it.
  pure function error_of(observer, which) result(error)
    type(observer_type), intent(in) :: observer
    !> `of_chi` ...
    integer, intent(in) :: which
    real(dp) :: error
    logical :: is_reliable

    associate (o => observer)
      ! The time of whole blocks, since the error is of these; averages are over `measured_time`.
      is_reliable = o%time/least_relaxations >= o%relaxation
      if (which == of_chi) is_reliable = is_reliable .and. number_relaxed(o) &
        .and. time_in_emptier_half(o)/least_stay >= o%relaxation
      if (which /= of_chi .and. o%has_two_urns .and. o%channel2_open) &
        is_reliable = is_reliable .and. .not. may_circulate(o%reversals - o%transient_reversals)
      if ((which == of_current1 .or. which == of_current2) .and. o%has_two_urns) &
        is_reliable = is_reliable .and. polarity_resolved(o%blocks(of_difference))
      error = unknown_real()
      if (is_reliable) error = standard_error(o%blocks(which))
    end associate
  end function error_of

  !> Time that the particles spent in the emptier half, summed over them, in the whole blocks.
  pure real(wp) function time_in_emptier_half(observer) result(time)
    type(observer_type), intent(in) :: observer

    time = 0.5_wp*(real(observer%number, wp)*observer%time - observer%spread)
  end function time_in_emptier_half

  !> Whether N1 had the time to relax, or is far from that of equal densities.
  pure logical function number_relaxed(observer)
    type(observer_type), intent(in) :: observer
    real(wp) :: changes, difference, number
    integer :: n

    associate (o => observer, blocks => observer%blocks)
      ! Four times the variance of N1, which is less than N if the urns are unequal.
      number = real(o%number, wp)*(1.0_wp - o%even_difference**2)
      n = blocks(of_difference)%count
      changes = sum((blocks(of_current1)%average(:n) + blocks(of_current2)%average(:n))**2) &
        *blocks(of_difference)%length**2
      difference = sum(blocks(of_difference)%average(:n))/real(max(n, 1), wp)
      number_relaxed = changes >= least_changes_of_number*number .or. (difference &
        - o%even_difference)**2*real(o%number, wp)**2 > equal_densities*number
    end associate
  end function number_relaxed

  !> Whether particles may have circulated throughout the run: one gate hardly ever reversed, the
  !> other often.
  pure logical function may_circulate(reversals)
    integer(int64), intent(in) :: reversals(2)

    may_circulate = minval(reversals) < least_reversals .and. &
      maxval(reversals) > unlike*max(minval(reversals), unlike)
  end function may_circulate

  !> Whether the sign of N1 - N2, from block to block, changed often enough.
  pure logical function polarity_resolved(blocks)
    type(blocks_type), intent(in) :: blocks
    logical, allocatable :: positive(:)

    positive = blocks%average(:blocks%count) > 0.0_wp
    polarity_resolved = count(positive(2:) .neqv. positive(:size(positive) - 1)) >= least_changes
  end function polarity_resolved

  !> Saves or restores all that is needed to continue observing to the same last bit.
  pure subroutine serialize_observer(observer, archive)
    type(observer_type), intent(inout) :: observer
    type(archive_type), intent(inout) :: archive
    integer :: flow, which

    call archive%serialize('number', observer%number)
    call archive%serialize('urn1_number', observer%urn1_number)
    call archive%serialize('two_halves', observer%has_two_urns)
    call archive%serialize('circuit_closed', observer%channel2_open)
    call archive%serialize('relaxation', observer%relaxation)
    call archive%serialize('reversals', observer%reversals)
    call archive%serialize('transient_reversals', observer%transient_reversals)
    call archive%serialize('bounce_backs', observer%bounce_backs)
    call archive%serialize('collisions', observer%collisions)
    call archive%serialize('measuring', observer%measuring)
    call archive%serialize('time', observer%time)
    call archive%serialize('spread', observer%spread)
    call archive%serialize('crossings', observer%crossings)
    call archive%serialize('downward', observer%downward)
    call archive%serialize('collision_spread_sum', observer%collision_spread_sum)
    call archive%serialize('collisions_seen', observer%collisions_seen)
    call archive%serialize('block_left', observer%block_left)
    call archive%serialize('block_time', observer%block_time)
    call archive%serialize('block_spread', observer%block_spread)
    call archive%serialize('block_difference', observer%block_difference)
    call archive%serialize('block_net', observer%block_net)
    call archive%serialize('block_downward', observer%block_downward)
    do which = 1, size(observer%blocks)
      call serialize_blocks(observer%blocks(which), archive)
    end do
    call archive%serialize('series_interval', observer%series_interval)
    call archive%serialize('series_left', observer%series_left)
    call archive%serialize('series_crossings', observer%series_crossings)
    call archive%serialize('entries', observer%entries)
    if (archive%failed()) return
    if (archive%reading) then
      observer%series_urn1_number = spread(0, 1, observer%entries)
      observer%series_flow = spread(spread(0.0_wp, 1, 4), 2, observer%entries)
    end if
    call archive%serialize('series_urn1_number', observer%series_urn1_number(:observer%entries))
    do flow = 1, 4
      call archive%serialize('series_flow', observer%series_flow(flow, :observer%entries))
    end do
  end subroutine serialize_observer

end module battery_observer
