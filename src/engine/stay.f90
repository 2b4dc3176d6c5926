!> What the engine `reservoir` knows of a particle, and the random numbers that it lives by.
module battery_stay
  use battery_kinds, only: wp, int32, int64, pi
  use battery_table, only: table_type, region_at, urn_one, urn_two, return_one, return_two, &
    longest_run, try_point
  use battery_channel, only: fold
  use battery_random, only: random_type, draw_uniform, hashed_uniform
  implicit none (type, external)
  private
  public :: stay_type, draws_type, block_length, draw_ticks, draw_exits, take_over, whereabouts, &
    passed_walls
  public :: from_gate, from_return, in_gate, to_return, parked

  !> Random numbers are drawn so many at a time.
  integer, parameter :: block_length = 512

  !> In an urn, or on the way into it from channel 1 or 2; counted in a gate; on the way to the
  !> periodic line; flying to and fro across a channel for ever.
  integer, parameter :: from_gate = 1, from_return = 2, in_gate = 3, to_return = 4, parked = 5

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
  !> which channel (positive: channel 1).
  type :: draws_type
    type(random_type) :: random
    integer :: next_tick = block_length + 1, next_exit = block_length + 1
    real(wp), dimension(block_length) :: wait = 0.0_wp, who = 0.0_wp
    real(wp), dimension(block_length) :: y = 0.0_wp, along = 0.0_wp, inverse = 0.0_wp, &
      across = 0.0_wp, hits = 0.0_wp, opening = 0.0_wp
  end type draws_type

contains

  !> A block of ticks.
  pure subroutine draw_ticks(draws)
    type(draws_type), intent(inout) :: draws
    integer :: k

    call draw_uniform(draws%random, block_length, draws%wait)
    call draw_uniform(draws%random, block_length, draws%who)
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

    width1 = table%channel1_width
    width2 = table%channel2_width
    length1 = table%channel1_length
    length2 = table%channel2_length
    call draw_uniform(draws%random, block_length, draws%y)
    call draw_uniform(draws%random, block_length, draws%across)
    do k = 1, block_length
      place = (width1 + width2)*draws%y(k)
      draws%opening(k) = merge(1.0_wp, -1.0_wp, place < width1)
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
  pure subroutine take_over(table, x, y, ux, uy, stay, entered)
    type(table_type), intent(in) :: table
    real(wp), intent(in) :: x, y, ux, uy
    type(stay_type), intent(out) :: stay
    real(wp), intent(out) :: entered
    integer :: region, urn
    real(wp) :: outward, depth, width, length, turned, hits
    logical :: in_channel2
    !> Slower passages, longer than any run, and those with more wall hits than an integer can
    !> count, are taken for endless.
    real(wp), parameter :: most_hits = 4.0e18_wp

    region = region_at(table, x, y, huge(1.0_wp))
    urn = merge(1, 2, x < 0.0_wp)
    entered = 0.0_wp
    stay = stay_type(y=y, along=abs(ux), across=uy, urn=int(urn, int32))
    if (region == urn_one .or. region == urn_two) return
    in_channel2 = region == return_one .or. region == return_two
    width = merge(table%channel2_width, table%channel1_width, in_channel2)
    length = merge(table%channel2_length, table%channel1_length, in_channel2)
    depth = merge(abs(x) - table%urn_centre - table%chord2_distance, 0.5_wp*length - abs(x), &
      in_channel2)
    ! Towards the far end of the channel.
    outward = merge(-1.0_wp, 1.0_wp, in_channel2)*merge(ux, -ux, urn == 1)
    if (.not. abs(ux)*min(longest_run*table%urn_radius, most_hits*width) > length) then
      stay%heading = int(parked, int32)
      stay%along = x
    else if (outward > 0.0_wp) then
      call fold(y - uy*depth/outward, width, stay%y, turned, hits)
      stay%time = -depth/outward
      stay%across = turned*uy
      stay%heading = int(merge(to_return, in_gate, in_channel2), int32)
      stay%hits = real(passed_walls(table, stay, length/outward), wp)
    else
      stay%heading = int(merge(from_return, from_gate, in_channel2), int32)
      entered = -depth/outward
      stay%hits = real(passed_walls(table, stay, entered), wp)
    end if
  end subroutine take_over

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
    if (stay%heading == parked) in_channel1 = abs(stay%along) <= 0.5_wp*table%channel1_length
    width = merge(table%channel1_width, table%channel2_width, in_channel1)
  end function width_of

  !> x, y, u_x, u_y of a particle. In an urn they are drawn, for this key and count alone.
  pure function whereabouts(table, stay, entered, now, key, count) result(place)
    type(table_type), intent(in) :: table
    type(stay_type), intent(in) :: stay
    real(wp), intent(in) :: entered, now
    integer(int64), intent(in) :: key, count
    real(wp) :: place(4)
    real(wp) :: side, gone, left, begins

    side = merge(-1.0_wp, 1.0_wp, stay%urn == 1)
    begins = table%urn_centre + table%chord2_distance
    gone = stay%along*(now - stay%time)
    left = stay%along*(entered - now)
    select case (stay%heading)
    case (parked)
      place = in_channel(stay%along, 0.0_wp)
      return
    case (in_gate)
      place = in_channel(0.5_wp*table%channel1_length - gone, -1.0_wp)
    case (to_return)
      place = in_channel(begins + gone, 1.0_wp)
    case default
      if (now >= entered) then
        place = in_urn(table, key, count)
      else if (stay%heading == from_gate) then
        place = in_channel(0.5_wp*table%channel1_length - left, 1.0_wp)
      else
        place = in_channel(begins + left, -1.0_wp)
      end if
    end select
    place(1) = side*place(1)
    place(3) = side*place(3)

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

  !> Uniform in the urn, in the half plane x > 0, with a direction.
  pure function in_urn(table, key, count) result(place)
    type(table_type), intent(in) :: table
    integer(int64), intent(in) :: key, count
    real(wp) :: place(4)
    integer(int64) :: turn
    real(wp) :: x, y, angle
    logical :: inside

    turn = ishft(count, 20)
    do
      call try_point(table%urn_radius, -table%chord1_distance, table%chord2_distance, &
        hashed_uniform(key, turn), hashed_uniform(key, turn + 1), x, y, inside)
      turn = turn + 2
      if (inside) exit
    end do
    angle = 2.0_wp*pi*hashed_uniform(key, turn)
    place = [table%urn_centre + x, y, cos(angle), sin(angle)]
  end function in_urn

end module battery_stay
