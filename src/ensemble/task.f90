!> One task of an ensemble, from its particles to its result.
module battery_task
  use battery_kinds, only: dp, int64
  use battery_error, only: error_type, fatal_error, exit_stopped_early
  use battery_engine, only: particles_type
  use battery_clocks, only: wall_seconds, cpu_seconds
  use battery_signals, only: stop_requested
  use battery_simulation, only: setup_type, simulation_type, begin_simulation, step, progress, &
    verify
  use battery_initial_state, only: random_particles
  use battery_room, only: check_room, particle_bytes
  use battery_text, only: to_text
  use battery_journal, only: journal_type, read_state, write_state
  use battery_task_result, only: task_result_type, result_of, failed_result
  use battery_communicator, only: board_type, add_to_board, read_board, help_board, help_interval, &
    collisions_done, stop_wanted
  use battery_screen, only: screen_type, show_ensemble
  implicit none (type, external)
  private
  public :: task_type, watch_type, run_task, place_particles, seconds_between_looks

  !> One task: a point of the scan, one of its replicas.
  type :: task_type
    !> Number of the task from 1; its point and replica.
    integer :: task = 0, point = 0, replica = 0
    type(setup_type) :: setup
    integer :: number = 0, urn1_number = 0
    !> Known by this is what is kept of the task: its result, and its state on the way.
    integer(int64) :: kept = 0
    logical :: final_state = .false.
  end type task_type

  !> What a running task looks at from time to time.
  type :: watch_type
    !> How often states are saved, and when next, in seconds of `wall_seconds`.
    real(dp) :: checkpoint_interval = huge(1.0_dp)
    real(dp) :: next_checkpoint = huge(1.0_dp)
    real(dp) :: next_look = 0.0_dp
    !> When rank 0 next lends the network a hand.
    real(dp) :: next_help = 0.0_dp
    !> Whether the run stops early.
    logical :: stopping = .false.
    !> Time spent in tasks.
    real(dp) :: busy = 0.0_dp
  end type watch_type

  !> Windows between two looks at the clock, for as many particles or fewer.
  integer, parameter :: windows_between_looks = 16, few_particles = 2000

  !> Seconds between two looks at the board: this long, or so long that all ranks together look this
  !> often a second, or that looking takes this share of the time, but no longer than this.
  real(dp), parameter :: look_interval = 0.1_dp, looks_a_second = 1.0e4_dp, look_share = 0.005_dp, &
    longest_interval = 5.0_dp

