!> Motion of one particle from event to event: the next wall or line that it reaches, the time until
!> then, and its state afterwards.
!>
!> Geometry in the coordinates of the table: in a channel one line and two straight walls, in an urn
!> the walls of its shape. Chords, the middle line and the periodic line are treated like walls, but
!> do not reflect. The walls and lines that a particle can reach follow from its chamber and its
!> direction, never from its distance to a wall: no position has to be nudged, and a particle is
!> placed exactly on the wall or line that it reaches.
module battery_wall_motion
  use battery_kinds, only: wp, int8
  use battery_table, only: table_type, urn_type, channel1, channel2, no_channel, in_urn, in_gate, &
    in_channel2, urn_at, chamber_at, x_direction
  use battery_channel, only: facing
  use battery_motion, only: motion_type, slowest, meets_nothing, meets_gate, meets_channel2, &
    meets_urn, meets_line, meets_channel_wall
  use battery_scatterers, only: scattered_half_channel_type, find_next_wall_in_half_channel, &
    reflect_in_half_channel, detect_periodic_path
  use battery_urn, only: find_next_wall, reflect_at_wall
  implicit none (type, external)
  private
  public :: motion_at, find_first_wall, hit_wall, pass_line, reverse_motion
  public :: heads_for_middle, time_to_middle, is_trapped

