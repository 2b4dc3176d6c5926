!> An ensemble: all tasks of a plan on any number of ranks, so that nothing that happens can spoil
!> it.
!>
!> Every rank takes the next task from the board when it is free, writes its result to the journal
!> at once, and in the end rank 0 merges the journal into the results file. A run that is stopped or
!> killed goes on from its journal; results depend on the plan alone, not on ranks, order or stops.
module battery_ensemble
  use battery_kinds, only: dp, int64
  use battery_error, only: error_type, fatal_error, exit_success, exit_failure, &
    exit_stopped_early, exit_bad_input
  use battery_files, only: remove_file
  use battery_fingerprint, only: fingerprint_text
  use battery_clocks, only: wall_seconds, rest
  use battery_terminal, only: say, complain
  use battery_text, only: string_type, to_text
  use battery_signals, only: stop_requested, stop_after, leave
  use battery_plan, only: plan_type
  use battery_tasks, only: task_count, task_of, is_task_of, put_longest_first
  use battery_namelist_input, only: differing_keys
  use battery_communicator, only: communicator_type, board_type, open_board, close_board, &
    take_task, add_to_board, read_board, share_error, share_integers, share_text, summary_of, &
    tasks_finished, tasks_failed, collisions_done, stop_wanted
  use battery_journal, only: journal_type, read_plan, begin_journal, join_journal, read_rank_file, &
    rank_files_of, write_finished, remove_journal, rank_files_in, kept_in, &
    settle_journal, check_journal
  use battery_ownership, only: ownership_type, take_ownership, give_up_ownership, is_taken_over, &
    taken_over_text
  use battery_task, only: watch_type, run_task, seconds_between_looks
  use battery_task_result, only: task_result_type, task_failed
  use battery_screen, only: screen_type, new_screen, show_ensemble, end_progress
  use battery_merge, only: merge_results, existing_results
  use battery_results, only: results_type, task_complete
  use battery_summary, only: print_summary
  implicit none (type, external)
  private
  public :: run_ensemble, heed_time_limit

