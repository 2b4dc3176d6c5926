!> The program `battery`: reads the command line and the plan, runs the ensemble or prints what was
!> asked for, and ends with an exit code.
program battery
  use battery_json_report, only: check_json_file, write_run_json
  use battery_error, only: error_type, exit_success, exit_failure
  use battery_launcher, only: check_command_lines
  use battery_command_line, only: command_line_type, command_line_words, parse_arguments, check, &
    overwrite, quiet, accept, partial, self_test, version
  use battery_communicator, only: communicator_type, open_communicator, close_communicator, &
    share_error, ranks_on_node, wait_for_all
  use battery_ensemble, only: run_ensemble, set_time_limit
  use battery_available_memory, only: estimate_type, estimate_memory, check_memory_for_mpi
  use battery_memory, only: spare_address_space
  use battery_plan_report, only: print_plan_report
  use battery_plan, only: plan_type
  use battery_plan_sharing, only: read_plan_once
  use battery_provenance, only: version_text
  use battery_self_test, only: run_self_test
  use battery_signals, only: watch_signals
  use battery_startup, only: accept_output, write_partial_results
  use battery_process, only: exit_process, exit_after
  use battery_terminal, only: guard_streams, print_line, print_error, all_was_printed
  use battery_text, only: string_type
  implicit none (type, external)

  !> Time limit of MPI_Finalize, in seconds.
  integer, parameter :: finalize_seconds = 30

  type(command_line_type) :: command_line
  type(communicator_type) :: communicator
  type(string_type), allocatable :: words(:)
  type(error_type), allocatable :: error
  integer :: exit_code

  exit_code = exit_success
  ! These come before MPI starts, which opens files and starts threads that reserve address space.
  call guard_streams()
  call spare_address_space()
  call watch_signals()
  call check_memory_for_mpi(error)
  if (allocated(error)) then
    call print_error(error%message)
    call exit_process(error%code)
  end if
  call open_communicator(communicator)
  words = command_line_words()
  words = words(2:)
  call check_command_lines(communicator, words, error)
  if (.not. allocated(error)) call parse_arguments(words, command_line, error)
  if (.not. allocated(error)) then
    if (command_line%has(self_test)) then
      call run_self_test(communicator, error)
    else if (command_line%text_to_print == '' .and. .not. command_line%has(version)) then
      call run()
    else if (communicator%rank == 0) then
      if (command_line%has(version)) command_line%text_to_print = version_text()
      call print_line(command_line%text_to_print)
    end if
  end if
  if (allocated(error)) then
    if (communicator%rank == 0) call print_error(error%message)
    exit_code = error%code
  end if
  if (.not. all_was_printed()) then
    call print_error('battery: part of the output could not be printed; files are as they ' &
      //'should be')
    if (exit_code == exit_success) exit_code = exit_failure
  end if
  ! All files are complete here. MPICH 4.0 over UCX sometimes blocks in MPI_Finalize on several
  ! nodes: one rank waits for another that has stopped its progress (pull request 6596 of MPICH).
  call wait_for_all(communicator)
  call exit_after(finalize_seconds, exit_code)
  call close_communicator(communicator)
  call exit_process(exit_code)

contains

  !> Reads the plan, and runs its ensemble or prints its report.
  subroutine run()
    type(plan_type) :: plan
    type(estimate_type) :: estimate
    character(len=:), allocatable :: message

    call read_plan_once(command_line%file, communicator, plan, error)
    if (.not. allocated(error) .and. communicator%rank == 0) &
      call check_json_file(command_line%json, plan, error)
    call share_error(communicator, error)
    if (allocated(error)) return
    if (any(command_line%has([accept, partial]))) then
      if (communicator%rank == 0 .and. command_line%has(accept)) &
        call accept_output(plan, message, error)
      if (communicator%rank == 0 .and. command_line%has(partial)) &
        call write_partial_results(plan, message, error)
      call share_error(communicator, error)
      if (communicator%rank == 0 .and. .not. (allocated(error) .or. command_line%has(quiet))) &
        call print_line(message)
      return
    end if
    call set_time_limit(plan)
    call estimate_memory(plan, ranks_on_node(communicator), estimate, error)
    call share_error(communicator, error)
    if (allocated(error)) return
    if (.not. command_line%has(check)) then
      call run_ensemble(plan, communicator, command_line%has(overwrite), command_line%has(quiet), &
        exit_code, error)
      if (communicator%rank == 0 .and. .not. allocated(error)) &
        call write_run_json(command_line%json, plan%file, exit_code, error)
    else if (communicator%rank == 0) then
      call print_plan_report(plan, communicator%size, estimate, command_line%has(overwrite), &
        command_line%json, error)
    end if
    call share_error(communicator, error)
  end subroutine run

end program battery
