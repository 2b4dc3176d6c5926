!> The results file: contents of `battery_results` by name, with units and named dimensions, and the
!> output of tasks over time: series, snapshots, final states, events.
!>
!> A new file, `name.part`, is made in memory (`open_file`), where it is compressed; its attributes,
!> its numbers (`write_results`), and the output of each task are written there. `publish_results`
!> writes it to the disk under a temporary name, reads it back to verify the checksum, and renames
!> it, so that there is always either the old file or the new one. An old file is opened
!> (`open_results`) and its numbers are read (`read_results`), then the outputs of its tasks one by
!> one. Unknown values are NaN, or -1 if an attribute `_FillValue` has it.
!>
!> Output is the large part of a results file, so that of at most one task is in memory. Each
!> dataset of it is declared once, in `outputs`. The output of a task is a table for each group of
!> datasets, which is written to a record and read from it (`serialize_output`), and written to its
!> hyperslabs of a results file and read from them (`serialize_slabs`). The datasets are prepared
!> for all tasks, (.., replica, point), filled with NaN or -1; then the output of each task is
!> exchanged, in the order of the tasks, which fills one chunk after the other. Events are those of
!> the only task.
module battery_results_file
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use battery_kinds, only: wp, dp, int32, int64
  use battery_archive, only: archive_type
  use battery_available_memory, only: need_type, check_memory, most_kept
  use battery_checksum_footer, only: check_footer, copy_with_footer
  use battery_error, only: error_type, fatal_error, exit_bad_input, exit_failure
  use battery_files, only: file_stamp_type, sync_file, publish_unless_replaced, remove_file
  use battery_hdf5_file, only: hdf5_file_type, open_file, close_file, make_group, check_status, &
    read_text_attribute, write_attribute, write_text_attribute, dataset_type, serialize_dataset, &
    write_dataset, write_dimension, prepare_dataset, serialize_slab, read_extents, &
    close_dataset
  use battery_key, only: key_type, find_key
  use battery_keys, only: all_keys
  use battery_plan, only: plan_type, point_type, point_of, setup_of
  use battery_quantities, only: quantity_type, real_quantities, integer_quantities, place_of, &
    flow_names, unknown_count, unknown_real
  use battery_results, only: results_type, new_results, set_points, scatter_of, &
    all_tasks_complete, task_complete, task_failed, task_not_done, task_not_asked, &
    point_precise, point_not_precise, point_two_states, point_undecided
  use battery_setup, only: setup_type
  use battery_text, only: lines_of, to_text
  implicit none (type, external)
  private
  public :: results_file_type, write_results, publish_results
  public :: open_results, read_results, close_results, accept_results
  public :: task_output_type, serialize_output, prepare_outputs, serialize_slabs, ended_early
  public :: series, snapshots, final, events

  !> Groups of datasets that have the same extents.
  integer, parameter :: series = 1, snapshots = 2, final = 3, events = 4
  character(len=*), parameter :: group_path(4) = [character(len=10) :: '/series', '/snapshots', &
    '/final', '/events']

  !> Name of the first dimension of each group, and which of the dimensions (that one, snapshot,
  !> replica, point) it has.
  character(len=*), parameter :: first_dimension(4) = [character(len=9) :: '/time', '/particle', &
    '/particle', '/event']
  logical, parameter :: has(4, 4) = reshape([.true., .false., .true., .true., .true., .true., &
    .true., .true., .true., .false., .true., .true., .true., .false., .false., .false.], [4, 4])

  !> Number of datasets of each group: N1 and four flows; x, y, ux, uy; the same; time, kind, where,
  !> particle.
  integer, parameter :: columns(4) = [5, 4, 4, 4]

  !> A dataset of task output.
  type :: output_type
    character(len=21) :: path = ''
    character(len=6) :: unit = ''
    character(len=112) :: meaning = ''
    !> Whether it has integers of 32 bits.
    logical :: is_count = .false.
  end type output_type

  !> Values of a task in the datasets of a group: one column for each.
  type :: table_type
    real(dp), allocatable :: values(:, :)
  end type table_type

  !> Output of one task: a table for each group, along time or of all particles, those of one
  !> snapshot after the other. A table that the task does not have is empty or not allocated.
  type :: task_output_type
    type(table_type) :: of(4)
  end type task_output_type

  !> An open results file, with the datasets of the output of its tasks, which are open as long as
  !> the file is.
  type, extends(hdf5_file_type) :: results_file_type
    !> Of a file that was opened: version of the program, namelist, `complete` or `partial`, and
    !> fingerprint of the initial file; 0: there was none.
    character(len=:), allocatable :: version, namelist, status
    integer(int64) :: initial_fingerprint = 0
    !> Stamp of a file that was opened, or was damaged; of a new file, that of the only file that it
    !> may replace.
    type(file_stamp_type) :: stamp
    !> Plan of the file, set before `write_results` or `read_results`: that of its namelist.
    type(plan_type) :: plan
    !> Length of the first dimension of each group: greatest number of entries, or of particles, of
    !> any task; number of events. 0: the file has no series, no snapshots, no final states.
    integer :: length(4) = 0
    !> Datasets: (column, group).
    type(dataset_type), private :: dataset(maxval(columns), 4)
  end type results_file_type

  !> Paths of the dimension scales, in Fortran order.
  character(len=*), parameter :: by_point(*) = ['/point']
  character(len=*), parameter :: by_gate(*) = [character(len=6) :: '/gate', '/point']
  character(len=*), parameter :: by_urn(*) = [character(len=6) :: '/urn', '/point']
  character(len=*), parameter :: task_dimensions(*) = [character(len=8) :: '/replica', '/point']

  !> Text for the meaning of times.
  character(len=*), parameter :: since_start = 'time since the start'

