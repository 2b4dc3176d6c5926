!> `battery --self-test`: tests the installation in seconds, without any file besides the program.
!> Every rank repeats a frozen run with every exact engine, since nodes may have different
!> processors and libraries: events and their order must be those of a run in quadruple precision,
!> times and final states nearly. Then all ranks run an ensemble together, whose results file is
!> written, read and compared with the same run.
module battery_self_test
  use battery_communicator, only: communicator_type, share_error, share_text
  use battery_build_information, only: program_version, git_commit
  use battery_engine, only: particles_type
  use battery_ensemble, only: run_ensemble
  use battery_error, only: error_type, fatal_error, exit_success
  use battery_files, only: remove_file
  use battery_journal, only: remove_journal
  use battery_kinds, only: wp, int64
  use battery_namelist_input, only: parse_namelist
  use battery_initial_state, only: parse_particles
  use battery_plan, only: plan_type, setup_of, table_of, point_of
  use battery_process, only: process_number
  use battery_results, only: results_type, all_tasks_complete
  use battery_results_file, only: results_file_type, open_results, read_results, close_results, &
    task_output_type, serialize_slabs, final
  use battery_setup, only: setup_type
  use battery_simulation, only: simulation_type, begin_simulation, advance_simulation, &
    verify_simulation
  use battery_terminal, only: print_line
  use battery_text, only: to_text, count_text
  implicit none (type, external)
  private
  public :: run_self_test

  !> Number of tasks of the ensemble per rank.
  integer, parameter :: tasks_a_rank = 2

  !> Engines that must find the events.
  character(len=*), parameter :: engines(3) = [character(len=11) :: 'excursion', 'collision', &
    'synchronous']

  !> Namelist of the frozen run: the case `own` of test/frozen/cases.py.
  character(len=*), parameter :: frozen_run = '&table channel1_width = 0.75, channel2_width = ' &
    //'0.375 / &particles number = 16, initial_file = ''frozen'' / &gate threshold = 1 / ' &
    //'&run duration = 20 / '

  ! Written by test/frozen/freeze.py from a run in quadruple precision.

  !> Largest differences of times, and of final positions and velocities.
  real(wp), parameter :: time_tolerance = 3.8e-09_wp, final_tolerance = 4.9e-10_wp

  !> x, y, ux, uy of each particle at the start.
  character(len=61), parameter :: start_lines(16) = [character(len=61) :: &
    '-1.45068359375 0.90087890625 0.6171875 0.786865234375', &
    '-2.32421875 -0.376220703125 -0.88623046875 0.46337890625', &
    '-2.08251953125 -0.181640625 -0.951904296875 -0.306640625', &
    '-1.50341796875 -0.340576171875 0.239013671875 -0.970947265625', &
    '-1.033447265625 -0.093017578125 0.665771484375 0.74609375', &
    '-1.233154296875 -0.593017578125 -0.077392578125 0.9970703125', &
    '-1.927734375 -0.439208984375 -0.99560546875 0.093017578125', &
    '-1.876708984375 0.08251953125 -0.168212890625 0.98583984375', &
    '1.459228515625 -0.768310546875 -0.7138671875 -0.700439453125', &
    '1.98046875 0.22607421875 0.867919921875 -0.49658203125', &
    '1.345703125 -0.875244140625 -0.630859375 -0.77587890625', &
    '2.13232421875 0.185791015625 -0.0634765625 0.998046875', &
    '2.106689453125 0.01904296875 -0.99755859375 -0.068359375', &
    '1.93310546875 -0.7041015625 0.423583984375 -0.90576171875', &
    '1.793701171875 0.57421875 0.358642578125 0.933349609375', &
    '2.03173828125 -0.617431640625 0.87158203125 0.490234375']

  !> Kind, where, particle, time of each event.
  character(len=23), parameter :: event_lines(48) = [character(len=23) :: &
    '4 21 10 1.070103713203', &
    '1 2 13 1.610457465577', &
    '3 21 13 2.111630066929', &
    '1 1 3 2.270371773596', &
    '1 1 8 2.471393622449', &
    '2 1 2 2.471393622449', &
    '1 2 16 3.528792429595', &
    '3 21 16 4.305218216735', &
    '1 2 14 5.983459820760', &
    '1 2 15 6.221101829370', &
    '2 2 2 6.221101829370', &
    '1 1 1 6.599086121094', &
    '1 2 9 6.783192292224', &
    '3 12 1 7.162948080950', &
    '3 21 9 7.409289188922', &
    '1 1 8 7.561530588595', &
    '1 1 3 7.614468734080', &
    '2 1 2 7.614468734080', &
    '1 1 10 9.059990629361', &
    '1 1 2 9.279847744101', &
    '2 1 2 9.279847744101', &
    '4 12 16 9.460026733911', &
    '1 1 6 9.481984375950', &
    '1 1 5 10.010902032318', &
    '2 1 2 10.010902032318', &
    '1 1 4 10.482816136929', &
    '3 12 4 10.998852214336', &
    '1 2 15 11.089214934206', &
    '4 21 1 11.270729952271', &
    '3 21 15 11.630483656750', &
    '1 1 3 12.586428900596', &
    '3 12 3 13.113465206237', &
    '1 2 16 14.119743049506', &
    '4 21 11 14.625259084702', &
    '1 1 1 14.835576029073', &
    '3 12 1 15.712321040931', &
    '1 1 13 16.134963148542', &
    '1 2 4 16.419851296037', &
    '2 2 2 16.419851296037', &
    '3 12 13 16.673272872079', &
    '4 12 7 16.702940485060', &
    '1 1 15 17.096280585228', &
    '3 12 15 17.662213155298', &
    '1 1 8 18.317663902943', &
    '3 12 8 18.903392157797', &
    '4 12 2 19.218077232843', &
    '1 1 5 19.498775387030', &
    '1 2 14 19.941171979683']

  !> x, y, ux, uy of each particle at the end.
  character(len=62), parameter :: final_lines(16) = [character(len=62) :: &
    '2.156598502552 0.336181920991 -0.912761395990 0.408493126002', &
    '2.854009453190 -0.029008372047 -0.070697468935 -0.997497803449', &
    '1.565176072430 0.354732036794 0.879613916583 -0.475688298945', &
    '1.719477631943 -0.902392643644 -0.710226258699 0.703973480647', &
    '-0.071476967653 0.251927276565 0.854952093848 -0.518706966625', &
    '-1.102189684551 0.457738553493 0.271818305490 -0.962348590065', &
    '1.052406518588 0.143754120267 0.314174212346 0.949365348165', &
    '0.936106319881 -0.052480852712 0.853638177528 0.520866453005', &
    '-1.372989779162 -0.736712452969 -0.788713482477 0.614760963756', &
    '-0.702970069505 -0.421372671882 -0.101902367286 0.994794404659', &
    '-1.634869117922 0.033473319947 0.374166271239 0.927361634675', &
    '0.578590364226 -0.365820607152 -0.274098575450 -0.961701601816', &
    '1.618574691098 -0.026822535414 -0.791923302360 -0.610620572188', &
    '0.442379586236 -0.030969797832 -0.979472255807 0.201579017025', &
    '2.065428788109 0.495451359637 0.883497480871 0.468435909484', &
    '1.330515346360 0.936956054358 0.999480053760 0.032243171919']

  ! End of what freeze.py writes.

