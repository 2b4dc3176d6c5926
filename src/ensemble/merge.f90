!> From the journal of an ensemble to its results file.
module battery_merge
  use battery_kinds, only: wp, dp, int64
  use battery_error, only: error_type, exit_bad_input
  use battery_files, only: file_exists, is_as_seen
  use battery_fingerprint, only: fingerprint_text
  use battery_journal, only: journal_type, read_rank_file, rank_files_of
  use battery_metadata, only: metadata_type, add_text
  use battery_plan, only: plan_type, point_of
  use battery_precision, only: decide
  use battery_provenance, only: add_origin, command_text
  use battery_quantities, only: counted_quantities, place_of, unknown_real, unknown_count
  use battery_results, only: results_type, new_results, task_complete, task_failed, &
    task_not_asked, point_undecided, all_complete
  use battery_results_file, only: read_results, write_results
  use battery_task_result, only: task_result_type
  use battery_tasks, only: task_type, task_count, task_of, roster_type, roster_of, number_in, &
    kept_in_results
  use battery_text, only: string_type, to_text, join, new_line_character
  implicit none (type, external)
  private
  public :: merge_results, collect_results

contains

  !> Writes the results file from all that the journal has, and what the file has already; it comes
  !> back in `results`.
  subroutine merge_results(plan, journal, begun, results, failures, error)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(in) :: journal
    !> When the run began.
    character(len=*), intent(in) :: begun
    type(results_type), intent(out) :: results
    !> Why a task failed; not allocated where it did not.
    type(string_type), allocatable, intent(out) :: failures(:)
    type(error_type), allocatable, intent(out) :: error
    type(metadata_type) :: metadata
    integer, allocatable :: wanted(:)

    call collect_results(plan, journal, .true., results, failures, wanted, error)
    if (allocated(error)) return
    call forget_unasked(results, wanted)
    call add_origin(metadata)
    call add_text(metadata, 'namelist', plan%text)
    call add_text(metadata, 'initial_file_fingerprint', trim(merge(repeat(' ', 16), &
      fingerprint_text(plan%initial_fingerprint), plan%initial_file == '')))
    call add_text(metadata, 'status', trim(merge('complete', 'partial ', &
      all_complete(results))))
    call add_text(metadata, 'shape', plan%shape)
    call add_text(metadata, 'urn_shape', plan%urn_shape)
    metadata%urn_sides = plan%urn_sides
    if (allocated(plan%outline(1)%corner)) then
      metadata%urn_vertices = real(plan%outline(1)%corner, dp)
      metadata%urn2_vertices = real(plan%outline(2)%corner, dp)
    end if
    if (size(plan%scatterers) > 0) call add_text(metadata, 'scatterers', &
      numbers_text(plan%scatterers))
    call add_text(metadata, 'engine', plan%engine)
    metadata%command_line = command_text()
    metadata%begun = begun
    metadata%hosts = join(results%host, new_line_character)
    metadata%mpi_ranks = journal%ranks
    metadata%start_time = real(plan%start_time, dp)
    call write_results(plan%file, results, metadata, journal%ownership%before, error)
  end subroutine merge_results

  !> Numbers set apart by blanks.
  pure function numbers_text(numbers) result(text)
    real(wp), intent(in) :: numbers(:)
    character(len=:), allocatable :: text
    type(string_type) :: words(size(numbers))
    integer :: k

    do k = 1, size(numbers)
      words(k)%text = to_text(numbers(k))
    end do
    text = join(words, ' ')
  end function numbers_text

  !> All results there are, in the arrays of the results file. A file that is there is read only
  !> where the journal does not have all.
  subroutine collect_results(plan, journal, whole, results, failures, wanted, error)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(in) :: journal
    !> Whether points, seeds, series, states and events are collected as well.
    logical, intent(in) :: whole
    type(results_type), intent(out) :: results
    !> Why a task failed, (task); not allocated where it did not.
    type(string_type), allocatable, intent(out) :: failures(:)
    !> Replicas that are asked for, (point).
    integer, allocatable, intent(out) :: wanted(:)
    !> The file is whole, but not what this program writes; one that is damaged is passed over.
    type(error_type), allocatable, intent(out) :: error
    type(task_result_type), allocatable :: found(:)
    type(results_type) :: before
    type(roster_type) :: roster
    type(task_type) :: task
    integer, allocatable :: files(:)
    integer :: file, k, r, p
    logical :: old

    allocate (failures(task_count(plan)))
    call new_results(results, plan%point_count, plan%replicas)
    results%scanned = plan%scanned
    do k = 1, merge(task_count(plan), 0, whole)
      task = task_of(plan, k)
      results%point(task%point) = point_of(plan, task%point)
      results%point(task%point)%urn_radius = task%setup%table%urn%radius
      results%seed(task%replica, task%point) = task%setup%seed
    end do
    files = rank_files_of(journal)
    if (size(files) > 0 .or. file_exists(plan%file)) roster = roster_of(plan)
    do file = 1, size(files)
      call read_rank_file(journal, files(file), found)
      do k = 1, size(found)
        call take(found(k))
      end do
    end do
    old = file_exists(plan%file)
    ! What has appeared there since the run began is none of its business.
    if (whole .and. old) old = is_as_seen(plan%file, journal%ownership%before)
    if (old .and. any(results%task_status /= task_complete)) then
      call read_results(plan%file, whole, before, error)
      if (allocated(error)) then
        if (error%code == exit_bad_input) return
        deallocate (error)
        if (allocated(before%seed)) deallocate (before%seed)
      end if
    end if
    if (allocated(before%seed)) then
      do p = 1, size(before%task_status, 2)
        do r = 1, before%replicas
          k = number_in(roster, kept_in_results(plan, before%seed(r, p)))
          if (before%task_status(r, p) == task_complete .and. k > 0) &
            call take(taken_from(before, task_of(plan, k), r, p))
        end do
      end do
    end if
    call decide(plan, results, wanted)

  contains

    !> Takes a result if it is one of this plan, and there is none already.
    subroutine take(one)
      type(task_result_type), intent(in) :: one
      integer :: number

      number = number_in(roster, one%kept)
      if (number == 0) return
      task = task_of(plan, number)
      if (results%task_status(task%replica, task%point) == task_complete) return
      call place(plan, one, task, whole, results)
      if (allocated(failures(number)%text)) deallocate (failures(number)%text)
      if (one%status == task_failed) failures(number)%text = one%message
    end subroutine take

  end subroutine collect_results

  !> The result of a task from the place (r, p) of its results file: `place` the other way round.
  function taken_from(results, task, r, p) result(found)
    type(results_type), intent(in) :: results
    type(task_type), intent(in) :: task
    integer, intent(in) :: r, p
    type(task_result_type) :: found
    integer :: n

    found%kept = task%kept
    found%status = task_complete
    found%measured%average = results%average(r, p, :)
    found%measured%error = results%error(r, p, :)
    found%measured%counted = results%counted(r, p, :)
    found%host = results%host(1 + results%counted(r, p, place_of('provenance/host', &
      counted_quantities())))%text
    allocate (found%series_urn1_number(0), found%snapshots(0), found%final_state(0))
    if (allocated(results%series_time)) then
      n = count(results%series_urn1_number(:, r, p) >= 0)
      found%series_urn1_number = results%series_urn1_number(:n, r, p)
      found%series_flow = pack(transpose(results%series_flow(:n, r, p, :)), .true.)
    end if
    if (allocated(results%snapshots)) found%snapshots = flat(results%snapshots(:task%number, :, r, &
      p, :))
    if (allocated(results%final_state)) found%final_state = flat(results%final_state( &
      :task%number, :, r, p, :))
  end function taken_from

  !> States (particle, time, which) as `place_states` takes them.
  pure function flat(states) result(array)
    real(dp), intent(in) :: states(:, :, :)
    real(dp), allocatable :: array(:)
    integer :: time

    array = [(pack(states(:, time, :), .true.), time=1, size(states, 2))]
  end function flat

  !> Replicas that nobody asks for, of points that are decided, are as if they had never been: they
  !> may be left from a run that asked for more.
  subroutine forget_unasked(results, wanted)
    type(results_type), intent(inout) :: results
    integer, intent(in) :: wanted(:)
    integer :: p

    if (.not. allocated(results%point_status)) return
    do p = 1, size(wanted)
      if (results%point_status(p) == point_undecided) cycle
      associate (n => wanted(p) + 1)
        results%task_status(n:, p) = task_not_asked
        results%average(n:, p, :) = unknown_real()
        results%error(n:, p, :) = unknown_real()
        results%counted(n:, p, :) = unknown_count
        if (allocated(results%series_flow)) then
          results%series_urn1_number(:, n:, p) = int(unknown_count)
          results%series_flow(:, n:, p, :) = unknown_real()
        end if
        if (allocated(results%snapshots)) results%snapshots(:, :, n:, p, :) = unknown_real()
        if (allocated(results%final_state)) results%final_state(:, :, n:, p, :) = unknown_real()
      end associate
    end do
  end subroutine forget_unasked

  !> Place of a text in a list from 0; it is added where it is not there.
  integer(int64) function place_among(text, list) result(place)
    character(len=*), intent(in) :: text
    type(string_type), allocatable, intent(inout) :: list(:)
    type(string_type) :: one

    do place = 0, size(list) - 1
      if (list(place + 1)%text == text) return
    end do
    one%text = text
    list = [list, one]
  end function place_among

  !> Puts one result into its place; runs of unequal length leave NaN behind the shorter.
  subroutine place(plan, found, task, whole, results)
    type(plan_type), intent(in) :: plan
    type(task_result_type), intent(in) :: found
    type(task_type), intent(in) :: task
    !> Whether series, states and events are placed as well.
    logical, intent(in) :: whole
    type(results_type), intent(inout) :: results
    integer :: entries, k

    associate (p => task%point, r => task%replica)
      results%task_status(r, p) = found%status
      results%average(r, p, :) = found%measured%average
      results%error(r, p, :) = found%measured%error
      results%counted(r, p, :) = found%measured%counted
      results%counted(r, p, place_of('provenance/host', counted_quantities())) &
        = place_among(found%host, results%host)
      if (.not. whole) return
      entries = size(found%series_urn1_number)
      if (entries > 0) then
        call room_for_series(entries, r, plan, results)
        results%series_urn1_number(:entries, r, p) = found%series_urn1_number
        do k = 1, 4
          results%series_flow(:entries, r, p, k) = found%series_flow(k::4)
        end do
      end if
    end associate
    if (size(found%snapshots) > 0) then
      results%snapshot_time = real(plan%snapshot_times, dp)
      call place_states(plan, found%snapshots, size(plan%snapshot_times), task, results%snapshots)
    end if
    if (size(found%final_state) > 0) &
      call place_states(plan, found%final_state, 1, task, results%final_state)
    if (plan%event_log) then
      k = size(found%event_times)
      results%event_time = found%event_times
      results%event_kind = found%events(:k)
      results%event_where = found%events(k + 1:2*k)
      results%event_particle = found%events(2*k + 1:3*k)
    end if
  end subroutine place

  !> Puts the states of a task at `times` times into their places in `states`, where there is room
  !> for them afterwards.
  subroutine place_states(plan, flat, times, task, states)
    type(plan_type), intent(in) :: plan
    !> One time after the other: x, y, ux, uy of all particles.
    real(dp), intent(in) :: flat(:)
    integer, intent(in) :: times
    type(task_type), intent(in) :: task
    real(dp), allocatable, intent(inout) :: states(:, :, :, :, :)
    real(dp), allocatable :: longer(:, :, :, :, :)
    integer :: n, before(2), time, which
    integer(int64) :: at

    n = task%number
    before = 0
    if (allocated(states)) before = [size(states, 1), size(states, 3)]
    if (n > before(1) .or. task%replica > before(2)) then
      allocate (longer(max(n, before(1)), times, room_for_replicas(plan, task%replica, &
        before(2)), plan%point_count, 4), source=unknown_real())
      if (allocated(states)) longer(:before(1), :, :before(2), :, :) = states
      call move_alloc(longer, states)
    end if
    at = 0
    do time = 1, times
      do which = 1, 4
        states(:n, time, task%replica, task%point, which) = flat(at + 1:at + n)
        at = at + n
      end do
    end do
  end subroutine place_states

  !> For how many replicas of a point there should be room where `replica` comes next and there is
  !> room for `before`: few points get as many as a precision allows.
  pure integer function room_for_replicas(plan, replica, before) result(room)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: replica, before

    room = before
    if (replica > before) room = min(plan%replicas, max(replica, plan%first_replicas, &
      before + before/2))
  end function room_for_replicas

  !> Series arrays with room for `entries` entries of a replica; keeps what is there.
  subroutine room_for_series(entries, replica, plan, results)
    integer, intent(in) :: entries, replica
    type(plan_type), intent(in) :: plan
    type(results_type), intent(inout) :: results
    integer, allocatable :: urn1_number(:, :, :)
    real(dp), allocatable :: flow(:, :, :, :)
    integer :: before(2), most, room, k

    before = 0
    if (allocated(results%series_time)) before = [size(results%series_time), &
      size(results%series_flow, 2)]
    if (entries <= before(1) .and. replica <= before(2)) return
    most = max(entries, before(1))
    room = room_for_replicas(plan, replica, before(2))
    allocate (urn1_number(most, room, plan%point_count), source=-1)
    allocate (flow(most, room, plan%point_count, 4), source=unknown_real())
    if (allocated(results%series_time)) then
      urn1_number(:before(1), :before(2), :) = results%series_urn1_number
      flow(:before(1), :before(2), :, :) = results%series_flow
    end if
    call move_alloc(urn1_number, results%series_urn1_number)
    call move_alloc(flow, results%series_flow)
    results%series_time = [(real(k - 1, dp)*real(plan%series_interval, dp), k=1, most)]
  end subroutine room_for_series

end module battery_merge
