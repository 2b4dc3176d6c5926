!> From the results of tasks in a journal to the arrays of the results file.
module battery_collection
  use battery_kinds, only: dp, int64
  use battery_journal, only: journal_type, read_rank_file, rank_files_of
  use battery_plan, only: plan_type
  use battery_quantities, only: unknown_real
  use battery_results, only: results_type, new_results, task_complete, task_failed
  use battery_table, only: gated, ungated
  use battery_task, only: task_type
  use battery_task_result, only: task_result_type
  use battery_tasks, only: task_count, task_of
  use battery_text, only: string_type
  implicit none (type, external)
  private
  public :: collect_results

contains

  !> All results of the journal, in the arrays of the results file.
  subroutine collect_results(plan, journal, results, failures)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(in) :: journal
    type(results_type), intent(out) :: results
    !> Why a task failed, (task); not allocated where it did not.
    type(string_type), allocatable, intent(out) :: failures(:)
    type(task_result_type), allocatable :: found(:)
    type(task_type) :: task
    integer, allocatable :: files(:)
    integer :: file, k

    allocate (failures(task_count(plan)))
    call new_results(results, plan%point_count, plan%replicas)
    results%scanned = plan%scanned
    do k = 1, task_count(plan)
      task = task_of(plan, k)
      results%number(task%point) = task%number
      results%threshold(task%point) = task%setup%threshold(1)
      results%gate_threshold(:, task%point) = task%setup%threshold
      results%urn1_number(task%point) = task%urn1_number
      associate (table => task%setup%table, p => task%point)
        results%urn_radius(:, p) = real(table%urn%radius, dp)
        results%channel1_width(p) = real(table%channel(gated)%width, dp)
        results%channel1_length(p) = real(table%channel(gated)%length, dp)
        results%channel2_width(p) = real(table%channel(ungated)%width, dp)
        results%channel2_length(p) = real(table%channel(ungated)%length, dp)
      end associate
      results%seed(task%replica, task%point) = task%setup%seed
    end do
    files = rank_files_of(journal)
    do file = 1, size(files)
      call read_rank_file(journal, files(file), found)
      do k = 1, size(found)
        if (found(k)%task < 1 .or. found(k)%task > task_count(plan)) cycle
        task = task_of(plan, found(k)%task)
        if (found(k)%kept /= task%kept) cycle
        if (results%task_status(task%replica, task%point) == task_complete) cycle
        call place(plan, found(k), task, results)
        if (allocated(failures(found(k)%task)%text)) deallocate (failures(found(k)%task)%text)
        if (found(k)%status == task_failed) failures(found(k)%task)%text = found(k)%message
      end do
    end do
  end subroutine collect_results

  !> Puts one result into its place.
  subroutine place(plan, found, task, results)
    type(plan_type), intent(in) :: plan
    type(task_result_type), intent(in) :: found
    type(task_type), intent(in) :: task
    type(results_type), intent(inout) :: results

    associate (p => task%point, r => task%replica)
      results%task_status(r, p) = found%status
      results%average(r, p, :) = found%measured%average
      results%error(r, p, :) = found%measured%error
      results%counted(r, p, :) = found%measured%counted
      call place_arrays(plan, found, task, results)
    end associate
  end subroutine place

  !> Series, snapshots, events and final state; runs of unequal length leave NaN behind the shorter.
  subroutine place_arrays(plan, found, task, results)
    type(plan_type), intent(in) :: plan
    type(task_result_type), intent(in) :: found
    type(task_type), intent(in) :: task
    type(results_type), intent(inout) :: results
    integer :: n, entries, k, q
    integer(int64) :: at

    n = task%number
    entries = size(found%series_urn1_number)
    if (entries > 0) then
      call room_for_series(entries, plan, results)
      results%series_urn1_number(:entries, task%replica, task%point) = found%series_urn1_number
      do q = 1, 4
        results%series_flow(:entries, task%replica, task%point, q) = found%series_flow(q::4)
      end do
    end if
    if (size(found%snapshots) > 0) then
      call room_for_snapshots(n, plan, results)
      do k = 1, size(results%snapshot_time)
        at = 4_int64*n*(k - 1)
        call unpack_state(found%snapshots(at + 1:at + 4_int64*n), n, &
          results%snapshot_x(:, k, task%replica, task%point), &
          results%snapshot_y(:, k, task%replica, task%point), &
          results%snapshot_ux(:, k, task%replica, task%point), &
          results%snapshot_uy(:, k, task%replica, task%point))
      end do
    end if
    if (size(found%final_state) > 0) then
      call room_for_final(n, plan, results)
      call unpack_state(found%final_state, n, results%final_x(:, task%replica, task%point), &
        results%final_y(:, task%replica, task%point), results%final_ux(:, task%replica, &
        task%point), results%final_uy(:, task%replica, task%point))
    end if
    if (plan%event_log) then
      k = size(found%event_times)
      results%event_time = found%event_times
      results%event_kind = found%events(:k)
      results%event_where = found%events(k + 1:2*k)
      results%event_particle = found%events(2*k + 1:3*k)
    end if
  end subroutine place_arrays

  pure subroutine unpack_state(flat, n, x, y, ux, uy)
    real(dp), intent(in) :: flat(:)
    integer, intent(in) :: n
    real(dp), intent(inout) :: x(:), y(:), ux(:), uy(:)

    x(:n) = flat(:n)
    y(:n) = flat(n + 1:2*n)
    ux(:n) = flat(2*n + 1:3*n)
    uy(:n) = flat(3*n + 1:4*n)
  end subroutine unpack_state

  !> Series arrays with room for `entries` entries of every task; keeps what is there.
  subroutine room_for_series(entries, plan, results)
    integer, intent(in) :: entries
    type(plan_type), intent(in) :: plan
    type(results_type), intent(inout) :: results
    integer, allocatable :: urn1_number(:, :, :)
    real(dp), allocatable :: flow(:, :, :, :)
    integer :: before, k

    before = 0
    if (allocated(results%series_time)) before = size(results%series_time)
    if (entries <= before) return
    allocate (urn1_number(entries, plan%replicas, plan%point_count), source=-1)
    allocate (flow(entries, plan%replicas, plan%point_count, 4), source=unknown_real())
    if (before > 0) then
      urn1_number(:before, :, :) = results%series_urn1_number
      flow(:before, :, :, :) = results%series_flow
    end if
    call move_alloc(urn1_number, results%series_urn1_number)
    call move_alloc(flow, results%series_flow)
    results%series_time = [(real(k - 1, dp)*real(plan%series_interval, dp), k=1, entries)]
  end subroutine room_for_series

  !> Snapshot arrays with room for `n` particles; keeps what is there.
  subroutine room_for_snapshots(n, plan, results)
    integer, intent(in) :: n
    type(plan_type), intent(in) :: plan
    type(results_type), intent(inout) :: results

    if (.not. allocated(results%snapshot_time)) results%snapshot_time = real(plan%snapshot_times, &
      dp)
    call extend(results%snapshot_x)
    call extend(results%snapshot_y)
    call extend(results%snapshot_ux)
    call extend(results%snapshot_uy)

  contains

    subroutine extend(array)
      real(dp), allocatable, intent(inout) :: array(:, :, :, :)
      real(dp), allocatable :: longer(:, :, :, :)
      integer :: before

      before = 0
      if (allocated(array)) before = size(array, 1)
      if (n <= before) return
      allocate (longer(n, size(plan%snapshot_times), plan%replicas, plan%point_count), &
        source=unknown_real())
      if (before > 0) longer(:before, :, :, :) = array
      call move_alloc(longer, array)
    end subroutine extend

  end subroutine room_for_snapshots

  !> Arrays of the final state with room for `n` particles; keeps what is there.
  subroutine room_for_final(n, plan, results)
    integer, intent(in) :: n
    type(plan_type), intent(in) :: plan
    type(results_type), intent(inout) :: results

    call extend(results%final_x)
    call extend(results%final_y)
    call extend(results%final_ux)
    call extend(results%final_uy)

  contains

    subroutine extend(array)
      real(dp), allocatable, intent(inout) :: array(:, :, :)
      real(dp), allocatable :: longer(:, :, :)
      integer :: before

      before = 0
      if (allocated(array)) before = size(array, 1)
      if (n <= before) return
      allocate (longer(n, plan%replicas, plan%point_count), source=unknown_real())
      if (before > 0) longer(:before, :, :) = array
      call move_alloc(longer, array)
    end subroutine extend

  end subroutine room_for_final

end module battery_collection
