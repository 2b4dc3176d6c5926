!> What the engine `timestep` tells of itself, and how its state is kept.
submodule (battery_timestep) battery_timestep_state
  implicit none (type, external)

  !> A window is at most so many urn radii long, and has about so many moves of particles.
  real(wp), parameter :: window_radii = 2.0_wp, window_moves = 262144.0_wp
contains

  !> What follows from the table and the number of particles.
  module subroutine prepare(self, table, threshold, number)
    class(timestep_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold, number

    self%table = table
    self%threshold = threshold
    self%number = number
    self%sees_collisions = .true.
    call new_scene(self%scene, table, threshold, number)
    self%window = int(max(1.0_wp, min(window_moves/real(number, wp), window_radii*table%urn_radius &
      /self%time_step)))
    self%now = 0.0_wp
    self%pages = 0
    self%slips = 0
    if (allocated(self%region)) deallocate (self%region, self%busy)
    allocate (self%region(number), self%busy(number))
  end subroutine prepare

  !> A particle as `battery_bounce` knows it.
  pure module function flight_of(self, i) result(flight)
    class(timestep_type), intent(in) :: self
    integer, intent(in) :: i
    type(flight_type) :: flight

    flight = flight_type(x=self%x(i), y=self%y(i), ux=self%ux(i), uy=self%uy(i), &
      region=self%region(i))
  end function flight_of

  module subroutine all_particles(self, first, last, particles)
    class(timestep_type), intent(in) :: self
    integer, intent(in) :: first, last
    type(particles_type), intent(out) :: particles

    particles%x = self%x(first:last)
    particles%y = self%y(first:last)
    particles%ux = self%ux(first:last)
    particles%uy = self%uy(first:last)
  end subroutine all_particles

  module function collisions(self) result(total)
    class(timestep_type), intent(in) :: self
    integer(int64) :: total

    total = self%scene%hits
  end function collisions

  module function trapped(self) result(total)
    class(timestep_type), intent(in) :: self
    integer(int64) :: total
    integer :: i

    total = 0
    do i = 1, self%number
      if (is_trapped(flight_of(self, i))) total = total + 1
    end do
  end function trapped

  module function clock(self) result(time)
    class(timestep_type), intent(in) :: self
    real(wp) :: time

    time = self%clock_start + (real(self%pages, wp)*self%scene%walls%page + self%now)
  end function clock

  module subroutine save_state(self, state)
    class(timestep_type), intent(in) :: self
    type(engine_state_type), intent(out) :: state

    state%integers = [self%pages, self%scene%hits, self%slips]
    state%reals = [self%now, self%clock_start, self%x, self%y, self%ux, self%uy]
    state%bytes = self%region
  end subroutine save_state

  module subroutine restore_state(self, table, threshold, number, state)
    class(timestep_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold, number
    type(engine_state_type), intent(in) :: state
    integer :: i

    call prepare(self, table, threshold, number)
    self%pages = state%integers(1)
    self%scene%hits = state%integers(2)
    self%slips = state%integers(3)
    self%now = state%reals(1)
    self%clock_start = state%reals(2)
    self%x = state%reals(3:number + 2)
    self%y = state%reals(number + 3:2*number + 2)
    self%ux = state%reals(2*number + 3:3*number + 2)
    self%uy = state%reals(3*number + 3:4*number + 2)
    self%region = state%bytes
    do i = 1, number
      call board(self%scene, i, flight_of(self, i))
    end do
  end subroutine restore_state

end submodule battery_timestep_state
