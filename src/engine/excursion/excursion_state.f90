!> Observation and serialisation of the state of the engine `excursion`.
submodule (battery_excursion) battery_excursion_state
  use battery_scatterer_visits, only: locate_by_replay, serialize_visit_starts
  use battery_flight, only: locate_particle, locate_parked_particle
  use battery_long_visits, only: is_nearer_start, locate_from_start, serialize_long_visits
  use battery_scatterers, only: detect_periodic_path
  use battery_table, only: chamber_at, in_return
  implicit none (type, external)

contains

  !> x, y, u_x, u_y of particle `i` now.
  module procedure state_of
    integer(int64) :: hits

    call locate_particle_now(self, i, state, hits)
  end procedure state_of

  !> The same, from the nearer end of its visit; and the `hits` to be added to `computed_hits` for
  !> it.
  subroutine locate_particle_now(self, i, state, hits)
    type(excursion_type), intent(in) :: self
    integer, intent(in) :: i
    real(wp), intent(out) :: state(4)
    integer(int64), intent(out) :: hits

    associate (flight => self%flight(i), urn => self%table%urn(self%flight(i)%urn))
      if (flight%next_event == parked_in_channel) then
        call locate_parked_particle(urn, flight, self%parked_x(i), self%now, state, hits)
      else if (self%scattered .and. flight%next_event /= counted_in_gate &
        .and. (flight%next_event /= to_gate .or. self%now < flight%time)) then
        call locate_by_replay(self%table, self%scatterer_visits%visit_start(i), self%now, state, &
          hits)
      else
        if (is_nearer_start(self%long_visits, flight, self%now)) then
          call locate_from_start(self%long_visits, urn, i, self%now, state(:2), state(3:), hits)
        else
          call locate_particle(urn, flight, self%now, state(:2), state(3:), hits)
        end if
        state(1) = urn%axis_sign*(state(1) - urn%centre)
        state(3) = urn%axis_sign*state(3)
      end if
    end associate
  end subroutine locate_particle_now

  !> Exact wall hits from the start until now: the computed ones, corrected for each particle.
  module procedure collisions
    real(wp) :: state(4)
    integer(int64) :: hits
    integer :: i

    total = self%computed_hits
    do i = 1, self%number
      call locate_particle_now(self, i, state, hits)
      total = total + hits
    end do
  end procedure collisions

  !> Particles that are parked, or that repeat a path among discs for ever.
  module procedure trapped
    real(wp) :: state(4)
    integer(int64) :: hits
    logical :: yes
    integer :: i

    total = count(self%flight%next_event == parked_in_urn .or. self%flight%next_event == &
      parked_in_channel)
    if (.not. self%scattered) return
    do i = 1, self%number
      if (self%flight(i)%next_event /= partial_visit) cycle
      call locate_particle_now(self, i, state, hits)
      if (chamber_at(self%table, state(1), state(2), huge(1.0_wp)) /= in_return) cycle
      associate (urn => self%table%urn(self%flight(i)%urn))
        call detect_periodic_path(self%table%half_channel2(self%flight(i)%urn), urn%periodic_line &
          + urn%axis_sign*state(1), state(2), urn%axis_sign*state(3), state(4), yes)
      end associate
      if (yes) total = total + 1
    end do
  end procedure trapped

  !> Serialises flights and counts; the calendar follows from the flights.
  module procedure serialize_own_state
    integer :: i

    ! In a saved state, x of a particle parked in a channel is stored in place of `u_axial`.
    if (allocated(self%parked_x) .and. .not. archive%reading) then
      where (self%flight%next_event == parked_in_channel) self%flight%u_axial = self%parked_x
    end if
    call archive%serialize('known_hits', self%computed_hits)
    call archive%serialize('told_hits', self%reported_hits)
    call archive%serialize('heading', self%flight%next_event)
    call archive%serialize('urn', self%flight%urn)
    call archive%serialize('due', self%flight%due, 'time', self%flight%time, 'y', self%flight%y)
    call archive%serialize('along', self%flight%u_axial, 'across', self%flight%u_lateral, &
      'length', self%flight%length, 'through', self%flight%through)
    if (any(self%flight%next_event == parked_in_channel)) then
      self%parked_x = self%flight%u_axial
      where (self%flight%next_event == parked_in_channel) self%flight%u_axial = 0.0_wp
    end if
    if (self%scattered) then
      call serialize_visit_starts(self%scatterer_visits, self%flight%urn, archive)
    else
      call serialize_long_visits(self%long_visits, self%flight, archive)
    end if
    if (.not. archive%reading .or. archive%failed()) return
    self%partial_count = merge(0, count(self%flight%next_event == partial_visit), self%scattered)
    call new_calendar(self%calendar, self%number, self%interval)
    do i = 1, self%number
      if (any(self%flight(i)%next_event == [to_gate, to_return, partial_visit])) &
        call schedule_event(self%calendar, self%flight, i, self%flight(i)%due)
    end do
  end procedure serialize_own_state

end submodule battery_excursion_state
