!> What the engine `excursion` tells of itself, and how its state is kept.
submodule (battery_excursion) battery_excursion_state
  use battery_scattered_sides, only: replay, pass_begun
  use battery_flight, only: locate, locate_parked
  use battery_long_visits, only: goes_forwards, locate_forwards, pass_long
  use battery_scatterers, only: comes_back
  use battery_table, only: chamber_at, in_return
  implicit none (type, external)

contains

  !> x, y, u_x, u_y of particle `i` now.
  module procedure state_of
    integer(int64) :: hits

    call locate_now(self, i, state, hits)
  end procedure state_of

  !> The same, from the nearer end of its visit, and by how many wall hits `known_hits` is short for
  !> it.
  subroutine locate_now(self, i, state, hits)
    type(excursion_type), intent(in) :: self
    integer, intent(in) :: i
    real(wp), intent(out) :: state(4)
    integer(int64), intent(out) :: hits

    associate (flight => self%flight(i), urn => self%table%urn(self%flight(i)%urn))
      if (flight%heading == parked_in_channel) then
        call locate_parked(urn, flight, self%parked_x(i), self%now, state, hits)
      else if (self%scattered .and. flight%heading /= in_gate &
        .and. (flight%heading /= to_gate .or. self%now < flight%time)) then
        call replay(self%table, self%sides%begun(i), self%now, state, hits)
      else
        if (goes_forwards(self%long_visits, flight, self%now)) then
          call locate_forwards(self%long_visits, urn, i, self%now, state(:2), state(3:), hits)
        else
          call locate(urn, flight, self%now, state(:2), state(3:), hits)
        end if
        state(1) = urn%way*(state(1) - urn%centre)
        state(3) = urn%way*state(3)
      end if
    end associate
  end subroutine locate_now

  !> Wall hits from the start until now: those known, put right for where each is.
  module procedure collisions
    real(wp) :: state(4)
    integer(int64) :: hits
    integer :: i

    total = self%known_hits
    do i = 1, self%number
      call locate_now(self, i, state, hits)
      total = total + hits
    end do
  end procedure collisions

  !> How many are parked, or come back to the same state among discs.
  module procedure trapped
    real(wp) :: state(4)
    integer(int64) :: hits
    logical :: yes
    integer :: i

    total = count(self%flight%heading == parked_in_urn .or. self%flight%heading == &
      parked_in_channel)
    if (.not. self%scattered) return
    do i = 1, self%number
      if (self%flight(i)%heading /= in_parts) cycle
      call locate_now(self, i, state, hits)
      if (chamber_at(self%table, state(1), state(2), huge(1.0_wp)) /= in_return) cycle
      associate (urn => self%table%urn(self%flight(i)%urn))
        call comes_back(self%table%scattered(self%flight(i)%urn), urn%periodic_line &
          + urn%way*state(1), state(2), urn%way*state(3), state(4), yes)
      end associate
      if (yes) total = total + 1
    end do
  end procedure trapped

  !> The flights and counts, through a stream; the calendar follows from the flights.
  module procedure pass_own
    integer :: i

    ! In a state x of who is parked in a channel stands with `along`.
    if (allocated(self%parked_x) .and. .not. stream%reading) then
      where (self%flight%heading == parked_in_channel) self%flight%along = self%parked_x
    end if
    call stream%pass('known_hits', self%known_hits)
    call stream%pass('told_hits', self%told_hits)
    call stream%pass('heading', self%flight%heading)
    call stream%pass('urn', self%flight%urn)
    call stream%pass('due', self%flight%due, 'time', self%flight%time, 'y', self%flight%y)
    call stream%pass('along', self%flight%along, 'across', self%flight%across, &
      'length', self%flight%length, 'through', self%flight%through)
    if (any(self%flight%heading == parked_in_channel)) then
      self%parked_x = self%flight%along
      where (self%flight%heading == parked_in_channel) self%flight%along = 0.0_wp
    end if
    if (self%scattered) then
      call pass_begun(self%sides, self%flight%urn, stream)
    else
      call pass_long(self%long_visits, self%flight, stream)
    end if
    if (.not. stream%reading .or. stream%failed()) return
    self%parts = merge(0, count(self%flight%heading == in_parts), self%scattered)
    call new_calendar(self%calendar, self%number, self%interval)
    do i = 1, self%number
      if (any(self%flight(i)%heading == [to_gate, to_return, in_parts])) &
        call schedule(self%calendar, self%flight, i, self%flight(i)%due)
    end do
  end procedure pass_own

end submodule battery_excursion_state
