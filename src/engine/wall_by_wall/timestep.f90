!> The engine `timestep`: all particles move by a fixed step, and walls take effect at its end. An
!> approximation to compare with: the simplest algorithm, wrong by first order in the step.
!>
!> After each step, each particle that may be near a wall of its urn, or is in a channel, is
!> corrected:
!> - If it is beyond the wall of its urn, its position is mirrored in the wall and its velocity
!>   reflected there; beyond a wall of its channel, it is mirrored as often as needed. Each is a
!>   wall collision. Its position and the normal are wrong by as much as the particle has overshot.
!> - If it is beyond the chord of an opening, between the channel's walls and moving outwards, it
!>   has entered the channel, unless it moves along the chord, or was beyond it before, in a part of
!>   a polygon that extends over the channel; on the chord or short of it, and not
!>   moving inwards, it has left the channel. Beyond the middle line or the periodic line it has
!>   crossed that. All events of a step take place at its end: crossings first,
!>   then all entries, then the decisions of the gates (`battery_gate`).
!>
!> **Corners.** Only the position at the end of a step counts. So a path that hits a wall less than
!> a step from a corner may pass the corner into the channel, or out of it. If a change of chambers
!> shows that the chord was crossed beyond its ends, it is counted in `slips`. Every position at the
!> end of a step is one of the cases above: after the correction no particle is outside the table,
!> as long as a step is shorter than the radius and than half a channel.
!>
!> A step during which the run stops (for a snapshot, or at its end) is made shorter.
module battery_timestep
  use battery_kinds, only: wp, int8, int64
  use battery_text, only: to_text
  use battery_table, only: table_type, urn_type, channel1, channel2, no_channel, in_urn, in_gate, &
    in_channel2, x_direction, are_mirror_images
  use battery_channel, only: fold_into_channel, facing, is_open
  use battery_motion, only: motion_type
  use battery_urn, only: contains_point, reflect_overshoot
  use battery_wall_by_wall, only: wall_by_wall_type, reset_counts, serialize_counts, end_instant, &
    count_hits, record_gate_entry, record_line_crossing, window_reaches
  use battery_engine, only: unmet_requirement
  use battery_event_record, only: event_record_type
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: timestep_type

  !> The last step before a stop may be longer by this fraction: what is left may be rounding.
  real(wp), parameter :: step_tolerance = 1.0e-6_wp

  !> Largest number of moves of particles in a window.
  real(wp), parameter :: window_moves = 262144.0_wp

  !> The engine: state of all particles now, as arrays.
  type, extends(wall_by_wall_type) :: timestep_type
    private
    !> Number of passages round a corner through a wall, as far as they are detected.
    integer(int64), public :: slips = 0
    real(wp), allocatable :: x(:), y(:), ux(:), uy(:)
    integer(int8), allocatable :: urn(:), chamber(:)
    !> Whether a particle may have hit a wall, or is in a channel.
    logical, allocatable :: near_wall(:)
    !> Steps in a window, and the length of the last one.
    integer :: steps = 1
    real(wp) :: last_step = 0.0_wp
  contains
    procedure :: reason_unsupported, prepare_engine, process_window, serialize_own_state, &
      motion_now, store_motion
  end type timestep_type

