!> How the engine `excursion` lives where discs stand in channel 2 (`battery_among`).
submodule (battery_excursion) battery_excursion_among
  use battery_table, only: in_urn, in_channel1 => in_gate, in_return, chamber_at
  use battery_among, only: leg_type, reserve_travels, add_travel, travel, settle
  use battery_history, only: record_crossing, crossing_of, put_in_order
  implicit none (type, external)

contains

  !> First those in the urns and in channel 2, then those in channel 1.
  module procedure take_over_among
    integer :: first, last, i, side

    do first = 1, self%number, start_chunk
      last = min(first + start_chunk - 1, self%number)
      call reserve_travels(self%among, start_chunk)
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
              self%among%leg(i) = leg_type(0.0_wp, urn%periodic_line - abs(x), y, urn%way*ux, uy, &
                in_return)
              call add_travel(self%among, i, side, self%among%leg(i), 0_int64)
            case default
              self%among%leg(i) = leg_type(0.0_wp, urn%centre - abs(x), y, urn%way*ux, uy, in_urn)
              call add_travel(self%among, i, side, self%among%leg(i), 0_int64)
            end select
          end associate
        end associate
      end do
      call leave_channels(self%table%urn(1), self%visits(1))
      call begin_travels(self)
      call travel(self%among, self%table, huge(1.0_wp))
      call settle(self%among, self%flight, self%known_hits)
    end do
    deallocate (particles%x, particles%y, particles%ux, particles%uy)
  end procedure take_over_among

  !> Those of the batch of visits, as they come out of `leave_channels`, begin new ones.
  subroutine begin_travels(self)
    type(excursion_type), intent(inout) :: self
    type(leg_type) :: leg
    integer :: j

    associate (v => self%visits(1))
      do j = 1, v%count
        leg = leg_type(v%time(j), 0.0_wp, v%y(j), v%along(j), v%across(j), in_return)
        if (v%channel(j) == gated) then
          leg%chamber = in_urn
          leg%x = self%table%urn(v%urn(j))%chord(gated)
        end if
        self%among%leg(v%particle(j)) = leg
        call add_travel(self%among, v%particle(j), v%urn(j), leg, int(v%hits(j), int64))
      end do
    end associate
  end subroutine begin_travels

  !> Those whose visits were too long for one part, and are due now: they stand where it ended.
  subroutine resume(self)
    type(excursion_type), intent(inout) :: self
    integer :: j, i

    call reserve_travels(self%among, self%others)
    do j = 1, self%others
      i = self%other(j)
      call add_travel(self%among, i, int(self%flight(i)%urn), self%among%leg(i), 0_int64)
    end do
    call travel(self%among, self%table, huge(1.0_wp))
    do j = 1, self%others
      self%among%leg(self%other(j)) = self%among%travel(j)%now
    end do
  end subroutine resume

  !> The visits of a window, on and on until none ends within it but at a gate: who crosses the line
  !> begins another one. The gates need not know, for nobody gets to one so soon.
  module procedure go_among
    integer :: j, i, again, later, first
    integer, allocatable :: whose(:)
    real(wp), allocatable :: due(:)

    first = history%crossings
    call resume(self)
    associate (v => self%visits(1), among => self%among)
      call gather(self%number, self%flight, v%count, v%particle, v%turned, v%passage, v%time, v%y, &
        v%along, v%across)
      call leave_channels(self%table%urn(1), v)
      call reserve_travels(among, v%count + self%others)
      call begin_travels(self)
      do j = 1, self%others
        i = self%other(j)
        call add_travel(among, i, int(self%flight(i)%urn), among%leg(i), 0_int64)
      end do
      allocate (whose(among%count), due(among%count))
      do while (among%count > 0)
        call travel(among, self%table, huge(1.0_wp))
        call settle(among, self%flight, self%known_hits)
        again = 0
        later = 0
        do j = 1, among%count
          associate (at => among%travel(j))
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
        among%count = again
      end do
    end associate
    if (history%crossings > first) call put_in_order(history)
  end procedure go_among

  !> Visit j of the batch ended at the line, or was too long for one part, within the window: the
  !> next one becomes number `again` + 1 of the batch.
  subroutine go_on_at_once(self, j, again, began, history)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: j
    integer, intent(inout) :: again
    !> When the window began.
    real(wp), intent(in) :: began
    type(history_type), intent(inout) :: history
    type(leg_type) :: leg
    integer :: side, i

    associate (at => self%among%travel(j))
      i = at%particle
      side = at%side
      leg = at%now
      if (at%heading == to_return) then
        call record_crossing(history, leg%time - began, crossing_of(side, ungated), i)
        side = self%table%beyond(side)
        leg = leg_type(leg%time, 0.0_wp, at%y, at%along, at%across, in_return)
      end if
    end associate
    self%among%leg(i) = leg
    self%among%count = again
    call add_travel(self%among, i, side, leg, 0_int64)
    again = again + 1
  end subroutine go_on_at_once

end submodule battery_excursion_among