contains

  !> Seconds between two looks at the board of each of so many ranks, at least `least`.
  pure function seconds_between_looks(ranks, least) result(seconds)
    !> How many look.
    integer, intent(in) :: ranks
    real(dp), intent(in) :: least
    real(dp) :: seconds

    seconds = max(least, ranks/looks_a_second)
  end function seconds_between_looks

  !> Runs a task to its end, or until the run must stop; then its state is saved and `stopped` set.
  !> What goes wrong in the task itself becomes a failed result; `error` is for the journal's
  !> troubles.
  subroutine run_task(task, start, journal, board, watch, screen, found, stopped, error)
    type(task_type), intent(in) :: task
    !> What the initial file says; no arrays: there is none.
    type(particles_type), intent(in) :: start
    type(journal_type), intent(inout) :: journal
    type(board_type), intent(in) :: board
    type(watch_type), intent(inout) :: watch
    type(screen_type), intent(inout) :: screen
    !> Its result, unless stopped.
    type(task_result_type), intent(out) :: found
    logical, intent(out) :: stopped
    type(error_type), allocatable, intent(out) :: error
    type(simulation_type) :: simulation
    type(error_type), allocatable :: trouble
    real(dp) :: cpu_before, cpu_began, began, now
    integer(int64) :: told

    stopped = .false.
    began = wall_seconds()
    cpu_began = cpu_seconds()
    call resume_or_begin(task, start, journal, simulation, cpu_before, trouble)
    told = 0
    if (.not. allocated(trouble)) told = simulation%observer%collisions
    watch%next_checkpoint = wall_seconds() + watch%checkpoint_interval
    do while (.not. allocated(trouble))
      if (simulation%done) exit
      call some_steps(simulation)
      now = wall_seconds()
      if (now >= watch%next_help) then
        call help_board(board)
        watch%next_help = now + help_interval
      end if
      if (now < watch%next_look .and. .not. stop_requested()) cycle
      call look_around()
      call show_ensemble(screen, board, real(progress(simulation), dp))
      if (simulation%done) exit
      stopped = watch%stopping
      now = wall_seconds()
      if (.not. stopped .and. now < watch%next_checkpoint) cycle
      call write_state(journal, task%task, task%kept, simulation, &
        cpu_before + cpu_seconds() - cpu_began, error)
      if (stopped .or. allocated(error)) exit
      watch%next_checkpoint = wall_seconds() + watch%checkpoint_interval
    end do
    watch%busy = watch%busy + wall_seconds() - began
    ! A task that was stopped before it had a state begins anew.
    if (allocated(trouble)) stopped = trouble%code == exit_stopped_early
    if (stopped .or. allocated(error)) return
    if (.not. allocated(trouble)) call verify(simulation, trouble)
    if (allocated(trouble)) then
      found = failed_result(task%task, task%kept, trouble%message)
    else
      call add_to_board(board, collisions_done, simulation%observer%collisions - told)
      found = result_of(task%task, task%kept, simulation, task%final_state, &
        cpu_before + cpu_seconds() - cpu_began)
    end if

  contains

    !> Tells the board what was done, and hears whether to stop.
    subroutine look_around()
      real(dp) :: now, after

      now = wall_seconds()
      call add_to_board(board, collisions_done, simulation%observer%collisions - told)
      told = simulation%observer%collisions
      if (stop_requested()) call add_to_board(board, stop_wanted, 1_int64)
      watch%stopping = read_board(board, stop_wanted) > 0
      after = wall_seconds()
      watch%next_look = after + min(longest_interval, max((after - now)/look_share, &
        seconds_between_looks(board%communicator%size, look_interval)))
    end subroutine look_around

  end subroutine run_task

  subroutine some_steps(simulation)
    type(simulation_type), intent(inout) :: simulation
    integer :: window

    do window = 1, max(1, windows_between_looks*few_particles &
      /max(few_particles, simulation%engine%number))
      call step(simulation)
      if (simulation%done .or. stop_requested()) exit
    end do
  end subroutine some_steps

  !> From the saved state if there is one, else from the start.
  subroutine resume_or_begin(task, start, journal, simulation, cpu_before, error)
    type(task_type), intent(in) :: task
    type(particles_type), intent(in) :: start
    type(journal_type), intent(inout) :: journal
    type(simulation_type), intent(out) :: simulation
    real(dp), intent(out) :: cpu_before
    type(error_type), allocatable, intent(out) :: error
    type(particles_type) :: particles
    logical :: resumed

    cpu_before = 0.0_dp
    call check_room(particle_bytes(task%setup%engine, task%number), to_text(task%number) &
      //' particles', error)
    if (allocated(error)) return
    call read_state(journal, task%task, task%kept, task%setup, simulation, cpu_before, resumed, &
      error)
    if (resumed .or. allocated(error)) return
    call place_particles(task, start, particles, error)
    if (allocated(error)) return
    call begin_simulation(simulation, task%setup, particles, error)
  end subroutine resume_or_begin

  !> Where the particles of a task start.
  subroutine place_particles(task, start, particles, error)
    type(task_type), intent(in) :: task
    !> What the initial file says; no arrays: at random.
    type(particles_type), intent(in) :: start
    type(particles_type), intent(out) :: particles
    type(error_type), allocatable, intent(out) :: error

    if (allocated(start%x)) then
      particles = start
    else
      call random_particles(task%setup%table, task%number, task%urn1_number, task%setup%seed, &
        particles, error)
    end if
  end subroutine place_particles

end module battery_task
