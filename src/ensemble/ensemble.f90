!> An ensemble: all tasks of a plan on any number of ranks, safe from kills and restarts.
!>
!> Every rank takes task after task from the queue and writes each result to the journal at once; at
!> the end rank 0 merges the journal into the results file. A run that was stopped or killed is
!> continued from its journal; results depend on the plan alone, not on ranks, order or stops.
module battery_ensemble
  use battery_kinds, only: wp, dp, int64
  use battery_clocks, only: wall_seconds, utc_now
  use battery_communicator, only: communicator_type, task_queue_type, open_task_queue, &
    close_task_queue, read_counter, share_error, share_text, share_words, mean_over_ranks, &
    tasks_finished, tasks_failed, collisions_done, sleep_until_all
  use battery_error, only: error_type, fatal_error, exit_success, exit_failure, exit_stopped_early
  use battery_journal, only: remove_journal
  use battery_launcher, only: check_output_folder, launcher_hint
  use battery_merge, only: merge_results, sources_type, close_sources
  use battery_lock_file, only: lock_type, acquire_lock, release_lock, check_lock
  use battery_plan, only: plan_type, point_of
  use battery_startup, only: find_pending_tasks, find_further_tasks, &
    check_writable, clear_error_if_complete
  use battery_results, only: results_type, all_tasks_complete
  use battery_signals, only: request_stop_after, signal_received
  use battery_summary, only: print_summary, stopped_text
  use battery_task_loop, only: monitor_type, run_tasks
  use battery_terminal, only: print_line
  implicit none (type, external)
  private
  public :: run_ensemble, set_time_limit

