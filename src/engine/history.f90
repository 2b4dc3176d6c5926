!> What happened in one window of an engine: crossings, counts, and the event log.
!>
!> Times in a history are counted from the beginning of its window, so they stay sharp however long
!> the run has been.
module battery_history
  use battery_kinds, only: wp, int8, int32, int64
  use battery_channel, only: gated, ungated
  use battery_ordering, only: put_times_in_order => put_in_order
  implicit none (type, external)
  private
  public :: history_type, reserve_history, make_room, record_crossing, record_event, &
    record_reversal, order_events, crossing_of, channel_of, put_in_order
  public :: channel1_12, channel1_21, channel2_12, channel2_21
  public :: event_entry, event_reversal, event_crossing1, event_crossing2

  !> Crossings: of the middle line of channel 1 and of the periodic line, from urn 1 to 2 and back.
  integer, parameter :: channel1_12 = 1, channel1_21 = 2, channel2_12 = 3, channel2_21 = 4

  !> The crossing of the line of each channel by one who comes from each side, (side, channel).
  integer, parameter :: crossing_of(2, 2) = reshape([channel1_12, channel1_21, channel2_12, &
    channel2_21], [2, 2])

  !> Kinds of the event log.
  integer, parameter :: event_entry = 1, event_reversal = 2, event_crossing1 = 3, &
    event_crossing2 = 4

  !> How the log tells of a crossing: its kind, and which way.
  integer, parameter :: event_of(4) = [event_crossing1, event_crossing1, event_crossing2, &
    event_crossing2], way_of(4) = [12, 21, 12, 21]

  !> The history of one window. Arrays may be longer than their counts say.
  type :: history_type
    !> Length of the window.
    real(wp) :: duration = 0.0_wp
    !> Crossings in the order of time: when (since the window began) and which (`channel1_12` ...).
    integer :: crossings = 0
    !> How many `make_room` has made room for; before, less than anybody asks for.
    integer, private :: room = -1
    real(wp), allocatable :: crossing_time(:)
    integer(int8), allocatable :: crossing(:)
    !> Wall collisions that became known in the window (see `engine_type%collisions`).
    integer(int64) :: collisions = 0
    !> How often the gate of each urn reversed, and how many particles both turned back.
    integer(int64) :: reversals(2) = 0, bounce_backs = 0
    !> Sum of |N1 - N2| over the states after each wall collision, and how many there were; only
    !> from engines that see each collision.
    integer(int64) :: collision_spread_sum = 0, collisions_seen = 0
    !> The event log, if asked for: kind, where (gate, or 12 or 21), particle (or how many).
    logical :: logging = .false.
    integer :: events = 0
    real(wp), allocatable :: event_time(:)
    integer(int32), allocatable :: event_kind(:), event_where(:), event_particle(:)
  end type history_type

