!> Starts of the passages through polygons, of the engine `excursion`.
!>
!> Position and number of hits before the end of a visit are computed backwards from there. A path
!> through a corner hits one of its two sides, and rounding decides which; on the way back it may
!> decide otherwise. Unless a wedge reflects both paths alike, the way back then leads to places
!> where the particle never was. So the start of each passage through a polygon is stored as
!> `compute_passages` gets it, and where a way back meets a corner, the passage is computed again
!> from its start, by the same operations.
module battery_passage_starts
  use battery_kinds, only: wp, int64
  use battery_archive, only: archive_type
  use battery_channel, only: no_channel
  use battery_flight, only: flight_type, trapped_in_urn, trace_back_into_channel, &
    way_back_meets_corner
  use battery_urn, only: urn_type, locate_in_passage, follow_passage, meets_corner
  use battery_visits, only: visits_type
  implicit none (type, external)
  private
  public :: store_passage_starts, correct_by_passage, serialize_passage_starts

  !> A start: x, y, u_x, u_y in the frame of the urn, and the time, which is the last word.
  integer, parameter, public :: start_words = 5

  !> Places on one path, computed in two ways, differ by less than this, in units of the reach.
  real(wp), parameter :: same_path = 1.0e-6_wp

contains

  !> Stores the starts of the passages of a batch, before `compute_passages` overwrites them.
  pure subroutine store_passage_starts(starts, visits, count)
    !> The start of the latest passage of each particle.
    real(wp), intent(inout) :: starts(:, :)
    !> As `cross_channels` leaves it.
    type(visits_type), intent(in) :: visits
    !> Number of visits, the first ones, whose starts are stored.
    integer, intent(in) :: count
    integer :: j

    do j = 1, count
      starts(:, visits%particle(j)) = [visits%x(j), visits%y(j), visits%u_axial(j), &
        visits%u_lateral(j), visits%time(j)]
    end do
  end subroutine store_passage_starts

  !> Corrects position, velocity and `hits` of a particle at the time `now`, if they were computed
  !> on another path than that of its passage.
  subroutine correct_by_passage(start, urn, flight, now, from_start, position, velocity, hits)
    !> The start of that passage.
    real(wp), intent(in) :: start(start_words)
    type(urn_type), intent(in) :: urn
    type(flight_type), intent(in) :: flight
    !> On the clock of the flight.
    real(wp), intent(in) :: now
    !> Whether they were computed forwards from the start of a long visit, else back from its end.
    logical, intent(in) :: from_start
    !> In the frame of the urn.
    real(wp), intent(inout) :: position(2), velocity(2)
    !> To be added to `computed_hits`.
    integer(int64), intent(inout) :: hits
    real(wp) :: end_position(2), end_velocity(2), here(2), direction(2), before
    integer(int64) :: all_hits, hits_since

    if (flight%next_event == trapped_in_urn .and. now >= flight%time) then
      if (meets_corner(urn, no_channel, flight%y, flight%u_axial, flight%u_lateral, now &
        - flight%time)) call locate_in_passage(urn, no_channel, flight%y, flight%u_axial, &
        flight%u_lateral, now - flight%time, position, velocity, hits)
      return
    end if
    if (.not. from_start) then
      if (.not. way_back_meets_corner(urn, flight, now)) return
    end if
    before = flight%time - now - flight%length
    ! Still in the channel, where the start of the visit gives its place.
    if (from_start .and. before > 0.0_wp) return
    ! A part of a visit begins where the one before it ends: in that one this particle still is.
    if (now < start(5) .and. start(5) - now > before + urn%reach) return
    call follow_passage(urn, start(1), start(2), start(3), start(4), max(now - start(5), 0.0_wp), &
      here, direction, hits_since)
    call trace_back_into_channel(urn, before, here, direction, hits_since)
    if (from_start .and. maxval(abs(here - position)) <= same_path*urn%reach &
      .and. maxval(abs(direction - velocity)) <= same_path) return
    call follow_passage(urn, start(1), start(2), start(3), start(4), huge(1.0_wp), end_position, &
      end_velocity, all_hits)
    position = here
    velocity = direction
    hits = hits_since - all_hits
  end subroutine correct_by_passage

  !> Saves or restores the starts.
  subroutine serialize_passage_starts(starts, archive)
    !> The start of the latest passage of each particle.
    real(wp), intent(inout) :: starts(:, :)
    type(archive_type), intent(inout) :: archive

    call archive%serialize('start_x', starts(1, :), 'start_y', starts(2, :), 'start_ux', &
      starts(3, :), 'start_uy', starts(4, :), 'start_time', starts(5, :))
  end subroutine serialize_passage_starts

end module battery_passage_starts
