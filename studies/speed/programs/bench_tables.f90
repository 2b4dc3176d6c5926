!> Measures the speed of the engines, and writes it as tables and JSON. Called by the program
!> `bench`.
module battery_bench
  use, intrinsic :: iso_fortran_env, only: compiler_version
  use battery_kinds, only: wp, dp, int64
  use battery_error, only: error_type
  use battery_file_text, only: close_written
  use battery_corners, only: regular_corners
  use battery_table, only: new_table, shape_circuit, urn_type, channel_type
  use battery_urn, only: shape_polygon
  use battery_engine, only: engine_type, particles_type
  use battery_event_record, only: event_record_type
  use battery_engines, only: new_engine
  use battery_initial_state, only: random_particles
  use battery_clocks, only: cpu_seconds
  use battery_bench_visits, only: entrances_type, draw_entrances, measure_visits
  use battery_bench_rows, only: case_type, rate_type, cost_of_collision, cost_of_visit, &
    cost_of_time, write_title, write_row, begin_json, write_json_row, end_json, processor_name, &
    peak_memory
  implicit none (type, external)
  private
  public :: bench_main

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

contains

  !> Reads the command line, and runs its command.
  subroutine bench_main(unit)
    integer, intent(in) :: unit
    character(len=256) :: word

    call get_command_argument(1, word)
    select case (word)
    case ('single')
      call run_single(unit, memory=.false.)
    case ('memory')
      call run_single(unit, memory=.true.)
    case ('', '--json')
      call run_all_tables(unit, json_file_name())
    case default
      write (unit, '(a)') 'usage: bench [--json FILE]', &
        '       bench single ENGINE NUMBER THRESHOLD WIDTH1 WIDTH2 COLLISIONS', &
        '       bench memory ENGINE NUMBER THRESHOLD WIDTH1 WIDTH2 COLLISIONS'
    end select
  end subroutine bench_main

  !> Name of the JSON file, from the command line; empty if there is none.
  function json_file_name() result(name)
    character(len=:), allocatable :: name
    character(len=256) :: word

    call get_command_argument(2, word)
    name = trim(word)
  end function json_file_name

  !> Runs the case of the command line once, until it has the wall collisions that are wanted.
  subroutine run_single(unit, memory)
    integer, intent(in) :: unit
    !> Whether to print the peak memory of the process in kB, in place of the number of collisions.
    logical, intent(in) :: memory
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
    write (unit, '(i0)') merge(peak_memory(), collisions, memory)
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
      call runner%engine%start(table, one%threshold, particles, 0.0_wp)
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

  !> Measures and writes all tables.
  subroutine run_all_tables(unit, json)
    integer, intent(in) :: unit
    !> Name of a JSON file to write too, or empty.
    character(len=*), intent(in) :: json
    integer :: file, status, k
    type(error_type), allocatable :: error

    file = 0
    if (json /= '') then
      open (newunit=file, file=json, status='replace', action='write', access='stream', &
        form='formatted', iostat=status)
      if (status /= 0) error stop 'bench: cannot write '//json
      call begin_json(file)
    end if
    write (unit, '(a)') 'processor: '//processor_name(), 'compiler:  '//compiler_version(), &
      'Medians of rounds in which the rows of a table run in turn; +- half of least to most.'
    flush (unit)
    call run_table(unit, file, 'engines', 'Engines, N = 1000, T = 7, w = 0.3, w'' = 0.01', &
      cost_of_collision, [case_type('excursion'), case_type('collision'), &
      case_type('synchronous'), case_type('reservoir'), case_type('timestep')])
    call run_table(unit, file, 'number', 'Number of particles, T/N = 0.007', cost_of_time, &
      [case_type(number=1000, threshold=7, warm_up=1000.0_wp), case_type(number=100, threshold=1), &
      case_type(number=10000, threshold=70), case_type(number=100000, threshold=700), &
      case_type(number=1000000, threshold=7000, seconds=1.0_dp)])
    call run_table(unit, file, 'threshold', &
      'Threshold, N = 1000: small, the working point, at the transition, N (no gate)', &
      cost_of_visit, [case_type(), case_type(threshold=1), case_type(threshold=2), &
      case_type(threshold=15), case_type(threshold=16), case_type(threshold=17), &
      case_type(threshold=1000)])
    call run_table(unit, file, 'openings', 'Openings, N = 1000, T = 7, w = w''', cost_of_visit, &
      [case_type(width1=0.3_wp, width2=0.3_wp), (case_type(width1=10.0_wp**(-k), &
      width2=10.0_wp**(-k)), k=1, 6)])
    call run_table(unit, file, 'collision', 'Engine collision: number of particles', cost_of_time, &
      [case_type('collision'), case_type('collision', 100, 1), case_type('collision', 10000, 70), &
      case_type('collision', 100000, 700), &
      case_type('collision', 1000000, 7000, seconds=1.0_dp, warm_up=5.0_wp)])
    call run_table(unit, file, 'shapes', &
      'Shapes of urns: discs, regular polygons; many particles, ' &
      //'whose visits come in large batches', cost_of_collision, [case_type(number=100000, &
      threshold=700), case_type(number=100000, threshold=700, sides=4), case_type(number=100000, &
      threshold=700, sides=6), case_type(number=100000, threshold=700, sides=24)])
    call run_table(unit, file, 'visits', &
      'Visits alone, in batches of 1024: discs, regular hexagons', cost_of_collision, &
      [case_type(visits_alone, 1024, 0), case_type(visits_alone, 1024, 0, sides=6), &
      case_type(visits_alone, 1024, 0, width2=0.3_wp), case_type(visits_alone, 1024, 0, &
      width2=0.3_wp, sides=6)])
    call run_table(unit, file, 'lorentz', '20 discs in channel 2, w'' = 0.3', cost_of_collision, &
      [case_type('excursion', width2=0.3_wp, scatterers=20), &
      case_type('collision', width2=0.3_wp, scatterers=20)])
    call run_table(unit, file, 'map', 'Map of Fig. numris: 25 of its points, as its five by five ' &
      //'parts have them in the middle', cost_of_collision, [(case_type(threshold=3 + k - mod(k, &
      5), width2=0.002_wp + 0.098_wp*(0.1_wp + 0.2_wp*modulo(k, 5)), seconds=0.15_dp), k=0, 24)])
    write (unit, '(/, a, i0, a)') 'peak memory of this run: ', peak_memory(), ' kB'
    if (file /= 0) then
      call end_json(file)
      call close_written(file, json, error)
      if (allocated(error)) error stop 'bench: '//error%message
    end if
  end subroutine run_all_tables

  !> Measures and writes one table, a row for each case; costs are relative to the first row.
  subroutine run_table(unit, file, key, title, cost, cases)
    !> Units of the table and of the JSON file (0: none); `cost_of_collision` or another.
    integer, intent(in) :: unit, file, cost
    !> Name of the table in JSON, and its title.
    character(len=*), intent(in) :: key, title
    type(case_type), intent(in) :: cases(:)
    type(rate_type) :: rates(rounds, size(cases))
    integer :: k

    call compare_cases(cases, rates)
    call write_title(unit, title, cost)
    do k = 1, size(cases)
      call write_row(unit, cases(k), rates(:, k), rates(:, 1), cost)
      if (file /= 0) call write_json_row(file, key, cases(k), rates(:, k), &
        key == 'engines' .and. k == 1)
    end do
  end subroutine run_table

end module battery_bench
