!> The task queue of an ensemble under load: `mpirun -n RANKS bench board [TASKS]`.
!>
!> All ranks fetch empty tasks from the queue of rank 0, so the rate of requests is higher than in
!> any ensemble. In the first round rank 0 only drives MPI progress at intervals, as it does while
!> it computes; in the second it fetches tasks too. The result is JSON with rates and latencies.
module battery_bench_task_queue
  use battery_kinds, only: dp, int64
  use battery_clocks, only: wall_seconds
  use battery_communicator, only: communicator_type, task_queue_type, open_communicator, &
    close_communicator, open_task_queue, close_task_queue, fetch_task, add_to_counter, &
    read_counter, drive_mpi_progress, mpi_progress_interval, least_mean_greatest, wait_for_all, &
    tasks_finished
  implicit none (type, external)
  private
  public :: bench_task_queue

contains

  !> Runs both rounds, and writes the results as JSON.
  subroutine bench_task_queue(unit, tasks)
    integer, intent(in) :: unit
    !> Number of tasks in the queue.
    integer, intent(in) :: tasks
    type(communicator_type) :: communicator
    real(dp) :: began, start_seconds, computing(3), fetching(3)

    began = wall_seconds()
    call open_communicator(communicator)
    start_seconds = wall_seconds() - began
    call measure_round(communicator, tasks, communicator%size > 1, computing)
    call measure_round(communicator, tasks, .false., fetching)
    if (communicator%rank == 0) then
      write (unit, '(a, i0, a, i0, a, f0.3, a)') '{"ranks": ', communicator%size, ', "tasks": ', &
        tasks, ', "start_seconds": ', start_seconds, ','
      call write_round('rank0_computes', computing, '},')
      call write_round('rank0_takes_part', fetching, '}}')
    end if
    call close_communicator(communicator)

  contains

    !> Writes the results of a round, as `measure_round` gives them, and then `end`.
    subroutine write_round(name, measured, end)
      character(len=*), intent(in) :: name, end
      real(dp), intent(in) :: measured(3)

      write (unit, '(3a, es10.3, a, es10.3, a, es10.3, a)') ' "', name, '": {"tasks_a_second":', &
        measured(1), ', "mean_latency":', measured(2), ', "longest_latency":', measured(3), end
    end subroutine write_round

  end subroutine bench_task_queue

  !> Runs one round.
  subroutine measure_round(communicator, tasks, rank0_computes, measured)
    type(communicator_type), intent(in) :: communicator
    !> Number of tasks in the queue.
    integer, intent(in) :: tasks
    !> Whether rank 0 only drives MPI progress, and fetches no tasks.
    logical, intent(in) :: rank0_computes
    !> Tasks per second of all ranks together; mean and longest time of one operation on the queue,
    !> in seconds.
    real(dp), intent(out) :: measured(3)
    type(task_queue_type) :: task_queue
    real(dp) :: began, before, after, summary(3), longest, spent
    integer :: task, k, operations

    call open_task_queue(task_queue, communicator, [(k, k=1, tasks)])
    longest = 0.0_dp
    operations = 0
    began = wall_seconds()
    if (rank0_computes .and. communicator%rank == 0) then
      call drive_until_done()
    else
      after = began
      do
        before = after
        call fetch_task(task_queue, task)
        if (task == 0) exit
        call add_to_counter(task_queue, tasks_finished, 1_int64)
        after = wall_seconds()
        ! Each task needs three operations on the queue.
        operations = operations + 3
        longest = max(longest, (after - before)/3.0_dp)
      end do
    end if
    spent = wall_seconds() - began
    call wait_for_all(communicator)
    summary = least_mean_greatest(communicator, wall_seconds() - began)
    measured(1) = tasks/summary(3)
    summary = least_mean_greatest(communicator, merge(spent, 0.0_dp, operations > 0))
    measured(2) = summary(2)*communicator%size
    summary = least_mean_greatest(communicator, real(operations, dp))
    measured(2) = measured(2)/max(summary(2)*communicator%size, 1.0_dp)
    summary = least_mean_greatest(communicator, longest)
    measured(3) = summary(3)
    call close_task_queue(task_queue)

  contains

    !> Keeps rank 0 busy, and drives MPI progress at intervals, until all tasks are finished.
    subroutine drive_until_done()
      real(dp) :: next

      do
        next = wall_seconds() + mpi_progress_interval
        do while (wall_seconds() < next)
          continue
        end do
        call drive_mpi_progress(task_queue)
        if (read_counter(task_queue, tasks_finished) >= tasks) exit
      end do
    end subroutine drive_until_done

  end subroutine measure_round

end module battery_bench_task_queue
