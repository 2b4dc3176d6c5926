!> The loop of each rank over the tasks of an ensemble, until none is left or all ranks must stop.
module battery_task_loop
  use battery_kinds, only: dp, int64
  use battery_clocks, only: wall_seconds, cpu_seconds, utc_seconds, sleep_for
  use battery_communicator, only: task_queue_type, fetch_task, add_to_counter, read_counter, &
    drive_mpi_progress, mpi_progress_interval, tasks_finished, tasks_failed, collisions_done, &
    stop_wanted
  use battery_engine, only: particles_type
  use battery_engines, only: bytes_per_particle
  use battery_error, only: error_type, exit_failure, exit_stopped_early
  use battery_journal, only: journal_type, read_state, write_state, write_finished, &
    sync_finished
  use battery_available_memory, only: need_type, check_memory
  use battery_lock_file, only: is_lock_lost
  use battery_plan, only: plan_type
  use battery_process, only: exit_process
  use battery_results, only: task_failed
  use battery_progress_line, only: progress_line_type, new_progress_line, show_progress, &
    clear_progress_line
  use battery_signals, only: stop_requested
  use battery_simulation, only: simulation_type, advance_simulation, progress, verify_simulation
  use battery_task_result, only: task_result_type, result_of, failed_result
  use battery_tasks, only: task_type, task_count, task_of, begin_task
  use battery_terminal, only: print_error
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: monitor_type, run_tasks, advance_some_windows

  !> Timers and the stop flag that a running task checks between windows.
  type :: monitor_type
    !> Interval between saved states in seconds.
    real(dp) :: checkpoint_interval = huge(1.0_dp)
    !> Time of the next saved state. This and the times below are those of `wall_seconds`.
    real(dp) :: next_checkpoint = huge(1.0_dp)
    !> Time at which this rank polls the task queue next.
    real(dp) :: next_poll = 0.0_dp
    !> Next time at which rank 0 calls MPI, so that one-sided requests make progress.
    real(dp) :: next_mpi_progress = 0.0_dp
    !> Whether the run stops early.
    logical :: stopping = .false.
    !> Time spent in tasks.
    real(dp) :: busy = 0.0_dp
  end type monitor_type

  !> Windows between two readings of the clock, for up to `few_particles` particles.
  integer, parameter :: windows_between_clock_readings = 16, few_particles = 2000

  !> Seconds between two polls of the task queue: the greatest of `poll_interval`, ranks /
  !> `polls_a_second` and the time of a poll / `poll_share`, but at most `longest_poll_interval`.
  real(dp), parameter :: poll_interval = 0.1_dp, polls_a_second = 1.0e4_dp, poll_share = 0.005_dp, &
    longest_poll_interval = 5.0_dp

