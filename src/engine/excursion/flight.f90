!> The state of a particle of the engine `excursion` between two of its events.
!>
!> A flight says how the particle will enter its next channel, or entered the one it is in. Earlier
!> positions are found backwards from there; for long visits the start is stored as well
!> (`battery_long_visits`).
module battery_flight
  use battery_kinds, only: wp, int16, int64
  use battery_calendar, only: flight_type
  use battery_channel, only: fold_into_channel, gated, ungated, no_channel, facing
  use battery_urn, only: urn_type, locate_in_visit
  use battery_visits, only: truncated
  implicit none (type, external)
  private
  public :: load_flights, locate_particle, locate_parked_particle, trace_back_into_channel, &
    middle_time, never
  public :: to_gate, to_return, counted_in_gate, parked_in_urn, parked_in_channel, partial_visit

  !> Headings:
  !> - `to_gate`, `to_return`: the next event is the entry into a gate, or the crossing of the
  !>   periodic line.
  !> - `counted_in_gate`: inside a gate, counted by it.
  !> - `parked_in_urn`: never leaves; the flight holds one impact, as `visits_type` describes it.
  !> - `parked_in_channel`: never leaves; time, y and u_y hold, x is stored elsewhere.
  !> - `partial_visit`: as `parked_in_urn`, until the next part of the visit is computed.
  integer(int16), parameter :: to_gate = 1, to_return = 2, counted_in_gate = 3, parked_in_urn = 4, &
    parked_in_channel = 5, partial_visit = 6

  !> Time of reversal of a particle that no gate turns back.
  real(wp), parameter :: never = 0.25_wp*huge(1.0_wp)

contains

  !> Time at which a particle that enters a gate reaches the middle line of channel 1: always after
  !> the entry, however short the channel.
  elemental function middle_time(enters, through) result(time)
    !> Time of the entry, 0 or more; time that the particle takes through the whole channel.
    real(wp), intent(in) :: enters, through
    real(wp) :: time

    time = max(enters + 0.5_wp*through, enters*(1.0_wp + 2.0_wp*epsilon(1.0_wp)))
  end function middle_time

  !> Copies what a batch of visits needs from the flights of its particles.
  pure subroutine load_flights(number, flight, n, particle, turned, passage, time, y, u_axial, &
    u_lateral)
    !> Number of particles; size of the batch.
    integer, intent(in) :: number, n
    type(flight_type), intent(in) :: flight(number)
    !> Particle of each visit.
    integer, intent(in) :: particle(n)
    !> Time at which a gate turned the particle back, or `never`.
    real(wp), intent(in) :: turned(n)
    !> Time spent in the channel; time, height and velocity at its entrance.
    real(wp), intent(out) :: passage(n), time(n), y(n), u_axial(n), u_lateral(n)
    integer :: j, i

    do j = 1, n
      i = particle(j)
      time(j) = flight(i)%time
      y(j) = flight(i)%y
      u_axial(j) = flight(i)%u_axial
      u_lateral(j) = flight(i)%u_lateral
      passage(j) = merge(2.0_wp*(turned(j) - time(j)), flight(i)%through, turned(j) < never)
    end do
  end subroutine load_flights

  !> Position and velocity at the time `now` of a particle that is not parked, in the frame of its
  !> urn, traced backwards from the end of its visit; and the `hits` to be added to `computed_hits`
  !> for it (negative: hits that are computed but still to come).
  pure subroutine locate_particle(urn, flight, now, position, velocity, hits)
    type(urn_type), intent(in) :: urn
    type(flight_type), intent(in) :: flight
    !> On the clock of the flight.
    real(wp), intent(in) :: now
    !> x and y of each: lengths, and a vector of length 1.
    real(wp), intent(out) :: position(2), velocity(2)
    !> A whole number of either sign.
    integer(int64), intent(out) :: hits
    real(wp) :: elapsed, reflected, passed
    integer :: channel

    elapsed = now - flight%time
    channel = merge(ungated, gated, flight%next_event == to_return)
    if (flight%next_event == partial_visit) channel = no_channel
    if (channel /= no_channel .and. elapsed >= 0.0_wp) then
      call fold_into_channel(flight%y + flight%u_lateral*elapsed, urn%width(channel), position(2), &
        reflected, passed)
      position(1) = facing(channel)*(urn%chord(channel) + flight%u_axial*elapsed)
      velocity = [facing(channel)*flight%u_axial, reflected*flight%u_lateral]
      hits = int(passed, int64)
    else
      elapsed = -min(flight%time - now, flight%length)
      call locate_in_visit(urn, channel, flight%y, flight%u_axial, flight%u_lateral, elapsed, &
        position, velocity, hits)
      call trace_back_into_channel(urn, flight%time - now - flight%length, position, velocity, hits)
    end if
  end subroutine locate_particle

  !> Moves a particle back from the start of its visit into the channel before it, if the visit
  !> starts only after the time `before`.
  pure subroutine trace_back_into_channel(urn, before, position, velocity, hits)
    type(urn_type), intent(in) :: urn
    !> 0 or less: the visit has started.
    real(wp), intent(in) :: before
    !> In the frame of the urn: at the start of the visit in, now out.
    real(wp), intent(inout) :: position(2), velocity(2)
    !> Reduced by the hits in the channel that are still to come.
    integer(int64), intent(inout) :: hits
    real(wp) :: reflected, passed, height
    integer :: from

    if (before <= 0.0_wp) return
    from = merge(gated, ungated, position(1) > 0.0_wp)
    call fold_into_channel(position(2) - velocity(2)*before, urn%width(from), height, reflected, &
      passed)
    ! However slow it is, it stays in this urn's half of the channel.
    position(1) = facing(from)*(urn%chord(from) + min(abs(velocity(1))*before, &
      0.5_wp*urn%length(from)))
    position(2) = height
    velocity(2) = reflected*velocity(2)
    hits = hits - int(passed, int64)
  end subroutine trace_back_into_channel

  !> Position and velocity of a particle that is parked in a channel, in the frame of the table.
  pure subroutine locate_parked_particle(urn, flight, x, now, state, hits)
    type(urn_type), intent(in) :: urn
    type(flight_type), intent(in) :: flight
    !> Its x, which never changes; the time, on the clock of the flight.
    real(wp), intent(in) :: x, now
    !> x, y, u_x, u_y.
    real(wp), intent(out) :: state(4)
    !> Wall hits since it was parked.
    integer(int64), intent(out) :: hits
    real(wp) :: height, reflected, passed
    integer :: channel

    channel = merge(gated, ungated, abs(x) <= 0.5_wp*urn%length(gated))
    call fold_into_channel(flight%y + flight%u_lateral*(now - flight%time), urn%width(channel), &
      height, reflected, passed)
    state = [x, height, 0.0_wp, reflected*flight%u_lateral]
    hits = int(passed, int64)
  end subroutine locate_parked_particle

end module battery_flight