contains

  !> Runs, or goes on with, what `plan` describes; `exit_code` is what the program should end with.
  !> Rank 0 owns the output from before it looks at what is there until the end.
  subroutine run_ensemble(plan, communicator, overwrite, quiet, exit_code, error)
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    logical, intent(in) :: overwrite, quiet
    integer, intent(out) :: exit_code
    type(error_type), allocatable, intent(out) :: error
    type(ownership_type) :: ownership

    exit_code = exit_failure
    if (communicator%rank == 0) call take_ownership(ownership, plan%file, error)
    call share_error(communicator, error)
    if (allocated(error)) return
    call share_text(communicator, ownership%path, 0)
    call share_text(communicator, ownership%text, 0)
    call run_owned(plan, communicator, ownership, overwrite, quiet, exit_code, error)
    call give_up_ownership(ownership)
  end subroutine run_ensemble

  !> Runs an ensemble whose output this run owns.
  subroutine run_owned(plan, communicator, ownership, overwrite, quiet, exit_code, &
      error)
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    type(ownership_type), intent(in) :: ownership
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
    journal%ownership = ownership
    watch%checkpoint_interval = 60.0_dp*real(plan%checkpoint_minutes, dp)
    if (.not. watch%checkpoint_interval > 0.0_dp) watch%checkpoint_interval = huge(1.0_dp)
    call open_board(board, communicator, pending)
    finished_before = task_count(plan) - board%tasks
    call work(plan, communicator, finished_before, journal, board, watch, quiet, error)
    call share_error(communicator, error)
    if (.not. allocated(error)) &
      call finish(plan, communicator, journal, board, watch, began, quiet, exit_code, error)
    call close_board(board)
  end subroutine run_owned

  !> From now on the run stops in time for `wall_minutes`.
  subroutine heed_time_limit(plan)
    type(plan_type), intent(in) :: plan

    if (plan%wall_minutes > 0.0_dp) call stop_after(stop_seconds(real(plan%wall_minutes, dp)))
  end subroutine heed_time_limit

  !> Seconds until the run must begin to stop, so that it has ended before `wall_minutes`.
  pure function stop_seconds(wall_minutes) result(seconds)
    real(dp), intent(in) :: wall_minutes
    real(dp) :: seconds

    seconds = 60.0_dp*wall_minutes
    seconds = seconds - min(20.0_dp, 0.1_dp*seconds)
  end function stop_seconds

  !> Rank 0 looks at what is there: results that are complete, a journal to go on with, or neither;
  !> it gets the tasks that are still to be done, longest first, the other ranks an empty list.
  subroutine prepare(plan, communicator, overwrite, quiet, journal, pending, complete, error)
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    logical, intent(in) :: overwrite, quiet
    type(journal_type), intent(out) :: journal
    integer, allocatable, intent(out) :: pending(:)
    logical, intent(out) :: complete
    type(error_type), allocatable, intent(out) :: error
    integer, allocatable :: numbers(:)

    allocate (numbers(2), source=0)
    allocate (pending(0))
    if (communicator%rank == 0) call look_for_results(numbers)
    call share_error(communicator, error)
    if (allocated(error)) return
    call share_integers(communicator, numbers)
    complete = numbers(1) == 1
    call join_journal(journal, journal_folder(plan), numbers(2), &
      communicator%rank, communicator%size)

  contains

    !> Fills `numbers`: 1 if all is complete, rank files of earlier starts; and `pending`.
    subroutine look_for_results(numbers)
      integer, intent(out) :: numbers(2)
      type(error_type), allocatable :: damage
      type(journal_type) :: earlier
      logical, allocatable :: finished(:)
      logical :: found

      numbers = 0
      call check_journal(journal_folder(plan), error)
      if (allocated(error)) return
      if (overwrite) then
        call discard(plan, error)
        if (allocated(error)) return
      end if
      call look_at_results_file(damage)
      if (allocated(error)) return
      if (complete) then
        if (.not. quiet) call say(plan%file//' is complete; --overwrite runs it again')
        numbers(1) = 1
        call remove_journal(journal_folder(plan), error)
        return
      end if
      call look_at_journal(found)
      if (allocated(error)) return
      numbers(2) = rank_files_in(journal_folder(plan))
      if (numbers(2) > huge(numbers) - communicator%size) then
        call fatal_error(error, journal_folder(plan)//'/rank_'//to_text(numbers(2) - 1) &
          //': leaves no number for another file; remove it')
        return
      end if
      allocate (finished(task_count(plan)), source=.false.)
      call join_journal(earlier, journal_folder(plan), numbers(2), 0, 0)
      call mark_finished(plan, earlier, finished)
      if (allocated(damage)) then
        if (.not. (found .or. any(finished))) then
          call move_alloc(damage, error)
          return
        end if
        if (.not. quiet) call say(plan%file//' is damaged, and is written anew from ' &
          //journal_folder(plan))
      end if
      call begin_journal(journal_folder(plan), plan%text, plan%initial_fingerprint, &
        numbers(2) + communicator%size, error)
      if (allocated(error)) return
      pending = longest_first(plan, finished)
      if ((found .or. any(finished)) .and. .not. quiet) call say('going on: ' &
        //to_text(count(finished))//' of '//to_text(size(finished))//' tasks are finished')
    end subroutine look_for_results

    !> Results must be of this input; `damage` says what a results file cannot be read for.
    subroutine look_at_results_file(damage)
      type(error_type), allocatable, intent(out) :: damage
      character(len=:), allocatable :: before, initial_fingerprint
      logical :: found

      call existing_results(plan%file, before, initial_fingerprint, found, complete, error)
      if (allocated(error)) then
        if (error%code == exit_failure) call move_alloc(error, damage)
      else if (found) then
        call compare(plan, before, initial_fingerprint, error)
      end if
    end subroutine look_at_results_file

    !> A journal must be of this input; if its plan is damaged, its other files must not say that
    !> they are of another.
    subroutine look_at_journal(found)
      logical, intent(out) :: found
      character(len=:), allocatable :: before
      integer(int64) :: initial_fingerprint

      call read_plan(journal_folder(plan), before, initial_fingerprint, found)
      if (found) then
        call compare(plan, before, fingerprint_text(initial_fingerprint), error)
      else if (belongs_to_another(plan)) then
        call fatal_error(error, journal_folder(plan)//' holds parts of another input, and the ' &
          //'plan in it is damaged; name another output file, or discard it with --overwrite', &
          exit_bad_input)
      end if
    end subroutine look_at_journal

  end subroutine prepare

  !> Which of the tasks of a plan a journal has as complete; failed ones are tried again.
  subroutine mark_finished(plan, journal, finished)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(in) :: journal
    logical, intent(inout) :: finished(:)
    type(task_result_type), allocatable :: results(:)
    integer, allocatable :: files(:)
    integer :: file, k

    files = rank_files_of(journal)
    do file = 1, size(files)
      call read_rank_file(journal, files(file), results)
      do k = 1, size(results)
        if (results(k)%status /= task_complete) cycle
        if (is_task_of(plan, int(results(k)%task, int64), results(k)%kept)) &
          finished(results(k)%task) = .true.
      end do
    end do
  end subroutine mark_finished

  !> Whether the journal has anything that is of another input, where its plan cannot tell.
  function belongs_to_another(plan) result(another)
    type(plan_type), intent(in) :: plan
    logical :: another
    integer(int64), allocatable :: kept(:, :)
    integer :: k

    another = .false.
    kept = kept_in(journal_folder(plan))
    do k = 1, size(kept, 2)
      another = another .or. .not. is_task_of(plan, kept(1, k), kept(2, k))
    end do
  end function belongs_to_another

  pure function journal_folder(plan) result(folder)
    type(plan_type), intent(in) :: plan
    character(len=:), allocatable :: folder

    folder = plan%file//'.tasks'
  end function journal_folder

  !> Removes results and journal of whatever run used the same output file.
  subroutine discard(plan, error)
    type(plan_type), intent(in) :: plan
    type(error_type), allocatable, intent(out) :: error

    call remove_file(plan%file, error)
    if (.not. allocated(error)) call remove_journal(journal_folder(plan), error)
  end subroutine discard

  !> Results of another input are not gone on with, nor those of an initial file that has changed.
  subroutine compare(plan, before, initial_fingerprint, error)
    type(plan_type), intent(in) :: plan
    character(len=*), intent(in) :: before, initial_fingerprint
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: keys

    keys = differing_keys(before, plan%text)
    if (keys == '' .and. plan%initial_file /= '' &
      .and. initial_fingerprint /= fingerprint_text(plan%initial_fingerprint)) &
      keys = '&particles initial_file: '''//plan%initial_file//''' has other contents now'
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
  subroutine work(plan, communicator, finished_before, journal, board, watch, quiet, error)
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    integer, intent(in) :: finished_before
    type(journal_type), intent(inout) :: journal
    type(board_type), intent(in) :: board
    type(watch_type), intent(inout) :: watch
    logical, intent(in) :: quiet
    type(error_type), allocatable, intent(out) :: error
    type(task_result_type) :: found
    type(screen_type) :: screen
    integer(int64) :: before
    integer :: task
    logical :: stopped

    screen = new_screen(communicator%rank == 0 .and. .not. quiet, task_count(plan), &
      finished_before, communicator%size)
    do
      if (must_stop()) exit
      call take_task(board, task)
      if (task == 0) exit
      call run_task(task_of(plan, task), plan%start, journal, board, watch, screen, found, &
        stopped, error)
      if (stopped .or. allocated(error)) exit
      call write_finished(journal, found, error)
      if (allocated(error)) exit
      if (found%status == task_failed) call add_to_board(board, tasks_failed, 1_int64, before)
      call add_to_board(board, tasks_finished, 1_int64, before)
    end do
    if (.not. allocated(error)) call settle_journal(journal, error)
    ! Its rank 0 may be dead: nobody can be told any more.
    if (allocated(error) .and. is_taken_over(journal%ownership)) then
      call complain(error%message)
      call leave(exit_failure)
    end if
    ! The others must not wait for a rank that has failed.
    if (allocated(error)) then
      call add_to_board(board, stop_wanted, 1_int64, before)
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
      if (stopping) call add_to_board(board, stop_wanted, 1_int64, before)
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
          next_look = wall_seconds() + seconds_between_looks(board%ranks, nap)
        end if
        call rest(nap)
      end do
    end subroutine wait_for_others

  end subroutine work

  !> Rank 0 merges the journal into the results file and says how it went. The journal is removed
  !> once all that it should have is in the results file.
  subroutine finish(plan, communicator, journal, board, watch, began, quiet, exit_code, error)
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    type(journal_type), intent(in) :: journal
    type(board_type), intent(in) :: board
    type(watch_type), intent(in) :: watch
    real(dp), intent(in) :: began
    logical, intent(in) :: quiet
    integer, intent(out) :: exit_code
    type(error_type), allocatable, intent(out) :: error
    type(results_type) :: results
    type(string_type), allocatable :: failures(:)
    real(dp) :: busy(3)
    logical :: all_done

    busy = summary_of(communicator, watch%busy/max(wall_seconds() - began, 1.0e-9_dp))
    all_done = read_board(board, tasks_finished) >= board%tasks
    exit_code = exit_success
    if (read_board(board, tasks_failed) > 0) exit_code = exit_failure
    if (.not. all_done) exit_code = exit_stopped_early
    if (communicator%rank == 0) then
      if (is_taken_over(journal%ownership)) then
        call fatal_error(error, taken_over_text(journal%ownership))
      else
        call merge_results(plan, journal, communicator%size, results, failures, error)
      end if
      if (.not. allocated(error)) call print_summary(plan, results, failures, communicator%size, &
        busy, wall_seconds() - began, read_board(board, collisions_done), all_done, quiet)
      if (.not. allocated(error) .and. exit_code == exit_success) then
        if (all(results%task_status == task_complete)) then
          call remove_journal(journal%folder, error)
        else
          call fatal_error(error, 'some results in '//journal%folder//' cannot be read back; ' &
            //'the same command computes them again')
        end if
      end if
    end if
    call share_error(communicator, error)
    if (allocated(error)) exit_code = exit_failure
  end subroutine finish

end module battery_ensemble
