!> The program `bench`: collisions and visits per second, all engines compared in one run.
!>
!> `bench table` reads the cases of a table, a line each: engine (or `visits`: passages through an
!> urn, without an engine), number, threshold, widths of the channels, sides of urns that are
!> regular polygons (0: discs), discs in channel 2, seconds of a round, time units of the warm-up.
!> They run in turn, in several rounds, so that a drift of the machine's speed changes all rates
!> alike. Prints version, commit and compiler, then for each case three lines, which have a number
!> for each round: wall collisions, passages through an urn, and simulated time summed over the
!> particles, per second of processor time.
!> `bench single ENGINE NUMBER THRESHOLD WIDTH1 WIDTH2 COLLISIONS` runs one case once, for tools
!> that count instructions or take the memory.
program bench
  use, intrinsic :: iso_fortran_env, only: compiler_version, input_unit, output_unit
  use battery_build_information, only: program_version, git_commit
  use battery_kinds, only: wp, dp, int64
  use battery_error, only: error_type
  use battery_corners, only: regular_corners
  use battery_table, only: new_table, shape_circuit, urn_type, channel_type
  use battery_urn, only: shape_polygon
  use battery_engine, only: engine_type, particles_type
  use battery_event_record, only: event_record_type
  use battery_engines, only: new_engine
  use battery_initial_state, only: random_particles
  use battery_clocks, only: cpu_seconds
  use battery_bench_visits, only: entrances_type, rate_type, draw_entrances, measure_visits
  implicit none (type, external)

  !> Parameters of a case, as they are read.
  type :: case_type
    character(len=12) :: engine
    integer :: number, threshold
    real(wp) :: width1, width2
    integer :: sides = 0, scatterers = 0
    real(dp) :: seconds
    real(wp) :: warm_up
  end type case_type

  !> State of a case, which continues from round to round: an engine, or starts of visits that are
  !> computed without an engine.
  type :: runner_type
    class(engine_type), allocatable :: engine
    type(entrances_type) :: entrances
  end type runner_type

  !> Number of rounds.
  integer, parameter :: rounds = 5
  !> In place of the name of an engine: visits are computed without one.
  character(len=*), parameter :: visits_alone = 'visits'
  !> Time step of the engine `timestep`; its error after 10 time units is 0.5 per cent.
  real(wp), parameter :: time_step = 1.0e-3_wp
  character(len=16) :: command

  call get_command_argument(1, command)
  select case (command)
  case ('single')
    call run_single()
  case ('table')
    call run_table()
  case default
    write (output_unit, '(a)') 'usage: bench table', &
      '       bench single ENGINE NUMBER THRESHOLD WIDTH1 WIDTH2 COLLISIONS'
  end select

