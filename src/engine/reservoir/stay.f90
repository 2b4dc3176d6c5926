!> What the engine `reservoir` knows of a particle, and the random numbers that it lives by.
module battery_stay
  use battery_kinds, only: wp, int32, int64, pi
  use battery_table, only: table_type, passage_type, passage_at, gated, ungated, no_channel, &
    x_direction, try_place
  use battery_channel, only: fold
  use battery_stream, only: stream_type
  use battery_random, only: random_type, draw_uniform, hashed_uniform
  implicit none (type, external)
  private
  public :: stay_type, draws_type, block_length, draw_ticks, draw_exits, take_in, whereabouts, &
    passed_walls, pass_draws
  public :: from_gate, from_return, in_gate, to_return, parked

  !> Random numbers are drawn so many at a time.
  integer, parameter :: block_length = 512

  !> In an urn, or on the way into it from channel 1 or 2; counted in a gate; on the way to the
  !> periodic line; flying to and fro across a channel for ever.
  integer, parameter :: from_gate = 1, from_return = 2, in_gate = 3, to_return = 4, parked = 5

  !> What is known of a particle, but for when it enters its urn.
  type :: stay_type
    !> When it entered the channel it is or was last in, at which height, with |u_x| and u_y.
    !> `parked`: time, y, x, u_y.
    real(wp) :: time = 0.0_wp, y = 0.0_wp, along = 0.0_wp, across = 0.0_wp
    !> Wall hits of the whole way through the channel it is in.
    real(wp) :: hits = 0.0_wp
    integer(int32) :: heading = from_gate
    !> Urn it is in or goes to, or leaves.
    integer(int32) :: urn = 0
  end type stay_type

  !> Numbers drawn ahead: times between ticks (mean 1), which particle ticks (0 to 1), and where and
  !> how an urn is left: height, |u_x|, 1 over it, u_y, the wall hits of the whole channel, and
  !> which channel.
  type :: draws_type
    type(random_type) :: random
    integer :: next_tick = block_length + 1, next_exit = block_length + 1
    real(wp), dimension(block_length) :: wait = 0.0_wp, who = 0.0_wp
    real(wp), dimension(block_length) :: y = 0.0_wp, along = 0.0_wp, inverse = 0.0_wp, &
      across = 0.0_wp, hits = 0.0_wp
    integer :: channel(block_length) = gated
  end type draws_type

contains

  !> A block of ticks.
  pure subroutine draw_ticks(draws)
    type(draws_type), intent(inout) :: draws
    integer :: k

    call draw_uniform(draws%random, block_length, draws%wait)
    call draw_uniform(draws%random, block_length, draws%who)
    ! Logarithms of the C library's vectors differ with their length in the last bit.
