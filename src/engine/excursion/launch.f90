!> How a particle starts in the engine `excursion`: from a position and a velocity to a flight, or
!> to a visit that will be one.
module battery_launch
  use battery_kinds, only: wp, int16, int64
  use battery_table, only: table_type, gated, ungated, in_urn, in_return, side_at, chamber_at, &
    x_direction, longest_run
  use battery_calendar, only: flight_type
  use battery_flight, only: to_return, in_gate, parked_in_channel
  use battery_visits, only: visits_type
  use battery_channel, only: fold
  implicit none (type, external)
  private
  public :: launch

contains

  !> Particle `i` at (x, y) with velocity (ux, uy) in the table's frame. One in a channel that heads
  !> for its far end is dated back to where it would have entered: its flight is written; `hits`
  !> loses the wall hits it did not have. One in an urn, or on its way back to it, is added to the
  !> visits. Those in the channels are left out, or only they are taken.
  subroutine launch(table, i, x, y, ux, uy, from_channels, flight, visits, hits)
    type(table_type), intent(in) :: table
    integer, intent(in) :: i
    !> Place, lengths, and velocity, of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    !> Whether those in the channels are taken, or those in the urns.
    logical, intent(in) :: from_channels
    type(flight_type), intent(inout) :: flight
    !> Visits to the urn of its side.
    type(visits_type), intent(inout) :: visits
    integer(int64), intent(inout) :: hits
    integer :: side, chamber, channel, count
    real(wp) :: outward, depth, width, length, turned, passed, height
    !> Slower passages, longer than any run, and those with more wall hits than an integer can
    !> count, are taken for endless.
    real(wp), parameter :: most_hits = 4.0e18_wp

    side = side_at(table, x)
    chamber = chamber_at(table, x, y, huge(1.0_wp))
    if (from_channels .eqv. chamber == in_urn) return
    if (.not. from_channels) then
      call reserve_place()
      visits%hits(count) = 0.0_wp
      visits%x(count) = table%urn(side)%centre - abs(x)
      visits%along(count) = -x_direction(side)*ux
      return
    end if
    channel = merge(ungated, gated, chamber == in_return)
    width = table%channel(channel)%width
    length = table%channel(channel)%length
    ! How far it is beyond the chord, and how fast it goes on from there.
    depth = 0.5_wp*length - abs(x)
    outward = -x_direction(side)*ux
    if (channel == ungated) then
      depth = abs(x) - table%urn(side)%centre - table%urn(side)%chord(ungated)
      outward = x_direction(side)*ux
    end if
    flight%urn = int(side, int16)
    if (.not. abs(ux)*min(longest_run*table%urn(side)%radius, most_hits*width) > length) then
      flight%heading = parked_in_channel
      flight%y = y
      flight%along = x
      flight%across = uy
    else if (outward > 0.0_wp) then
      call fold(y - uy*depth/outward, width, height, turned, passed)
      flight%time = -depth/outward
      flight%y = height
      flight%along = outward
      flight%through = length/outward
      flight%across = turned*uy
      hits = hits - int(passed, int64)
      flight%heading = merge(to_return, in_gate, channel == ungated)
    else
      call reserve_place()
      visits%channel(count) = channel
      visits%passage(count) = -depth/outward
      visits%along(count) = abs(ux)
    end if

  contains

    subroutine reserve_place()
      count = visits%count + 1
      visits%count = count
      visits%particle(count) = i
      visits%urn(count) = side
      visits%time(count) = 0.0_wp
      visits%passage(count) = 0.0_wp
      visits%y(count) = y
      visits%across(count) = uy
    end subroutine reserve_place

  end subroutine launch

end module battery_launch
