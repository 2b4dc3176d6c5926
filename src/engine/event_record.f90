!> Record of one window of an engine: crossings, counts, and the event log.
!>
!> Times count from the beginning of the window, so they stay sharp however long the run has been.
module battery_event_record
  use battery_kinds, only: wp, int8, int32, int64
  use battery_channel, only: channel1, channel2
  use battery_ordering, only: sort_by_time
  implicit none (type, external)
  private
  public :: event_type, event_record_type, reserve_event_record, record_crossing, &
    put_channel1_first, record_event, record_reversal, sort_simultaneous_events, crossing_of, &
    channel_of, sort_event_record
  public :: channel1_12, channel1_21, channel2_12, channel2_21
  public :: event_entry, event_reversal, event_crossing1, event_crossing2

  !> Crossings: of the middle line of channel 1 and of the periodic line, from urn 1 to 2 and back.
  integer, parameter :: channel1_12 = 1, channel1_21 = 2, channel2_12 = 3, channel2_21 = 4

  !> The crossing of the line of each channel by a particle from each urn, (urn, channel).
  integer, parameter :: crossing_of(2, 2) = reshape([channel1_12, channel1_21, channel2_12, &
    channel2_21], [2, 2])

  !> Kinds of the event log.
  integer, parameter :: event_entry = 1, event_reversal = 2, event_crossing1 = 3, &
    event_crossing2 = 4

  !> Kind and direction of a crossing in the event log.
  integer, parameter :: event_of(4) = [event_crossing1, event_crossing1, event_crossing2, &
    event_crossing2], direction_of(4) = [12, 21, 12, 21]

  !> An event of the log: time; kind, place (gate, or direction 12 or 21) and particle (of a
  !> reversal: number of particles).
  type :: event_type
    real(wp) :: time = 0.0_wp
    integer(int32) :: kind = 0, where = 0, particle = 0
  end type event_type

  !> Events and counts of one window. Arrays may be longer than their counts.
  type :: event_record_type
    !> Length of the window.
    real(wp) :: duration = 0.0_wp
    !> Crossings in the order of time: time and kind (`channel1_12` ...) of each.
    integer :: crossings = 0
    !> Size of the arrays of crossings.
    integer, private :: capacity = 0
    real(wp), allocatable :: crossing_time(:)
    integer(int8), allocatable :: crossing(:)
    !> Wall collisions computed in the window (see `engine_type%collisions`).
    integer(int64) :: collisions = 0
    !> Reversals of each gate, and particles reversed by both.
    integer(int64) :: reversals(2) = 0, bounce_backs = 0
    !> Sum of |N1 - N2| over the wall collisions, and their number; only from
    !> engines that process every collision.
    integer(int64) :: collision_spread_sum = 0, collisions_seen = 0
    !> The event log, if asked for.
    logical :: logging = .false.
    integer :: events = 0
    type(event_type), allocatable :: event(:)
  end type event_record_type

