!> Speed of the engines: cases, rounds, tables and JSON. The program `bench` is just a call of this.
module battery_bench
  use, intrinsic :: iso_fortran_env, only: compiler_version
  use battery_kinds, only: wp, dp, int64
  use battery_error, only: error_type
  use battery_table, only: new_table, shape_circuit
  use battery_engine, only: engine_type, history_type, particles_type
  use battery_engines, only: new_engine
  use battery_initial_state, only: random_particles
  use battery_signals, only: wall_seconds
  use battery_bench_board, only: bench_board
  implicit none (type, external)
  private
  public :: bench_main

  type :: case_type
    character(len=12) :: engine = 'excursion'
    integer :: number = 1000, threshold = 7
    real(wp) :: width1 = 0.3_wp, width2 = 0.01_wp
    !> Seconds a round lasts; warm-up in time units (particle time) before the first.
    real(dp) :: seconds = 0.5_dp
    real(wp) :: warm_up = 50.0_wp
  end type case_type

  !> What one round showed: rates a second.
  type :: rate_type
    real(dp) :: collisions = 0.0_dp, visits = 0.0_dp, particle_time = 0.0_dp
  end type rate_type

  !> An engine that has been warmed up and goes on from round to round.
  type :: runner_type
    class(engine_type), allocatable :: engine
  end type runner_type

  integer, parameter :: rounds = 5

  !> Step of the engine `timestep`, with which it is off by half a per cent after 10 time units.
  real(wp), parameter :: time_step = 1.0e-3_wp