!GCC$ novector
    do k = 1, block_length
      draws%wait(k) = -log(draws%wait(k))
    end do
    draws%next_tick = 1
  end subroutine draw_ticks

  !> A block of ways out. One number says through which opening and at which height: where on the
  !> length of both openings, one after the other, it falls.
  pure subroutine draw_exits(draws, table)
    type(draws_type), intent(inout) :: draws
    type(table_type), intent(in) :: table
    real(wp) :: place, sine, width, length, width1, width2, length1, length2
    integer :: k

    width1 = table%channel(gated)%width
    width2 = table%channel(ungated)%width
    length1 = table%channel(gated)%length
    length2 = table%channel(ungated)%length
    call draw_uniform(draws%random, block_length, draws%y)
    call draw_uniform(draws%random, block_length, draws%across)
    do k = 1, block_length
      place = (width1 + width2)*draws%y(k)
      draws%channel(k) = merge(gated, ungated, place < width1)
      width = merge(width1, width2, place < width1)
      length = merge(length1, length2, place < width1)
      draws%y(k) = merge(place, place - width1, place < width1) - 0.5_wp*width
      sine = 2.0_wp*draws%across(k) - 1.0_wp
      draws%across(k) = sine
      draws%along(k) = sqrt((1.0_wp - sine)*(1.0_wp + sine))
      draws%inverse(k) = 1.0_wp/draws%along(k)
      draws%hits(k) = aint(abs(draws%y(k) + sine*length*draws%inverse(k))/width + 0.5_wp)
    end do
    draws%next_exit = 1
  end subroutine draw_exits

  !> From a position and velocity at the time 0. A particle in a channel that heads for its far end
  !> is dated back to where it would have entered; `entered` is when any other enters its urn.
  pure subroutine take_in(table, x, y, ux, uy, stay, entered)
    type(table_type), intent(in) :: table
    !> Place in the frame of the table, lengths; velocity, of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    type(stay_type), intent(out) :: stay
    real(wp), intent(out) :: entered
    type(passage_type) :: passage

    passage = passage_at(table, x, y, ux, uy)
    entered = 0.0_wp
    stay = stay_type(y=y, along=abs(ux), across=uy, urn=int(passage%side, int32))
    if (passage%endless) then
      stay%heading = int(parked, int32)
      stay%along = x
    else if (passage%inward) then
      stay%time = passage%time
      stay%y = passage%height
      stay%across = passage%turned*uy
      stay%heading = int(merge(in_gate, to_return, passage%channel == gated), int32)
      stay%hits = real(passed_walls(table, stay, table%channel(passage%channel)%length/abs(ux)), wp)
    else if (passage%channel /= no_channel) then
      stay%heading = int(merge(from_gate, from_return, passage%channel == gated), int32)
      entered = passage%time
      stay%hits = real(passed_walls(table, stay, entered), wp)
    end if
  end subroutine take_in

  !> Wall hits in its channel in the time `passage` after it entered that.
  elemental function passed_walls(table, stay, passage) result(hits)
    type(table_type), intent(in) :: table
    type(stay_type), intent(in) :: stay
    real(wp), intent(in) :: passage
    integer(int64) :: hits

    hits = 0
    if (passage > 0.0_wp) hits = int(abs(stay%y + stay%across*passage)/width_of(table, stay) &
      + 0.5_wp, int64)
  end function passed_walls

  !> Width of the channel it is or was last in.
  elemental function width_of(table, stay) result(width)
    type(table_type), intent(in) :: table
    type(stay_type), intent(in) :: stay
    real(wp) :: width
    logical :: in_channel1

    in_channel1 = stay%heading == from_gate .or. stay%heading == in_gate
    if (stay%heading == parked) in_channel1 = abs(stay%along) <= 0.5_wp*table%channel(gated)%length
    width = table%channel(merge(gated, ungated, in_channel1))%width
  end function width_of

  !> x, y, u_x, u_y of a particle. In an urn they are drawn, for this key and count alone.
  pure function whereabouts(table, stay, entered, now, key, count) result(place)
    type(table_type), intent(in) :: table
    type(stay_type), intent(in) :: stay
    !> When it enters its urn, if it goes there or is there; the time now, on the same clock.
    real(wp), intent(in) :: entered, now
    !> Of the seed and the time; number of the particle.
    integer(int64), intent(in) :: key, count
    real(wp) :: place(4)
    real(wp) :: gone, left, begins

    begins = table%urn(stay%urn)%begins(ungated)
    gone = stay%along*(now - stay%time)
    left = stay%along*(entered - now)
    select case (stay%heading)
    case (parked)
      place = in_channel(stay%along, 0.0_wp)
      return
    case (in_gate)
      place = in_channel(0.5_wp*table%channel(gated)%length - gone, -1.0_wp)
    case (to_return)
      place = in_channel(begins + gone, 1.0_wp)
    case default
      if (now >= entered) then
        place = drawn_in_urn(table, stay%urn, key, count)
      else if (stay%heading == from_gate) then
        place = in_channel(0.5_wp*table%channel(gated)%length - left, 1.0_wp)
      else
        place = in_channel(begins + left, -1.0_wp)
      end if
    end select
    place(1:3:2) = x_direction(stay%urn)*place(1:3:2)

  contains

    !> In a channel at the distance `x` from the middle of the table, on the way away from it
    !> (`way` = 1) or towards it (-1).
    pure function in_channel(x, way) result(found)
      real(wp), intent(in) :: x, way
      real(wp) :: found(4)
      real(wp) :: turned, hits

      call fold(stay%y + stay%across*(now - stay%time), width_of(table, stay), found(2), turned, &
        hits)
      found(1) = x
      found(3) = way*stay%along
      found(4) = turned*stay%across
    end function in_channel

  end function whereabouts

  !> Uniform in an urn, as if that lay at x > 0, with a direction.
  pure function drawn_in_urn(table, side, key, count) result(place)
    type(table_type), intent(in) :: table
    integer(int32), intent(in) :: side
    integer(int64), intent(in) :: key, count
    real(wp) :: place(4)
    integer(int64) :: turn
    real(wp) :: angle
    logical :: inside

    turn = ishft(count, 20)
    do
      call try_place(table%urn(side), 1.0_wp - hashed_uniform(key, turn), hashed_uniform(key, &
        turn + 1), place(1), place(2), inside)
      turn = turn + 2
      if (inside) exit
    end do
    place(1) = x_direction(side)*place(1)
    angle = 2.0_wp*pi*hashed_uniform(key, turn)
    place(3:) = [cos(angle), sin(angle)]
  end function drawn_in_urn

  !> The numbers drawn ahead, and the generator, through a stream.
  pure subroutine pass_draws(draws, stream)
    type(draws_type), intent(inout) :: draws
    type(stream_type), intent(inout) :: stream
    integer :: word

    do word = 1, size(draws%random%state, 2)
      call stream%pass('random', draws%random%state(:, word))
    end do
    call stream%pass('next_tick', draws%next_tick)
    call stream%pass('next_exit', draws%next_exit)
    call stream%pass('wait', draws%wait, 'y', draws%y, 'along', draws%along, &
      'inverse', draws%inverse, 'across', draws%across)
    call stream%pass('who', draws%who)
    call stream%pass('hits', draws%hits)
    call stream%pass('channel', draws%channel)
  end subroutine pass_draws

end module battery_stay
