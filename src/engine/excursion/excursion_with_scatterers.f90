!> Windows of the engine `excursion` on tables with discs in channel 2 (`battery_scatterer_visits`).
submodule (battery_excursion) battery_excursion_with_scatterers
  use battery_table, only: in_urn, in_gate, in_channel2, passage_type, passage_at, enters_at_once
  use battery_motion, only: motion_type
  use battery_scatterer_visits, only: visit_start_at, reserve_scatterer_visits, &
    add_scatterer_visit, compute_scatterer_visits, store_scatterer_flights
  use battery_event_record, only: record_crossing, crossing_of, sort_event_record
  implicit none (type, external)

contains

  !> Loads the particles; those in channel 1 get a flight, all others a visit.
  module procedure load_particles_with_scatterers
    type(passage_type) :: passage
    integer :: first, last, i, urn_index

    do first = 1, self%number, start_chunk
      last = min(first + start_chunk - 1, self%number)
      call reserve_scatterer_visits(self%scatterer_visits, start_chunk)
      call reserve_visits(self%visits(1), start_chunk)
      do i = first, last
        associate (x => particles%x(i), y => particles%y(i), ux => particles%ux(i), &
          uy => particles%uy(i))
          urn_index = urn_at(self%table, x)
          associate (urn => self%table%urn(urn_index))
            passage = passage_at(self%table, x, y, ux, uy)
            select case (passage%chamber)
            case (in_gate)
              call make_initial_flight(self%table, i, x, y, ux, uy, .true., self%flight(i), &
                self%visits(1), self%computed_hits)
            case (in_channel2)
              call begin_scatterer_visit(self, i, visit_start_at(0.0_wp, urn_index, in_channel2, &
                urn%periodic_line - abs(x), y, urn%axis_sign*ux, uy), 0_int64)
            case default
              if (enters_at_once(self%table, x, y, ux)) then
                call make_initial_flight(self%table, i, x, y, ux, uy, .false., self%flight(i), &
                  self%visits(1), self%computed_hits)
                cycle
              end if
              call begin_scatterer_visit(self, i, visit_start_at(0.0_wp, urn_index, in_urn, &
                urn%centre - abs(x), y, urn%axis_sign*ux, uy), 0_int64)
            end select
          end associate
        end associate
      end do
      call cross_channels(self%table%urn(1), self%visits(1))
      call begin_scatterer_visits(self)
      call compute_scatterer_visits(self%scatterer_visits, self%table, huge(1.0_wp))
      call store_scatterer_flights(self%scatterer_visits, self%flight, self%computed_hits)
    end do
  end procedure load_particles_with_scatterers

  !> Starts a visit of particle `i`, after `hits` wall hits in a channel.
  subroutine begin_scatterer_visit(self, i, visit_start, hits)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: i
    type(motion_type), intent(in) :: visit_start
    integer(int64), intent(in) :: hits

    self%scatterer_visits%visit_start(i) = visit_start
    ! Not of the visit: that is computed again from its start to locate the particle.
    self%computed_hits = self%computed_hits + hits
    call add_scatterer_visit(self%scatterer_visits, i, visit_start)
  end subroutine begin_scatterer_visit

  !> Starts a visit for each particle of the batch, as `cross_channels` leaves it.
  subroutine begin_scatterer_visits(self)
    type(excursion_type), intent(inout) :: self
    integer :: j

    associate (v => self%visits(1))
      do j = 1, v%count
        associate (flight => self%flight(v%particle(j)))
          if (v%channel(j) == channel1) then
            call begin_scatterer_visit(self, v%particle(j), visit_start_at(v%time(j), v%urn(j), &
              in_urn, self%table%urn(v%urn(j))%chord(channel1), v%y(j), v%u_axial(j), &
              v%u_lateral(j)), int(v%hits(j), int64))
          else
            ! At the line, no channel has been crossed: on a wall, `cross_channels` finds a hit.
            call begin_scatterer_visit(self, v%particle(j), visit_start_at(flight%time, v%urn(j), &
              in_channel2, 0.0_wp, flight%y, flight%u_axial, flight%u_lateral), 0_int64)
          end if
        end associate
      end do
    end associate
  end subroutine begin_scatterer_visits

  !> Moves the start of each truncated visit that is due to the point where it was truncated.
  subroutine resume_truncated_visits(self)
    type(excursion_type), intent(inout) :: self
    integer :: j, i

    call reserve_scatterer_visits(self%scatterer_visits, self%resumed_count)
    do j = 1, self%resumed_count
      i = self%resumed(j)
      call add_scatterer_visit(self%scatterer_visits, i, self%scatterer_visits%visit_start(i))
    end do
    call compute_scatterer_visits(self%scatterer_visits, self%table, huge(1.0_wp))
    do j = 1, self%resumed_count
      self%scatterer_visits%visit_start(self%resumed(j)) = self%scatterer_visits%visit(j)%now
    end do
  end subroutine resume_truncated_visits

  !> Computes visits until each ends after the window, or at a gate. A particle that crosses the
  !> periodic line within the window starts another visit in it. The gates take no part: by the
  !> lookahead, no particle enters one before the window ends.
  module procedure compute_window_visits_with_scatterers
    integer :: j, i, continued_count, ended_count, first
    integer, allocatable :: due_particle(:)
    real(wp), allocatable :: due(:)

    first = event_record%crossings
    call resume_truncated_visits(self)
    associate (v => self%visits(1), scatterer_visits => self%scatterer_visits)
      call load_flights(self%number, self%flight, v%count, v%particle, v%reversal_time, v%passage, &
        v%time, v%y, v%u_axial, v%u_lateral)
      call cross_channels(self%table%urn(1), v)
      call reserve_scatterer_visits(scatterer_visits, v%count + self%resumed_count)
      call begin_scatterer_visits(self)
      do j = 1, self%resumed_count
        i = self%resumed(j)
        call add_scatterer_visit(scatterer_visits, i, scatterer_visits%visit_start(i))
      end do
      allocate (due_particle(scatterer_visits%count), due(scatterer_visits%count))
      do while (scatterer_visits%count > 0)
        call compute_scatterer_visits(scatterer_visits, self%table, huge(1.0_wp))
        call store_scatterer_flights(scatterer_visits, self%flight, self%computed_hits)
        continued_count = 0
        ended_count = 0
        do j = 1, scatterer_visits%count
          associate (visit => scatterer_visits%visit(j))
            if (visit%now%time < window_end .and. any(visit%next_event == [to_periodic_line, &
              partial_visit])) then
              call continue_within_window(self, j, continued_count, window_start, event_record)
            else
              ended_count = ended_count + 1
              due_particle(ended_count) = visit%particle
              due(ended_count) = self%flight(visit%particle)%due
            end if
          end associate
        end do
        call schedule_events(self%calendar, ended_count, due_particle, due)
        scatterer_visits%count = continued_count
      end do
    end associate
    if (event_record%crossings > first) call sort_event_record(event_record)
  end procedure compute_window_visits_with_scatterers

  !> Starts the next visit of a particle whose visit, number `j` of the batch, ended at the
  !> periodic line or was truncated within the window. The new visit becomes number
  !> `continued_count` + 1 of the batch; `continued_count` is increased.
  subroutine continue_within_window(self, j, continued_count, window_start, event_record)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: j
    integer, intent(inout) :: continued_count
    !> Start of the window.
    real(wp), intent(in) :: window_start
    type(event_record_type), intent(inout) :: event_record
    type(motion_type) :: visit_start
    integer :: i

    associate (visit => self%scatterer_visits%visit(j))
      i = visit%particle
      visit_start = visit%now
      if (visit%next_event == to_periodic_line) then
        call record_crossing(event_record, visit_start%time - window_start, &
          crossing_of(int(visit_start%urn), channel2), i)
        visit_start = visit_start_at(visit_start%time, self%table%urn_across(visit_start%urn), &
          in_channel2, 0.0_wp, visit%y, visit%u_axial, visit%u_lateral)
      end if
    end associate
    self%scatterer_visits%count = continued_count
    call begin_scatterer_visit(self, i, visit_start, 0_int64)
    continued_count = continued_count + 1
  end subroutine continue_within_window

end submodule battery_excursion_with_scatterers