contains

  !> Why the engine cannot simulate a table: a step must not lead over a gate, or out of an urn.
  pure function reason_unsupported(self, table) result(reason)
    class(timestep_type), intent(in) :: self
    type(table_type), intent(in) :: table
    character(len=:), allocatable :: reason
    real(wp) :: longest

    reason = unmet_requirement(table)
    if (table%has_scatterers) reason = 'it does not support scatterers'
    if (reason /= '') return
    longest = min(minval(table%urn%longest_step), minval(0.5_wp*table%channel%length, &
      mask=is_open(table%channel)))
    if (.not. (self%time_step > 0.0_wp .and. self%time_step*(1.0_wp + step_tolerance) < longest)) &
      reason = &
      'its time_step must be above 0 and below '//to_text(longest) &
      //', the least of half the length of each open channel, of twice the area of an urn over ' &
      //'its perimeter (a disc''s radius), and of the distance between walls that are not adjacent'
  end function reason_unsupported

  !> Sets the number of steps in a window, from the table and the number of particles; allocates the
  !> particles.
  subroutine prepare_engine(self)
    class(timestep_type), intent(inout) :: self
    integer :: number

    call reset_counts(self)
    number = self%number
    self%steps = int(max(1.0_wp, min(window_moves/real(number, wp), &
      window_reaches*maxval(self%table%urn%reach)/self%time_step)))
    self%slips = 0
    if (allocated(self%x)) deallocate (self%x, self%y, self%ux, self%uy, self%urn, self%chamber, &
      self%near_wall)
    allocate (self%x(number), self%y(number), self%ux(number), self%uy(number))
    allocate (self%urn(number), self%chamber(number), self%near_wall(number))
  end subroutine prepare_engine

  !> Advances by the steps of a window: by less than `duration` if `steps` time steps are shorter,
  !> or if the epoch ends.
  subroutine process_window(self, event_record, duration)
    class(timestep_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    real(wp), intent(in) :: duration
    real(wp) :: step
    integer :: step_number

    self%window_time = 0.0_wp
    do step_number = 1, self%steps
      if (self%window_start + self%window_time >= self%epoch) exit
      step = self%time_step
      if (duration - self%window_time < (1.0_wp + step_tolerance)*step) &
        step = max(duration - self%window_time, 0.0_wp)
      if (step_number > 1 .and. .not. step > 0.0_wp) exit
      self%window_time = self%window_time + step
      self%last_step = step
      self%now = self%window_start + self%window_time
      call move_particles(self%table%urn(1), self%number, step, self%x, self%y, self%ux, self%uy, &
        self%chamber, self%near_wall)
      if (.not. are_mirror_images(self%table%urn)) call mark_near_walls_of_urn2(self)
      call process_step_end(self, event_record)
    end do
  end subroutine process_window

  !> Kernel: moves every particle straight by `step`; marks those that may have hit a wall.
  !> Vectorised over the particles.
  pure subroutine move_particles(urn, number, step, x, y, ux, uy, chamber, near_wall)
    !> Urn 1; the marks of particles in urn 2 are right if the urns are mirror images.
    type(urn_type), intent(in) :: urn
    integer, intent(in) :: number
    real(wp), intent(in) :: step, ux(number), uy(number)
    real(wp), intent(inout) :: x(number), y(number)
    integer(int8), intent(in) :: chamber(number)
    logical, intent(out) :: near_wall(number)
    real(wp) :: clear2, chord1, chord2, centre
    integer :: i

    ! Copies that the compiler may keep in registers.
    clear2 = urn%clear**2
    chord1 = urn%chord(channel1)
    chord2 = urn%chord(channel2)
    centre = urn%centre
    do i = 1, number
      x(i) = x(i) + ux(i)*step
      y(i) = y(i) + uy(i)*step
      near_wall(i) = is_near_wall(centre - abs(x(i)), y(i), clear2, chord1, chord2)
    end do
    do i = 1, number
      near_wall(i) = near_wall(i) .or. chamber(i) /= in_urn
    end do
  end subroutine move_particles

  !> Whether a particle at (x, y) in the frame of its urn may have hit a wall or crossed a chord.
  elemental function is_near_wall(x, y, clear2, chord1, chord2) result(near)
    real(wp), intent(in) :: x, y, clear2, chord1, chord2
    logical :: near

    near = x**2 + y**2 > clear2 .or. x >= chord1 .or. x <= -chord2
  end function is_near_wall

  !> If the urns differ: marks the particles in urn 2 that may have hit a wall.
  pure subroutine mark_near_walls_of_urn2(self)
    type(timestep_type), intent(inout) :: self
    integer :: i

    associate (urn => self%table%urn(2))
      do i = 1, self%number
        if (self%urn(i) == 2 .and. self%chamber(i) == in_urn) self%near_wall(i) = &
          is_near_wall(urn%centre - abs(self%x(i)), self%y(i), urn%clear**2, urn%chord(channel1), &
          urn%chord(channel2))
      end do
    end associate
  end subroutine mark_near_walls_of_urn2

  !> Corrects the particles at the end of a step, and lets the gates decide.
  subroutine process_step_end(self, event_record)
    type(timestep_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    integer :: i, first

    first = event_record%events + 1
    do i = 1, self%number
      if (.not. self%near_wall(i)) cycle
      if (self%chamber(i) == in_urn) then
        call correct_in_urn(self, i, event_record)
      else
        call correct_in_channel(self, i, event_record)
      end if
    end do
    call end_instant(self, first, event_record)
  end subroutine process_step_end

  !> Corrects a particle in an urn that may be beyond a wall or a chord. Who moves along a chord
  !> passes over the opening.
  subroutine correct_in_urn(self, i, event_record)
    type(timestep_type), intent(inout) :: self
    integer, intent(in) :: i
    type(event_record_type), intent(inout) :: event_record
    real(wp) :: x, ux, moved
    integer :: opening
    logical :: was_beyond

    opening = no_channel
    associate (urn => self%table%urn(self%urn(i)), y => self%y(i))
      x = urn%centre + urn%axis_sign*self%x(i)
      ux = urn%axis_sign*self%ux(i)
      ! Who is farther beyond a chord was beyond it before this step.
      moved = huge(1.0_wp)
      if (urn%overhangs) moved = abs(ux)*self%last_step + urn%least_across*urn%reach
      if (is_past(x - urn%chord(channel1)) .and. abs(y) < urn%half_width(channel1)) then
        opening = channel1
      else if (is_past(-x - urn%chord(channel2)) .and. abs(y) < urn%half_width(channel2)) then
        opening = channel2
      end if
      if (opening /= no_channel .and. abs(ux) <= urn%least_across) return
      if (opening == channel1 .and. ux > 0.0_wp) then
        call change_chamber(self, i, in_gate, urn%half_width(channel1), (x - urn%chord(channel1)) &
          /ux)
        call record_gate_entry(self, event_record, i, self%motion_now(i))
      else if (opening == channel2 .and. ux < 0.0_wp) then
        call change_chamber(self, i, in_channel2, urn%half_width(channel2), &
          (x + urn%chord(channel2))/ux)
      else
        call reflect_overshoot(urn, x, y, ux, self%uy(i), was_beyond)
        if (.not. was_beyond) return
        self%x(i) = urn%axis_sign*(x - urn%centre)
        self%ux(i) = urn%axis_sign*ux
        call count_hits(self, event_record, 1_int64)
      end if
    end associate

  contains

    !> Whether the particle is beyond a chord, by no more than it `moved` in this step.
    pure logical function is_past(behind)
      real(wp), intent(in) :: behind

      is_past = behind >= 0.0_wp .and. behind <= moved
    end function is_past

  end subroutine correct_in_urn

  !> Moves a particle through a chord, which it crossed the time `ago` before now, into another
  !> chamber; the channel's half width is `half_width`.
  subroutine change_chamber(self, i, chamber, half_width, ago)
    type(timestep_type), intent(inout) :: self
    integer, intent(in) :: i, chamber
    real(wp), intent(in) :: half_width, ago

    if (abs(self%y(i) - self%uy(i)*ago) > half_width) self%slips = self%slips + 1
    self%chamber(i) = int(chamber, int8)
  end subroutine change_chamber

  !> Corrects a particle in a channel: walls, line, and the way into the urn.
  subroutine correct_in_channel(self, i, event_record)
    type(timestep_type), intent(inout) :: self
    integer, intent(in) :: i
    type(event_record_type), intent(inout) :: event_record
    real(wp) :: out, depth, ahead, half_width, ago
    integer :: channel
    logical :: inward

    out = x_direction(self%urn(i))
    channel = merge(channel1, channel2, self%chamber(i) == in_gate)
    ! Towards the line: such a particle cannot leave the channel.
    inward = facing(channel)*out*self%ux(i) < 0.0_wp
    associate (urn => self%table%urn(self%urn(i)), x => self%x(i))
      half_width = urn%half_width(channel)
      ! Distance beyond the chord, and distance to the line.
      depth = facing(channel)*(urn%channel_start(channel) - out*x)
      ahead = merge(out*x, urn%periodic_line - out*x, channel == channel1)
      ! On the chord it is in the urn: who moves along the chord passes over the opening.
      if (.not. inward .and. depth <= 0.0_wp .and. contains_point(urn, urn%centre - out*x, &
        self%y(i), 0.0_wp)) then
        ago = 0.0_wp
        if (abs(self%ux(i)) > 0.0_wp) ago = -depth/abs(self%ux(i))
        call change_chamber(self, i, in_urn, half_width, ago)
        return
      end if
      if (abs(self%y(i)) > half_width) call mirror_in_channel(self, i, half_width, event_record)
      if (.not. inward) then
        ! The particle is on the chord, or in the wall beside the channel.
        if (depth <= 0.0_wp) call change_chamber(self, i, in_urn, half_width, 0.0_wp)
      else if (ahead < 0.0_wp) then
        call move_across_line(self, i, event_record)
      end if
    end associate
  end subroutine correct_in_channel

  !> Mirrors a particle in the walls of its channel until it is between them.
  subroutine mirror_in_channel(self, i, half_width, event_record)
    type(timestep_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp), intent(in) :: half_width
    type(event_record_type), intent(inout) :: event_record
    real(wp) :: height, reflected, hits

    call fold_into_channel(self%y(i), 2.0_wp*half_width, height, reflected, hits)
    self%y(i) = height
    self%uy(i) = reflected*self%uy(i)
    call count_hits(self, event_record, int(hits, int64))
  end subroutine mirror_in_channel

  !> Moves a particle across the line of its channel, or back from the end wall.
  subroutine move_across_line(self, i, event_record)
    type(timestep_type), intent(inout) :: self
    integer, intent(in) :: i
    type(event_record_type), intent(inout) :: event_record
    integer :: from

    from = self%urn(i)
    self%urn(i) = int(self%table%urn_across(from), int8)
    if (self%urn(i) == from) then
      self%x(i) = -self%x(i)
      self%ux(i) = -self%ux(i)
    else if (self%chamber(i) == in_channel2) then
      ! From one end of the table to the other.
      self%x(i) = self%x(i) - x_direction(from)*sum(self%table%urn%periodic_line)
    end if
    call record_line_crossing(self, event_record, i, from, int(self%chamber(i)))
  end subroutine move_across_line

  !> State of particle `i` now; its next wall is not computed.
  pure function motion_now(self, i) result(motion)
    class(timestep_type), intent(in) :: self
    integer, intent(in) :: i
    type(motion_type) :: motion

    motion = motion_type(x=self%x(i), y=self%y(i), ux=self%ux(i), uy=self%uy(i), &
      urn=self%urn(i), chamber=self%chamber(i))
  end function motion_now

  !> Stores particle `i`; the time `wait` until its next event says whether it is near a wall.
  subroutine store_motion(self, i, motion, wait)
    class(timestep_type), intent(inout) :: self
    integer, intent(in) :: i
    type(motion_type), intent(in) :: motion
    real(wp), intent(in) :: wait

    self%x(i) = motion%x
    self%y(i) = motion%y
    self%ux(i) = motion%ux
    self%uy(i) = motion%uy
    self%urn(i) = motion%urn
    self%chamber(i) = motion%chamber
    ! Later hits are detected at the end of a step.
    self%near_wall(i) = wait <= self%time_step
  end subroutine store_motion

  !> Saves or restores the counts and the particles.
  subroutine serialize_own_state(self, archive)
    class(timestep_type), intent(inout) :: self
    type(archive_type), intent(inout) :: archive

    call serialize_counts(self, archive)
    call archive%serialize('slips', self%slips)
    call archive%serialize('x', self%x, 'y', self%y, 'ux', self%ux, 'uy', self%uy)
    call archive%serialize('side', self%urn)
    call archive%serialize('chamber', self%chamber)
  end subroutine serialize_own_state

end module battery_timestep
