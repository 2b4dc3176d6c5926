!> Merges the journal of an ensemble into its results file.
!>
!> First all records are read once, one in memory at a time: the numbers of each task are stored in
!> arrays, with the place of its record and the largest extents of any output (`collect_results`).
!> Tasks that the journal does not have are taken from the old results file. From this the new file
!> is made and its datasets are prepared. Then, in the order of the tasks, each output is copied
!> from its place into its hyperslab (`move_task_outputs`), one in memory at a time. The old file is
!> replaced when the new one is complete.
module battery_merge
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use battery_kinds, only: wp, dp, int64
  use battery_task_output, only: output_datasets_type, output_extents_type, &
    prepare_output_datasets, write_task_output, read_task_output, close_output_datasets, &
    write_events
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_files, only: file_exists, has_stamp
  use battery_fingerprint, only: fingerprint_text
  use battery_hdf5_file, only: hdf5_file_type
  use battery_journal, only: journal_type, open_rank_file, next_result, rank_files_of
  use battery_metadata, only: metadata_type, add_text_metadata
  use battery_plan, only: plan_type, point_of
  use battery_precision, only: decide_replicas
  use battery_provenance, only: add_build_metadata, command_text
  use battery_quantities, only: counted_quantities, place_of, unknown_real, unknown_count
  use battery_record_file, only: record_reader_type, close_records
  use battery_results, only: results_type, new_results, task_complete, task_failed, &
    task_not_asked, point_undecided, all_tasks_complete
  use battery_results_file, only: create_results, publish_results, open_results, close_results
  use battery_task_result, only: task_result_type
  use battery_tasks, only: task_type, task_count, task_of, task_index_type, task_index_of, &
    task_number_of, task_id_in_results
  use battery_text, only: string_type, to_text, join, new_line_character
  implicit none (type, external)
  private
  public :: merge_results, collect_results, sources_type, close_sources

  !> Place of a task's output: a record in a rank file, or columns of the old results file.
  type :: place_type
    private
    !> Number of the rank file; below 0 if the output is in none.
    integer :: rank_file = -1
    !> Offset of the record in the rank file.
    integer(int64) :: at = 0
    !> Replica and point in the old file, from 1; 0: the old file does not have the output.
    integer :: replica = 0, point = 0
  end type place_type

  !> Places of the outputs of all tasks.
  type :: sources_type
    private
    !> Place of the output of each task.
    type(place_type), allocatable :: place(:)
    !> Largest extents of any output.
    type(output_extents_type) :: largest
    !> The old results file; open if it has tasks that the journal does not have.
    type(hdf5_file_type) :: file
    type(output_datasets_type) :: output_datasets
  end type sources_type

