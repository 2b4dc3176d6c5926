!> What each rank does in an ensemble: task after task, until none is left or all must stop.
module battery_work
  use battery_kinds, only: dp, int64
  use battery_background_sync, only: end_sync
  use battery_clocks, only: wall_seconds, rest
  use battery_communicator, only: board_type, take_task, add_to_board, read_board, &
    tasks_finished, tasks_failed, stop_wanted
  use battery_error, only: error_type, exit_failure
  use battery_journal, only: journal_type, write_finished
  use battery_ownership, only: is_taken_over
  use battery_plan, only: plan_type
  use battery_process, only: leave
  use battery_results, only: task_failed
  use battery_screen, only: screen_type, new_screen, show_ensemble, end_progress
  use battery_signals, only: stop_requested
  use battery_task, only: watch_type, run_task, seconds_between_looks
  use battery_task_result, only: task_result_type
  use battery_tasks, only: task_count, task_of
  use battery_terminal, only: complain
  implicit none (type, external)
  private
  public :: work

contains

  !> One rank's part: takes tasks from the board until none is left.
  subroutine work(plan, journal, board, watch, quiet, error)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(inout) :: journal
    type(board_type), intent(in) :: board
    type(watch_type), intent(inout) :: watch
    !> Whether nothing is shown.
    logical, intent(in) :: quiet
    type(error_type), allocatable, intent(out) :: error
    type(task_result_type) :: found
    type(screen_type) :: screen
    integer :: task
    logical :: stopped

    screen = new_screen(board%communicator%rank == 0 .and. .not. quiet, task_count(plan))
    do
      if (must_stop()) exit
      call take_task(board, task)
      if (task == 0) exit
      call run_task(task_of(plan, task), plan%start, journal, board, watch, screen, found, &
        stopped, error)
      if (stopped .or. allocated(error)) exit
      call write_finished(journal, found, error)
      if (allocated(error)) exit
      if (found%status == task_failed) call add_to_board(board, tasks_failed, 1_int64)
      call add_to_board(board, tasks_finished, 1_int64)
    end do
    ! All results of this rank must be on the disk.
    if (.not. allocated(error)) call end_sync(journal%sync, error)
    ! Its rank 0 may be dead: nobody can be told any more.
    if (allocated(error) .and. is_taken_over(journal%ownership)) then
      call complain(error%message)
      call leave(exit_failure)
    end if
    ! The others must not wait for a rank that has failed.
    if (allocated(error)) then
      call add_to_board(board, stop_wanted, 1_int64)
    else
      call wait_for_others()
    end if
    call end_progress(screen)

  contains

    !> Whether the run ends here; if this rank is the first to know, it tells the others.
    function must_stop() result(stopping)
      logical :: stopping

      stopping = read_board(board, stop_wanted) > 0
      if (stopping) return
      stopping = stop_requested()
      if (stopping) call add_to_board(board, stop_wanted, 1_int64)
    end function must_stop

    !> A rank without a task still hears signals, and leaves the processor to those that have one.
    subroutine wait_for_others()
      real(dp), parameter :: nap = 0.005_dp
      real(dp) :: next_look

      next_look = 0.0_dp
      do
        if (wall_seconds() >= next_look .or. stop_requested()) then
          if (must_stop()) exit
          if (read_board(board, tasks_finished) >= board%tasks) exit
          call show_ensemble(screen, board, 0.5_dp)
          next_look = wall_seconds() + seconds_between_looks(board%communicator%size, nap)
        end if
        call rest(nap)
      end do
    end subroutine wait_for_others

  end subroutine work

end module battery_work
