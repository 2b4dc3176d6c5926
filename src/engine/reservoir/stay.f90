!> State of a particle of the engine `reservoir`, and the random numbers that decide its stays.
module battery_stay
  use battery_kinds, only: wp, int32, int64, pi
  use battery_table, only: table_type, passage_type, passage_at, channel1, channel2, no_channel, &
    x_direction, try_random_point
  use battery_channel, only: fold_into_channel
  use battery_archive, only: archive_type
  use battery_random, only: random_type, draw_uniform, hashed_uniform
  implicit none (type, external)
  private
  public :: stay_type, draws_type, block_length, draw_ticks, draw_exits, make_initial_stay, &
    locate_stay, locate_trapped_stay, is_trapped, remaining_channel_hits, sum_outside_urns, &
    serialize_stays, serialize_draws
  public :: from_gate, from_channel2, counted_in_gate, to_periodic_line

  !> Random numbers drawn at a time.
  integer, parameter :: block_length = 512

  !> Phases of a particle: in an urn, or on the way into it from channel 1 or 2 (`from_gate`,
  !> `from_channel2`); counted in a gate; on the way to the periodic line; trapped, moving across
  !> channel 1 or 2 for ever.
  integer, parameter :: from_gate = 1, from_channel2 = 2, counted_in_gate = 3, &
    to_periodic_line = 4, trapped_in_gate = 5, trapped_in_channel2 = 6

  !> State of a particle, except for the time at which it enters its urn.
  type :: stay_type
    !> Time, height, |u_x| and u_y at its entry into the channel that it is in, or was in last. If
    !> it is trapped: time and height at which it was loaded.
    real(wp) :: time = 0.0_wp, y = 0.0_wp, u_axial = 0.0_wp, u_lateral = 0.0_wp
    !> Wall hits of the complete passage through that channel.
    real(wp) :: hits = 0.0_wp
    integer(int32) :: phase = from_gate
    !> Urn that the particle is in, enters or leaves.
    integer(int32) :: urn = 0
  end type stay_type

  !> Random numbers drawn ahead. Of ticks: time between two of them (mean 1), and a number in (0, 1)
  !> that selects the particle. Of exits from an urn: height, |u_x|, 1/|u_x|, u_y, wall hits of the
  !> complete passage, and the channel.
  type :: draws_type
    type(random_type) :: random
    integer :: next_tick = block_length + 1, next_exit = block_length + 1
    real(wp), dimension(block_length) :: wait = 0.0_wp, selector = 0.0_wp
    real(wp), dimension(block_length) :: y = 0.0_wp, u_axial = 0.0_wp, inverse = 0.0_wp, &
      u_lateral = 0.0_wp, hits = 0.0_wp
    integer :: channel(block_length) = channel1
  end type draws_type

contains

  !> Draws `block_length` ticks.
  pure subroutine draw_ticks(draws)
    type(draws_type), intent(inout) :: draws
    integer :: k

    call draw_uniform(draws%random, block_length, draws%wait)
    call draw_uniform(draws%random, block_length, draws%selector)
    ! In the last bit, the vectorised logarithms of the C library depend on the length of the
    ! vector.
