!> `battery --self-test`: tests the installation in seconds, without any file besides the program.
!> Every rank repeats every frozen log with every engine that must find its events, since nodes may
!> have different processors and libraries. Then all ranks run an ensemble together, whose results
!> file is written, read and compared with the same log.
module battery_self_test
  use battery_communicator, only: communicator_type, share_error, share_text
  use battery_build_information, only: program_version, git_commit
  use battery_ensemble, only: run_ensemble
  use battery_error, only: error_type, fatal_error, exit_success
  use battery_task_output, only: task_output_type, serialize_slabs, final
  use battery_files, only: remove_file
  use battery_frozen_log, only: frozen_log_type, read_frozen_log, find_difference, is_final_state
  use battery_frozen_logs, only: exact_circuit, exact_urn, timestep_circuit, reservoir_circuit
  use battery_journal, only: remove_journal
  use battery_kinds, only: wp, int64
  use battery_namelist_input, only: parse_namelist
  use battery_plan, only: plan_type
  use battery_process, only: process_number
  use battery_results, only: results_type, all_tasks_complete
  use battery_results_file, only: results_file_type, open_results, read_results, close_results
  use battery_table, only: channel1, channel2
  use battery_terminal, only: print_line
  use battery_text, only: to_text, count_text, new_line_character
  implicit none (type, external)
  private
  public :: run_self_test

  !> Number of tasks of the ensemble per rank.
  integer, parameter :: tasks_a_rank = 2