contains

  !> State of a particle from its position and its velocity, of length 1.
  pure function motion_at(table, x, y, ux, uy) result(motion)
    type(table_type), intent(in) :: table
    !> In the frame of the table: lengths, and components of the velocity.
    real(wp), intent(in) :: x, y, ux, uy
    type(motion_type) :: motion

    motion = motion_type(x=x, y=y, ux=ux, uy=uy, urn=int(urn_at(table, x), int8), &
      chamber=int(chamber_at(table, x, y, huge(1.0_wp)), int8))
    ! The sign of zero tells that a particle that glides along the wall of a channel has been
    ! reflected there.
    if (.not. abs(uy) > 0.0_wp) motion%uy = sign(0.0_wp, -y)
  end function motion_at

  !> Finds the first wall or line (chord, middle line or periodic line) that a particle reaches, and
  !> the time `wait` until then. Called at the start, when there is no previous wall.
  pure subroutine find_first_wall(table, motion, wait)
    type(table_type), intent(in) :: table
    type(motion_type), intent(inout) :: motion
    real(wp), intent(out) :: wait

    associate (urn => table%urn(motion%urn))
      if (motion%chamber /= in_urn) then
        call find_next_wall_in_channel(table, motion, wait)
      else
        call find_next_wall(urn, no_channel, urn%centre + urn%axis_sign*motion%x, motion%y, &
          urn%axis_sign*motion%ux, motion%uy, motion%next, wait)
      end if
    end associate
  end subroutine find_first_wall

  !> Reflects a particle at a wall of its urn or its channel, or at a disc in the channel.
  pure subroutine hit_wall(table, motion, wait)
    type(table_type), intent(in) :: table
    type(motion_type), intent(inout) :: motion
    !> Time until the next event; huge if there is none.
    real(wp), intent(out) :: wait
    real(wp) :: x, ux

    associate (urn => table%urn(motion%urn))
      if (motion%chamber == in_urn) then
        x = urn%centre + urn%axis_sign*motion%x
        ux = urn%axis_sign*motion%ux
        call reflect_at_wall(urn, x, motion%y, ux, motion%uy, motion%next, wait)
        motion%x = urn%axis_sign*(x - urn%centre)
        motion%ux = urn%axis_sign*ux
      else if (motion%next == meets_channel_wall) then
        motion%y = sign(half_width_at(urn, motion), motion%uy)
        motion%uy = -motion%uy
        call find_next_wall_in_channel(table, motion, wait)
      else
        call reflect_at_scatterer(table%half_channel2(motion%urn), urn, motion, wait)
      end if
    end associate
  end subroutine hit_wall

  !> Reflects a particle at a disc in channel 2.
  pure subroutine reflect_at_scatterer(half_channel, urn, motion, wait)
    !> Half channel that the particle is in, and its urn.
    type(scattered_half_channel_type), intent(in) :: half_channel
    type(urn_type), intent(in) :: urn
    type(motion_type), intent(inout) :: motion
    real(wp), intent(out) :: wait
    real(wp) :: x, ux

    x = urn%periodic_line + urn%axis_sign*motion%x
    ux = urn%axis_sign*motion%ux
    call reflect_in_half_channel(half_channel, int(motion%next), x, motion%y, ux, motion%uy)
    call find_next_wall_in_half_channel(half_channel, x, motion%y, ux, motion%uy, motion%next, wait)
    motion%x = urn%axis_sign*(x - urn%periodic_line)
    motion%ux = urn%axis_sign*ux
  end subroutine reflect_at_scatterer

  !> Finds the next wall or line of a particle in a channel, and the time `wait` until then. If it
  !> reaches a wall and a chord at the same time, the wall comes first: the corner belongs to the
  !> channel.
  pure subroutine find_next_wall_in_channel(table, motion, wait)
    type(table_type), intent(in) :: table
    type(motion_type), intent(inout) :: motion
    real(wp), intent(out) :: wait

    associate (urn => table%urn(motion%urn))
      if (table%has_scatterers .and. motion%chamber == in_channel2) then
        call find_next_wall_in_half_channel(table%half_channel2(motion%urn), &
          urn%periodic_line + urn%axis_sign*motion%x, motion%y, urn%axis_sign*motion%ux, &
          motion%uy, motion%next, wait)
      else
        call find_next_wall_in_strip(urn, motion, wait)
      end if
    end associate
  end subroutine find_next_wall_in_channel

  !> As `find_next_wall_in_channel`, for a channel without discs.
  pure subroutine find_next_wall_in_strip(urn, motion, wait)
    type(urn_type), intent(in) :: urn
    type(motion_type), intent(inout) :: motion
    real(wp), intent(out) :: wait
    real(wp) :: out, depth, distance, to_wall

    out = x_direction(motion%urn)
    depth = out*motion%x
    motion%next = meets_line
    if (motion%chamber == in_gate) then
      distance = depth
      if (out*motion%ux >= 0.0_wp) then
        distance = urn%channel_start(channel1) - depth
        motion%next = meets_urn
      end if
    else
      distance = urn%periodic_line - depth
      if (out*motion%ux <= 0.0_wp) then
        distance = depth - urn%channel_start(channel2)
        motion%next = meets_urn
      end if
    end if
    wait = max(distance, 0.0_wp)/max(abs(motion%ux), slowest)
    to_wall = max(half_width_at(urn, motion) - sign(1.0_wp, motion%uy)*motion%y, 0.0_wp) &
      /max(abs(motion%uy), slowest)
    if (to_wall <= wait) then
      wait = to_wall
      motion%next = meets_channel_wall
    end if
  end subroutine find_next_wall_in_strip

  !> Moves a particle across the line that it has reached: through a chord into a channel or an urn;
  !> over the middle line; over the periodic line, from one end of the table to the other; or back,
  !> if the line is an end wall.
  pure subroutine pass_line(table, motion, wait)
    type(table_type), intent(in) :: table
    type(motion_type), intent(inout) :: motion
    !> Time until the next event; huge if there is none.
    real(wp), intent(out) :: wait
    integer :: urn_index, channel

    urn_index = motion%urn
    select case (motion%next)
    case (meets_gate, meets_channel2)
      motion%chamber = int(merge(in_gate, in_channel2, motion%next == meets_gate), int8)
      motion%x = x_direction(urn_index)*table%urn(urn_index)%channel_start(channel_of(motion))
    case (meets_urn)
      channel = channel_of(motion)
      if (sign(1.0_wp, motion%uy)*motion%y >= half_width_at(table%urn(urn_index), motion)) then
        ! Rounding has brought it to the corner on the line: the wall comes first there, too.
        motion%next = meets_channel_wall
        wait = 0.0_wp
        return
      end if
      call keep_between_walls(table%urn(urn_index), motion)
      motion%x = x_direction(urn_index)*table%urn(urn_index)%channel_start(channel)
      motion%chamber = int(in_urn, int8)
      associate (urn => table%urn(urn_index))
        call find_next_wall(urn, channel, facing(channel)*urn%chord(channel), motion%y, &
          urn%axis_sign*motion%ux, motion%uy, motion%next, wait)
      end associate
      return
    case (meets_line)
      if (table%urn_across(urn_index) == urn_index) motion%ux = -motion%ux
      urn_index = table%urn_across(urn_index)
      motion%urn = int(urn_index, int8)
      motion%x = 0.0_wp
      if (motion%chamber == in_channel2) motion%x = &
        x_direction(urn_index)*table%urn(urn_index)%periodic_line
    case default
      wait = huge(1.0_wp)
      return
    end select
    call keep_between_walls(table%urn(urn_index), motion)
    call find_next_wall_in_channel(table, motion, wait)
  end subroutine pass_line

  !> Reverses u_x of a particle in channel 1, which has been moved to its present position.
  pure subroutine reverse_motion(table, motion, wait)
    type(table_type), intent(in) :: table
    type(motion_type), intent(inout) :: motion
    !> Time until the next event.
    real(wp), intent(out) :: wait

    motion%ux = -motion%ux
    call keep_between_walls(table%urn(motion%urn), motion)
    call find_next_wall_in_channel(table, motion, wait)
  end subroutine reverse_motion

  !> Whether a particle in channel 1 heads for the other gate: it came from its urn and has not been
  !> reversed.
  elemental function heads_for_middle(motion) result(heads)
    type(motion_type), intent(in) :: motion
    logical :: heads

    heads = motion%chamber == in_gate .and. x_direction(motion%urn)*motion%ux < 0.0_wp
  end function heads_for_middle

  !> Time until a particle of channel 1 that heads for the middle line reaches it.
  elemental function time_to_middle(motion) result(time)
    type(motion_type), intent(in) :: motion
    real(wp) :: time

    time = abs(motion%x)/max(abs(motion%ux), slowest)
  end function time_to_middle

  !> Whether a particle can never leave: it moves across a channel, along a wall, or back and forth
  !> between discs.
  elemental function is_trapped(table, motion) result(trapped)
    type(table_type), intent(in) :: table
    type(motion_type), intent(in) :: motion
    logical :: trapped

    associate (urn => table%urn(motion%urn))
      if (table%has_scatterers .and. motion%chamber == in_channel2) then
        call detect_periodic_path(table%half_channel2(motion%urn), urn%periodic_line &
          + urn%axis_sign*motion%x, motion%y, urn%axis_sign*motion%ux, motion%uy, trapped)
      else
        trapped = motion%next == meets_nothing &
          .or. (motion%chamber /= in_urn .and. .not. abs(motion%ux) > 0.0_wp)
      end if
    end associate
  end function is_trapped

  !> Channel that a particle is in.
  elemental function channel_of(motion) result(channel)
    type(motion_type), intent(in) :: motion
    integer :: channel

    channel = merge(channel1, channel2, motion%chamber == in_gate)
  end function channel_of

  !> Half the width of the channel that a particle is in.
  elemental function half_width_at(urn, motion) result(half_width)
    type(urn_type), intent(in) :: urn
    type(motion_type), intent(in) :: motion
    real(wp) :: half_width

    half_width = urn%half_width(channel_of(motion))
  end function half_width_at

  !> Undoes rounding that has moved a particle of a channel beyond a wall.
  pure subroutine keep_between_walls(urn, motion)
    type(urn_type), intent(in) :: urn
    type(motion_type), intent(inout) :: motion

    motion%y = sign(min(abs(motion%y), half_width_at(urn, motion)), motion%y)
  end subroutine keep_between_walls

end module battery_wall_motion