contains

  !> Runs all tests on all ranks; rank 0 prints one line for each.
  subroutine run_self_test(communicator, error)
    !> All ranks of the program.
    type(communicator_type), intent(in) :: communicator
    !> Some tests failed; the same error on all ranks.
    type(error_type), allocatable, intent(out) :: error
    type(plan_type) :: plan
    character(len=:), allocatable :: name, particles
    integer :: tests, failed, k

    tests = 0
    failed = 0
    if (communicator%rank == 0) call print_line('battery '//program_version//' (commit ' &
      //git_commit() //') on '//count_text(communicator%size, 'rank'))
    name = 'battery-self-test-'//to_text(int(process_number()))//'.h5'
    call share_text(communicator, name, 0)
    call parse_namelist(frozen_run//'&scan replicas = '//to_text(tasks_a_rank*communicator%size) &
      //' / &output final_state = .true., file = '''//name//''' /', 'battery --self-test', plan, &
      error)
    if (allocated(error)) return
    ! As if read from an initial file; any fingerprint except 0 will do.
    particles = ''
    do k = 1, size(start_lines)
      particles = particles//start_lines(k)//new_line('a')
    end do
    call parse_particles(particles, 'battery --self-test', table_of(plan, point_of(plan, 1)), &
      size(start_lines), plan%file_particles, error)
    if (allocated(error)) return
    plan%base%urn1_number = count(plan%file_particles%x < 0.0_wp)
    plan%initial_fingerprint = 1_int64
    do k = 1, size(engines)
      call repeat_run(plan, trim(engines(k)), error)
      if (allocated(error)) error%message = error%message//' (rank '//to_text(communicator%rank) &
        //')'
      call share_error(communicator, error)
      call print_outcome(trim(engines(k))//', two urns, '//count_text(size(event_lines), 'event'))
    end do
    call test_results_file(plan, communicator, error)
    call print_outcome(count_text(plan%replicas, 'task')//', results file written and read back')
    if (failed > 0) then
      call fatal_error(error, 'battery: '//to_text(failed)//' of '//count_text(tests, 'test') &
        //' failed')
    else if (communicator%rank == 0) then
      call print_line('all '//count_text(tests, 'test')//' passed')
    end if

  contains

    !> Prints the outcome of a test on rank 0, and clears its error.
    subroutine print_outcome(what)
      character(len=*), intent(in) :: what
      character(len=:), allocatable :: line

      tests = tests + 1
      line = what//': '
      if (allocated(error)) then
        failed = failed + 1
        line = line//'FAILED: '//error%message
        deallocate (error)
      else
        line = line//'passed'
      end if
      if (communicator%rank == 0) call print_line(line)
    end subroutine print_outcome

  end subroutine run_self_test

  !> Repeats the frozen run with an engine.
  subroutine repeat_run(plan, engine, error)
    !> The plan of the frozen run.
    type(plan_type), intent(in) :: plan
    !> Name of the engine.
    character(len=*), intent(in) :: engine
    !> The run fails, or differs from the frozen one: the first difference.
    type(error_type), allocatable, intent(out) :: error
    !> More windows than any of these runs takes.
    integer, parameter :: most_windows = 100000
    type(setup_type) :: setup
    type(simulation_type) :: simulation
    type(particles_type) :: particles
    real(wp) :: events(4, size(event_lines))
    integer :: window, same, k

    setup = setup_of(plan, 1, 1)
    setup%engine = engine
    setup%event_log = .true.
    particles = plan%file_particles
    call begin_simulation(simulation, setup, particles, error)
    if (allocated(error)) return
    do window = 1, most_windows
      if (simulation%done) exit
      call advance_simulation(simulation)
    end do
    call verify_simulation(simulation, error)
    if (allocated(error)) return
    call simulation%engine%get_particles(1, simulation%engine%number, particles)
    associate (found => simulation%events)
      events = columns_of(event_lines)
      same = 0
      do k = 1, min(found%count, size(event_lines))
        if (any(nint(events(:3, k)) /= [found%event(k)%kind, found%event(k)%where, &
          found%event(k)%particle]) .or. abs(found%event(k)%time - events(4, k)) &
          > time_tolerance) exit
        same = k
      end do
      if (.not. simulation%done) then
        call fatal_error(error, 'the run does not end')
      else if (same < max(found%count, size(event_lines))) then
        call fatal_error(error, 'event '//to_text(same + 1)//' of '//to_text(size(event_lines)) &
          //' differs')
      else if (.not. is_final_state(particles%x, particles%y, particles%ux, particles%uy)) then
        call fatal_error(error, 'the final state differs')
      end if
    end associate
  end subroutine repeat_run

  !> Four numbers of each line, (number, line).
  pure function columns_of(lines) result(columns)
    character(len=*), intent(in) :: lines(:)
    real(wp) :: columns(4, size(lines))
    integer :: k

    do k = 1, size(lines)
      read (lines(k), *) columns(:, k)
    end do
  end function columns_of

  !> Whether all particles are in the final state of the frozen run.
  pure logical function is_final_state(x, y, ux, uy) result(yes)
    !> Positions (length) and velocities (1), shape (particle).
    real(wp), intent(in) :: x(:), y(:), ux(:), uy(:)

    yes = size(x) == size(final_lines)
    if (yes) yes = all(abs(reshape([x, y, ux, uy], [size(x), 4]) &
      - transpose(columns_of(final_lines))) <= final_tolerance)
  end function is_final_state

  !> Runs an ensemble of the frozen run in the working directory, and compares its results file.
  subroutine test_results_file(plan, communicator, error)
    !> The plan of the frozen run.
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    !> The test failed; the same error on all ranks.
    type(error_type), allocatable, intent(out) :: error
    type(error_type), allocatable :: other
    integer :: exit_code

    call run_ensemble(plan, communicator, overwrite=.false., quiet=.true., exit_code=exit_code, &
      error=error)
    if (.not. allocated(error) .and. exit_code /= exit_success) &
      call fatal_error(error, 'exit code '//to_text(exit_code)//' of the run')
    if (communicator%rank == 0) then
      if (.not. allocated(error)) call compare_results(plan, error)
      ! After an error, the files may be missing, or may be the cause of the error.
      call remove_journal(plan%file//'.tasks', other)
      call remove_file(plan%file, other)
    end if
    call share_error(communicator, error)
  end subroutine test_results_file

  !> Reads the results file of a plan. The error is a final state that differs from the frozen one.
  subroutine compare_results(plan, error)
    type(plan_type), intent(in) :: plan
    type(error_type), allocatable, intent(out) :: error
    type(results_type) :: results
    type(results_file_type) :: file
    type(task_output_type) :: output
    integer :: k

    call open_results(plan%file, file, error)
    file%plan = plan
    if (.not. allocated(error)) call read_results(file, results, error)
    if (allocated(error)) return
    if (size(results%seed, 1) /= plan%replicas .or. .not. all_tasks_complete(results)) &
      call fatal_error(error, 'not all tasks are in the file')
    do k = 1, plan%replicas
      if (allocated(error)) exit
      call serialize_slabs(file, k, output, error)
      if (allocated(error)) exit
      associate (states => output%of(final)%values)
        if (.not. is_final_state(states(:, 1), states(:, 2), states(:, 3), states(:, 4))) &
          call fatal_error(error, 'the final state of task '//to_text(k)//' in the file differs')
      end associate
    end do
    call close_results(file)
  end subroutine compare_results

end module battery_self_test
