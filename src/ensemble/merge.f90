!> From the journal of an ensemble to its results file, and back to what an earlier run has left.
module battery_merge
  use, intrinsic :: iso_fortran_env, only: compiler_version, compiler_options
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  use battery_kinds, only: dp
  use battery_build_information, only: program_version, git_commit
  use battery_error, only: error_type, exit_failure
  use battery_files, only: file_exists
  use battery_plan, only: plan_type
  use battery_tasks, only: task_count, task_of
  use battery_task, only: task_type
  use battery_task_result, only: task_result_type
  use battery_journal, only: journal_type, read_rank_file
  use battery_communicator, only: mpi_library
  use battery_metadata, only: metadata_type, read_metadata
  use battery_results, only: results_type, new_results, task_complete, task_failed
  use battery_fingerprint, only: fingerprint_text
  use battery_text, only: string_type
  use battery_results_file, only: write_results
  implicit none (type, external)
  private
  public :: merge_results, collect_results, existing_results

contains

  !> Writes the results file from all that the journal has, which comes back in `results`.
  subroutine merge_results(plan, journal, ranks, results, failures, error)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(in) :: journal
    integer, intent(in) :: ranks
    type(results_type), intent(out) :: results
    !> Why a task failed; not allocated where it did not.
    type(string_type), allocatable, intent(out) :: failures(:)
    type(error_type), allocatable, intent(out) :: error
    type(metadata_type) :: metadata

    call collect_results(plan, journal, results, failures)
    metadata%program = 'battery'
    metadata%version = program_version
    metadata%git_commit = git_commit
    metadata%compiler = compiler_version()
    metadata%compiler_options = compiler_options()
    metadata%mpi_library = mpi_library()
    metadata%mpi_ranks = ranks
    metadata%namelist = plan%text
    metadata%initial_file_fingerprint = ''
    if (plan%initial_file /= '') &
      metadata%initial_file_fingerprint = fingerprint_text(plan%initial_fingerprint)
    metadata%status = merge('complete', 'partial ', all(results%task_status == task_complete))
    metadata%status = trim(metadata%status)
    metadata%shape = plan%shape
    metadata%engine = plan%engine
    metadata%urn_radius = real(plan%urn_radius, dp)
    metadata%channel1_length = real(plan%channel1_length, dp)
    metadata%channel2_length = real(plan%channel2_length, dp)
    metadata%start_time = real(plan%start_time, dp)
    call write_results(plan%file, results, metadata, error)
  end subroutine merge_results

  !> All results of the journal, in the arrays of the results file.
  subroutine collect_results(plan, journal, results, failures)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(in) :: journal
    type(results_type), intent(out) :: results
    type(string_type), allocatable, intent(out) :: failures(:)
    type(task_result_type), allocatable :: found(:)
    type(task_type) :: task
    integer :: file, k

    allocate (failures(task_count(plan)))
    call new_results(results, plan%point_count, plan%replicas)
    do k = 1, task_count(plan)
      task = task_of(plan, k)
      results%number(task%point) = task%number
      results%threshold(task%point) = task%setup%threshold
      results%urn1_number(task%point) = task%urn1_number
      results%channel1_width(task%point) = real(task%setup%table%channel1_width, dp)
      results%channel2_width(task%point) = real(task%setup%table%channel2_width, dp)
      results%seed(task%replica, task%point) = task%seed
    end do
    do file = 0, journal%rank_files - 1
      call read_rank_file(journal, file, found)
      do k = 1, size(found)
        if (found(k)%task < 1 .or. found(k)%task > task_count(plan)) cycle
        task = task_of(plan, found(k)%task)
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
      results%collisions(r, p) = found%collisions
      results%bounce_backs(r, p) = found%bounce_backs
      results%reversals(r, p) = found%reversals
      results%trapped(r, p) = found%trapped
      results%chi(r, p) = found%chi
      results%chi_error(r, p) = found%chi_error
      results%chi_collision(r, p) = found%chi_collision
      results%current1(r, p) = found%current1
      results%current1_error(r, p) = found%current1_error
      results%current2(r, p) = found%current2
      results%current2_error(r, p) = found%current2_error
      results%flow1_12(r, p) = found%flow(1)
      results%flow1_21(r, p) = found%flow(2)
      results%flow2_12(r, p) = found%flow(3)
      results%flow2_21(r, p) = found%flow(4)
      results%time(r, p) = found%time
      results%transient_time(r, p) = found%transient_time
      results%cpu_seconds(r, p) = found%cpu_seconds
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

    n = task%number
    entries = size(found%series_urn1_number)
    if (entries > 0) then
      call room_for_series(entries, plan, results)
      results%series_urn1_number(:entries, task%replica, task%point) = int(found%series_urn1_number)
      do q = 1, 4
        results%series_flow(:entries, task%replica, task%point, q) = found%series_flow(q::4)
      end do
    end if
    if (size(found%snapshots) > 0) then
      call room_for_snapshots(n, plan, results)
      do k = 1, size(results%snapshot_time)
        call unpack_state(found%snapshots(4*n*(k - 1) + 1:4*n*k), n, &
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
      results%event_kind = int(found%events(:k))
      results%event_where = int(found%events(k + 1:2*k))
      results%event_particle = int(found%events(2*k + 1:3*k))
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
    allocate (flow(entries, plan%replicas, plan%point_count, 4), source=unknown())
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
        source=unknown())
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
      allocate (longer(n, plan%replicas, plan%point_count), source=unknown())
      if (before > 0) longer(:before, :, :) = array
      call move_alloc(longer, array)
    end subroutine extend

  end subroutine room_for_final

  pure function unknown()
    real(dp) :: unknown

    unknown = ieee_value(unknown, ieee_quiet_nan)
  end function unknown

  !> What stands under the name of the output file: nothing, or results of which input, complete or
  !> not. Anything else there is an error: with the code `exit_failure` if it is a results file that
  !> is damaged, else with `exit_bad_input`.
  subroutine existing_results(file, input_text, initial_fingerprint, found, complete, error)
    character(len=*), intent(in) :: file
    character(len=:), allocatable, intent(out) :: input_text
    !> Of the initial file, in hexadecimal digits; empty if there was none.
    character(len=:), allocatable, intent(out) :: initial_fingerprint
    logical, intent(out) :: found, complete
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: status

    complete = .false.
    input_text = ''
    initial_fingerprint = ''
    found = file_exists(file)
    if (.not. found) return
    call read_metadata(file, input_text, status, error, initial_fingerprint)
    complete = .not. allocated(error) .and. status == 'complete'
    if (.not. allocated(error)) return
    if (error%code == exit_failure) then
      error%message = error%message//'; there is no journal to write it anew from: ' &
        //'remove the file, or compute it again with --overwrite'
    else
      error%message = error%message//', but is there already; name another output file, ' &
        //'move it away, or discard it with --overwrite'
    end if
  end subroutine existing_results

end module battery_merge
