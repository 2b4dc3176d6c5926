!> How the engine `excursion` lives where discs stand in channel 2 (`battery_scattered_sides`).
submodule (battery_excursion) battery_excursion_scattered
  use battery_table, only: in_urn, in_channel1 => in_gate, in_return, chamber_at
  use battery_motion, only: motion_type
  use battery_scattered_sides, only: begins_at, reserve_travels, add_travel, travel, settle
  use battery_history, only: record_crossing, crossing_of, put_in_order
  implicit none (type, external)

contains

  !> First those in the urns and in channel 2, then those in channel 1.
  module procedure take_over_scattered
    integer :: first, last, i, side

    do first = 1, self%number, start_chunk
      last = min(first + start_chunk - 1, self%number)
      call reserve_travels(self%sides, start_chunk)
      call reserve_visits(self%visits(1), start_chunk)
      do i = first, last
        associate (x => particles%x(i), y => particles%y(i), ux => particles%ux(i), &
          uy => particles%uy(i))
          side = side_at(self%table, x)
          associate (urn => self%table%urn(side))
            select case (chamber_at(self%table, x, y, huge(1.0_wp)))
            case (in_channel1)
              call launch(self%table, i, x, y, ux, uy, .true., self%flight(i), self%visits(1), &
                self%known_hits)
            case (in_return)
              call begin_travel(self, i, begins_at(0.0_wp, side, in_return, urn%periodic_line &
                - abs(x), y, urn%way*ux, uy), 0_int64)
            case default
              call begin_travel(self, i, begins_at(0.0_wp, side, in_urn, urn%centre - abs(x), y, &
                urn%way*ux, uy), 0_int64)
            end select
          end associate
        end associate
      end do
      call leave_channels(self%table%urn(1), self%visits(1))
      call begin_travels(self)
      call travel(self%sides, self%table, huge(1.0_wp))
      call settle(self%sides, self%flight, self%known_hits)
    end do
  end procedure take_over_scattered

  !> A particle begins a visit, after so many wall `hits` in a channel.
  subroutine begin_travel(self, i, begun, hits)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: i
    type(motion_type), intent(in) :: begun
    integer(int64), intent(in) :: hits

    self%sides%begun(i) = begun
    call add_travel(self%sides, i, begun, hits)
  end subroutine begin_travel

  !> Those of the batch of visits, as they come out of `leave_channels`, begin new ones.
  subroutine begin_travels(self)
    type(excursion_type), intent(inout) :: self
    integer :: j, chamber
    real(wp) :: x

    associate (v => self%visits(1))
      do j = 1, v%count
        chamber = merge(in_urn, in_return, v%channel(j) == gated)
        x = merge(self%table%urn(v%urn(j))%chord(gated), 0.0_wp, v%channel(j) == gated)
        call begin_travel(self, v%particle(j), begins_at(v%time(j), v%urn(j), chamber, x, v%y(j), &
          v%along(j), v%across(j)), int(v%hits(j), int64))
      end do
    end associate
  end subroutine begin_travels

  !> Those whose visits were too long for one part, and are due now: they stand where it ended.
  subroutine resume(self)
    type(excursion_type), intent(inout) :: self
    integer :: j, i

    call reserve_travels(self%sides, self%others)
    do j = 1, self%others
      i = self%other(j)
      call add_travel(self%sides, i, self%sides%begun(i), 0_int64)
    end do
    call travel(self%sides, self%table, huge(1.0_wp))
    do j = 1, self%others
      self%sides%begun(self%other(j)) = self%sides%travel(j)%now
    end do
  end subroutine resume

  !> The visits of a window, on and on until none ends within it but at a gate: who crosses the line
  !> begins another one. The gates need not know, for nobody gets to one so soon.
  module procedure go_scattered
    integer :: j, i, again, later, first
    integer, allocatable :: whose(:)
    real(wp), allocatable :: due(:)

    first = history%crossings
    call resume(self)
    associate (v => self%visits(1), sides => self%sides)
      call gather(self%number, self%flight, v%count, v%particle, v%turned, v%passage, v%time, v%y, &
        v%along, v%across)
      call leave_channels(self%table%urn(1), v)
      call reserve_travels(sides, v%count + self%others)
      call begin_travels(self)
      do j = 1, self%others
        i = self%other(j)
        call add_travel(sides, i, sides%begun(i), 0_int64)
      end do
      allocate (whose(sides%count), due(sides%count))
      do while (sides%count > 0)
        call travel(sides, self%table, huge(1.0_wp))
        call settle(sides, self%flight, self%known_hits)
        again = 0
        later = 0
        do j = 1, sides%count
          associate (at => sides%travel(j))
            if (at%now%time < ends .and. any(at%heading == [to_return, in_parts])) then
              call go_on_at_once(self, j, again, began, history)
            else
              later = later + 1
              whose(later) = at%particle
              due(later) = self%flight(at%particle)%due
            end if
          end associate
        end do
        call schedule_all(self%calendar, later, whose, due)
        sides%count = again
      end do
    end associate
    if (history%crossings > first) call put_in_order(history)
  end procedure go_scattered

  !> Visit j of the batch ended at the line, or was too long for one part, within the window: the
  !> next one becomes number `again` + 1 of the batch.
  subroutine go_on_at_once(self, j, again, began, history)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: j
    integer, intent(inout) :: again
    !> When the window began.
    real(wp), intent(in) :: began
    type(history_type), intent(inout) :: history
    type(motion_type) :: begun
    integer :: i

    associate (at => self%sides%travel(j))
      i = at%particle
      begun = at%now
      if (at%heading == to_return) then
        call record_crossing(history, begun%time - began, crossing_of(int(begun%side), ungated), i)
        begun = begins_at(begun%time, self%table%beyond(begun%side), in_return, 0.0_wp, at%y, &
          at%along, at%across)
      end if
    end associate
    self%sides%count = again
    call begin_travel(self, i, begun, 0_int64)
    again = again + 1
  end subroutine go_on_at_once

end submodule battery_excursion_scattered