contains

  !> Runs tasks from the queue on this rank until none is left.
  subroutine run_tasks(plan, journal, task_queue, monitor, quiet, error)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(inout) :: journal
    type(task_queue_type), intent(in) :: task_queue
    type(monitor_type), intent(inout) :: monitor
    !> Whether nothing is printed.
    logical, intent(in) :: quiet
    type(error_type), allocatable, intent(out) :: error
    type(task_result_type) :: found
    type(progress_line_type) :: progress_line
    integer :: task
    logical :: stopped

    progress_line = new_progress_line(task_queue%communicator%rank == 0 .and. .not. quiet, &
      task_count(plan))
    do
      if (stop_is_wanted(task_queue)) exit
      call fetch_task(task_queue, task)
      if (task == 0) exit
      call run_task(task_of(plan, task), plan%file_particles, journal, task_queue, monitor, &
        progress_line, found, stopped, error)
      if (stopped .or. allocated(error)) exit
      call write_finished(journal, found, error)
      if (allocated(error)) exit
      if (found%status == task_failed) call add_to_counter(task_queue, tasks_failed, 1_int64)
      call add_to_counter(task_queue, tasks_finished, 1_int64)
    end do
    ! All results of this rank must be on the disk.
    if (.not. allocated(error)) call sync_finished(journal, error)
    ! This rank has lost the lock: rank 0 may have ended, and any call of MPI would wait for ever.
    ! So the rank ends by itself.
    if (allocated(error) .and. is_lock_lost(journal%lock)) then
      call print_error(error%message)
      call exit_process(exit_failure)
    end if
    ! The other ranks must not wait for a rank that has failed.
    if (allocated(error)) then
      call add_to_counter(task_queue, stop_wanted, 1_int64)
    else
      call wait_for_others()
    end if
    call clear_progress_line(progress_line)

  contains

    !> Waits, without using the processor, until all tasks are finished; still notices signals.
    subroutine wait_for_others()
      real(dp), parameter :: nap = 0.005_dp
      real(dp) :: next_poll

      next_poll = 0.0_dp
      do
        if (wall_seconds() >= next_poll .or. stop_requested()) then
          if (stop_is_wanted(task_queue)) exit
          if (read_counter(task_queue, tasks_finished) >= task_queue%tasks) exit
          call show_progress(progress_line, task_queue, 0.5_dp)
          next_poll = wall_seconds() + max(nap, task_queue%communicator%size/polls_a_second)
        end if
        call sleep_for(nap)
      end do
    end subroutine wait_for_others

  end subroutine run_tasks

  !> Whether the run must stop: another rank has counted a stop request in the task queue, or this
  !> rank has one (`stop_requested`), which it counts there.
  logical function stop_is_wanted(task_queue) result(stopping)
    type(task_queue_type), intent(in) :: task_queue

    stopping = read_counter(task_queue, stop_wanted) > 0
    if (stopping) return
    stopping = stop_requested()
    if (stopping) call add_to_counter(task_queue, stop_wanted, 1_int64)
  end function stop_is_wanted

  !> Runs a task to its end, or until the run must stop; then its state is saved and `stopped` set.
  !> An error of the task itself becomes a failed result; `error` is an error of the journal.
  subroutine run_task(task, file_particles, journal, task_queue, monitor, progress_line, found, &
    stopped, error)
    type(task_type), intent(in) :: task
    !> Particles of the initial file; arrays are not allocated if there is none.
    type(particles_type), intent(in) :: file_particles
    type(journal_type), intent(inout) :: journal
    type(task_queue_type), intent(in) :: task_queue
    type(monitor_type), intent(inout) :: monitor
    type(progress_line_type), intent(inout) :: progress_line
    !> Result of the task, unless it was stopped.
    type(task_result_type), intent(out) :: found
    logical, intent(out) :: stopped
    type(error_type), allocatable, intent(out) :: error
    type(simulation_type) :: simulation
    type(error_type), allocatable :: failure
    real(dp) :: cpu_before, cpu_at_start, start_seconds, start_date, now
    integer(int64) :: reported

    stopped = .false.
    start_seconds = wall_seconds()
    start_date = utc_seconds()
    cpu_at_start = cpu_seconds()
    call resume_or_begin_task(task, file_particles, journal, simulation, cpu_before, failure, error)
    if (allocated(error)) return
    reported = 0
    if (.not. allocated(failure)) reported = simulation%observer%collisions
    monitor%next_checkpoint = wall_seconds() + monitor%checkpoint_interval
    do while (.not. allocated(failure))
      if (simulation%done) exit
      call advance_some_windows(simulation)
      now = wall_seconds()
      if (now >= monitor%next_mpi_progress) then
        call drive_mpi_progress(task_queue)
        monitor%next_mpi_progress = now + mpi_progress_interval
      end if
      if (now < monitor%next_poll .and. .not. stop_requested()) cycle
      call exchange_with_queue()
      call show_progress(progress_line, task_queue, real(progress(simulation), dp))
      if (simulation%done) exit
      stopped = monitor%stopping
      now = wall_seconds()
      if (.not. stopped .and. now < monitor%next_checkpoint) cycle
      call write_state(journal, task, simulation, cpu_before + cpu_seconds() - cpu_at_start, error)
      if (stopped .or. allocated(error)) exit
      monitor%next_checkpoint = wall_seconds() + monitor%checkpoint_interval
    end do
    monitor%busy = monitor%busy + wall_seconds() - start_seconds
    ! A task that was stopped before its state was saved starts again.
    if (allocated(failure)) stopped = failure%code == exit_stopped_early
    if (stopped .or. allocated(error)) return
    if (.not. allocated(failure)) call verify_simulation(simulation, failure)
    if (allocated(failure)) then
      found = failed_result(task, failure%message)
    else
      call add_to_counter(task_queue, collisions_done, simulation%observer%collisions - reported)
      found = result_of(task, simulation, cpu_before + cpu_seconds() - cpu_at_start, start_date)
    end if

  contains

    !> Adds the collisions since the last call to the queue's counter, and reads whether to stop.
    subroutine exchange_with_queue()
      real(dp) :: now, after

      now = wall_seconds()
      call add_to_counter(task_queue, collisions_done, simulation%observer%collisions - reported)
      reported = simulation%observer%collisions
      monitor%stopping = stop_is_wanted(task_queue)
      after = wall_seconds()
      monitor%next_poll = after + min(longest_poll_interval, max((after - now)/poll_share, &
        poll_interval, task_queue%communicator%size/polls_a_second))
    end subroutine exchange_with_queue

  end subroutine run_task

  !> Advances a simulation by several windows, between two readings of the clock.
  subroutine advance_some_windows(simulation)
    type(simulation_type), intent(inout) :: simulation
    integer :: window

    do window = 1, max(1, windows_between_clock_readings*few_particles &
      /max(few_particles, simulation%engine%number))
      call advance_simulation(simulation)
      if (simulation%done .or. stop_requested()) exit
    end do
  end subroutine advance_some_windows

  !> Continues a task from its saved state if there is one, else begins it.
  subroutine resume_or_begin_task(task, file_particles, journal, simulation, cpu_before, failure, &
    error)
    type(task_type), intent(in) :: task
    type(particles_type), intent(in) :: file_particles
    type(journal_type), intent(inout) :: journal
    type(simulation_type), intent(out) :: simulation
    real(dp), intent(out) :: cpu_before
    !> Error of the task; of the journal.
    type(error_type), allocatable, intent(out) :: failure, error
    logical :: resumed

    cpu_before = 0.0_dp
    associate (setup => task%setup)
      call check_memory(need_type(bytes_per_particle(setup%engine, &
        any(setup%table%urn%truncates_passages))*setup%number), to_text(setup%number) &
        //' particles', failure)
    end associate
    if (allocated(failure)) return
    call read_state(journal, task, simulation, cpu_before, resumed, failure, error)
    if (resumed .or. allocated(failure) .or. allocated(error)) return
    call begin_task(task, file_particles, simulation, failure)
  end subroutine resume_or_begin_task

end module battery_task_loop