contains

  !> Runs all tests on all ranks; rank 0 prints one line for each.
  subroutine run_self_test(communicator, error)
    !> All ranks of the program.
    type(communicator_type), intent(in) :: communicator
    !> Some tests failed; the same error on all ranks.
    type(error_type), allocatable, intent(out) :: error
    type(frozen_log_type) :: circuit
    integer :: tests, failed
    character(len=*), parameter :: exact(3) = [character(len=11) :: 'excursion', 'collision', &
      'synchronous']

    tests = 0
    failed = 0
    if (communicator%rank == 0) call print_line('battery '//program_version//' (commit ' &
      //git_commit() //') on '//count_text(communicator%size, 'rank'))
    call test_engines('two urns', exact_circuit, exact)
    call test_engines('two urns', timestep_circuit, ['timestep'])
    call test_engines('two urns', reservoir_circuit, ['reservoir'])
    call test_engines('one urn', exact_urn, exact)
    call read_frozen_log(exact_circuit, circuit)
    call test_ensemble_file(communicator, circuit, error)
    call print_outcome(count_text(tasks_a_rank*communicator%size, 'task') &
      //', results file written and read back', error)
    if (failed > 0) then
      call fatal_error(error, 'battery: '//to_text(failed)//' of '//count_text(tests, 'test') &
        //' failed')
    else if (communicator%rank == 0) then
      call print_line('all '//count_text(tests, 'test')//' passed')
    end if

  contains

    !> Repeats a log with several engines.
    subroutine test_engines(name, lines, engines)
      !> Name of the table; lines of the log; names of the engines that must find its events.
      character(len=*), intent(in) :: name, lines(:), engines(:)
      type(frozen_log_type) :: log
      type(error_type), allocatable :: difference
      character(len=:), allocatable :: problem
      integer :: k

      call read_frozen_log(lines, log)
      do k = 1, size(engines)
        problem = find_difference(log, trim(engines(k)))
        if (problem /= '') call fatal_error(difference, problem//' (rank ' &
          //to_text(communicator%rank)//')')
        call share_error(communicator, difference)
        call print_outcome(trim(engines(k))//', '//name//', '//count_text(size(log%times), &
          'event'), difference)
      end do
    end subroutine test_engines

    !> Prints the outcome of a test on rank 0, and clears its problem.
    subroutine print_outcome(what, problem)
      character(len=*), intent(in) :: what
      type(error_type), allocatable, intent(inout) :: problem
      character(len=:), allocatable :: line

      tests = tests + 1
      line = what//': '
      if (allocated(problem)) then
        failed = failed + 1
        line = line//'FAILED: '//problem%message
        deallocate (problem)
      else
        line = line//'passed'
      end if
      if (communicator%rank == 0) call print_line(line)
    end subroutine print_outcome

  end subroutine run_self_test

  !> Runs an ensemble with the particles of a log, in the working directory. In the results file,
  !> the final state of each task must be that of the log.
  subroutine test_ensemble_file(communicator, log, error)
    type(communicator_type), intent(in) :: communicator
    type(frozen_log_type), intent(in) :: log
    !> The test failed; the same error on all ranks.
    type(error_type), allocatable, intent(out) :: error
    type(error_type), allocatable :: other
    type(plan_type) :: plan
    character(len=:), allocatable :: name
    integer :: exit_code

    name = 'battery-self-test-'//to_text(int(process_number()))//'.h5'
    call share_text(communicator, name, 0)
    call parse_namelist(namelist_of(log, name, tasks_a_rank*communicator%size), &
      'battery --self-test', plan, error)
    if (allocated(error)) return
    ! As if read from an initial file; any fingerprint except 0 will do.
    plan%file_particles = log%start
    plan%base%urn1_number = count(log%start%x < 0.0_wp)
    plan%initial_fingerprint = 1_int64
    call run_ensemble(plan, communicator, overwrite=.false., quiet=.true., exit_code=exit_code, &
      error=error)
    if (.not. allocated(error) .and. exit_code /= exit_success) &
      call fatal_error(error, 'exit code '//to_text(exit_code)//' of the run')
    if (communicator%rank == 0) then
      if (.not. allocated(error)) call compare_with_log(name, log, tasks_a_rank*communicator%size, &
        error)
      ! After an error, the files may be missing, or may be the cause of the error.
      call remove_journal(name//'.tasks', other)
      call remove_file(name, other)
    end if
    call share_error(communicator, error)
  end subroutine test_ensemble_file

  !> Text of a namelist for the run of a log.
  function namelist_of(log, name, replicas) result(text)
    type(frozen_log_type), intent(in) :: log
    !> Name of the results file.
    character(len=*), intent(in) :: name
    integer, intent(in) :: replicas
    character(len=:), allocatable :: text
    character(len=1), parameter :: nl = new_line_character

    associate (setup => log%setup, table => log%setup%table)
      text = '&table urn_radius = '//to_text(table%urn(1)%radius) &
        //', channel1_width = '//to_text(table%channel(channel1)%width) &
        //', channel1_length = '//to_text(table%channel(channel1)%length) &
        //', channel2_width = '//to_text(table%channel(channel2)%width) &
        //', channel2_length = '//to_text(table%channel(channel2)%length)//' /'//nl &
        //'&particles number = '//to_text(size(log%start%x))//', initial_file = ''frozen'' /'//nl &
        //'&gate threshold = '//to_text(setup%threshold(1))//' /'//nl &
        //'&run duration = '//to_text(setup%duration)//' /'//nl &
        //'&scan replicas = '//to_text(replicas)//' /'//nl &
        //'&output file = '''//name//''', final_state = .true. /'//nl
    end associate
  end function namelist_of

  !> Reads a results file and compares it with a log.
  subroutine compare_with_log(name, log, replicas, error)
    character(len=*), intent(in) :: name
    type(frozen_log_type), intent(in) :: log
    integer, intent(in) :: replicas
    type(error_type), allocatable, intent(out) :: error
    type(results_type) :: results
    type(results_file_type) :: file
    type(task_output_type) :: output
    integer :: number, k

    call open_results(name, file, error)
    if (.not. allocated(error)) call read_results(file, results, error)
    if (allocated(error)) return
    if (results%replicas /= replicas .or. .not. all_tasks_complete(results)) &
      call fatal_error(error, 'not all tasks are in the file')
    number = size(log%start%x)
    do k = 1, replicas
      if (allocated(error)) exit
      call serialize_slabs(file, file%outputs, k, 1, number, output, error)
      if (allocated(error)) exit
      associate (states => output%of(final)%values)
        if (.not. is_final_state(log, states(:, 1), states(:, 2), states(:, 3), states(:, 4))) &
          call fatal_error(error, 'the final state of task '//to_text(k)//' in the file differs')
      end associate
    end do
    call close_results(file)
  end subroutine compare_with_log

end module battery_self_test
