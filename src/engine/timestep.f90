!> The engine `timestep`: all particles move by a fixed step, and walls are seen at its end.
!>
!> What one would write first, here to be measured against: it is wrong by one order of the step.
!> After each step, for each particle that is not well inside its urn:
!> - Beyond the arc of its urn it is put back by mirroring it in the circle, along the ray from the
!>   centre, and its velocity is reflected there; beyond a wall of its channel it is mirrored in the
!>   wall, as often as it takes. That is a wall collision. The places and normals of these are wrong
!>   by as much as the particle has gone too far.
!> - Beyond the chord of an opening, between the channel's walls and on its way out, it has entered
!>   the channel; short of the chord it has left it. Beyond the middle line or the periodic line it
!>   has crossed that. Gates count at the end of the step: crossings first, then all entries, then
!>   they decide (`battery_instant`). All events of a step happen at its end.
!>
!> **Corners.** Only the place at the end of a step counts. So a path that meets a wall less than a
!> step from a corner may slip past it into the channel, or out of it. Where a change of rooms shows
!> that the chord was crossed beyond its ends, that is counted in `slips`. Every place that a
!> step can end at is one of the cases above: nobody is ever outside of the table at the end of a
!> step, however long it is, as long as it is shorter than the radius and than half a channel.
!>
!> A stop that falls into a step (a snapshot, the end of the run) makes that step shorter.
module battery_timestep
  use battery_kinds, only: wp, int8, int64
  use battery_table, only: table_type, region_at, urn_two, gate_one, gate_two, return_one, &
    return_two
  use battery_bounce, only: walls_type, flight_type, heads_for_middle, is_trapped
  use battery_channel, only: fold
  use battery_instant, only: scene_type, new_scene, board, join, quit, count_hits, turns_back, &
    count_reversal, order_events
  use battery_engine, only: engine_type, engine_state_type, history_type, particles_type, &
    reserve_history, record_crossing, record_event, channel1_12, channel1_21, channel2_12, &
    channel2_21, event_entry
  implicit none (type, external)
  private
  public :: timestep_type

  !> The last step before a stop may be longer by this share of it, lest another follow that is
  !> almost nothing.
  real(wp), parameter :: stretch = 1.0e-3_wp

  type, extends(engine_type) :: timestep_type
    private
    !> Times that a particle went round a corner through the wall, as far as that could be seen.
    integer(int64), public :: slips = 0
    type(scene_type) :: scene
    real(wp), allocatable :: x(:), y(:), ux(:), uy(:)
    !> Region (`urn_one` ...) of each.
    integer(int8), allocatable :: region(:)
    !> Who is not well inside an urn.
    logical, allocatable :: busy(:)
    !> Time since the page was turned, and how often it was.
    real(wp) :: now = 0.0_wp
    integer(int64) :: pages = 0
    real(wp) :: clock_start = 0.0_wp
    !> Steps in a window.
    integer :: window = 1
  contains
    procedure :: start
    procedure :: advance
    procedure :: particles => all_particles
    procedure :: collisions
    procedure :: trapped
    procedure :: clock
    procedure :: save_state
    procedure :: restore_state
  end type timestep_type

  ! What it tells of itself, and how its state is kept: `timestep_state.f90`.
  interface
    module subroutine prepare(self, table, threshold, number)
      implicit none (type, external)
      class(timestep_type), intent(inout) :: self
      type(table_type), intent(in) :: table
      integer, intent(in) :: threshold, number
    end subroutine prepare

    pure module function flight_of(self, i) result(flight)
      implicit none (type, external)
      class(timestep_type), intent(in) :: self
      integer, intent(in) :: i
      type(flight_type) :: flight
    end function flight_of

    module subroutine all_particles(self, first, last, particles)
      implicit none (type, external)
      class(timestep_type), intent(in) :: self
      integer, intent(in) :: first, last
      type(particles_type), intent(out) :: particles
    end subroutine all_particles

    module function collisions(self) result(total)
      implicit none (type, external)
      class(timestep_type), intent(in) :: self
      integer(int64) :: total
    end function collisions

    module function trapped(self) result(total)
      implicit none (type, external)
      class(timestep_type), intent(in) :: self
      integer(int64) :: total
    end function trapped

    module function clock(self) result(time)
      implicit none (type, external)
      class(timestep_type), intent(in) :: self
      real(wp) :: time
    end function clock

    module subroutine save_state(self, state)
      implicit none (type, external)
      class(timestep_type), intent(in) :: self
      type(engine_state_type), intent(out) :: state
    end subroutine save_state

    module subroutine restore_state(self, table, threshold, number, state)
      implicit none (type, external)
      class(timestep_type), intent(inout) :: self
      type(table_type), intent(in) :: table
      integer, intent(in) :: threshold, number
      type(engine_state_type), intent(in) :: state
    end subroutine restore_state
  end interface

