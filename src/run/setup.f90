!> What one simulation is: the parameters of the run, the table, the numbers of particles.
module battery_setup
  use battery_kinds, only: wp, int64
  use battery_table, only: table_type
  implicit none (type, external)
  private
  public :: run_type, setup_type

  !> Parameters that all simulations of a run have in common. Components are named like the keys of
  !> the namelist; times in lengths over the speed.
  type :: run_type
    character(len=:), allocatable :: engine
    !> Length of the run and of its transient (negative: half of it) in wall collisions, or, if
    !> `duration` > 0, in time.
    integer(int64) :: collisions = 0, transient_collisions = -1
    real(wp) :: duration = 0.0_wp, transient_duration = 0.0_wp
    real(wp) :: start_time = 0.0_wp
    !> Step of the engine `timestep`; 0: not given.
    real(wp) :: time_step = 0.0_wp
    real(wp) :: series_interval = 0.0_wp
    !> Times since the start, ascending, at which positions and velocities are stored.
    real(wp), allocatable :: snapshot_times(:)
    logical :: event_log = .false., final_state = .false.
  end type run_type

  !> Setup of a simulation, without the particles.
  type, extends(run_type) :: setup_type
    type(table_type) :: table
    !> Number of particles, and of those that start in urn 1.
    integer :: number = 0, urn1_number = 0
    !> Thresholds of the gates of urn 1 and 2.
    integer :: threshold(2) = 0
    !> Seed of engines that draw random numbers.
    integer(int64) :: seed = 0
  end type setup_type

end module battery_setup
