!> Finishes an ensemble: makes its results file from the journal and the old results file.
!>
!> First all records are read once, one in memory at a time: the numbers of each task are stored in
!> arrays, with the place of its record and the greatest lengths of any output (`collect_results`).
!> Tasks that the journal does not have are taken from the old results file. From this the new file
!> is made and its datasets are prepared. Then, in the order of the tasks, each output is copied
!> from its place into its hyperslab (`copy_outputs`), one in memory at a time. The old file is
!> replaced when the new one is complete.
module battery_merge
  use battery_kinds, only: dp, int32, int64
  use battery_clocks, only: utc_now
  use battery_checksum_footer, only: check_unchanged
  use battery_command_line, only: command_line_words
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_files, only: file_stamp_type, may_open
  use battery_fingerprint, only: fingerprint_text
  use battery_hdf5_file, only: hdf5_file_type, open_file, make_group, write_attribute, &
    write_text_attribute, no_handle
  use battery_identity, only: task_id_with
  use battery_journal, only: journal_type, rank_file, rank_files_of
  use battery_plan, only: plan_type, setup_of
  use battery_precision, only: decide_replicas
  use battery_provenance, only: attribute_type, build_attributes
  use battery_quantities, only: integer_quantities, place_of, unknown_real, unknown_count
  use battery_record_file, only: record_reader_type, open_records, close_records
  use battery_results, only: results_type, new_results, set_points, task_complete, task_failed, &
    task_not_asked, point_undecided, all_tasks_complete
  use battery_results_file, only: results_file_type, write_results, &
    publish_results, read_results, close_results, prepare_outputs, serialize_slabs, ended_early, &
    series, events
  use battery_setup, only: setup_type
  use battery_task_result, only: task_result_type, next_result
  use battery_tasks, only: task_type, task_count, task_of, task_index_type, task_index_of, &
    task_number_of
  use battery_text, only: string_type, to_text, join, numbers_text, new_line_character
  implicit none (type, external)
  private
  public :: merge_results, write_results_of, collect_results, sources_type
  public :: open_sources, close_sources

  !> Place of a task's output.
  type :: place_type
    private
    !> Index of the rank file in the list of sources; 0: the old results file.
    integer :: file = 0
    !> Offset of the record in the rank file; or number of the task in the old results file.
    integer(int64) :: at = 0
  end type place_type

  !> Where results of tasks are: in records of a journal, or in the old results file.
  type, extends(journal_type) :: sources_type
    !> The old results file, open if it is there and undamaged.
    type(results_file_type) :: old
    !> Numbers of the rank files, their readers, and whether all are held open.
    integer, allocatable, private :: number(:)
    type(record_reader_type), allocatable, private :: reader(:)
    logical, private :: are_held = .false.
    !> Numbers of the tasks by their `task_id`; place of the output of each.
    type(task_index_type), private :: task_index
    type(place_type), allocatable, private :: place(:)
    !> Greatest number of entries, or of particles, of any task in each group of outputs.
    integer, private :: length(4) = 0
  end type sources_type

