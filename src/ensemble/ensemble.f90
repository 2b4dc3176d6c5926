!> An ensemble: all tasks of a plan on any number of ranks, so that nothing that happens can spoil
!> it.
!>
!> Every rank takes the next task from the board when it is free, writes its result to the journal
!> at once, and in the end rank 0 merges the journal into the results file. A run that is stopped or
!> killed goes on from its journal; results depend on the plan alone, not on ranks, order or stops.
module battery_ensemble
  use, intrinsic :: iso_fortran_env, only: output_unit
  use battery_kinds, only: dp, int64
  use battery_error, only: error_type, fatal_error, exit_success, exit_failure, &
    exit_stopped_early, exit_bad_input
  use battery_files, only: file_exists, remove_file
  use battery_signals, only: wall_seconds, stop_requested, rest
  use battery_plan, only: plan_type
  use battery_tasks, only: task_count, task_of, put_longest_first
  use battery_namelist_input, only: differing_keys
  use battery_communicator, only: communicator_type, board_type, open_board, close_board, &
    add_to_board, &
    read_board, share_error, share_integers, wait_for_all, all_true, summary_of, next_task, &
    tasks_finished, tasks_failed, collisions_done, stop_wanted
  use battery_journal, only: journal_type, read_plan, begin_journal, join_journal, read_finished, &
    write_finished, remove_journal
  use battery_task, only: task_type, watch_type, run_task
  use battery_task_result, only: task_result_type, task_failed
  use battery_screen, only: screen_type, new_screen, show_ensemble, end_progress
  use battery_merge, only: merge_results, existing_results
  use battery_summary, only: print_summary
  implicit none (type, external)
  private
  public :: run_ensemble