contains

  !> The channel of a crossing.
  elemental function channel_of(crossing) result(channel)
    !> `channel1_12` ...
    integer, intent(in) :: crossing
    integer :: channel

    channel = merge(channel1, channel2, crossing == channel1_12 .or. crossing == channel1_21)
  end function channel_of

  !> Empties the record, and allocates it for `crossings` crossings, or none.
  subroutine reserve_event_record(event_record, crossings)
    type(event_record_type), intent(inout) :: event_record
    integer, intent(in) :: crossings

    event_record%duration = 0.0_wp
    event_record%crossings = 0
    event_record%collisions = 0
    event_record%reversals = 0
    event_record%bounce_backs = 0
    event_record%collision_spread_sum = 0
    event_record%collisions_seen = 0
    event_record%events = 0
    if (crossings >= event_record%capacity) call grow_event_record(event_record, crossings)
  end subroutine reserve_event_record

  !> Enlarges the arrays to at least `crossings` crossings; if they must grow, they are at least
  !> doubled. The first call allocates the event log too, which `record_event` enlarges.
  subroutine grow_event_record(event_record, crossings)
    type(event_record_type), intent(inout) :: event_record
    !> Total number to fit.
    integer, intent(in) :: crossings
    integer :: capacity

    if (.not. allocated(event_record%crossing_time)) allocate (event_record%crossing_time(0), &
      event_record%crossing(0), event_record%event(0))
    if (size(event_record%crossing_time) < crossings) then
      capacity = max(crossings, 2*size(event_record%crossing_time), 64)
      event_record%crossing_time = [event_record%crossing_time, spread(0.0_wp, 1, capacity &
        - size(event_record%crossing_time))]
      event_record%crossing = [event_record%crossing, spread(0_int8, 1, capacity &
        - size(event_record%crossing))]
    end if
    event_record%capacity = size(event_record%crossing_time)
  end subroutine grow_event_record

  !> Adds a crossing, and its event if events are logged.
  subroutine record_crossing(event_record, time, crossing, particle)
    type(event_record_type), intent(inout) :: event_record
    !> Since the window began.
    real(wp), intent(in) :: time
    !> `channel1_12` ...
    integer, intent(in) :: crossing
    !> Particle index, 1 ... N.
    integer, intent(in) :: particle

    if (event_record%crossings >= event_record%capacity) call grow_event_record(event_record, &
      event_record%crossings + 1)
    event_record%crossings = event_record%crossings + 1
    event_record%crossing_time(event_record%crossings) = time
    event_record%crossing(event_record%crossings) = int(crossing, int8)
    if (event_record%logging) call record_event(event_record, time, event_of(crossing), &
      direction_of(crossing), particle)
  end subroutine record_crossing

  !> Moves a crossing of channel 1 before those of channel 2 at the same time, which change N1 - N2
  !> afterwards; of one channel any order yields the same averages.
  pure subroutine put_channel1_first(event_record, at)
    type(event_record_type), intent(inout) :: event_record
    !> Index of the crossing; those before it are in order.
    integer, intent(in) :: at
    integer(int8) :: mine
    integer :: k

    mine = event_record%crossing(at)
    if (channel_of(int(mine)) /= channel1) return
    do k = at - 1, 1, -1
      if (event_record%crossing_time(k) < event_record%crossing_time(at) &
        .or. channel_of(int(event_record%crossing(k))) == channel1) exit
      event_record%crossing(k + 1) = event_record%crossing(k)
    end do
    event_record%crossing(k + 1) = mine
  end subroutine put_channel1_first

  !> Adds a reversal of a gate, which reverses `counted` particles.
  subroutine record_reversal(event_record, time, gate, counted)
    type(event_record_type), intent(inout) :: event_record
    !> Since the window began.
    real(wp), intent(in) :: time
    !> The gate, 1 or 2, and the number of particles.
    integer, intent(in) :: gate, counted

    if (event_record%logging) call record_event(event_record, time, event_reversal, gate, counted)
    event_record%reversals(gate) = event_record%reversals(gate) + 1
    event_record%bounce_backs = event_record%bounce_backs + counted
  end subroutine record_reversal

  !> Adds an event to the log.
  subroutine record_event(event_record, time, kind, where, particle)
    type(event_record_type), intent(inout) :: event_record
    !> Since the window began.
    real(wp), intent(in) :: time
    !> Kind (`event_entry` ...); gate, or direction 12 or 21; particle, or number of particles.
    integer, intent(in) :: kind, where, particle

    if (event_record%events == size(event_record%event)) event_record%event = [event_record%event, &
      spread(event_type(), 1, max(event_record%events, 64))]
    event_record%events = event_record%events + 1
    event_record%event(event_record%events) = event_type(time, int(kind, int32), int(where, &
      int32), int(particle, int32))
  end subroutine record_event

  !> Sorts the events of one instant, `first` to `last`, in the order of the log: crossings of
  !> channel 1 from urn 1, from urn 2, then the rest, by particle; a reversal after the last entry.
  pure subroutine sort_simultaneous_events(event_record, first, last)
    type(event_record_type), intent(inout) :: event_record
    !> Their first and last index.
    integer, intent(in) :: first, last
    type(event_type) :: event
    integer(int64) :: rank(first:last), mine
    integer :: at, k

    do at = first, last
      event = event_record%event(at)
      mine = 2_int64*event%particle
      if (event%kind == event_crossing1) then
        mine = mine - merge(2_int64, 1_int64, event%where == 12)*2_int64**40
      else if (event%kind == event_reversal) then
        associate (all => event_record%event(first:last))
          mine = 1 + 2_int64*maxval(all%particle, mask=all%kind == event_entry .and. all%where &
            == event%where)
        end associate
      end if
      rank(at) = mine
    end do
    do at = first + 1, last
      mine = rank(at)
      event = event_record%event(at)
      do k = at - 1, first, -1
        if (rank(k) <= mine) exit
        rank(k + 1) = rank(k)
        event_record%event(k + 1) = event_record%event(k)
      end do
      rank(k + 1) = mine
      event_record%event(k + 1) = event
    end do
  end subroutine sort_simultaneous_events

  !> Sorts the record by time, and the events of one instant in the order of the log. Crossings of
  !> one instant keep their order: those of channel 1 are recorded first.
  subroutine sort_event_record(event_record)
    type(event_record_type), intent(inout) :: event_record
    integer, allocatable :: order(:)
    real(wp), allocatable :: time(:)
    integer :: first, last

    associate (n => event_record%crossings)
      call sort_times_with_permutation(event_record%crossing_time(:n), order)
      event_record%crossing(:n) = event_record%crossing(order)
    end associate
    if (.not. event_record%logging) return
    associate (n => event_record%events)
      time = event_record%event(:n)%time
      call sort_times_with_permutation(time, order)
      event_record%event(:n) = event_record%event(order)
      first = 1
      do last = 1, n
        if (last < n) then
          if (time(last + 1) <= time(last)) cycle
        end if
        if (last > first) call sort_simultaneous_events(event_record, first, last)
        first = last + 1
      end do
    end associate
  end subroutine sort_event_record

  !> Sorts times; `order` is the permutation: the index that each had before.
  subroutine sort_times_with_permutation(time, order)
    real(wp), intent(inout) :: time(:)
    integer, allocatable, intent(out) :: order(:)
    integer :: k

    order = [(k, k=1, size(time))]
    call sort_by_time(size(time), time, order)
  end subroutine sort_times_with_permutation

end module battery_event_record
