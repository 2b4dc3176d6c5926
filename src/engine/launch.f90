!> How a particle starts in the engine `excursion`: from a position and a velocity to a flight, or
!> to a visit that will be one.
module battery_launch
  use battery_kinds, only: wp, int16, int64
  use battery_table, only: table_type, region_at, urn_one, urn_two, return_one, return_two, &
    longest_run
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
    real(wp), intent(in) :: x, y, ux, uy
    logical, intent(in) :: from_channels
    type(flight_type), intent(inout) :: flight
    type(visits_type), intent(inout) :: visits
    integer(int64), intent(inout) :: hits
    integer :: region, urn, count
    real(wp) :: outward, depth, width, length, opening, turned, passed, height
    logical :: in_channel2
    !> Slower passages, longer than any run, and those with more wall hits than an integer can
    !> count, are taken for endless.
    real(wp), parameter :: most_hits = 4.0e18_wp

    region = region_at(table, x, y, huge(1.0_wp))
    urn = merge(1, 2, x < 0.0_wp)
    if (from_channels .eqv. (region == urn_one .or. region == urn_two)) return
    if (.not. from_channels) then
      call reserve_place()
      visits%hits(count) = 0.0_wp
      visits%x(count) = table%urn_centre - abs(x)
      visits%along(count) = merge(ux, -ux, urn == 1)
      return
    end if
    in_channel2 = region == return_one .or. region == return_two
    opening = merge(-1.0_wp, 1.0_wp, in_channel2)
    width = merge(table%channel2_width, table%channel1_width, in_channel2)
    length = merge(table%channel2_length, table%channel1_length, in_channel2)
    depth = merge(abs(x) - table%urn_centre - table%chord2_distance, 0.5_wp*length - abs(x), &
      in_channel2)
    outward = opening*merge(ux, -ux, urn == 1)
    flight%urn = int(urn, int16)
    if (.not. abs(ux)*min(longest_run*table%urn_radius, most_hits*width) > length) then
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
      flight%heading = merge(to_return, in_gate, in_channel2)
    else
      call reserve_place()
      visits%opening(count) = opening
      visits%passage(count) = -depth/outward
      visits%along(count) = abs(ux)
    end if

  contains

    subroutine reserve_place()
      count = visits%count + 1
      visits%count = count
      visits%particle(count) = i
      visits%urn(count) = urn
      visits%time(count) = 0.0_wp
      visits%passage(count) = 0.0_wp
      visits%y(count) = y
      visits%across(count) = uy
    end subroutine reserve_place

  end subroutine launch

end module battery_launch
