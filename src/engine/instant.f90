!> What happens at one instant: hits, crossings, who is counted in the gates, and when they reverse.
!>
!> For engines in which a particle has an event at every wall. Such an engine knows when events
!> happen; here is what they do to the counts and to the history. It hands over the particle that
!> has an event (`meet`), goes on until no other event is due at that same instant, and only then
!> asks each gate whether it turns its particles back (`turns_back`). Whatever the order in which
!> the events of the instant came, that decides as if all crossings of the middle line came first,
!> then all entries, then the gate: the rule of `battery_gate`.
module battery_instant
  use battery_kinds, only: wp, int32, int64
  use battery_table, only: table_type
  use battery_bounce, only: walls_type, flight_type, new_walls, hit_arc, hit_channel, &
    enter_channel, leave_channel, cross_middle_line, cross_periodic_line, heads_for_middle, &
    on_side_one, meets_arc, meets_wall, meets_gate, meets_return, meets_urn, meets_middle, &
    meets_period
  use battery_engine, only: history_type, record_crossing, record_event, channel1_12, channel1_21, &
    channel2_12, channel2_21, event_entry, event_reversal, event_crossing1
  implicit none (type, external)
  private
  public :: scene_type, new_scene, board, meet, turns_back, count_reversal, order_events
  public :: join, quit, count_hits

  !> Who is counted in a gate, in no order.
  type :: roster_type
    integer :: count = 0
    integer(int32), allocatable :: member(:)
    !> Whether somebody has entered since the gate last decided.
    logical :: entered = .false.
  end type roster_type

  type :: scene_type
    type(walls_type) :: walls
    integer :: threshold = 0
    !> N1 - N2.
    integer :: difference = 0
    !> Wall collisions since the start.
    integer(int64) :: hits = 0
    type(roster_type) :: gate(2)
    !> Place of each particle in the roster of its gate; 0 if it is not counted.
    integer(int32), allocatable :: place(:)
  end type scene_type

