!> First impact on a circle that lies in one of two opposite openings, in O(log) operations.
!>
!> Angles are taken modulo half a turn, so that the openings overlap, and the wider one is searched
!> for; an impact that is outside the narrower opening, if it is on that side, is skipped.
module battery_opening_search
  use battery_kinds, only: angle_kind
  use battery_rotation, only: full_turn, first_step_into_arc
  implicit none (type, external)
  private
  public :: find_opening

contains

  !> Finds the first impact in an opening. Impacts lie at start, start + step, ... (integer angles,
  !> see `battery_rotation`); the openings are the open arcs within `angle1` of 0 and within
  !> `angle2` of half a turn. `total` is the number of impacts before it, `landing` its angle from
  !> the middle of its opening. `found` is false if the orbit is periodic and never enters an
  !> opening.
  pure subroutine find_opening(angle1, angle2, start, step, total, landing, first_side, found)
    !> Integer angles; `start` and `step` in [0, full_turn).
    integer(angle_kind), intent(in) :: angle1, angle2, start, step
    integer(angle_kind), intent(out) :: total, landing
    !> `first_side`: whether the impact is in the opening about 0.
    logical, intent(out) :: first_side, found
    integer(angle_kind), parameter :: half_turn = full_turn/2
    !> After this many misses of the narrower opening, each opening is searched for alone.
    integer, parameter :: most_misses = 100
    integer(angle_kind) :: moves, widest, place
    integer :: misses

    first_side = .false.
    widest = max(angle1, angle2)
    place = start
    total = 0
    do misses = 1, most_misses
      call first_step_into_arc(modulo(place + widest - 1, half_turn), modulo(step, half_turn), &
        2*widest - 2, moves, landing, found, half_turn)
      if (.not. found) return
      ! The product may overflow, by a multiple of the full turn.
      place = modulo(place + moves*step, full_turn)
      total = total + moves
      landing = landing - widest + 1
      first_side = modulo(place + half_turn/2, full_turn) < half_turn
      found = abs(landing) < merge(angle1, angle2, first_side)
      if (found) return
      place = modulo(place + step, full_turn)
      total = total + 1
    end do
    call search_each_opening(angle1, angle2, start, step, total, landing, first_side, found)
  end subroutine find_opening

  !> As `find_opening`, but searches for each opening alone.
  pure subroutine search_each_opening(angle1, angle2, start, step, total, landing, first_side, &
    found)
    integer(angle_kind), intent(in) :: angle1, angle2, start, step
    integer(angle_kind), intent(out) :: total, landing
    logical, intent(out) :: first_side, found
    integer(angle_kind) :: other_total, other_landing
    logical :: other_found

    call find_impact_in_arc(angle1, 0_angle_kind, total, landing, found)
    call find_impact_in_arc(angle2, full_turn/2, other_total, other_landing, other_found)
    first_side = found .and. (.not. other_found .or. total <= other_total)
    found = found .or. other_found
    if (first_side) return
    total = other_total
    landing = other_landing

  contains

    !> Finds the first impact in the open arc within `half_angle` of `middle`.
    pure subroutine find_impact_in_arc(half_angle, middle, steps, landing, found)
      integer(angle_kind), intent(in) :: half_angle, middle
      integer(angle_kind), intent(out) :: steps, landing
      logical, intent(out) :: found

      found = .false.
      steps = 0
      landing = 0
      if (half_angle == 0) return
      call first_step_into_arc(modulo(start - middle + half_angle - 1, full_turn), step, &
        2*half_angle - 2, steps, landing, found)
      landing = landing - half_angle + 1
    end subroutine find_impact_in_arc

  end subroutine search_each_opening

end module battery_opening_search
