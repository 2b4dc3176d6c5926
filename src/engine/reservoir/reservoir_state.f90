!> What the engine `reservoir` tells of itself, and how its state is kept.
submodule (battery_reservoir) battery_reservoir_state
  use battery_queue, only: pass_queue
  use battery_stay, only: whereabouts, pass_draws
  implicit none (type, external)

contains

  !> Where a particle is now; in an urn a place is drawn.
  module procedure state_of
    integer(int64) :: key

    key = self%seed + ishft(self%pages, 20) + int(self%now/self%page*2.0_wp**61, int64)
    state = whereabouts(self%table, self%stay(i), self%entered(i), self%now, key, int(i, int64))
  end procedure state_of

  !> Wall hits from the start until now: those known, put right for where each particle is.
  module procedure collisions
    real(wp) :: outside
    integer :: i

    total = self%known_hits
    outside = 0.0_wp
    do i = 1, self%number
      associate (stay => self%stay(i))
        select case (stay%heading)
        case (from_gate, from_return)
          outside = outside + (min(self%entered(i), self%now) - stay%time)
          if (self%now < self%entered(i)) total = total + passed_walls(self%table, stay, self%now &
            - stay%time) - int(stay%hits, int64)
        case (parked)
          total = total + passed_walls(self%table, stay, self%now - stay%time)
        case default
          outside = outside + (self%now - stay%time)
          total = total + passed_walls(self%table, stay, self%now - stay%time) &
            - int(stay%hits, int64)
        end select
      end associate
    end do
    if (self%uneven) outside = outside + missed_time(self)
    total = max(total + floor(self%fraction - self%hit_rate*outside + 0.5_wp, int64), 0_int64)
    total = min(total, self%known_hits + merge(huge(total) - self%known_hits, 0_int64, &
      self%moving < self%number))
  end procedure collisions

  !> Urns that differ: the time in the urn of more hits that would have as many as are missed in the
  !> other.
  pure function missed_time(self) result(time)
    class(reservoir_type), intent(in) :: self
    real(wp) :: time
    integer :: i

    time = 0.0_wp
    do i = 1, self%number
      associate (stay => self%stay(i))
        if (stay%heading /= from_gate .and. stay%heading /= from_return) cycle
        time = time + (1.0_wp - self%urn_rate(stay%urn)/self%hit_rate)*max(self%now &
          - self%entered(i), 0.0_wp)
      end associate
    end do
  end function missed_time

  !> How many are parked.
  module procedure trapped
    total = self%number - self%moving
  end procedure trapped

  !> The stays, those that tick, the numbers drawn ahead and the counts, through a stream.
  module procedure pass_own
    call stream%pass('time', self%stay%time, 'y', self%stay%y, 'along', self%stay%along, &
      'across', self%stay%across, 'entered', self%entered)
    call stream%pass('hits', self%stay%hits)
    call stream%pass('heading', self%stay%heading)
    call stream%pass('urn', self%stay%urn)
    call stream%pass('members', self%members)
    call stream%pass('member', self%member(:self%members))
    call stream%pass('next_tick', self%next_tick)
    call pass_queue(self%returning, stream)
    call pass_draws(self%draws, stream)
    call stream%pass('known_hits', self%known_hits)
    call stream%pass('told_hits', self%told_hits)
    call stream%pass('fraction', self%fraction)
    call stream%pass('moving', self%moving)
  end procedure pass_own

end submodule battery_reservoir_state