contains

  !> The channel of a crossing.
  elemental function channel_of(crossing) result(channel)
    !> `channel1_12` ...
    integer, intent(in) :: crossing
    integer :: channel

    channel = merge(gated, ungated, crossing == channel1_12 .or. crossing == channel1_21)
  end function channel_of

  !> Empties the history and makes room for `crossings` crossings and as many as `events` events.
  subroutine reserve_history(history, crossings, events)
    type(history_type), intent(inout) :: history
    integer, intent(in) :: crossings, events

    history%duration = 0.0_wp
    history%crossings = 0
    history%collisions = 0
    history%reversals = 0
    history%bounce_backs = 0
    history%collision_spread_sum = 0
    history%collisions_seen = 0
    history%events = 0
    if (crossings > history%room .or. history%logging) call make_room(history, crossings, events)
  end subroutine reserve_history

  !> Makes room for that many crossings and events, at least doubling what must grow.
  subroutine make_room(history, crossings, events)
    type(history_type), intent(inout) :: history
    !> How many must fit in all; events only if they are logged.
    integer, intent(in) :: crossings, events
    integer :: room

    if (.not. allocated(history%crossing_time)) allocate (history%crossing_time(0), &
      history%crossing(0))
    if (size(history%crossing_time) < crossings) then
      room = max(crossings, 2*size(history%crossing_time), 64)
      history%crossing_time = [history%crossing_time, spread(0.0_wp, 1, room &
        - size(history%crossing_time))]
      history%crossing = [history%crossing, spread(0_int8, 1, room - size(history%crossing))]
    end if
    history%room = size(history%crossing_time)
    if (.not. history%logging) return
    if (.not. allocated(history%event_time)) allocate (history%event_time(0), &
      history%event_kind(0), history%event_where(0), history%event_particle(0))
    if (size(history%event_time) < events) then
      room = max(events, 2*size(history%event_time), 64) - size(history%event_time)
      history%event_time = [history%event_time, spread(0.0_wp, 1, room)]
      history%event_kind = [history%event_kind, spread(0_int32, 1, room)]
      history%event_where = [history%event_where, spread(0_int32, 1, room)]
      history%event_particle = [history%event_particle, spread(0_int32, 1, room)]
    end if
  end subroutine make_room

  !> Adds a crossing, and its event if events are logged.
  subroutine record_crossing(history, time, crossing, particle)
    type(history_type), intent(inout) :: history
    !> Since the window began.
    real(wp), intent(in) :: time
    !> `channel1_12` ...
    integer, intent(in) :: crossing
    !> Its number, from 1.
    integer, intent(in) :: particle

    if (history%crossings >= history%room) call make_room(history, history%crossings + 1, 0)
    history%crossings = history%crossings + 1
    history%crossing_time(history%crossings) = time
    history%crossing(history%crossings) = int(crossing, int8)
    if (history%logging) call record_event(history, time, event_of(crossing), way_of(crossing), &
      particle)
  end subroutine record_crossing

  !> A gate turns back `counted` particles.
  subroutine record_reversal(history, time, gate, counted)
    type(history_type), intent(inout) :: history
    !> Since the window began.
    real(wp), intent(in) :: time
    !> That of urn 1 or 2, and how many it turns back.
    integer, intent(in) :: gate, counted

    if (history%logging) call record_event(history, time, event_reversal, gate, counted)
    history%reversals(gate) = history%reversals(gate) + 1
    history%bounce_backs = history%bounce_backs + counted
  end subroutine record_reversal

  !> Adds an event to the log.
  subroutine record_event(history, time, kind, where, particle)
    type(history_type), intent(inout) :: history
    !> Since the window began.
    real(wp), intent(in) :: time
    !> `event_entry` ...; the gate, or 12 or 21; who, or how many.
    integer, intent(in) :: kind, where, particle
    integer :: at

    if (history%events == size(history%event_time)) call make_room(history, 0, history%events + 1)
    at = history%events + 1
    history%events = at
    history%event_time(at) = time
    history%event_kind(at) = int(kind, int32)
    history%event_where(at) = int(where, int32)
    history%event_particle(at) = int(particle, int32)
  end subroutine record_event

  !> Puts the events of one instant, `first` to `last`, in the order of the log: crossings
  !> of channel 1 from urn 1, from urn 2, then the rest, by particle; a reversal after the last of
  !> those who entered.
  pure subroutine order_events(history, first, last)
    type(history_type), intent(inout) :: history
    !> Places of the first and the last of them.
    integer, intent(in) :: first, last
    integer(int64) :: rank(first:last), mine
    integer(int32) :: kind, where, particle
    integer :: at, k

    do at = first, last
      mine = 2_int64*history%event_particle(at)
      if (history%event_kind(at) == event_crossing1) then
        mine = mine - merge(2_int64, 1_int64, history%event_where(at) == 12)*2_int64**40
      else if (history%event_kind(at) == event_reversal) then
        mine = 1 + 2_int64*maxval(history%event_particle(first:last), &
          mask=history%event_kind(first:last) == event_entry &
          .and. history%event_where(first:last) == history%event_where(at))
      end if
      rank(at) = mine
    end do
    do at = first + 1, last
      mine = rank(at)
      kind = history%event_kind(at)
      where = history%event_where(at)
      particle = history%event_particle(at)
      do k = at - 1, first, -1
        if (rank(k) <= mine) exit
        rank(k + 1) = rank(k)
        history%event_kind(k + 1) = history%event_kind(k)
        history%event_where(k + 1) = history%event_where(k)
        history%event_particle(k + 1) = history%event_particle(k)
      end do
      rank(k + 1) = mine
      history%event_kind(k + 1) = kind
      history%event_where(k + 1) = where
      history%event_particle(k + 1) = particle
    end do
  end subroutine order_events

  !> Puts all that a history tells in the order of time, and the events of one instant in that of
  !> the log.
  subroutine put_in_order(history)
    type(history_type), intent(inout) :: history
    integer, allocatable :: order(:)
    integer :: first, last

    associate (n => history%crossings)
      call find_order(n, history%crossing_time, order)
      history%crossing(:n) = history%crossing(order)
    end associate
    if (.not. history%logging) return
    associate (n => history%events)
      call find_order(n, history%event_time, order)
      history%event_kind(:n) = history%event_kind(order)
      history%event_where(:n) = history%event_where(order)
      history%event_particle(:n) = history%event_particle(order)
      first = 1
      do last = 1, n
        if (last < n) then
          if (history%event_time(last + 1) <= history%event_time(last)) cycle
        end if
        if (last > first) call order_events(history, first, last)
        first = last + 1
      end do
    end associate
  end subroutine put_in_order

  !> Puts times in order, and says where each came from.
  subroutine find_order(n, time, order)
    integer, intent(in) :: n
    real(wp), intent(inout) :: time(:)
    integer, allocatable, intent(out) :: order(:)
    integer :: k

    order = [(k, k=1, n)]
    call put_times_in_order(n, time(:n), order)
  end subroutine find_order

end module battery_history