contains

  subroutine start(self, table, threshold, particles, clock)
    class(timestep_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold
    type(particles_type), intent(inout) :: particles
    real(wp), intent(in) :: clock
    integer :: i

    call prepare(self, table, threshold, size(particles%x))
    self%clock_start = clock
    self%x = particles%x
    self%y = particles%y
    self%ux = particles%ux
    self%uy = particles%uy
    deallocate (particles%x, particles%y, particles%ux, particles%uy)
    do i = 1, self%number
      self%region(i) = int(region_at(table, self%x(i), self%y(i), huge(1.0_wp)), int8)
      if (self%scene%walls%end_wall .and. self%region(i) == gate_two) &
        self%region(i) = int(gate_one, int8)
      call board(self%scene, i, flight_of(self, i))
    end do
  end subroutine start

  subroutine advance(self, duration, history)
    class(timestep_type), intent(inout) :: self
    real(wp), intent(in) :: duration
    type(history_type), intent(inout) :: history
    real(wp) :: step, since
    integer(int64) :: hits
    integer :: turn

    if (self%now >= self%scene%walls%page) then
      self%now = self%now - self%scene%walls%page
      self%pages = self%pages + 1
    end if
    hits = self%scene%hits
    since = 0.0_wp
    call reserve_history(history, 64, 64)
    do turn = 1, self%window
      if (self%now + since >= self%scene%walls%page) exit
      step = self%time_step
      if (duration - since < (1.0_wp + stretch)*step) step = max(duration - since, 0.0_wp)
      if (turn > 1 .and. .not. step > 0.0_wp) exit
      since = since + step
      call move_all(self%scene%walls, self%number, step, self%x, self%y, self%ux, self%uy, &
        self%region, self%busy)
      call look_around(self, since, history)
    end do
    self%now = self%now + since
    history%duration = since
    history%collisions = self%scene%hits - hits
  end subroutine advance

  !> Straight on by `step`; who may have met something is busy.
  pure subroutine move_all(walls, number, step, x, y, ux, uy, region, busy)
    type(walls_type), intent(in) :: walls
    integer, intent(in) :: number
    real(wp), intent(in) :: step, ux(number), uy(number)
    real(wp), intent(inout) :: x(number), y(number)
    integer(int8), intent(in) :: region(number)
    logical, intent(out) :: busy(number)
    real(wp) :: qx, radius2, chord1, chord2, centre
    integer :: i

    ! Copies that the compiler may keep in registers.
    radius2 = walls%radius2
    chord1 = walls%chord1
    chord2 = walls%chord2
    centre = walls%centre
    do i = 1, number
      x(i) = x(i) + ux(i)*step
      y(i) = y(i) + uy(i)*step
      qx = abs(x(i)) - centre
      busy(i) = qx**2 + y(i)**2 > radius2 .or. qx <= -chord1 .or. qx >= chord2
    end do
    do i = 1, number
      busy(i) = busy(i) .or. region(i) > urn_two
    end do
  end subroutine move_all

  !> Puts the particles right at the end of a step, and lets the gates decide.
  subroutine look_around(self, since, history)
    type(timestep_type), intent(inout) :: self
    real(wp), intent(in) :: since
    type(history_type), intent(inout) :: history
    integer :: i, g, member, first
    logical :: turns

    first = history%events + 1
    do i = 1, self%number
      if (.not. self%busy(i)) cycle
      if (self%region(i) > urn_two) then
        call live_in_channel(self, i, since, history)
      else
        call live_in_urn(self, i, since, history)
      end if
    end do
    do g = 1, 2
      call turns_back(self%scene, g, turns)
      if (.not. turns) cycle
      do member = 1, self%scene%gate(g)%count
        i = self%scene%gate(g)%member(member)
        self%ux(i) = -self%ux(i)
      end do
      call count_reversal(self%scene, g, since, history)
    end do
    if (history%events > first) call order_events(history, first)
  end subroutine look_around

  !> A particle of an urn that is beyond the arc or beyond a chord.
  subroutine live_in_urn(self, i, since, history)
    type(timestep_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp), intent(in) :: since
    type(history_type), intent(inout) :: history
    real(wp) :: side, qx, vx, distance, outward, factor

    side = side_of(self%region(i))
    associate (walls => self%scene%walls, x => self%x(i), y => self%y(i), ux => self%ux(i), &
      uy => self%uy(i))
      qx = side*x - walls%centre
      vx = side*ux
      if (qx <= -walls%chord1 .and. vx < 0.0_wp .and. abs(y) < walls%half1) then
        call enter(self, i, gate_one, walls%half1, (qx + walls%chord1)/vx)
        call join(self%scene, gate_of(self, i), i)
        self%scene%gate(gate_of(self, i))%entered = .true.
        call record_event(history, since, event_entry, gate_of(self, i), i)
      else if (qx >= walls%chord2 .and. vx > 0.0_wp .and. abs(y) < walls%half2) then
        call enter(self, i, return_one, walls%half2, (qx - walls%chord2)/vx)
      else if (qx**2 + y**2 > walls%radius2) then
        distance = hypot(qx, y)
        outward = (qx*vx + y*uy)/distance
        ! In a segment beyond a chord it may have come out of the channel into the wall.
        outward = max(outward, 0.0_wp)
        vx = vx - 2.0_wp*outward*qx/distance
        uy = uy - 2.0_wp*outward*y/distance
        factor = 1.5_wp - 0.5_wp*(vx**2 + uy**2)
        ux = side*factor*vx
        uy = factor*uy
        factor = 2.0_wp*sqrt(walls%radius2)/distance - 1.0_wp
        x = side*(walls%centre + factor*qx)
        y = factor*y
        call count_hits(self%scene, history, 1_int64)
      end if
    end associate
  end subroutine live_in_urn

  !> From an urn into the channel whose region on the side of urn 1 is `channel`; it crossed the
  !> chord `ago`.
  subroutine enter(self, i, channel, half, ago)
    type(timestep_type), intent(inout) :: self
    integer, intent(in) :: i, channel
    real(wp), intent(in) :: half, ago

    if (abs(self%y(i) - self%uy(i)*ago) > half) self%slips = self%slips + 1
    self%region(i) = int(channel, int8) + merge(0_int8, 1_int8, is_one(self%region(i)))
  end subroutine enter

  !> A particle of a channel: walls, lines, and the way out.
  subroutine live_in_channel(self, i, since, history)
    type(timestep_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp), intent(in) :: since
    type(history_type), intent(inout) :: history
    real(wp) :: side, depth, half, qx
    logical :: in_gate, inward

    side = side_of(self%region(i))
    in_gate = self%region(i) <= gate_two
    ! On its way to the far end: such a particle is counted, and it cannot leave.
    inward = merge(side, -side, in_gate)*self%ux(i) < 0.0_wp
    associate (walls => self%scene%walls, x => self%x(i))
      half = merge(walls%half1, walls%half2, in_gate)
      ! How far it is beyond the chord.
      depth = merge(walls%gate_end - side*x, side*x - walls%return_begin, in_gate)
      qx = side*x - walls%centre
      if (.not. inward .and. depth < 0.0_wp .and. qx**2 + self%y(i)**2 <= walls%radius2) then
        call leave(self, i, half, depth, in_gate)
        return
      end if
      if (abs(self%y(i)) > half) call mirror(self, i, half, history)
      if (.not. inward) then
        if (depth < 0.0_wp) call leave(self, i, half, 0.0_wp, in_gate)
      else if (in_gate .and. side*x < 0.0_wp) then
        call cross_middle(self, i, since, history)
      else if (.not. in_gate .and. side*x > walls%return_end) then
        call record_crossing(history, since, merge(channel2_12, channel2_21, &
          is_one(self%region(i))), i)
        self%scene%difference = self%scene%difference + merge(-2, 2, is_one(self%region(i)))
        self%region(i) = int(return_one + return_two, int8) - self%region(i)
        x = x - 2.0_wp*side*walls%return_end
      end if
    end associate
  end subroutine live_in_channel

  !> Mirrors a particle in the walls of its channel until it is between them.
  subroutine mirror(self, i, half, history)
    type(timestep_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp), intent(in) :: half
    type(history_type), intent(inout) :: history
    real(wp) :: height, turned, hits

    call fold(self%y(i), 2.0_wp*half, height, turned, hits)
    self%y(i) = height
    self%uy(i) = turned*self%uy(i)
    call count_hits(self%scene, history, int(hits, int64))
  end subroutine mirror

  !> From a channel into its urn; `depth` is how far it is beyond the chord, or 0 if it was in the
  !> wall beside the channel.
  subroutine leave(self, i, half, depth, in_gate)
    type(timestep_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp), intent(in) :: half, depth
    logical, intent(in) :: in_gate
    real(wp) :: ago

    ago = 0.0_wp
    if (abs(self%ux(i)) > 0.0_wp) ago = -depth/abs(self%ux(i))
    if (abs(self%y(i) - self%uy(i)*ago) > half) self%slips = self%slips + 1
    self%region(i) = self%region(i) - int(merge(gate_one - 1, return_one - 1, in_gate), int8)
  end subroutine leave

  !> Over the middle line of channel 1, or back from the end wall.
  subroutine cross_middle(self, i, since, history)
    type(timestep_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp), intent(in) :: since
    type(history_type), intent(inout) :: history
    integer :: g

    g = gate_of(self, i)
    call quit(self%scene, g, i)
    call record_crossing(history, since, merge(channel1_12, channel1_21, g == 1), i)
    if (self%scene%walls%end_wall) then
      self%x(i) = -self%x(i)
      self%ux(i) = -self%ux(i)
      call count_hits(self%scene, history, 1_int64)
    else
      self%scene%difference = self%scene%difference + merge(-2, 2, g == 1)
      self%region(i) = int(gate_one + gate_two, int8) - self%region(i)
    end if
  end subroutine cross_middle

  !> Whether a region is on the side of urn 1.
  elemental function is_one(region)
    integer(int8), intent(in) :: region
    logical :: is_one

    is_one = btest(region, 0)
  end function is_one

  !> -1 on the side of urn 1, where x < 0, and 1 on the side of urn 2.
  elemental function side_of(region) result(side)
    integer(int8), intent(in) :: region
    real(wp) :: side

    side = merge(-1.0_wp, 1.0_wp, is_one(region))
  end function side_of

  !> The gate on the side of a particle.
  pure function gate_of(self, i) result(g)
    type(timestep_type), intent(in) :: self
    integer, intent(in) :: i
    integer :: g

    g = merge(1, 2, is_one(self%region(i)))
  end function gate_of

end module battery_timestep