contains

  !> Writes all contents except attributes of the root and task output. Does nothing after an error.
  subroutine write_results(file, results, error)
    !> New file, with its plan.
    type(results_file_type), intent(in) :: file
    !> Results, which are only read.
    type(results_type), intent(inout) :: results
    type(error_type), allocatable, intent(inout) :: error

    call write_scan(file, error)
    call write_points(file, results, error)
    call serialize_measured(file, results, error)
    call write_precision(file, results, error)
  end subroutine write_results

  !> Replaces the old results file by a new one, which is read back before; after an error the old
  !> file is unchanged. If another file has taken its place in the meantime, the results stay in
  !> `name.part`.
  subroutine publish_results(name, file, error)
    !> Path of the results file.
    character(len=*), intent(in) :: name
    !> New file `name.part`, with the stamp of the file that may be replaced; closed here.
    type(results_file_type), intent(inout) :: file
    !> After an earlier error, while the file was filled, it is not published.
    type(error_type), allocatable, intent(inout) :: error
    type(error_type), allocatable :: other
    integer :: group, k

    ! Their last chunks are freed before the bytes of the file are taken.
    do group = series, merge(events, 0, file%is_new)
      do k = 1, columns(group)
        call close_dataset(file, file%dataset(k, group), error)
      end do
    end do
    call close_file(file, error)
    if (.not. allocated(error)) then
      call check_footer(file%name, error)
      if (allocated(error)) error%code = exit_failure
    end if
    if (.not. allocated(error)) call sync_file(file%name, error)
    if (allocated(error)) then
      call remove_file(file%name, other)
    else
      call publish_unless_replaced(file%name, name, file%stamp, error)
    end if
  end subroutine publish_results

  !> Gives a results file that lacks a footer a new one, if all in it can be read, its structure,
  !> its parameters and its seeds are those that follow from its namelist, and it says of its tasks
  !> what it has of them. A copy with a footer replaces it.
  subroutine accept_results(name, file, results, error)
    !> Path of the file.
    character(len=*), intent(in) :: name
    !> File from `open_results`, with its plan, closed here; no change since is accepted.
    type(results_file_type), intent(inout) :: file
    !> Its numbers.
    type(results_type), intent(out) :: results
    type(error_type), allocatable, intent(out) :: error
    type(task_output_type) :: output
    integer :: task

    call read_results(file, results, error)
    if (allocated(error)) return
    if (any(results%task_status < task_complete .or. results%task_status > task_not_asked) .or. &
      file%status /= trim(merge('complete', 'partial ', all_tasks_complete(results)))) &
      call fatal_error(error, name//': /task_status is not that of a file with the status ' &
      //file%status, exit_bad_input)
    associate (status => reshape(results%task_status, [size(results%task_status)]))
      do task = 1, size(status)
        if (status(task) == task_complete) call serialize_slabs(file, task, output, error)
      end do
    end associate
    call set_points(results, file%plan)
    call write_scan(file, error)
    call write_points(file, results, error)
    call close_results(file)
    file%name = name//'.part'
    if (.not. allocated(error)) call copy_with_footer(name, file%name, error)
    call publish_results(name, file, error)
  end subroutine accept_results

  !> Writes the grid of the scan, or compares it: its keys in the attribute `scan` of the root, the
  !> slowest first, and the values of each key in the group `scan`.
  subroutine write_scan(file, error)
    type(results_file_type), intent(in) :: file
    type(error_type), allocatable, intent(inout) :: error
    type(key_type), allocatable :: keys(:)
    character(len=:), allocatable :: names
    integer :: k

    names = ''
    keys = all_keys()
    if (size(file%plan%scanned) > 0) call make_group(file, '/scan', error)
    do k = 1, size(file%plan%scanned)
      ! The second values of pairs belong to the points of the first.
      if (file%plan%scanned(k)%is_paired) cycle
      associate (key => keys(find_key(keys, 'scan', file%plan%scanned(k)%key)))
        names = names//' '//trim(key%name)
        call write_dataset(file, '/scan/'//trim(key%name), real(file%plan%scanned(k)%values, dp), &
          trim(key%unit)//repeat('1', merge(1, 0, key%unit == '')), trim(key%meaning), error)
      end associate
    end do
    call write_text_attribute(file, '/', 'scan', names(2:), error)
  end subroutine write_scan

  !> Opens a results file, verifies its checksum, and reads which input it was made with. The code
  !> of the error is `exit_failure` if the file is damaged, otherwise `exit_bad_input`.
  subroutine open_results(name, file, error, lacks_footer)
    !> Path of the file.
    character(len=*), intent(in) :: name
    !> File, to be closed with `close_results`; after an error not open, but with its stamp.
    type(results_file_type), intent(out) :: file
    type(error_type), allocatable, intent(out) :: error
    !> Whether the file has no footer, which is no error if this argument is present.
    logical, intent(out), optional :: lacks_footer
    character(len=:), allocatable :: fingerprint
    type(file_stamp_type) :: stamp
    integer :: status
    logical :: lacks

    call check_footer(name, error, lacks, stamp)
    if (present(lacks_footer)) then
      lacks_footer = lacks
      if (lacks) deallocate (error)
    end if
    if (.not. allocated(error)) call open_file(file, name, .false., error)
    file%stamp = stamp
    if (allocated(error)) return
    call read_text_attribute(file, '/', 'version', file%version, error)
    call read_text_attribute(file, '/', 'namelist', file%namelist, error)
    call read_text_attribute(file, '/', 'status', file%status, error)
    call read_text_attribute(file, '/', 'initial_file_fingerprint', fingerprint, error)
    ! Without an initial file the text is empty.
    read (fingerprint, '(z16)', iostat=status) file%initial_fingerprint
    if (status /= 0) file%initial_fingerprint = 0
    if (allocated(error)) call close_results(file)
  end subroutine open_results

  !> Reads the numbers of an open file, except the parameters of points; task outputs are read one
  !> by one (`serialize_slabs`). Its datasets must be those that follow from its namelist; otherwise
  !> the error has the code `exit_bad_input`. They may be read several times.
  subroutine read_results(file, results, error)
    !> File from `open_results`, of this version, with its plan; closed after an error.
    type(results_file_type), intent(inout) :: file
    type(results_type), intent(out) :: results
    type(error_type), allocatable, intent(out) :: error

    call read_tasks(file, file%plan, results, error)
    if (.not. allocated(error)) call open_outputs(file, results, error)
    if (allocated(error)) call close_results(file)
  end subroutine read_results

  !> Closes a results file that was read; a file that is not open is no error.
  subroutine close_results(file)
    !> File from `open_results`.
    type(results_file_type), intent(inout) :: file
    !> An error that is ignored: the file was only read.
    type(error_type), allocatable :: ignored

    call close_file(file, ignored)
  end subroutine close_results

  !> Reads the numbers of every task. Seeds and hosts of complete tasks must be valid, since the use
  !> of the other numbers depends on them.
  subroutine read_tasks(file, plan, results, error)
    class(hdf5_file_type), intent(in) :: file
    type(plan_type), intent(in) :: plan
    type(results_type), intent(out) :: results
    type(error_type), allocatable, intent(inout) :: error
    type(setup_type) :: setup
    character(len=:), allocatable :: hosts
    integer :: p, r, host

    call check_memory_of(need_type(tasks=real(plan%point_count, dp)*plan%replicas), 'tasks', &
      file, error)
    if (allocated(error)) return
    call new_results(results, plan%point_count, plan%replicas)
    call serialize_measured(file, results, error)
    call read_text_attribute(file, '/provenance', 'hosts', hosts, error)
    if (allocated(error)) return
    results%host = lines_of(hosts)
    host = place_of('provenance/host', integer_quantities())
    do p = 1, plan%point_count
      do r = 1, plan%replicas
        if (results%task_status(r, p) /= task_complete) cycle
        setup = setup_of(plan, p, r)
        if (results%seed(r, p) /= setup%seed) call check_status(file, '/seed', &
          'has a seed that the namelist in the file does not', 1, error)
        if (.not. allocated(error) .and. (results%counted(r, p, host) < 0 .or. results%counted(r, &
          p, host) >= size(results%host))) call check_status(file, '/provenance/host', &
          'has a host that is not in the list', 1, error)
        if (allocated(error)) return
      end do
    end do
  end subroutine read_tasks

  !> Opens series and states, if any task is complete and they are not open yet, and checks that
  !> there is memory for those of one task.
  subroutine open_outputs(file, results, error)
    type(results_file_type), intent(inout) :: file
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error
    type(dataset_type) :: dataset
    type(point_type) :: point
    integer(int64) :: entries(3)
    integer :: length(4), most, p

    if (all(results%task_status /= task_complete) .or. any(file%length > 0)) return
    length = 0
    associate (plan => file%plan)
      if (plan%series_interval > 0.0_wp) then
        call read_extents(file, '/series/urn1_number', entries, error, dataset)
        call check_memory_of(need_type(entries=real(entries(1), dp)), '/series', file, error)
        if (.not. allocated(error) .and. (entries(1) < 1 .or. entries(1) > most_kept)) &
          call check_status(file, '/series/urn1_number', &
          'has no length that a series can have', 1, error)
        if (allocated(error)) return
        length(series) = int(entries(1))
      end if
      ! States have the extent of the largest point with a complete task.
      most = 0
      do p = 1, plan%point_count
        if (all(results%task_status(:, p) /= task_complete)) cycle
        point = point_of(plan, p)
        most = max(most, point%number)
      end do
      if (size(plan%snapshot_times) > 0) length(snapshots) = most
      if (plan%final_state) length(final) = most
      call check_memory_of(need_type(states=real(most, dp)*(size(plan%snapshot_times) &
        + merge(1, 0, plan%final_state))), '/snapshots and /final', file, error)
      call prepare_outputs(file, length, .false., error)
    end associate
  end subroutine open_outputs

  !> An error if there is no memory for what is in a file. Does nothing after an error.
  subroutine check_memory_of(need, what, file, error)
    type(need_type), intent(in) :: need
    !> Text for the datasets that need them.
    character(len=*), intent(in) :: what
    class(hdf5_file_type), intent(in) :: file
    type(error_type), allocatable, intent(inout) :: error

    if (allocated(error)) return
    call check_memory(need, what//' in '//file%name, error)
    if (allocated(error)) error%code = exit_bad_input
  end subroutine check_memory_of

  !> Writes or compares the dimension scales, and the parameters of the points.
  subroutine write_points(file, results, error)
    class(hdf5_file_type), intent(in) :: file
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error
    character(len=:), allocatable :: name
    integer :: k

    call write_counting_scale(file, '/point', 0, size(results%point), 'point of the scan, from 0', &
      error)
    call write_counting_scale(file, '/replica', 0, size(results%seed, 1), &
      'replica of a point, from 0', error)
    call write_counting_scale(file, '/gate', 1, 2, 'gate, that of urn 1 and that of urn 2', error)
    call write_counting_scale(file, '/urn', 1, 2, 'urn', error)
    associate (p => results%point)
      call write_dataset(file, '/number', p%number, '1', 'particles N', error, by_point)
      call write_dataset(file, '/threshold', p%threshold(1), '1', &
        'threshold T of gate 1: a gate reverses when it counts more than T particles', error, &
        by_point)
      call write_dataset(file, '/urn1_number', p%urn1_number, '1', &
        'particles in urn 1 at the start', error, by_point)
      call write_dataset(file, '/gate_threshold', reshape([p%threshold(1), p%threshold(2)], &
        [2, size(p)], order=[2, 1]), '1', 'threshold T of each gate', error, by_gate)
      call write_dataset(file, '/urn_radius', reshape([p%urn_radius(1), p%urn_radius(2)], &
        [2, size(p)], order=[2, 1]), 'length', 'radius r of each urn', error, by_urn)
      do k = 1, 2
        name = 'channel'//to_text(k)
        call write_dataset(file, '/'//name//'_width', p%channel(k)%width, 'length', 'width w' &
          //repeat('''', k - 1)//' of channel '//to_text(k), error, by_point)
        call write_dataset(file, '/'//name//'_length', p%channel(k)%length, 'length', 'length l' &
          //repeat('''', k - 1)//' of channel '//to_text(k), error, by_point)
      end do
    end associate
  end subroutine write_points

  !> Writes or reads the numbers of every task, and their standard errors over the replicas.
  subroutine serialize_measured(file, results, error)
    class(hdf5_file_type), intent(in) :: file
    type(results_type), intent(inout) :: results
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: blocks = ', standard error from the run; NaN: not known'
    character(len=*), parameter :: scatter = ', standard error from the scatter of the replicas'
    type(quantity_type), allocatable :: list(:)
    character(len=:), allocatable :: path, unit, meaning
    integer :: q

    call serialize_dataset(file, '/seed', results%seed, '1', 'seed of the random start', error, &
      task_dimensions)
    call serialize_dataset(file, '/task_status', results%task_status, '1', 'how the task ended', &
      error, task_dimensions)
    call write_attribute(file, '/task_status', 'flag_values', [task_complete, task_failed, &
      task_not_done, task_not_asked], error)
    call write_text_attribute(file, '/task_status', 'flag_meanings', &
      'complete failed not_done not_asked', error)
    list = real_quantities()
    do q = 1, size(list)
      path = '/'//trim(list(q)%name)
      unit = trim(list(q)%unit)
      meaning = trim(list(q)%meaning)
      call serialize_dataset(file, path, results%average(:, :, q), unit, meaning, error, &
        task_dimensions)
      if (.not. list(q)%has_error) cycle
      call serialize_dataset(file, path//'_error', results%error(:, :, q), unit, meaning//blocks, &
        error, task_dimensions)
      if (file%is_new) call write_dataset(file, path//'_spread', scatter_of(results%average(:, &
        :, q), results%task_status), unit, meaning//scatter, error, by_point)
    end do
    list = integer_quantities()
    do q = 1, size(list)
      path = '/'//trim(list(q)%name)
      call serialize_dataset(file, path, results%counted(:, :, q), trim(list(q)%unit), &
        trim(list(q)%meaning), error, task_dimensions)
      call write_attribute(file, path, '_FillValue', unknown_count, error)
    end do
  end subroutine serialize_measured

  !> Writes the status of each point with respect to the required precision.
  subroutine write_precision(file, results, error)
    class(hdf5_file_type), intent(in) :: file
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: meaning = 'standard error over replicas of '

    if (.not. allocated(results%point_status)) return
    call write_dataset(file, '/chi_replica_error', results%replica_error(:, 1), '1', &
      meaning//'chi', error, by_point)
    call write_dataset(file, '/polarised_current_replica_error', results%replica_error(:, 2), &
      '1/time', meaning//'polarised_current', error, by_point)
    call write_dataset(file, '/point_status', results%point_status, '1', &
      'whether the precision was reached', error, by_point)
    call write_attribute(file, '/point_status', 'flag_values', [point_precise, point_not_precise, &
      point_two_states, point_undecided], error)
    call write_text_attribute(file, '/point_status', 'flag_meanings', &
      'reached not_reached two_states undecided', error)
  end subroutine write_precision

  !> The datasets of a group.
  pure function outputs(group) result(list)
    integer, intent(in) :: group
    type(output_type) :: list(columns(group))
    type(quantity_type), allocatable :: quantities(:)
    integer :: k

    select case (group)
    case (series)
      list(1) = output_type('urn1_number', '1', 'particles at x < 0', .true.)
      quantities = real_quantities()
      do k = 1, size(flow_names)
        associate (flow => quantities(place_of(flow_names(k), quantities)))
          list(1 + k) = output_type(flow%name, flow%unit, trim(flow%meaning) &
            //', since the previous entry')
        end associate
      end do
    case (events)
      list = [output_type('time', 'time', since_start), &
        output_type('kind', '1', 'what happens', .true.), &
        output_type('where', '1', 'gate (1 or 2), or direction of a crossing (12 or 21)', .true.), &
        output_type('particle', '1', &
        'particle, from 1; of a reversal, how many particles it reverses', .true.)]
    case default
      list = [output_type('x', 'length', 'position x'), output_type('y', 'length', 'position y'), &
        output_type('ux', '1', 'velocity x'), output_type('uy', '1', 'velocity y')]
    end select
    do k = 1, size(list)
      list(k)%path = trim(group_path(group))//'/'//list(k)%path
    end do
  end function outputs

  !> Writes the output of a task to an archive, or reads it; then all tables are allocated.
  subroutine serialize_output(output, archive)
    type(task_output_type), intent(inout) :: output
    type(archive_type), intent(inout) :: archive
    integer :: group, rows, k

    do group = series, events
      if (.not. allocated(output%of(group)%values)) &
        allocate (output%of(group)%values(0, columns(group)))
      rows = size(output%of(group)%values, 1)
      call archive%serialize(trim(group_path(group)), rows)
      if (archive%reading .and. (rows < 0 .or. rows > size(archive%word, kind=int64))) &
        archive%problem = 'the state has a number of rows that it cannot have'
      if (archive%failed()) return
      if (archive%reading) then
        deallocate (output%of(group)%values)
        allocate (output%of(group)%values(rows, columns(group)))
      end if
      do k = 1, merge(columns(group), 0, rows > 0)
        call archive%serialize(trim(group_path(group)), output%of(group)%values(:, k))
      end do
    end do
  end subroutine serialize_output

  !> Creates the datasets of a new file, or opens those of a file that is read, which must have
  !> these extents. Does nothing after an error.
  subroutine prepare_outputs(file, length, has_events, error)
    !> File, open.
    type(results_file_type), intent(inout) :: file
    !> Length of the first dimension of each group.
    integer, intent(in) :: length(4)
    !> Whether there is an event log, which may be empty; it is only written.
    logical, intent(in) :: has_events
    type(error_type), allocatable, intent(inout) :: error
    character(len=19) :: scales(4)
    integer, allocatable :: extents(:)
    type(output_type), allocatable :: list(:)
    integer :: group, k

    file%length = length
    scales(2:) = [character(len=19) :: '/snapshots/time', task_dimensions]
    do group = series, events
      if (merge(.not. has_events, length(group) == 0, group == events)) cycle
      call write_group(file, file%plan, group, length(group), error)
      extents = [length(group), size(file%plan%snapshot_times), file%plan%replicas, &
        file%plan%point_count]
      scales(1) = trim(group_path(group))//trim(first_dimension(group))
      list = outputs(group)
      do k = 1, size(list)
        associate (one => list(k), dataset => file%dataset(k, group), has => has(:, group))
          if (one%is_count) then
            call prepare_dataset(file, trim(one%path), pack(extents, has), merge(0, &
              int(unknown_count, int32), group == events), trim(one%unit), trim(one%meaning), &
              error, pack(scales, has), dataset)
          else
            call prepare_dataset(file, trim(one%path), pack(extents, has), merge(0.0_dp, &
              unknown_real(), group == events), trim(one%unit), trim(one%meaning), error, &
              pack(scales, has), dataset)
          end if
        end associate
      end do
    end do
    if (length(series) > 0) call write_attribute(file, '/series/urn1_number', '_FillValue', &
      int(unknown_count, int32), error)
    if (.not. has_events) return
    call write_attribute(file, '/events/kind', 'flag_values', [1_int32, 2_int32, 3_int32, &
      4_int32], error)
    call write_text_attribute(file, '/events/kind', 'flag_meanings', &
      'enters_gate gate_reverses crosses_channel_1 crosses_channel_2', error)
  end subroutine prepare_outputs

  !> Makes a group in a new file, with its dimension scales, or compares these.
  subroutine write_group(file, plan, group, length, error)
    class(hdf5_file_type), intent(in) :: file
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: group, length
    type(error_type), allocatable, intent(inout) :: error
    integer :: k

    call make_group(file, trim(group_path(group)), error)
    if (group == snapshots) call write_dataset(file, '/snapshots/time', real(plan%snapshot_times, &
      dp), 'time', since_start, error)
    associate (path => trim(group_path(group))//trim(first_dimension(group)))
      select case (group)
      case (series)
        call write_dataset(file, path, [(real(k - 1, dp)*real(plan%series_interval, dp), k=1, &
          length)], 'time', since_start, error)
      case (events)
        call write_dimension(file, path, length, 'events in the order of time', error)
      case default
        call write_counting_scale(file, path, 1, length, &
          'particle, from 1, in the order of the initial file', error)
      end select
    end associate
  end subroutine write_group

  !> Writes the output of a task to its hyperslabs of a new file, or reads all but events; then all
  !> tables are allocated. Does nothing after an error.
  subroutine serialize_slabs(file, task, output, error)
    !> File from `prepare_outputs`.
    type(results_file_type), intent(in) :: file
    !> Number of the task in the plan of the file.
    integer, intent(in) :: task
    !> Output of the task; if it is written, all tables are allocated, at most as long as the
    !> datasets.
    type(task_output_type), intent(inout) :: output
    type(error_type), allocatable, intent(inout) :: error
    type(point_type) :: point
    integer :: group, times, rows, replica, p, k

    p = (task - 1)/file%plan%replicas + 1
    replica = task - (p - 1)*file%plan%replicas
    if (.not. file%is_new) point = point_of(file%plan, p)
    do group = series, events
      times = merge(size(file%plan%snapshot_times), 1, group == snapshots)
      if (.not. file%is_new) then
        rows = file%length(group)
        if (group /= series) rows = times*min(point%number, rows)
        if (allocated(output%of(group)%values)) deallocate (output%of(group)%values)
        allocate (output%of(group)%values(merge(0, rows, group == events), columns(group)), &
          source=unknown_real())
      end if
      rows = size(output%of(group)%values, 1)
      do k = 1, merge(columns(group), 0, rows > 0)
        call serialize_slab(file, file%dataset(k, group), output%of(group)%values(:, k), &
          pack([rows/times, times, 1, 1], has(:, group)), &
          pack([1, 1, replica, p], has(:, group)), error)
      end do
    end do
    if (file%is_new .or. allocated(error)) return
    ! Series may have fewer entries than the datasets.
    rows = count(output%of(series)%values(:, 1) >= 0.0_dp)
    output%of(series)%values = output%of(series)%values(:rows, :)
  end subroutine serialize_slabs

  !> Whether a run with a given number of collisions ended before the last of `times` snapshots: its
  !> first number is NaN. The summary counts such runs.
  pure logical function ended_early(output, times) result(yes)
    type(task_output_type), intent(in) :: output
    integer, intent(in) :: times

    yes = .false.
    associate (states => output%of(snapshots)%values)
      if (size(states) > 0) yes = ieee_is_nan(states(1 + size(states, 1)/times*(times - 1), 1))
    end associate
  end function ended_early

  !> Writes a dimension scale with the coordinates `first`, `first` + 1, ... Does nothing after an
  !> error.
  subroutine write_counting_scale(file, path, first, length, long_name, error)
    !> New file, open for writing.
    class(hdf5_file_type), intent(in) :: file
    !> Path of the dataset in the file, from the root.
    character(len=*), intent(in) :: path
    !> The first coordinate, and the number of coordinates.
    integer, intent(in) :: first, length
    !> Attribute of that name: what the dimension counts.
    character(len=*), intent(in) :: long_name
    type(error_type), allocatable, intent(inout) :: error
    integer :: k

    call write_dataset(file, path, int([(first + k, k=0, length - 1)], int32), '1', long_name, &
      error)
  end subroutine write_counting_scale

end module battery_results_file