contains

  !> Writes the results file from the journal and the old results file; `results` returns its
  !> numbers.
  subroutine merge_results(plan, sources, start_date, results, error)
    type(plan_type), intent(in) :: plan
    !> The old results file is not used if it is not the one any more that was read at the start.
    type(sources_type), intent(inout) :: sources
    !> Start of the run as date and time of day.
    character(len=*), intent(in) :: start_date
    type(results_type), intent(out) :: results
    type(error_type), allocatable, intent(out) :: error
    type(error_type), allocatable :: change

    call check_unchanged(plan%file, sources%old%stamp, change)
    if (allocated(change)) then
      ! What has the name now, if anything, is not replaced by a file without the old results.
      call close_results(sources%old)
      sources%old%stamp = file_stamp_type()
    end if
    call collect_results(plan, sources, results, error)
    if (.not. allocated(error)) call write_results_of(plan, sources, plan%file, &
      sources%old%stamp, start_date, results, error)
  end subroutine merge_results

  !> Writes the results of all sources to a new file, and publishes it.
  subroutine write_results_of(plan, sources, name, before, start_date, results, error)
    type(plan_type), intent(in) :: plan
    !> From `collect_results`, as are the results; closed here.
    type(sources_type), intent(inout) :: sources
    !> Path of the file.
    character(len=*), intent(in) :: name
    !> Identity of the file that may be replaced.
    type(file_stamp_type), intent(in) :: before
    !> Start of the run as date and time of day.
    character(len=*), intent(in) :: start_date
    type(results_type), intent(inout) :: results
    type(error_type), allocatable, intent(out) :: error
    type(results_file_type) :: file
    type(setup_type) :: setup
    integer :: p, r

    call set_points(results, plan)
    do p = 1, plan%point_count
      do r = 1, plan%replicas
        setup = setup_of(plan, p, r)
        results%seed(r, p) = setup%seed
      end do
      r = results%replicas_needed(p) + 1
      if (r > plan%replicas) cycle
      ! An earlier run may have needed more replicas than a point needs whose number is decided.
      if (results%point_status(p) == point_undecided) cycle
      results%task_status(r:, p) = task_not_asked
      results%average(r:, p, :) = unknown_real()
      results%error(r:, p, :) = unknown_real()
      results%counted(r:, p, :) = unknown_count
    end do
    call open_file(file, name//'.part', .true., error)
    file%plan = plan
    file%stamp = before
    call write_description(file, plan, max(1, sources%ranks), start_date, results, error)
    call write_results(file, results, error)
    call prepare_outputs(file, sources%length, plan%event_log .and. any( &
      results%task_status <= task_failed), error)
    call copy_outputs(plan, sources, file, results, error)
    call close_sources(sources)
    call publish_results(name, file, error)
  end subroutine write_results_of

  !> Finds the rank files. Those of a run that may be going on are all opened, and held open, so
  !> that what is in them now can be read even if the run ends and removes them.
  subroutine open_sources(sources, hold, error)
    !> Sources with a journal from `find_journal`, to be closed with `close_sources`.
    type(sources_type), intent(inout) :: sources
    !> Whether to hold the files open; else they are opened one by one.
    logical, intent(in) :: hold
    !> They are more than this process may open.
    type(error_type), allocatable, intent(out) :: error
    !> Other files that may be open at the same time.
    integer(int64), parameter :: others = 64
    integer :: k

    sources%number = rank_files_of(sources%journal_type)
    if (allocated(sources%reader)) deallocate (sources%reader)
    allocate (sources%reader(size(sources%number)))
    sources%are_held = hold
    if (.not. hold) return
    if (may_open(size(sources%number) + others) == 0) then
      call fatal_error(error, sources%folder//': has '//to_text(size(sources%number)) &
        //' files to be open at the same time, more than this process may open (ulimit -Hn)')
      return
    end if
    do k = 1, size(sources%number)
      call open_rank_file(sources, k)
    end do
  end subroutine open_sources

  !> Closes the old results file and the rank files that are held open.
  subroutine close_sources(sources)
    type(sources_type), intent(inout) :: sources
    integer :: k

    call close_results(sources%old)
    if (.not. allocated(sources%reader)) return
    do k = 1, size(sources%reader)
      call close_records(sources%reader(k))
    end do
  end subroutine close_sources

  !> Opens a rank file, by its index in the list, unless it is open.
  subroutine open_rank_file(sources, k)
    type(sources_type), intent(inout) :: sources
    integer, intent(in) :: k

    call open_records(sources%reader(k), rank_file(sources%journal_type, sources%number(k)))
  end subroutine open_rank_file

  !> Closes a rank file, by its index in the list, unless it is held open; 0: none.
  subroutine close_rank_file(sources, k)
    type(sources_type), intent(inout) :: sources
    integer, intent(in) :: k

    if (k > 0 .and. .not. sources%are_held) call close_records(sources%reader(k))
  end subroutine close_rank_file

  !> Writes the attributes of the root: program, input and run. Does nothing after an error.
  subroutine write_description(file, plan, ranks, start_date, results, error)
    class(hdf5_file_type), intent(in) :: file
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: ranks
    character(len=*), intent(in) :: start_date
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error
    type(attribute_type) :: build(8)
    integer :: k

    if (allocated(error)) return
    build = build_attributes()
    do k = 1, size(build)
      call write_text_attribute(file, '/', trim(build(k)%name), build(k)%text, error)
    end do
    call write_text_attribute(file, '/', 'namelist', plan%text, error)
    call write_text_attribute(file, '/', 'initial_file_fingerprint', trim(merge(repeat(' ', 16), &
      fingerprint_text(plan%initial_fingerprint), plan%initial_file == '')), error)
    call write_text_attribute(file, '/', 'status', trim(merge('complete', 'partial ', &
      all_tasks_complete(results))), error)
    call write_text_attribute(file, '/', 'shape', plan%shape, error)
    call write_text_attribute(file, '/', 'urn_shape', plan%urn_shape, error)
    if (size(plan%scatterers) > 0) call write_text_attribute(file, '/', 'scatterers', &
      numbers_text(plan%scatterers, ' '), error)
    call write_text_attribute(file, '/', 'engine', plan%engine, error)
    if (plan%urn_sides > 0) call write_attribute(file, '/', 'urn_sides', int(plan%urn_sides, &
      int32), error)
    ! The corners of each urn, counterclockwise, (x, y) in columns, with x towards channel 1.
    if (allocated(plan%outline(1)%corner)) then
      call write_attribute(file, '/', 'urn_vertices', real(plan%outline(1)%corner, dp), error)
      call write_attribute(file, '/', 'urn2_vertices', real(plan%outline(2)%corner, dp), error)
    end if
    call write_text_attribute(file, '/', 'created', utc_now(), error)
    call make_group(file, '/provenance', error)
    call write_text_attribute(file, '/provenance', 'command_line', &
      join(command_line_words(), ' '), error)
    call write_text_attribute(file, '/provenance', 'begun', start_date, error)
    call write_text_attribute(file, '/provenance', 'ended', utc_now(), error)
    call write_text_attribute(file, '/provenance', 'hosts', join(results%host, &
      new_line_character), error)
    call write_attribute(file, '/', 'mpi_ranks', int(ranks, int32), error)
    ! Times in the file count from the clock time at the start of the runs.
    call write_attribute(file, '/', 'start_time', real(plan%start_time, dp), error)
  end subroutine write_description

  !> Collects the numbers of all results, and the places of their task outputs. The old results file
  !> is read only if it is open and the journal does not have all tasks.
  subroutine collect_results(plan, sources, results, error)
    type(plan_type), intent(in) :: plan
    !> Sources, whose old file may be open; it is not open after an error in it.
    type(sources_type), intent(inout) :: sources
    !> Results; points and seeds are unknown.
    type(results_type), intent(out) :: results
    !> The old file is undamaged, but was not written by this program; a damaged file is ignored.
    type(error_type), allocatable, intent(out) :: error
    type(task_result_type) :: found
    type(place_type) :: place
    integer :: k, group
    logical :: is_one

    sources%place = [(place_type(), k=1, task_count(plan))]
    sources%length = 0
    call new_results(results, plan%point_count, plan%replicas)
    if (.not. sources%are_held) call open_sources(sources, .false., error)
    if (size(sources%number) > 0 .or. sources%old%id /= no_handle) &
      sources%task_index = task_index_of(plan)
    do k = 1, size(sources%number)
      place%file = k
      call open_rank_file(sources, k)
      do
        call next_result(sources%reader(k), found, place%at, is_one)
        if (.not. is_one) exit
        call add_result(plan, found, place, [(size(found%of(group)%values, 1), group=1, &
          size(found%of))], sources, results)
      end do
      if (allocated(sources%reader(k)%error)) then
        call move_alloc(sources%reader(k)%error, error)
        return
      end if
      call close_rank_file(sources, k)
    end do
    if (any(results%task_status /= task_complete) .and. sources%old%id /= no_handle) &
      call add_old_results(plan, sources, results, error)
    if (.not. allocated(error)) call decide_replicas(plan, results)
  end subroutine collect_results

  !> Adds all complete tasks of the old file.
  subroutine add_old_results(plan, sources, results, error)
    type(plan_type), intent(in) :: plan
    type(sources_type), intent(inout) :: sources
    type(results_type), intent(inout) :: results
    type(error_type), allocatable, intent(out) :: error
    type(results_type) :: before
    type(task_result_type) :: found
    integer :: r, p

    call read_results(sources%old, before, error)
    if (allocated(error)) then
      if (error%code /= exit_bad_input) deallocate (error)
      return
    end if
    found%status = task_complete
    do p = 1, size(before%task_status, 2)
      do r = 1, size(before%task_status, 1)
        if (before%task_status(r, p) /= task_complete) cycle
        found%task_id = task_id_with(before%seed(r, p), plan)
        found%measured%average = before%average(r, p, :)
        found%measured%error = before%error(r, p, :)
        found%measured%counted = before%counted(r, p, :)
        found%host = before%host(1 + before%counted(r, p, host_place()))%text
        call add_result(plan, found, place_type(at=r + (p - 1)*size(before%task_status, 1)), &
          sources%old%length, sources, results)
      end do
    end do
  end subroutine add_old_results

  !> Adds the numbers of a result if its task is one of the plan and has none already; stores the
  !> place of its output, and updates the greatest lengths.
  subroutine add_result(plan, found, place, length, sources, results)
    type(plan_type), intent(in) :: plan
    type(task_result_type), intent(in) :: found
    type(place_type), intent(in) :: place
    !> Numbers of entries of the series and of events; greater than 0 if there are snapshots and a
    !> final state.
    integer, intent(in) :: length(4)
    type(sources_type), intent(inout) :: sources
    type(results_type), intent(inout) :: results
    type(task_type) :: task
    integer :: number

    number = task_number_of(sources%task_index, found%task_id)
    if (number == 0) return
    task = task_of(plan, number)
    associate (p => task%point, r => task%replica, n => task%setup%number)
      if (results%task_status(r, p) == task_complete) return
      results%task_status(r, p) = found%status
      results%average(r, p, :) = found%measured%average
      results%error(r, p, :) = found%measured%error
      results%counted(r, p, :) = found%measured%counted
      results%counted(r, p, host_place()) = index_in_list(found%host, results%host)
      sources%length = max(sources%length, merge([length(series), n, n, length(events)], 0, &
        length > 0))
    end associate
    sources%place(number) = place
    results%failure(number) = string_type()
    if (found%status == task_failed) results%failure(number)%text = found%message
  end subroutine add_result

  !> Place of the host among the integer quantities.
  pure integer function host_place()

    host_place = place_of('provenance/host', integer_quantities())
  end function host_place

  !> Copies the output of every task to its place in a new file, in the order of the tasks. Does
  !> nothing after an error.
  subroutine copy_outputs(plan, sources, file, results, error)
    type(plan_type), intent(in) :: plan
    type(sources_type), intent(inout) :: sources
    type(results_file_type), intent(in) :: file
    !> Results with the statuses of the tasks; the number of tasks that ended before their last
    !> snapshot is set here.
    type(results_type), intent(inout) :: results
    type(error_type), allocatable, intent(inout) :: error
    type(task_result_type) :: found
    type(task_type) :: task
    integer(int64) :: at
    integer :: k, open_file
    logical :: is_one

    if (all(sources%length == 0)) return
    open_file = 0
    do k = 1, task_count(plan)
      if (allocated(error)) exit
      task = task_of(plan, k)
      if (all(results%task_status(task%replica, task%point) /= [task_complete, task_failed])) cycle
      associate (place => sources%place(k))
        if (place%file == 0) then
          call serialize_slabs(sources%old, int(place%at), found%task_output_type, error)
        else
          if (place%file /= open_file) then
            call close_rank_file(sources, open_file)
            call open_rank_file(sources, place%file)
            open_file = place%file
          end if
          sources%reader(open_file)%at = place%at
          call next_result(sources%reader(open_file), found, at, is_one)
          call move_alloc(sources%reader(open_file)%error, error)
          if (allocated(error)) exit
          if (.not. is_one .or. found%task_id /= task%task_id) call fatal_error(error, &
            sources%folder//': the result of task '//to_text(k)//' cannot be read a second time')
        end if
      end associate
      if (allocated(error)) exit
      call serialize_slabs(file, k, found%task_output_type, error)
      if (ended_early(found%task_output_type, size(plan%snapshot_times))) &
        results%short_tasks = results%short_tasks + 1
    end do
    call close_rank_file(sources, open_file)
  end subroutine copy_outputs

  !> Index of a text in a list, from 0; the text is added if the list does not have it.
  integer(int64) function index_in_list(text, list) result(place)
    character(len=*), intent(in) :: text
    type(string_type), allocatable, intent(inout) :: list(:)
    type(string_type) :: one

    do place = 0, size(list) - 1
      if (list(place + 1)%text == text) return
    end do
    one%text = text
    list = [list, one]
  end function index_in_list

end module battery_merge