!GCC$ novector
    do k = 1, block_length
      draws%wait(k) = -log(draws%wait(k))
    end do
    draws%next_tick = 1
  end subroutine draw_ticks

  !> Draws `block_length` exits from an urn. One random number decides opening and height: it is a
  !> position on both openings laid end to end.
  pure subroutine draw_exits(draws, table)
    type(draws_type), intent(inout) :: draws
    type(table_type), intent(in) :: table
    real(wp) :: place, sine, width, length, width1, width2, length1, length2
    integer :: k

    width1 = table%channel(channel1)%width
    width2 = table%channel(channel2)%width
    length1 = table%channel(channel1)%length
    length2 = table%channel(channel2)%length
    call draw_uniform(draws%random, block_length, draws%y)
    call draw_uniform(draws%random, block_length, draws%u_lateral)
    do k = 1, block_length
      place = (width1 + width2)*draws%y(k)
      draws%channel(k) = merge(channel1, channel2, place < width1)
      width = merge(width1, width2, place < width1)
      length = merge(length1, length2, place < width1)
      draws%y(k) = merge(place, place - width1, place < width1) - 0.5_wp*width
      sine = 2.0_wp*draws%u_lateral(k) - 1.0_wp
      draws%u_lateral(k) = sine
      draws%u_axial(k) = sqrt((1.0_wp - sine)*(1.0_wp + sine))
      draws%inverse(k) = 1.0_wp/draws%u_axial(k)
      draws%hits(k) = aint(abs(draws%y(k) + sine*length*draws%inverse(k))/width + 0.5_wp)
    end do
    draws%next_exit = 1
  end subroutine draw_exits

  !> Initial state of a particle, from its position and velocity at the time 0. If it is in a
  !> channel and heads for the far end, `stay` holds its entry into the channel, which lies in the
  !> past; otherwise `urn_entry_time` is the time at which it enters its urn.
  pure subroutine make_initial_stay(table, x, y, ux, uy, stay, urn_entry_time)
    type(table_type), intent(in) :: table
    !> Position in the frame of the table, lengths; velocity, of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    type(stay_type), intent(out) :: stay
    real(wp), intent(out) :: urn_entry_time
    type(passage_type) :: passage

    passage = passage_at(table, x, y, ux, uy)
    urn_entry_time = 0.0_wp
    stay = stay_type(y=y, u_axial=abs(ux), u_lateral=uy, urn=int(passage%urn, int32))
    if (passage%trapped) then
      stay%phase = int(merge(trapped_in_gate, trapped_in_channel2, passage%channel == channel1), &
        int32)
    else if (passage%moves_away) then
      stay%time = passage%time
      stay%y = passage%height
      stay%u_lateral = passage%reflected*uy
      stay%phase = int(merge(counted_in_gate, to_periodic_line, passage%channel == channel1), int32)
      stay%hits = real(channel_hits(table, stay, table%channel(passage%channel)%length/abs(ux)), wp)
    else if (passage%channel /= no_channel) then
      stay%phase = int(merge(from_gate, from_channel2, passage%channel == channel1), int32)
      urn_entry_time = passage%time
      stay%y = passage%height
      stay%hits = real(channel_hits(table, stay, urn_entry_time), wp)
    end if
  end subroutine make_initial_stay

  !> Wall hits of a particle in its channel within the time `passage` after its entry; for particles
  !> that are in a channel at the start or when hits are counted.
  elemental function channel_hits(table, stay, passage) result(hits)
    type(table_type), intent(in) :: table
    type(stay_type), intent(in) :: stay
    real(wp), intent(in) :: passage
    integer(int64) :: hits

    hits = 0
    if (passage > 0.0_wp) hits = int(abs(stay%y + stay%u_lateral*passage)/channel_width_of(table, &
      stay) + 0.5_wp, int64)
  end function channel_hits

  !> Width of the channel that a particle is in. In an urn: of the channel that it was in last,
  !> since the wall hits of that passage are still corrected.
  elemental function channel_width_of(table, stay) result(width)
    type(table_type), intent(in) :: table
    type(stay_type), intent(in) :: stay
    real(wp) :: width

    width = table%channel(merge(channel1, channel2, any(stay%phase == [from_gate, counted_in_gate, &
      trapped_in_gate])))%width
  end function channel_width_of

  !> Whether a particle moves across a channel for ever.
  elemental function is_trapped(stay)
    type(stay_type), intent(in) :: stay
    logical :: is_trapped

    is_trapped = any(stay%phase == [trapped_in_gate, trapped_in_channel2])
  end function is_trapped

  !> Wall hits after the time 0 in the passage that a particle is in at the start.
  elemental function remaining_channel_hits(table, stay) result(hits)
    type(table_type), intent(in) :: table
    type(stay_type), intent(in) :: stay
    integer(int64) :: hits

    hits = int(stay%hits, int64) - channel_hits(table, stay, -stay%time)
  end function remaining_channel_hits

  !> Sums over all particles by which `collisions` corrects the counted hits.
  pure subroutine sum_outside_urns(table, stay, urn_entry_time, now, rate, outside, passed)
    type(table_type), intent(in) :: table
    type(stay_type), intent(in) :: stay(:)
    !> Time at which each particle enters its urn, if it is on the way there or inside; the time
    !> now, on the same clock.
    real(wp), intent(in) :: urn_entry_time(:), now
    !> Wall hits per time in each urn, relative to the urn with more hits.
    real(wp), intent(in) :: rate(2)
    !> Time that all particles that are not trapped have spent in their last channels; plus the time
    !> in the urn with more hits that equals the hits by which stays in the other one fall short.
    real(wp), intent(out) :: outside
    !> Wall hits in these channels until now, less those of the complete passages; of trapped
    !> particles, all hits.
    integer(int64), intent(out) :: passed
    real(wp) :: missed
    integer :: i

    outside = 0.0_wp
    missed = 0.0_wp
    passed = 0
    do i = 1, size(stay)
      associate (this_stay => stay(i))
        if (is_trapped(this_stay)) then
          passed = passed + channel_hits(table, this_stay, now - this_stay%time)
        else if (any(this_stay%phase == [counted_in_gate, to_periodic_line])) then
          outside = outside + (now - this_stay%time)
          passed = passed + channel_hits(table, this_stay, &
            now - this_stay%time) - int(this_stay%hits, int64)
        else
          outside = outside + (min(urn_entry_time(i), now) - this_stay%time)
          missed = missed + (1.0_wp - rate(this_stay%urn))*max(now - urn_entry_time(i), 0.0_wp)
          if (now < urn_entry_time(i)) passed = passed + channel_hits(table, this_stay, &
            now - this_stay%time) - int(this_stay%hits, int64)
        end if
      end associate
    end do
    outside = outside + missed
  end subroutine sum_outside_urns

  !> State (x, y, u_x, u_y) of a trapped particle.
  pure function locate_trapped_stay(table, stay, x, now) result(state)
    type(table_type), intent(in) :: table
    type(stay_type), intent(in) :: stay
    !> x of the particle in the frame of the table; the time now.
    real(wp), intent(in) :: x, now
    real(wp) :: state(4)
    real(wp) :: reflected, hits

    ! A signed zero: saved states have always had it.
    state = [x, 0.0_wp, sign(0.0_wp, x), 0.0_wp]
    call fold_into_channel(stay%y + stay%u_lateral*(now - stay%time), channel_width_of(table, &
      stay), state(2), reflected, hits)
    state(4) = reflected*stay%u_lateral
  end function locate_trapped_stay

  !> State (x, y, u_x, u_y) of a particle that is not trapped. In an urn it is drawn, from `key` and
  !> `count`.
  pure function locate_stay(table, stay, urn_entry_time, now, key, count) result(state)
    type(table_type), intent(in) :: table
    type(stay_type), intent(in) :: stay
    !> Time at which the particle enters its urn, if it is on the way there or inside; the time now,
    !> on the same clock.
    real(wp), intent(in) :: urn_entry_time, now
    !> Key of the seed and the time; particle index.
    integer(int64), intent(in) :: key, count
    real(wp) :: state(4)
    real(wp) :: gone, left, begins

    begins = table%urn(stay%urn)%channel_start(channel2)
    gone = stay%u_axial*(now - stay%time)
    left = stay%u_axial*(urn_entry_time - now)
    select case (stay%phase)
    case (counted_in_gate)
      state = in_channel(0.5_wp*table%channel(channel1)%length - gone, -1.0_wp)
    case (to_periodic_line)
      state = in_channel(begins + gone, 1.0_wp)
    case default
      if (now >= urn_entry_time) then
        state = draw_point_in_urn(table, stay%urn, key, count)
      else if (stay%phase == from_gate) then
        state = in_channel(0.5_wp*table%channel(channel1)%length - left, 1.0_wp)
      else
        state = in_channel(begins + left, -1.0_wp)
      end if
    end select
    state(1:3:2) = x_direction(stay%urn)*state(1:3:2)

  contains

    !> State in a channel at the distance `x` from the middle of the table, moving away from it
    !> (`way` = 1) or towards it (-1).
    pure function in_channel(x, way) result(found)
      real(wp), intent(in) :: x, way
      real(wp) :: found(4)
      real(wp) :: reflected, hits

      call fold_into_channel(stay%y + stay%u_lateral*(now - stay%time), channel_width_of(table, &
        stay), found(2), reflected, hits)
      found(1) = x
      found(3) = way*stay%u_axial
      found(4) = reflected*stay%u_lateral
    end function in_channel

  end function locate_stay

  !> Draws a position uniform in an urn, as if the urn lay at x > 0, and a direction.
  pure function draw_point_in_urn(table, urn, key, count) result(state)
    type(table_type), intent(in) :: table
    integer(int32), intent(in) :: urn
    integer(int64), intent(in) :: key, count
    real(wp) :: state(4)
    integer(int64) :: counter
    real(wp) :: angle
    logical :: inside

    counter = ishft(count, 20)
    do
      call try_random_point(table%urn(urn), 1.0_wp - hashed_uniform(key, counter), &
        hashed_uniform(key, counter + 1), state(1), state(2), inside)
      counter = counter + 2
      if (inside) exit
    end do
    state(1) = x_direction(urn)*state(1)
    angle = 2.0_wp*pi*hashed_uniform(key, counter)
    state(3:) = [cos(angle), sin(angle)]
  end function draw_point_in_urn

  !> Saves or restores the stays, and the time at which each particle `urn_entry_time` its urn.
  subroutine serialize_stays(table, stay, urn_entry_time, trapped_x, archive)
    type(table_type), intent(in) :: table
    type(stay_type), intent(inout) :: stay(:)
    real(wp), intent(inout) :: urn_entry_time(:)
    !> x of each particle in the frame of the table; allocated if there are trapped ones.
    real(wp), allocatable, intent(inout) :: trapped_x(:)
    type(archive_type), intent(inout) :: archive

    ! In a saved state, x of a trapped particle is stored in place of `u_axial`, and both channels
    ! have the same phase of trapped particles.
    if (allocated(trapped_x) .and. .not. archive%reading) then
      where (is_trapped(stay))
        stay%u_axial = trapped_x
        stay%phase = trapped_in_gate
      end where
    end if
    call archive%serialize('time', stay%time, 'y', stay%y, 'along', stay%u_axial, 'across', &
      stay%u_lateral, 'entered', urn_entry_time)
    call archive%serialize('hits', stay%hits)
    call archive%serialize('heading', stay%phase)
    call archive%serialize('urn', stay%urn)
    if (.not. any(is_trapped(stay))) return
    trapped_x = stay%u_axial
    where (is_trapped(stay))
      stay%u_axial = 0.0_wp
      stay%phase = int(merge(trapped_in_gate, trapped_in_channel2, &
        abs(trapped_x) <= 0.5_wp*table%channel(channel1)%length), int32)
    end where
  end subroutine serialize_stays

  !> Saves or restores the random generator, and the numbers drawn ahead.
  pure subroutine serialize_draws(draws, archive)
    type(draws_type), intent(inout) :: draws
    type(archive_type), intent(inout) :: archive
    integer :: word

    do word = 1, size(draws%random%state, 2)
      call archive%serialize('random', draws%random%state(:, word))
    end do
    call archive%serialize('next_tick', draws%next_tick)
    call archive%serialize('next_exit', draws%next_exit)
    call archive%serialize('wait', draws%wait, 'y', draws%y, 'along', draws%u_axial, &
      'inverse', draws%inverse, 'across', draws%u_lateral)
    call archive%serialize('who', draws%selector)
    call archive%serialize('hits', draws%hits)
    call archive%serialize('channel', draws%channel)
  end subroutine serialize_draws

end module battery_stay