contains

  !> An empty scene, for `number` particles.
  pure subroutine new_scene(scene, table, threshold, number)
    type(scene_type), intent(inout) :: scene
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold, number
    integer :: g

    scene%walls = new_walls(table)
    scene%threshold = threshold
    scene%difference = 0
    scene%hits = 0
    if (allocated(scene%place)) deallocate (scene%place)
    allocate (scene%place(number), source=0_int32)
    do g = 1, 2
      if (.not. allocated(scene%gate(g)%member)) allocate (scene%gate(g)%member(64))
      scene%gate(g)%count = 0
      scene%gate(g)%entered = .false.
    end do
  end subroutine new_scene

  !> Takes in a particle that is there from the start. In a gate and on its way to the other it is
  !> counted, but only an entry can make a gate reverse.
  pure subroutine board(scene, particle, flight)
    type(scene_type), intent(inout) :: scene
    integer, intent(in) :: particle
    type(flight_type), intent(in) :: flight

    scene%difference = scene%difference + merge(1, -1, on_side_one(flight))
    if (heads_for_middle(flight)) call join(scene, merge(1, 2, on_side_one(flight)), particle)
  end subroutine board

  !> The event of a particle, which has been moved to it; `since` is the time since the window
  !> began. `wait` is how long it takes to its next.
  subroutine meet(scene, history, since, particle, flight, wait)
    type(scene_type), intent(inout) :: scene
    type(history_type), intent(inout) :: history
    real(wp), intent(in) :: since
    integer, intent(in) :: particle
    type(flight_type), intent(inout) :: flight
    real(wp), intent(out) :: wait
    integer :: g

    g = merge(1, 2, on_side_one(flight))
    select case (flight%next)
    case (meets_arc)
      call hit_arc(scene%walls, flight, wait)
      call count_hits(scene, history, 1_int64)
    case (meets_wall)
      call hit_channel(scene%walls, flight, wait)
      call count_hits(scene, history, 1_int64)
    case (meets_gate)
      call enter_channel(scene%walls, flight, wait)
      call join(scene, g, particle)
      scene%gate(g)%entered = .true.
      call record_event(history, since, event_entry, g, particle)
    case (meets_return)
      call enter_channel(scene%walls, flight, wait)
    case (meets_urn)
      call leave_channel(scene%walls, flight, wait)
    case (meets_middle)
      call cross_middle_line(scene%walls, flight, wait)
      call quit(scene, g, particle)
      call record_crossing(history, since, merge(channel1_12, channel1_21, g == 1), particle)
      if (scene%walls%end_wall) then
        call count_hits(scene, history, 1_int64)
      else
        scene%difference = scene%difference + merge(-2, 2, g == 1)
      end if
    case (meets_period)
      call cross_periodic_line(scene%walls, flight, wait)
      call record_crossing(history, since, merge(channel2_12, channel2_21, g == 1), particle)
      scene%difference = scene%difference + merge(-2, 2, g == 1)
    case default
      wait = huge(1.0_wp)
    end select
  end subroutine meet

  !> `hits` wall collisions, and the state right after them.
  pure subroutine count_hits(scene, history, hits)
    type(scene_type), intent(inout) :: scene
    type(history_type), intent(inout) :: history
    integer(int64), intent(in) :: hits

    scene%hits = scene%hits + hits
    history%collision_spread_sum = history%collision_spread_sum + hits*abs(scene%difference)
    history%collisions_seen = history%collisions_seen + hits
  end subroutine count_hits

  !> Whether a gate turns back those it counts; asked when the instant is over.
  pure subroutine turns_back(scene, g, turns)
    type(scene_type), intent(inout) :: scene
    integer, intent(in) :: g
    logical, intent(out) :: turns

    turns = scene%gate(g)%entered .and. scene%gate(g)%count > scene%threshold
    scene%gate(g)%entered = .false.
  end subroutine turns_back

  !> A gate has turned its particles back: nobody is counted in it any more.
  subroutine count_reversal(scene, g, since, history)
    type(scene_type), intent(inout) :: scene
    integer, intent(in) :: g
    real(wp), intent(in) :: since
    type(history_type), intent(inout) :: history
    integer :: count

    count = scene%gate(g)%count
    call record_event(history, since, event_reversal, g, count)
    history%reversals = history%reversals + 1
    history%bounce_backs = history%bounce_backs + count
    scene%place(scene%gate(g)%member(:count)) = 0
    scene%gate(g)%count = 0
  end subroutine count_reversal

  !> A gate counts a particle from now on.
  pure subroutine join(scene, g, particle)
    type(scene_type), intent(inout) :: scene
    integer, intent(in) :: g, particle

    associate (gate => scene%gate(g))
      if (gate%count == size(gate%member)) gate%member = [gate%member, gate%member]
      gate%count = gate%count + 1
      gate%member(gate%count) = int(particle, int32)
      scene%place(particle) = gate%count
    end associate
  end subroutine join

  !> A gate does not count a particle any more.
  pure subroutine quit(scene, g, particle)
    type(scene_type), intent(inout) :: scene
    integer, intent(in) :: g, particle
    integer :: last

    associate (gate => scene%gate(g))
      last = gate%member(gate%count)
      gate%member(scene%place(particle)) = int(last, int32)
      scene%place(last) = scene%place(particle)
      scene%place(particle) = 0
      gate%count = gate%count - 1
    end associate
  end subroutine quit

  !> Puts the events of one instant, `first` and those after it, in the order of the log: crossings
  !> of channel 1 from urn 1, from urn 2, then the rest, by particle; a reversal after the last of
  !> those who entered.
  pure subroutine order_events(history, first)
    type(history_type), intent(inout) :: history
    integer, intent(in) :: first
    integer(int64) :: rank(first:history%events), mine
    integer(int32) :: kind, where, particle
    integer :: at, k

    do at = first, history%events
      mine = 2_int64*history%event_particle(at)
      if (history%event_kind(at) == event_crossing1) then
        mine = mine - merge(2_int64, 1_int64, history%event_where(at) == 12)*2_int64**40
      else if (history%event_kind(at) == event_reversal) then
        mine = 1 + 2_int64*maxval(history%event_particle(first:history%events), &
          mask=history%event_kind(first:history%events) == event_entry &
          .and. history%event_where(first:history%events) == history%event_where(at))
      end if
      rank(at) = mine
    end do
    do at = first + 1, history%events
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

end module battery_instant