contains

  !> Reads the cases of a table, and prints their rates.
  subroutine run_table()
    type(case_type), allocatable :: cases(:)
    type(rate_type), allocatable :: rates(:, :)
    type(case_type) :: one
    integer :: k, status

    allocate (cases(0))
    do
      read (input_unit, *, iostat=status) one%engine, one%number, one%threshold, one%width1, &
        one%width2, one%sides, one%scatterers, one%seconds, one%warm_up
      if (status /= 0) exit
      cases = [cases, one]
    end do
    allocate (rates(rounds, size(cases)))
    call compare_cases(cases, rates)
    write (output_unit, '(a)') program_version, git_commit(), compiler_version()
    do k = 1, size(cases)
      write (output_unit, '(*(es13.5))') rates(:, k)%collisions
      write (output_unit, '(*(es13.5))') rates(:, k)%visits
      write (output_unit, '(*(es13.5))') rates(:, k)%particle_time
    end do
  end subroutine run_table

  !> Runs the case of the command line once, until it has the wall collisions that are wanted;
  !> prints their number.
  subroutine run_single()
    type(case_type) :: one
    type(runner_type) :: runner
    type(event_record_type) :: event_record
    character(len=512) :: words
    character(len=64) :: word
    integer(int64) :: collisions, wanted
    integer :: k, status

    words = ''
    do k = 2, command_argument_count()
      call get_command_argument(k, word)
      words = trim(words)//' '//word
    end do
    read (words, *, iostat=status) one%engine, one%number, one%threshold, one%width1, one%width2, &
      wanted
    if (status /= 0) error stop 'bench: six words are needed; see bench --help'
    call start_case(one, runner)
    collisions = 0
    do while (collisions < wanted)
      call runner%engine%advance(huge(1.0_wp), event_record)
      collisions = collisions + event_record%collisions
    end do
    write (output_unit, '(i0)') collisions
  end subroutine run_single

  !> Creates the engine of a case with random particles, or draws the starts of its visits.
  subroutine start_case(one, runner)
    type(case_type), intent(in) :: one
    type(runner_type), intent(inout) :: runner
    type(particles_type) :: particles
    type(error_type), allocatable :: error
    type(urn_type) :: urn

    if (one%sides > 0) then
      urn%shape = shape_polygon
      urn%corner = regular_corners(one%sides, 1.0_wp)
    end if
    associate (table => new_table(shape_circuit, [urn, urn], [channel_type(one%width1, 1.0_wp), &
      channel_type(one%width2, 1.0_wp)], disc_lattice(one%scatterers)))
      if (one%engine == visits_alone) then
        call draw_entrances(runner%entrances, table)
        return
      end if
      call new_engine(trim(one%engine), runner%engine, error)
      if (.not. allocated(error)) call random_particles(table, one%number, one%number/2, 1_int64, &
        particles, error)
      if (allocated(error)) error stop 'bench: '//error%message
      runner%engine%time_step = time_step
      call runner%engine%start(table, [one%threshold, one%threshold], particles, 0.0_wp)
    end associate
  end subroutine start_case

  !> Discs of radius 0.025 in two alternating rows, as in `namelists/lorentz.nml`.
  pure function disc_lattice(scatterers) result(discs)
    !> Number of discs; even.
    integer, intent(in) :: scatterers
    real(wp) :: discs(3, scatterers)
    integer :: k, column

    do k = 1, scatterers
      column = (k - 1)/2
      discs(:, k) = [-0.45_wp + 0.1_wp*column, -0.1125_wp + 0.075_wp*modulo(column, 2) &
        + 0.15_wp*modulo(k - 1, 2), 0.025_wp]
    end do
  end function disc_lattice

  !> Runs a case for its warm-up, but not longer than four rounds.
  subroutine warm_up_case(one, runner)
    type(case_type), intent(in) :: one
    type(runner_type), intent(inout) :: runner
    type(event_record_type) :: event_record
    real(wp) :: time
    real(dp) :: began
    type(rate_type) :: rate

    if (one%engine == visits_alone) then
      call measure_visits(runner%entrances, one%seconds, rate)
      return
    end if
    time = 0.0_wp
    began = cpu_seconds()
    do while (time < one%warm_up .and. cpu_seconds() - began < 4.0_dp*one%seconds)
      call runner%engine%advance(one%warm_up - time, event_record)
      time = time + event_record%duration
    end do
  end subroutine warm_up_case

  !> Runs a case for about `one%seconds` of processor time, and measures its rates. The number of
  !> visits is that of crossings and of particles reversed.
  subroutine run_round(one, runner, rate)
    type(case_type), intent(in) :: one
    type(runner_type), intent(inout) :: runner
    type(rate_type), intent(out) :: rate
    type(event_record_type) :: event_record
    integer(int64) :: before
    real(dp) :: began, spent, time, visits
    integer :: k

    if (one%engine == visits_alone) then
      call measure_visits(runner%entrances, one%seconds, rate)
      return
    end if
    before = runner%engine%collisions()
    time = 0.0_dp
    visits = 0.0_dp
    began = cpu_seconds()
    do
      do k = 1, 8
        call runner%engine%advance(huge(1.0_wp), event_record)
        time = time + real(event_record%duration, dp)
        visits = visits + real(event_record%bounce_backs + event_record%crossings, dp)
      end do
      spent = cpu_seconds() - began
      if (spent > one%seconds) exit
    end do
    rate%collisions = real(runner%engine%collisions() - before, dp)/spent
    rate%visits = visits/spent
    rate%particle_time = time*real(one%number, dp)/spent
  end subroutine run_round

  !> Runs the cases in turn, round by round.
  subroutine compare_cases(cases, rates)
    type(case_type), intent(in) :: cases(:)
    !> By (round, case).
    type(rate_type), intent(out) :: rates(:, :)
    type(runner_type), allocatable :: runners(:)
    integer :: k, round_number

    allocate (runners(size(cases)))
    do k = 1, size(cases)
      call start_case(cases(k), runners(k))
      call warm_up_case(cases(k), runners(k))
    end do
    do round_number = 1, rounds
      do k = 1, size(cases)
        call run_round(cases(k), runners(k), rates(round_number, k))
      end do
    end do
  end subroutine compare_cases

end program bench