contains

  !> Runs, or goes on with, what `plan` describes; `exit_code` is what the program should end with.
  subroutine run_ensemble(plan, communicator, overwrite, quiet, exit_code, error)
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    logical, intent(in) :: overwrite, quiet
    integer, intent(out) :: exit_code
    type(error_type), allocatable, intent(out) :: error
    integer, allocatable :: pending(:)
    type(journal_type) :: journal
    type(board_type) :: board
    type(watch_type) :: watch
    real(dp) :: began
    logical :: complete
    integer :: finished_before

    exit_code = exit_failure
    began = wall_seconds()
    call prepare(plan, communicator, overwrite, quiet, journal, pending, complete, error)
    if (allocated(error)) return
    if (complete) then
      exit_code = exit_success
      return
    end if
    finished_before = task_count(plan) - size(pending)
    if (plan%wall_minutes > 0.0_dp) watch%stop_at = began + stop_seconds(real(plan%wall_minutes, &
      dp))
    watch%checkpoint_interval = 60.0_dp*real(plan%checkpoint_minutes, dp)
    if (.not. watch%checkpoint_interval > 0.0_dp) watch%checkpoint_interval = huge(1.0_dp)
    call open_board(board, communicator)
    call work(plan, communicator, pending, finished_before, journal, board, watch, quiet, error)
    call share_error(communicator, error)
    if (.not. allocated(error)) &
      call finish(plan, communicator, journal, board, watch, began, size(pending), quiet, &
      exit_code, error)
    call close_board(board)
  end subroutine run_ensemble

  !> Seconds until the run must begin to stop, so that it has ended before `wall_minutes`.
  pure function stop_seconds(wall_minutes) result(seconds)
    real(dp), intent(in) :: wall_minutes
    real(dp) :: seconds

    seconds = 60.0_dp*wall_minutes
    seconds = seconds - min(20.0_dp, 0.1_dp*seconds)
  end function stop_seconds

  !> Rank 0 looks at what is there: results that are complete, a journal to go on with, or neither;
  !> every rank gets the tasks that are still to be done, longest first.
  subroutine prepare(plan, communicator, overwrite, quiet, journal, pending, complete, error)
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    logical, intent(in) :: overwrite, quiet
    type(journal_type), intent(out) :: journal
    integer, allocatable, intent(out) :: pending(:)
    logical, intent(out) :: complete
    type(error_type), allocatable, intent(out) :: error
    integer, allocatable :: numbers(:)

    allocate (numbers(0))
    if (communicator%rank == 0) call look_for_results(numbers)
    call share_error(communicator, error)
    if (allocated(error)) return
    call share_integers(communicator, numbers)
    complete = numbers(1) == 1
    pending = numbers(3:)
    call join_journal(journal, journal_folder(plan), numbers(2), communicator%rank, &
      communicator%size)

  contains

    !> Fills `numbers`: 1 if all is complete, rank files of earlier starts, the tasks to be done.
    subroutine look_for_results(numbers)
      integer, allocatable, intent(out) :: numbers(:)
      character(len=:), allocatable :: before
      type(journal_type) :: earlier
      logical, allocatable :: finished(:)
      logical :: found
      integer :: rank_files

      numbers = [0, 0]
      if (overwrite) then
        call discard(plan, error)
        if (allocated(error)) return
      end if
      call existing_results(plan%file, before, found, complete, error)
      if (allocated(error)) return
      if (found) then
        call compare(plan, before, error)
        if (allocated(error)) return
        if (complete) then
          if (.not. quiet) write (output_unit, '(a)') plan%file &
            //' is complete; --overwrite runs it again'
          numbers = [1, 0]
          return
        end if
      end if
      call read_plan(journal_folder(plan), before, rank_files, found)
      allocate (finished(task_count(plan)), source=.false.)
      if (found) then
        call compare(plan, before, error)
        if (allocated(error)) return
        call join_journal(earlier, journal_folder(plan), 0, 0, rank_files)
        call read_finished(earlier, finished)
      end if
      call begin_journal(journal_folder(plan), plan%text, rank_files, communicator%size, &
        task_count(plan), error)
      if (allocated(error)) return
      numbers = [0, rank_files, longest_first(plan, finished)]
      if (found .and. .not. quiet) write (output_unit, '(a, i0, a, i0, a)') &
        'going on: ', count(finished), ' of ', size(finished), ' tasks are finished'
    end subroutine look_for_results

  end subroutine prepare

  pure function journal_folder(plan) result(folder)
    type(plan_type), intent(in) :: plan
    character(len=:), allocatable :: folder

    folder = plan%file//'.tasks'
  end function journal_folder

  !> Removes results and journal of whatever run used the same output file.
  subroutine discard(plan, error)
    type(plan_type), intent(in) :: plan
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: before
    integer :: rank_files
    logical :: found

    call remove_file(plan%file, error)
    if (allocated(error)) return
    call read_plan(journal_folder(plan), before, rank_files, found)
    if (found) call remove_journal(journal_folder(plan), rank_files, error)
  end subroutine discard

  !> Results of another input are not gone on with.
  subroutine compare(plan, before, error)
    type(plan_type), intent(in) :: plan
    character(len=*), intent(in) :: before
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: keys

    keys = differing_keys(before, plan%text)
    if (keys /= '') call fatal_error(error, plan%file &
      //' was made from another input; these differ:' &
      //new_line('a')//keys//new_line('a') &
      //'name another output file, or discard it with --overwrite', exit_bad_input)
  end subroutine compare

  !> The tasks that are not finished, the longest first, else in their order.
  function longest_first(plan, finished) result(pending)
    type(plan_type), intent(in) :: plan
    logical, intent(in) :: finished(:)
    integer, allocatable :: pending(:)
    integer :: k

    pending = pack([(k, k=1, size(finished))], .not. finished)
    call put_longest_first(plan, pending)
  end function longest_first

  !> One rank's part: takes tasks from the board until none is left.
  subroutine work(plan, communicator, pending, finished_before, journal, board, watch, quiet, error)
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    integer, intent(in) :: pending(:), finished_before
    type(journal_type), intent(inout) :: journal
    type(board_type), intent(in) :: board
    type(watch_type), intent(inout) :: watch
    logical, intent(in) :: quiet
    type(error_type), allocatable, intent(out) :: error
    type(task_type) :: task
    type(task_result_type) :: found
    type(screen_type) :: screen
    integer(int64) :: taken, before
    logical :: stopped

    screen = new_screen(communicator%rank == 0 .and. .not. quiet, task_count(plan), &
      finished_before, communicator%size)
    do
      stopped = wall_seconds() >= watch%stop_at
      if (stop_requested()) stopped = .true.
      if (read_board(board, stop_wanted) > 0) stopped = .true.
      if (stopped) then
        call add_to_board(board, stop_wanted, 1_int64, before)
        exit
      end if
      call add_to_board(board, next_task, 1_int64, taken)
      if (taken >= size(pending)) exit
      task = task_of(plan, pending(taken + 1))
      call run_task(task, journal, board, watch, screen, found, stopped, error)
      if (stopped .or. allocated(error)) exit
      call write_finished(journal, found, error)
      if (allocated(error)) exit
      call add_to_board(board, tasks_finished, 1_int64, before)
      if (found%status == task_failed) call add_to_board(board, tasks_failed, 1_int64, before)
    end do
    ! The others must not wait for a rank that has failed.
    if (allocated(error)) call add_to_board(board, stop_wanted, 1_int64, before)
    if (communicator%rank == 0 .and. .not. allocated(error)) call wait_showing()
    call end_progress(screen)

  contains

    !> Rank 0 goes on showing the progress while others finish their last tasks.
    subroutine wait_showing()
      if (.not. screen%speaks) return
      do while (read_board(board, stop_wanted) == 0)
        if (read_board(board, tasks_finished) >= size(pending)) exit
        call show_ensemble(screen, board, 0.5_dp)
        if (stop_requested()) call add_to_board(board, stop_wanted, 1_int64, before)
        call rest(0.02_dp)
      end do
    end subroutine wait_showing

  end subroutine work

  !> Rank 0 merges the journal into the results file and says how it went.
  subroutine finish(plan, communicator, journal, board, watch, began, tasks, quiet, exit_code, &
    error)
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    type(journal_type), intent(in) :: journal
    type(board_type), intent(in) :: board
    type(watch_type), intent(in) :: watch
    real(dp), intent(in) :: began
    integer, intent(in) :: tasks
    logical, intent(in) :: quiet
    integer, intent(out) :: exit_code
    type(error_type), allocatable, intent(out) :: error
    real(dp) :: busy(3)
    logical :: all_done
    integer :: failed

    busy = summary_of(communicator, watch%busy/max(wall_seconds() - began, 1.0e-9_dp))
    all_done = read_board(board, tasks_finished) >= tasks
    failed = int(read_board(board, tasks_failed))
    exit_code = exit_success
    if (failed > 0) exit_code = exit_failure
    if (.not. all_done) exit_code = exit_stopped_early
    if (communicator%rank == 0) then
      call merge_results(plan, journal, communicator%size, all_done .and. failed == 0, error)
      if (.not. allocated(error)) then
        call print_summary(plan, journal, communicator%size, busy, wall_seconds() - began, &
          read_board(board, collisions_done), all_done, quiet)
        if (all_done .and. failed == 0) &
          call remove_journal(journal%folder, journal%rank_files, error)
      end if
    end if
    call share_error(communicator, error)
    if (allocated(error)) exit_code = exit_failure
  end subroutine finish

end module battery_ensemble