contains

  !> Reads the command line and runs what it asks for.
  subroutine bench_main(unit)
    integer, intent(in) :: unit
    character(len=256) :: word

    call get_command_argument(1, word)
    select case (word)
    case ('single')
      call single(unit)
    case ('board')
      call bench_board(unit, board_items())
    case ('', '--json')
      call tables(unit, json_name())
    case default
      write (unit, '(a)') 'usage: bench [--json FILE]', &
        '       bench single ENGINE NUMBER THRESHOLD WIDTH1 WIDTH2 COLLISIONS', &
        '       mpirun -n RANKS bench board [TASKS]'
    end select
  end subroutine bench_main

  !> Tasks for the board of an ensemble.
  function board_items() result(items)
    integer :: items
    character(len=32) :: word
    integer :: status

    call get_command_argument(2, word)
    items = 100000
    if (word == '') return
    read (word, *, iostat=status) items
    if (status /= 0 .or. items < 1) error stop 'bench board: TASKS is a whole number from 1 up'
  end function board_items

  function json_name() result(name)
    character(len=:), allocatable :: name
    character(len=256) :: word

    call get_command_argument(2, word)
    name = trim(word)
  end function json_name

  !> One case, once: for instruction counters.
  subroutine single(unit)
    integer, intent(in) :: unit
    type(case_type) :: one
    type(runner_type) :: runner
    type(history_type) :: history
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
    if (status /= 0) then
      write (unit, '(a)') 'bench single: six words are needed; see bench --help'
      return
    end if
    call prepare(one, runner)
    collisions = 0
    do while (collisions < wanted)
      call runner%engine%advance(huge(1.0_wp), history)
      collisions = collisions + history%collisions
    end do
    write (unit, '(i0)') collisions
  end subroutine single

  !> An engine with particles, started.
  subroutine prepare(one, runner)
    type(case_type), intent(in) :: one
    type(runner_type), intent(inout) :: runner
    type(particles_type) :: particles
    type(error_type), allocatable :: error

    associate (table => new_table(shape_circuit, 1.0_wp, one%width1, 1.0_wp, one%width2, 1.0_wp))
      call new_engine(trim(one%engine), runner%engine, error)
      if (.not. allocated(error)) call random_particles(table, one%number, one%number/2, 1_int64, &
        particles, error)
      if (allocated(error)) error stop 'bench: '//error%message
      runner%engine%time_step = time_step
      call runner%engine%start(table, one%threshold, particles, 0.0_wp)
    end associate
  end subroutine prepare

  subroutine warm_up(one, runner)
    type(case_type), intent(in) :: one
    type(runner_type), intent(inout) :: runner
    type(history_type) :: history
    real(wp) :: time
    real(dp) :: began

    time = 0.0_wp
    began = wall_seconds()
    do while (time < one%warm_up .and. wall_seconds() - began < 4.0_dp*one%seconds)
      call runner%engine%advance(one%warm_up - time, history)
      time = time + history%duration
    end do
  end subroutine warm_up

  !> Goes on for about the seconds of the case. Visits are counted from the stationary rate of
  !> visits per particle time only in the tables; here what the engine reports is summed up.
  subroutine round(one, runner, rate)
    type(case_type), intent(in) :: one
    type(runner_type), intent(inout) :: runner
    type(rate_type), intent(out) :: rate
    type(history_type) :: history
    integer(int64) :: before
    real(dp) :: began, spent, time, visits
    integer :: k

    before = runner%engine%collisions()
    time = 0.0_dp
    visits = 0.0_dp
    began = wall_seconds()
    do
      do k = 1, 8
        call runner%engine%advance(huge(1.0_wp), history)
        time = time + real(history%duration, dp)
        visits = visits + real(history%bounce_backs + history%crossings, dp)
      end do
      spent = wall_seconds() - began
      if (spent > one%seconds) exit
    end do
    rate%collisions = real(runner%engine%collisions() - before, dp)/spent
    rate%visits = visits/spent
    rate%particle_time = time*real(one%number, dp)/spent
  end subroutine round

  !> Runs cases in turn and gives the rates as (round, case).
  subroutine compare(cases, rates)
    type(case_type), intent(in) :: cases(:)
    type(rate_type), intent(out) :: rates(:, :)
    type(runner_type), allocatable :: runners(:)
    integer :: k, turn

    allocate (runners(size(cases)))
    do k = 1, size(cases)
      call prepare(cases(k), runners(k))
      call warm_up(cases(k), runners(k))
    end do
    do turn = 1, rounds
      do k = 1, size(cases)
        call round(cases(k), runners(k), rates(turn, k))
      end do
    end do
  end subroutine compare

  !> Least, median and greatest.
  pure function spread_of(values) result(three)
    real(dp), intent(in) :: values(:)
    real(dp) :: three(3)
    real(dp) :: sorted(size(values))
    integer :: k, at

    do k = 1, size(values)
      at = k
      do while (at > 1)
        if (sorted(at - 1) <= values(k)) exit
        sorted(at) = sorted(at - 1)
        at = at - 1
      end do
      sorted(at) = values(k)
    end do
    three = [sorted(1), sorted((size(values) + 1)/2), sorted(size(values))]
  end function spread_of

  !> All tables, and the same as JSON if `json` is not empty.
  subroutine tables(unit, json)
    integer, intent(in) :: unit
    character(len=*), intent(in) :: json
    integer :: file

    file = 0
    if (json /= '') then
      open (newunit=file, file=json, status='replace', action='write')
      write (file, '(a)') '{"compiler": "'//compiler_version()//'", "processor": "'//processor() &
        //'", "cases": ['
    end if
    write (unit, '(a)') 'processor: '//processor(), 'compiler:  '//compiler_version()
    call table(unit, file, 'Engines at N = 1000, T = 7, w = 0.3, w'' = 0.01; ratios to the first', &
      [case_type('excursion'), case_type('collision'), case_type('synchronous'), &
      case_type('reservoir'), case_type('timestep')])
    call table(unit, file, 'Number of particles, T/N = 0.007', &
      [case_type('excursion', 1000, 7, warm_up=1000.0_wp), case_type('excursion', 100, 1), &
      case_type('excursion', 10000, 70), case_type('excursion', 100000, 700), &
      case_type('excursion', 1000000, 7000, seconds=1.0_dp)])
    call table(unit, file, 'Threshold, N = 1000', &
      [case_type('excursion'), case_type('excursion', threshold=2), &
      case_type('excursion', threshold=15), case_type('excursion', threshold=1000)])
    call table(unit, file, 'Openings, N = 1000, T = 7, w = w''', &
      [case_type('excursion', width1=0.3_wp, width2=0.3_wp), &
      case_type('excursion', width1=0.1_wp, width2=0.1_wp), &
      case_type('excursion', width1=1.0e-2_wp, width2=1.0e-2_wp), &
      case_type('excursion', width1=1.0e-3_wp, width2=1.0e-3_wp), &
      case_type('excursion', width1=1.0e-4_wp, width2=1.0e-4_wp), &
      case_type('excursion', width1=1.0e-6_wp, width2=1.0e-6_wp)])
    call table(unit, file, 'Collision engine', [case_type('collision'), &
      case_type('collision', 100, 1), case_type('collision', 10000, 70), &
      case_type('collision', 100000, 700)])
    write (unit, '(/, a, i0, a)') 'peak memory of this run: ', peak_memory(), ' kB'
    if (file /= 0) then
      write (file, '(a, i0, a)') '], "peak_memory_kilobytes": ', peak_memory(), '}'
      close (file)
    end if
  end subroutine tables

  !> One table; its rows are compared with the first.
  subroutine table(unit, file, title, cases)
    integer, intent(in) :: unit, file
    character(len=*), intent(in) :: title
    type(case_type), intent(in) :: cases(:)
    type(rate_type) :: rates(rounds, size(cases))
    real(dp) :: collisions(3), visits(3), time(3), ratio(3)
    integer :: k
    logical, save :: first = .true.
    character(len=*), parameter :: row = '(a12, i8, i8, 2es10.2, es14.3, a, es9.2, a, es9.2, a, ' &
      // 'es10.2, f10.1, f8.3, a, f5.3, a, f5.3, a)'

    call compare(cases, rates)
    write (unit, '(/, a)') title
    write (unit, '(a)') 'engine            N       T         w        w''  collisions/s' &
      //' (least ... most)       visits/s  ns/visit  ratio of visits'
    do k = 1, size(cases)
      collisions = spread_of(rates(:, k)%collisions)
      visits = spread_of(rates(:, k)%visits)
      time = spread_of(rates(:, k)%particle_time)
      ratio = spread_of(rates(:, k)%visits/rates(:, 1)%visits)
      write (unit, row) cases(k)%engine, cases(k)%number, cases(k)%threshold, cases(k)%width1, &
        cases(k)%width2, collisions(2), ' (', collisions(1), ' ... ', collisions(3), ')', &
        visits(2), 1.0e9_dp/visits(2), ratio(2), ' (', ratio(1), ' ... ', ratio(3), ')'
      if (file /= 0) then
        if (.not. first) write (file, '(a)') ','
        first = .false.
        write (file, &
          '(a, i0, a, i0, a, es12.5, a, es12.5, a, 3(es12.5, a), es12.5, a, es12.5, a)') &
          '{"engine": "'//trim(cases(k)%engine)//'", "number": ', cases(k)%number, &
          ', "threshold": ', &
          cases(k)%threshold, ', "channel1_width": ', cases(k)%width1, ', "channel2_width": ', &
          cases(k)%width2, ', "collisions_per_second": [', collisions(1), ', ', collisions(2), &
          ', ', &
          collisions(3), '], "visits_per_second": ', visits(2), ', "particle_time_per_second": ', &
          time(2), '}'
      end if
    end do
    flush (unit)
  end subroutine table

  !> Name of the processor, as Linux gives it.
  function processor() result(name)
    character(len=:), allocatable :: name

    name = line_of('/proc/cpuinfo', 'model name')
  end function processor

  !> Most memory this process had, in kB, as Linux gives it; 0 if it does not.
  function peak_memory() result(kilobytes)
    integer(int64) :: kilobytes
    character(len=:), allocatable :: text
    integer :: status

    text = line_of('/proc/self/status', 'VmHWM')
    kilobytes = 0
    read (text, *, iostat=status) kilobytes
    if (status /= 0) kilobytes = 0
  end function peak_memory

  !> What stands after the colon in the line of a file that begins with `key`.
  function line_of(file, key) result(value)
    character(len=*), intent(in) :: file, key
    character(len=:), allocatable :: value
    character(len=512) :: line
    integer :: unit, status

    value = 'unknown'
    open (newunit=unit, file=file, action='read', status='old', iostat=status)
    if (status /= 0) return
    do
      read (unit, '(a)', iostat=status) line
      if (status /= 0) exit
      if (index(line, key) /= 1) cycle
      value = trim(adjustl(line(index(line, ':') + 1:)))
      exit
    end do
    close (unit)
  end function line_of

end module battery_bench
