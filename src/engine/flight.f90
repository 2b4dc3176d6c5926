!> What the engine `excursion` knows of a particle between two of its events.
!>
!> A flight says how a particle will enter its next channel, or entered the one it is in. Where it
!> is until then follows by going back from there; so a flight is all the state there is.
module battery_flight
  use battery_kinds, only: wp, int16, int64, pi
  use battery_calendar, only: flight_type
  use battery_urn, only: urn_type, position_before
  use battery_channel, only: fold
  implicit none (type, external)
  private
  public :: look_up, gather, land, locate, straight
  public :: to_gate, to_return, in_gate, parked_in_urn, parked_in_channel

  !> Headings: into a gate, into channel 2; inside a gate and counted; nowhere. `parked_in_urn`: the
  !> flight holds time and angle of an impact, cosine and sine of the incidence.
  !> `parked_in_channel`: time, y, x, u_y.
  integer(int16), parameter :: to_gate = 1, to_return = 2, in_gate = 3, parked_in_urn = 4, &
    parked_in_channel = 5

  !> In place of the time of a reversal: nothing turned the particle back.
  real(wp), parameter :: straight = 0.25_wp*huge(1.0_wp)

contains

  !> When each of the particles whose events are due would cross the middle of channel 1, if it is
  !> to enter a gate. Without branches: with many particles each flight is a line of memory, and
  !> many of them are to be on their way at a time, before the events are walked through one by one.
  pure subroutine look_up(number, flight, n, particle, due, middle)
    integer, intent(in) :: number, n
    type(flight_type), intent(in) :: flight(number)
    integer, intent(in) :: particle(n)
    real(wp), intent(in) :: due(n)
    real(wp), intent(out) :: middle(n)
    integer :: k

    do k = 1, n
      middle(k) = due(k) + 0.5_wp*flight(particle(k))%through
    end do
  end subroutine look_up

  !> Takes what a batch needs to know of its particles from their flights. `passage` is the time at
  !> which a gate reversed the particle, or `straight`; it becomes the time in the channel. `urn` is
  !> where it goes, negative through channel 2; the sign becomes that of `opening`.
  pure subroutine gather(number, flight, n, particle, urn, opening, passage, time, y, along, across)
    integer, intent(in) :: number, n
    type(flight_type), intent(in) :: flight(number)
    integer, intent(in) :: particle(n)
    integer, intent(inout) :: urn(n)
    real(wp), intent(inout) :: passage(n)
    real(wp), intent(out) :: opening(n), time(n), y(n), along(n), across(n)
    integer :: j, i

    do j = 1, n
      i = particle(j)
      time(j) = flight(i)%time
      y(j) = flight(i)%y
      along(j) = flight(i)%along
      across(j) = flight(i)%across
      passage(j) = merge(2.0_wp*(passage(j) - time(j)), flight(i)%through, passage(j) < straight)
    end do
    do j = 1, n
      opening(j) = real(sign(1, urn(j)), wp)
      urn(j) = abs(urn(j))
    end do
  end subroutine gather

  !> Writes down how each particle of a batch goes on; its `time` becomes that of its next event.
  pure subroutine land(number, flight, n, particle, urn, opening, time, length, y, along, across, &
    through)
    integer, intent(in) :: number, n
    type(flight_type), intent(inout) :: flight(number)
    integer, intent(in) :: particle(n), urn(n)
    real(wp), intent(in) :: opening(n), length(n), y(n), along(n), across(n), through(n)
    real(wp), intent(inout) :: time(n)
    integer :: j, i
    real(wp) :: leaves

    do j = 1, n
      i = particle(j)
      leaves = time(j) + length(j)
      flight(i)%length = length(j)
      flight(i)%time = leaves
      flight(i)%y = y(j)
      flight(i)%along = along(j)
      flight(i)%across = across(j)
      flight(i)%through = through(j)
      flight(i)%urn = int(urn(j), int16)
      flight(i)%heading = to_gate
      time(j) = leaves
      if (.not. opening(j) > 0.0_wp) then
        flight(i)%heading = merge(to_return, parked_in_urn, opening(j) < 0.0_wp)
        time(j) = merge(leaves + 0.5_wp*through(j), huge(1.0_wp), opening(j) < 0.0_wp)
      end if
    end do
  end subroutine land

  !> Where a particle is now, in the local frame of its urn (`parked_in_channel`: of the table), and
  !> by how many wall hits `known_hits` is short for it (negative: so many are still to come).
  pure subroutine locate(urn, half1, flight, now, position, velocity, hits)
    type(urn_type), intent(in) :: urn
    type(flight_type), intent(in) :: flight
    real(wp), intent(in) :: half1, now
    real(wp), intent(out) :: position(2), velocity(2)
    integer(int64), intent(out) :: hits
    real(wp) :: elapsed, opening, turned, passed, chord, width, step
    complex(wp) :: impact

    elapsed = now - flight%time
    select case (flight%heading)
    case (parked_in_channel)
      call fold(flight%y + flight%across*elapsed, urn%width1, position(2), turned, &
        passed)
      if (abs(flight%along) > half1) &
        call fold(flight%y + flight%across*elapsed, urn%width2, position(2), &
        turned, passed)
      position(1) = flight%along
      velocity = [0.0_wp, turned*flight%across]
      hits = int(passed, int64)
    case (parked_in_urn)
      step = 2.0_wp*urn%radius*flight%along
      hits = 0
      if (step > 0.0_wp) hits = floor(elapsed/step, int64)
      elapsed = elapsed - real(hits, wp)*step
      turned = flight%y + modulo(real(hits, wp)*2.0_wp*acos(flight%across), 2.0_wp*pi)
      if (.not. step > 0.0_wp) then
        ! A chord without length: the particle glides along the wall.
        turned = flight%y + flight%across*elapsed/urn%radius
        elapsed = 0.0_wp
      end if
      impact = cmplx(cos(turned), sin(turned), wp)
      velocity = [real(impact*cmplx(-flight%along, flight%across, wp), wp), &
        aimag(impact*cmplx(-flight%along, flight%across, wp))]
      position = urn%radius*[real(impact, wp), aimag(impact)] + elapsed*velocity
      hits = hits + 1
    case default
      opening = merge(-1.0_wp, 1.0_wp, flight%heading == to_return)
      chord = merge(urn%chord2, urn%chord1, opening < 0.0_wp)
      width = merge(urn%width2, urn%width1, opening < 0.0_wp)
      if (elapsed >= 0.0_wp) then
        call fold(flight%y + flight%across*elapsed, width, position(2), turned, passed)
        position(1) = opening*(chord + flight%along*elapsed)
        velocity = [opening*flight%along, turned*flight%across]
        hits = int(passed, int64)
      else
        call locate_before(urn, flight, now, opening, position, velocity, hits)
      end if
    end select
  end subroutine locate

  !> The same for a particle that has not yet left its urn, or is still in the channel before it.
  pure subroutine locate_before(urn, flight, now, opening, position, velocity, hits)
    type(urn_type), intent(in) :: urn
    type(flight_type), intent(in) :: flight
    real(wp), intent(in) :: now, opening
    real(wp), intent(out) :: position(2), velocity(2)
    integer(int64), intent(out) :: hits
    real(wp) :: before, side, turned, passed, width, height

    call position_before(urn, opening, flight%y, flight%along, flight%across, &
      min(flight%time - now, flight%length), position, velocity, hits)
    hits = -hits
    before = flight%time - now - flight%length
    if (before <= 0.0_wp) return
    side = merge(1.0_wp, -1.0_wp, position(1) > 0.0_wp)
    width = merge(urn%width1, urn%width2, side > 0.0_wp)
    call fold(position(2) - velocity(2)*before, width, height, turned, passed)
    ! It is in this urn's half of the channel, even if it is so slow that rounding moves it far.
    position(1) = side*(merge(urn%chord1, urn%chord2, side > 0.0_wp) &
      + min(abs(velocity(1))*before, 0.5_wp*merge(urn%length1, urn%length2, side > 0.0_wp)))
    position(2) = height
    velocity(2) = turned*velocity(2)
    hits = hits - int(passed, int64)
  end subroutine locate_before

end module battery_flight