contains

  !> Runs or continues the ensemble of a plan; `exit_code` is that of the program. Rank 0 holds the
  !> lock of the output from before it inspects existing files until the end.
  subroutine run_ensemble(plan, communicator, overwrite, quiet, exit_code, error)
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    !> Whether to discard existing results; whether to print errors only.
    logical, intent(in) :: overwrite, quiet
    integer, intent(out) :: exit_code
    type(error_type), allocatable, intent(out) :: error
    type(lock_type) :: lock
    integer, allocatable :: pending(:)
    type(sources_type) :: sources
    type(task_queue_type) :: task_queue
    type(monitor_type) :: monitor
    real(dp) :: start_seconds
    integer(int64) :: collisions
    integer(int64), allocatable :: shared(:)
    character(len=20) :: start_date
    logical :: complete, unwritable, goes_on

    exit_code = exit_failure
    complete = .false.
    if (communicator%rank == 0) then
      call check_writable(plan, error)
      unwritable = allocated(error)
      if (.not. unwritable) then
        call acquire_lock(lock, plan%file, error, hint=launcher_hint(communicator))
        unwritable = lock%is_refused
      end if
      if (unwritable .and. .not. overwrite) &
        call clear_error_if_complete(plan, quiet, complete, error)
    end if
    ! Rank 0 may have waited for the end of another run.
    call sleep_until_all(communicator)
    call share_error(communicator, error)
    if (allocated(error)) return
    shared = [merge(1_int64, 0_int64, complete)]
    call share_words(communicator, shared)
    if (shared(1) == 1) then
      exit_code = exit_success
      return
    end if
    call share_text(communicator, lock%path, 0)
    call share_text(communicator, lock%text, 0)
    call check_output_folder(communicator, lock, plan%file, error)
    if (allocated(error)) then
      call release_lock(lock)
      return
    end if
    start_seconds = wall_seconds()
    start_date = utc_now()
    if (plan%checkpoint_minutes > 0.0_dp) &
      monitor%checkpoint_interval = 60.0_dp*real(plan%checkpoint_minutes, dp)
    call find_pending_tasks(plan, communicator, overwrite, quiet, sources, pending, complete, &
      error)
    if (complete .and. .not. allocated(error)) exit_code = exit_success
    goes_on = .not. (complete .or. allocated(error))
    sources%lock = lock
    collisions = 0
    ! Results may ask for more replicas, until nothing is pending.
    do while (goes_on)
      call open_task_queue(task_queue, communicator, pending, error)
      if (allocated(error)) exit
      call run_tasks(plan, sources%journal_type, task_queue, monitor, quiet, error)
      call share_error(communicator, error)
      goes_on = .not. allocated(error) .and. any(plan%precision > 0.0_wp) .and. task_queue%tasks &
        > 0 .and. read_counter(task_queue, tasks_finished) >= task_queue%tasks &
        .and. read_counter(task_queue, tasks_failed) == 0
      if (.not. allocated(error)) collisions = collisions + read_counter(task_queue, &
        collisions_done)
      if (.not. (goes_on .or. allocated(error))) call finish_ensemble(plan, sources, task_queue, &
        collisions, monitor%busy, start_seconds, start_date, quiet, exit_code, error)
      call close_task_queue(task_queue)
      if (goes_on) call find_further_tasks(plan, communicator, sources, pending, error)
      if (allocated(error)) exit
    end do
    call close_sources(sources)
    call release_lock(lock)
  end subroutine run_ensemble

  !> Merges the journal into the results file on rank 0, and prints the summary. The journal is
  !> removed when the results file has all results. A run that a signal has stopped ends at once,
  !> without a results file: Open MPI kills its ranks a second later; `--partial` makes the file.
  subroutine finish_ensemble(plan, sources, task_queue, collisions, busy_seconds, start_seconds, &
    start_date, quiet, exit_code, error)
    type(plan_type), intent(in) :: plan
    !> The journal, and the older results file, which is closed here.
    type(sources_type), intent(inout) :: sources
    type(task_queue_type), intent(in) :: task_queue
    !> Wall collisions of this start, on all ranks.
    integer(int64), intent(in) :: collisions
    !> Seconds that this rank spent in tasks; start of the run on the clock of `wall_seconds`.
    real(dp), intent(in) :: busy_seconds, start_seconds
    !> Start of the run as date and time of day.
    character(len=*), intent(in) :: start_date
    !> Whether to print errors only.
    logical, intent(in) :: quiet
    !> Exit code of the program, the same on all ranks.
    integer, intent(out) :: exit_code
    type(error_type), allocatable, intent(out) :: error
    type(results_type) :: results
    !> Fraction of the time that ranks spent in tasks, and of ranks that have received a signal.
    real(dp) :: busy, signalled
    logical :: all_done, stops

    busy = mean_over_ranks(task_queue%communicator, &
      busy_seconds/max(wall_seconds() - start_seconds, 1.0e-9_dp))
    signalled = mean_over_ranks(task_queue%communicator, merge(1.0_dp, 0.0_dp, signal_received()))
    all_done = read_counter(task_queue, tasks_finished) >= task_queue%tasks
    stops = signalled > 0.0_dp .and. .not. all_done
    exit_code = exit_success
    if (read_counter(task_queue, tasks_failed) > 0) exit_code = exit_failure
    if (.not. all_done) exit_code = exit_stopped_early
    if (task_queue%communicator%rank == 0) then
      call check_lock(sources%lock, error)
      if (.not. (stops .or. allocated(error))) call merge_results(plan, sources, start_date, &
        results, error)
      if (stops .and. .not. (quiet .or. allocated(error))) then
        call print_line(stopped_text)
        ! Something is finished now, or was before.
        if (read_counter(task_queue, tasks_finished) > 0 .or. task_queue%tasks &
          < plan%point_count*plan%first_replicas) call print_line('what is finished: battery ' &
          //'--partial FILE.nml writes it to '//plan%file//'.partial.h5')
      end if
      if (.not. (stops .or. allocated(error))) call print_summary(plan, results, &
        sources%ranks, busy, wall_seconds() - start_seconds, collisions, all_done, quiet)
      if (.not. allocated(error) .and. exit_code == exit_success) then
        if (all_tasks_complete(results)) then
          call remove_journal(sources%folder, error)
        else
          call fatal_error(error, 'some results cannot be read back from '//sources%folder//' or ' &
            //plan%file//': put back what was moved; the same command computes what is lost again')
        end if
      end if
    end if
    call share_error(task_queue%communicator, error)
    if (allocated(error)) exit_code = exit_failure
  end subroutine finish_ensemble

  !> Requests a stop early enough to end the run within `wall_minutes`.
  subroutine set_time_limit(plan)
    type(plan_type), intent(in) :: plan
    !> Seconds that the end of a run may take for each particle: its window is computed, its state
    !> saved. 1e-6 for 8e6 particles on an idle machine, more on a busy one.
    real(dp), parameter :: each = 3.0e-6_dp
    real(dp) :: seconds
    integer :: at, largest

    seconds = 60.0_dp*real(plan%wall_minutes, dp)
    if (.not. seconds > 0.0_dp) return
    largest = 0
    do at = 1, plan%point_count
      associate (point => point_of(plan, at))
        largest = max(largest, point%number)
      end associate
    end do
    ! Writing results takes time as well.
    call request_stop_after(seconds - max(min(20.0_dp, 0.1_dp*seconds), min(each*largest, &
      0.5_dp*seconds)))
  end subroutine set_time_limit

end module battery_ensemble