contains

  !> Writes the results file from the journal and the old results file; `results` returns its
  !> numbers.
  subroutine merge_results(plan, journal, start_date, results, failures, error)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(in) :: journal
    !> Start of the run as date and time of day.
    character(len=*), intent(in) :: start_date
    type(results_type), intent(out) :: results
    !> Reason for which each task failed; not allocated for the others.
    type(string_type), allocatable, intent(out) :: failures(:)
    type(error_type), allocatable, intent(out) :: error
    type(sources_type) :: sources
    type(hdf5_file_type) :: file
    type(metadata_type) :: metadata
    type(output_datasets_type) :: output_datasets
    integer, allocatable :: replicas_needed(:)

    call collect_results(plan, journal, .true., results, failures, replicas_needed, sources, error)
    if (allocated(error)) return
    call drop_unwanted_replicas(results, replicas_needed)
    call describe_sources(plan, journal, start_date, results, metadata)
    call create_results(plan%file, results, metadata, file, error)
    call prepare_output_datasets(file, sources%largest, real(plan%series_interval, dp), &
      real(plan%snapshot_times, dp), output_datasets, error)
    call move_task_outputs(plan, journal, sources, file, output_datasets, results, error)
    call close_output_datasets(file, output_datasets, error)
    call close_sources(sources)
    call publish_results(plan%file, file, journal%lock%before, error)
  end subroutine merge_results

  !> Collects the metadata of the results file: its program, input and run.
  subroutine describe_sources(plan, journal, start_date, results, metadata)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(in) :: journal
    character(len=*), intent(in) :: start_date
    type(results_type), intent(in) :: results
    type(metadata_type), intent(out) :: metadata

    call add_build_metadata(metadata)
    call add_text_metadata(metadata, 'namelist', plan%text)
    call add_text_metadata(metadata, 'initial_file_fingerprint', trim(merge(repeat(' ', 16), &
      fingerprint_text(plan%initial_fingerprint), plan%initial_file == '')))
    call add_text_metadata(metadata, 'status', trim(merge('complete', 'partial ', &
      all_tasks_complete(results))))
    call add_text_metadata(metadata, 'shape', plan%shape)
    call add_text_metadata(metadata, 'urn_shape', plan%urn_shape)
    metadata%urn_sides = plan%urn_sides
    if (allocated(plan%outline(1)%corner)) then
      metadata%urn_vertices = real(plan%outline(1)%corner, dp)
      metadata%urn2_vertices = real(plan%outline(2)%corner, dp)
    end if
    if (size(plan%scatterers) > 0) call add_text_metadata(metadata, 'scatterers', &
      numbers_text(plan%scatterers))
    call add_text_metadata(metadata, 'engine', plan%engine)
    metadata%command_line = command_text()
    metadata%begun = start_date
    metadata%hosts = join(results%host, new_line_character)
    metadata%mpi_ranks = journal%ranks
    metadata%start_time = real(plan%start_time, dp)
  end subroutine describe_sources

  !> Numbers separated by blanks.
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

  !> Collects the numbers of all results, and the places of their task outputs. An existing results
  !> file is read only if the journal does not have all tasks.
  subroutine collect_results(plan, journal, makes_file, results, failures, replicas_needed, &
    sources, error)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(in) :: journal
    !> Whether a new file is to be made from the results. Then points and seeds are set; and if
    !> the old file is no longer the one that was there when the lock was taken, it is not read.
    logical, intent(in) :: makes_file
    type(results_type), intent(out) :: results
    !> Reason for which each task failed; not allocated for the others.
    type(string_type), allocatable, intent(out) :: failures(:)
    !> Number of replicas required at each point.
    integer, allocatable, intent(out) :: replicas_needed(:)
    !> Sources, to be closed with `close_sources`; not open after an error.
    type(sources_type), intent(out) :: sources
    !> The old file is undamaged, but was not written by this program; a damaged file is ignored.
    type(error_type), allocatable, intent(out) :: error
    type(task_result_type) :: found
    type(results_type) :: before
    type(record_reader_type) :: reader
    type(task_index_type) :: task_index
    type(task_type) :: task
    type(place_type) :: place
    integer, allocatable :: files(:)
    integer :: k
    logical :: old, is_one

    allocate (failures(task_count(plan)), sources%place(task_count(plan)))
    call new_results(results, plan%point_count, plan%replicas)
    results%scanned = plan%scanned
    do k = 1, merge(task_count(plan), 0, makes_file)
      task = task_of(plan, k)
      results%point(task%point) = point_of(plan, task%point)
      results%point(task%point)%urn_radius = task%setup%table%urn%radius
      results%seed(task%replica, task%point) = task%setup%seed
    end do
    sources%largest%snapshots = size(plan%snapshot_times)
    sources%largest%replicas = plan%replicas
    sources%largest%points = plan%point_count
    files = rank_files_of(journal)
    if (size(files) > 0 .or. file_exists(plan%file)) task_index = task_index_of(plan)
    do k = 1, size(files)
      place%rank_file = files(k)
      call open_rank_file(journal, files(k), reader)
      do
        call next_result(reader, found, place%at, is_one)
        if (.not. is_one) exit
        call add_result(found, place, size(found%series_urn1_number), size(found%snapshots) > 0, &
          size(found%final_state) > 0)
      end do
      call close_records(reader)
    end do
    old = file_exists(plan%file)
    if (makes_file .and. old) old = has_stamp(plan%file, journal%lock%before)
    if (old .and. any(results%task_status /= task_complete)) then
      call open_results(plan%file, sources%file, before, sources%output_datasets, error)
      if (.not. allocated(error)) then
        call add_results_of_file(before, sources%output_datasets%largest)
      else if (error%code == exit_bad_input) then
        return
      else
        deallocate (error)
      end if
    end if
    call decide_replicas(plan, results, replicas_needed)

  contains

    !> Adds all complete tasks of the old file.
    subroutine add_results_of_file(before, largest)
      type(results_type), intent(in) :: before
      type(output_extents_type), intent(in) :: largest
      integer :: r, p

      do p = 1, size(before%task_status, 2)
        do r = 1, before%replicas
          if (before%task_status(r, p) /= task_complete) cycle
          found = numbers_of(before, r, p)
          found%task_id = task_id_in_results(plan, before%seed(r, p))
          call add_result(found, place_type(replica=r, point=p), largest%entries, &
            largest%particles*largest%snapshots > 0, largest%final_particles > 0)
        end do
      end do
    end subroutine add_results_of_file

    !> Adds the numbers of a result if its task is one of the plan and has none already; stores the
    !> place of its output, and updates the largest extents.
    subroutine add_result(one, place, entries, has_snapshots, has_final_state)
      type(task_result_type), intent(in) :: one
      type(place_type), intent(in) :: place
      integer, intent(in) :: entries
      logical, intent(in) :: has_snapshots, has_final_state
      integer :: number

      number = task_number_of(task_index, one%task_id)
      if (number == 0) return
      task = task_of(plan, number)
      associate (p => task%point, r => task%replica, largest => sources%largest)
        if (results%task_status(r, p) == task_complete) return
        results%task_status(r, p) = one%status
        results%average(r, p, :) = one%measured%average
        results%error(r, p, :) = one%measured%error
        results%counted(r, p, :) = one%measured%counted
        results%counted(r, p, place_of('provenance/host', counted_quantities())) &
          = index_in_list(one%host, results%host)
        largest%entries = max(largest%entries, entries)
        if (has_snapshots) largest%particles = max(largest%particles, task%number)
        if (has_final_state) largest%final_particles = max(largest%final_particles, task%number)
      end associate
      sources%place(number) = place
      if (allocated(failures(number)%text)) deallocate (failures(number)%text)
      if (one%status == task_failed) failures(number)%text = one%message
    end subroutine add_result

  end subroutine collect_results

  !> Numbers of the complete task of replica `r` and point `p` in a results file.
  function numbers_of(results, r, p) result(found)
    type(results_type), intent(in) :: results
    integer, intent(in) :: r, p
    type(task_result_type) :: found

    found%status = task_complete
    found%measured%average = results%average(r, p, :)
    found%measured%error = results%error(r, p, :)
    found%measured%counted = results%counted(r, p, :)
    found%host = results%host(1 + results%counted(r, p, place_of('provenance/host', &
      counted_quantities())))%text
  end function numbers_of

  !> Closes the old results file, if it is open.
  subroutine close_sources(sources)
    !> Sources from `collect_results`.
    type(sources_type), intent(inout) :: sources

    call close_results(sources%file, sources%output_datasets)
  end subroutine close_sources

  !> Moves the output of every task to its place in a new file, in the order of the tasks. Does
  !> nothing after an error.
  subroutine move_task_outputs(plan, journal, sources, file, output_datasets, results, error)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(in) :: journal
    type(sources_type), intent(in) :: sources
    type(hdf5_file_type), intent(in) :: file
    type(output_datasets_type), intent(in) :: output_datasets
    !> Results with the statuses of the tasks; the number of tasks that ended before their last
    !> snapshot is set here.
    type(results_type), intent(inout) :: results
    type(error_type), allocatable, intent(inout) :: error
    type(task_result_type) :: found
    type(record_reader_type) :: reader
    type(task_type) :: task
    integer(int64) :: at
    integer :: k, open_file
    logical :: is_one

    if (sources%largest%entries + sources%largest%particles + sources%largest%final_particles &
      == 0 .and. .not. plan%event_log) return
    open_file = -1
    do k = 1, task_count(plan)
      if (allocated(error)) exit
      task = task_of(plan, k)
      if (all(results%task_status(task%replica, task%point) /= [task_complete, task_failed])) cycle
      associate (place => sources%place(k))
        if (place%replica > 0) then
          call read_task_output(sources%file, sources%output_datasets, place%replica, place%point, &
            task%number, found%task_output_type, error)
        else
          if (place%rank_file /= open_file) then
            call close_records(reader)
            call open_rank_file(journal, place%rank_file, reader)
            open_file = place%rank_file
          end if
          reader%at = place%at
          call next_result(reader, found, at, is_one)
          if (.not. is_one .or. found%task_id /= task%task_id) call fatal_error(error, &
            journal%folder //': the result of task '//to_text(k)//' cannot be read a second time')
        end if
      end associate
      if (allocated(error)) exit
      call write_task_output(file, output_datasets, task%replica, task%point, &
        found%task_output_type, error)
      if (plan%event_log) call write_events(file, found%task_output_type, error)
      if (ended_early(found%snapshots, size(plan%snapshot_times))) &
        results%short_tasks = results%short_tasks + 1
    end do
    call close_records(reader)
  end subroutine move_task_outputs

  !> Whether a run with a given number of collisions ended before the last snapshot: its first
  !> number is NaN. The summary counts such runs.
  pure logical function ended_early(snapshots, times)
    !> States at the snapshots, as in an output; number of snapshots.
    real(dp), intent(in) :: snapshots(:)
    integer, intent(in) :: times

    ended_early = .false.
    if (size(snapshots) > 0) ended_early = ieee_is_nan(snapshots(1 + size(snapshots)/times &
      *(times - 1)))
  end function ended_early

  !> Removes replicas beyond the number that their point needs: an earlier run may have needed more.
  subroutine drop_unwanted_replicas(results, replicas_needed)
    type(results_type), intent(inout) :: results
    integer, intent(in) :: replicas_needed(:)
    integer :: p

    if (.not. allocated(results%point_status)) return
    do p = 1, size(replicas_needed)
      if (results%point_status(p) == point_undecided) cycle
      associate (n => replicas_needed(p) + 1)
        results%task_status(n:, p) = task_not_asked
        results%average(n:, p, :) = unknown_real()
        results%error(n:, p, :) = unknown_real()
        results%counted(n:, p, :) = unknown_count
      end associate
    end do
  end subroutine drop_unwanted_replicas

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
