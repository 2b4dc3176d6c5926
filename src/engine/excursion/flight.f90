!> What the engine `excursion` knows of a particle between two of its events.
!>
!> A flight says how a particle will enter its next channel, or entered the one it is in. Where it
!> is until then follows by going back from there; only of long visits more is kept
!> (`battery_long_visits`).
module battery_flight
  use battery_kinds, only: wp, int16, int64
  use battery_calendar, only: flight_type
  use battery_channel, only: fold, gated, ungated, no_channel, facing
  use battery_urn, only: urn_type, locate_in_visit
  use battery_visits, only: truncated
  implicit none (type, external)
  private
  public :: load_flights, locate_particle, locate_parked_particle, trace_back_into_channel, &
    middle_time, never
  public :: to_gate, to_return, counted_in_gate, parked_in_urn, parked_in_channel, partial_visit

  !> Headings: into a gate, into channel 2; inside a gate and counted; nowhere. `parked_in_urn`: the
  !> flight holds the time of an impact, and what `visits_type` tells of it. `parked_in_channel`:
  !> time, y and u_y; x is kept elsewhere. `partial_visit`: as `parked_in_urn`, but for a while
  !> only.
  integer(int16), parameter :: to_gate = 1, to_return = 2, counted_in_gate = 3, parked_in_urn = 4, &
    parked_in_channel = 5, partial_visit = 6

  !> When a particle is turned back that nothing turns back.
  real(wp), parameter :: never = 0.25_wp*huge(1.0_wp)

contains

  !> When a particle that enters a gate is to cross the middle of channel 1. Nobody does so before
  !> having entered, however short the channel.
  elemental function middle_time(enters, through) result(time)
    !> When it enters, from 0 up, and how long it would be in the channel.
    real(wp), intent(in) :: enters, through
    real(wp) :: time

    time = max(enters + 0.5_wp*through, enters*(1.0_wp + 2.0_wp*epsilon(1.0_wp)))
  end function middle_time

  !> Takes what a batch needs to know of its particles from their flights.
  pure subroutine load_flights(number, flight, n, particle, turned, passage, time, y, u_axial, &
    u_lateral)
    !> How many particles there are, and how many are in the batch.
    integer, intent(in) :: number, n
    type(flight_type), intent(in) :: flight(number)
    !> Who is in the batch.
    integer, intent(in) :: particle(n)
    !> When a gate turned each back, or `never`.
    real(wp), intent(in) :: turned(n)
    !> How long each has been in the channel, and how it entered that.
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

  !> Where a particle is now that is not parked, in the local frame of its urn, and by how many wall
  !> hits `computed_hits` is short for it (negative: so many are still to come). In an urn: going
  !> back from where it leaves.
  pure subroutine locate_particle(urn, flight, now, position, velocity, hits)
    type(urn_type), intent(in) :: urn
    type(flight_type), intent(in) :: flight
    !> The time, on the clock of the flight.
    real(wp), intent(in) :: now
    !> x and y of each: lengths, and a vector of length 1.
    real(wp), intent(out) :: position(2), velocity(2)
    !> Whole number of either sign.
    integer(int64), intent(out) :: hits
    real(wp) :: elapsed, reflected, passed
    integer :: channel

    elapsed = now - flight%time
    channel = merge(ungated, gated, flight%heading == to_return)
    if (flight%heading == partial_visit) channel = no_channel
    if (channel /= no_channel .and. elapsed >= 0.0_wp) then
      call fold(flight%y + flight%u_lateral*elapsed, urn%width(channel), position(2), reflected, &
        passed)
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

  !> From where a visit began back into the channel before it, if it is to begin only after the time
  !> `before`.
  pure subroutine trace_back_into_channel(urn, before, position, velocity, hits)
    type(urn_type), intent(in) :: urn
    !> 0 or less: the visit has begun.
    real(wp), intent(in) :: before
    !> In the frame of the urn: in, where the visit begins; out, now.
    real(wp), intent(inout) :: position(2), velocity(2)
    !> Loses those on the walls of the channel that are still to come.
    integer(int64), intent(inout) :: hits
    real(wp) :: reflected, passed, height
    integer :: from

    if (before <= 0.0_wp) return
    from = merge(gated, ungated, position(1) > 0.0_wp)
    call fold(position(2) - velocity(2)*before, urn%width(from), height, reflected, passed)
    ! It is in this urn's half of the channel, even if it is so slow that rounding moves it far.
    position(1) = facing(from)*(urn%chord(from) + min(abs(velocity(1))*before, &
      0.5_wp*urn%length(from)))
    position(2) = height
    velocity(2) = reflected*velocity(2)
    hits = hits - int(passed, int64)
  end subroutine trace_back_into_channel

  !> The same for one that is parked in a channel, in the frame of the table.
  pure subroutine locate_parked_particle(urn, flight, x, now, state, hits)
    type(urn_type), intent(in) :: urn
    type(flight_type), intent(in) :: flight
    !> Where it is along the channel; the time, on the clock of the flight.
    real(wp), intent(in) :: x, now
    !> x, y, u_x, u_y.
    real(wp), intent(out) :: state(4)
    !> Since it was parked.
    integer(int64), intent(out) :: hits
    real(wp) :: height, reflected, passed
    integer :: channel

    channel = merge(gated, ungated, abs(x) <= 0.5_wp*urn%length(gated))
    call fold(flight%y + flight%u_lateral*(now - flight%time), urn%width(channel), height, &
      reflected, passed)
    state = [x, height, 0.0_wp, reflected*flight%u_lateral]
    hits = int(passed, int64)
  end subroutine locate_parked_particle

end module battery_flight
