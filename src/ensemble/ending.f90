!> The end of an ensemble: from the journal to the results file, and what is said of it.
module battery_ending
  use battery_kinds, only: dp
  use battery_clocks, only: wall_seconds
  use battery_communicator, only: board_type, read_board, share_error, &
    summary_of, tasks_finished, tasks_failed, collisions_done
  use battery_error, only: error_type, fatal_error, exit_success, exit_failure, exit_stopped_early
  use battery_journal, only: journal_type
  use battery_journal_folder, only: remove_journal
  use battery_merge, only: merge_results
  use battery_ownership, only: is_taken_over, taken_over_text
  use battery_plan, only: plan_type
  use battery_results, only: results_type, task_complete
  use battery_summary, only: print_summary
  use battery_text, only: string_type
  implicit none (type, external)
  private
  public :: finish

contains

  !> Rank 0 merges the journal into the results file and says how it went. The journal is removed
  !> once all that it should have is in the results file.
  subroutine finish(plan, journal, board, busy_seconds, began, quiet, exit_code, error)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(in) :: journal
    type(board_type), intent(in) :: board
    !> What this rank spent in tasks, and when it began on the clock of `wall_seconds`.
    real(dp), intent(in) :: busy_seconds, began
    !> Whether only failures are told.
    logical, intent(in) :: quiet
    !> What the program should end with; the same on all ranks.
    integer, intent(out) :: exit_code
    type(error_type), allocatable, intent(out) :: error
    type(results_type) :: results
    type(string_type), allocatable :: failures(:)
    real(dp) :: busy(3)
    logical :: all_done

    busy = summary_of(board%communicator, busy_seconds/max(wall_seconds() - began, 1.0e-9_dp))
    all_done = read_board(board, tasks_finished) >= board%tasks
    exit_code = exit_success
    if (read_board(board, tasks_failed) > 0) exit_code = exit_failure
    if (.not. all_done) exit_code = exit_stopped_early
    if (board%communicator%rank == 0) then
      if (is_taken_over(journal%ownership)) then
        call fatal_error(error, taken_over_text(journal%ownership))
      else
        call merge_results(plan, journal, results, failures, error)
      end if
      if (.not. allocated(error)) call print_summary(plan, results, failures, journal%ranks, busy, &
        wall_seconds() - began, read_board(board, collisions_done), all_done, quiet)
      if (.not. allocated(error) .and. exit_code == exit_success) then
        if (all(results%task_status == task_complete)) then
          call remove_journal(journal%folder, error)
        else
          call fatal_error(error, 'some results in '//journal%folder//' cannot be read back; ' &
            //'the same command computes them again')
        end if
      end if
    end if
    call share_error(board%communicator, error)
    if (allocated(error)) exit_code = exit_failure
  end subroutine finish

end module battery_ending
