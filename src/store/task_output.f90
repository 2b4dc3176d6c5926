!> Output of tasks over time: series, snapshots, final states, events.
!>
!> Each dataset of it is declared once, in `outputs`. The output of a task is a table for each group
!> of datasets, which is written to a record and read from it (`serialize_output`), and written to
!> its hyperslabs of a results file and read from them (`serialize_slabs`). These are the large part
!> of a results file, so the output of at most one task is in memory: the datasets are prepared for
!> all tasks, (.., replica, point), filled with NaN or -1; then the output of each task is
!> exchanged, in the order of the tasks, which fills one chunk after the other. Events are those of
!> the only task.
module battery_task_output
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use battery_kinds, only: dp, int32, int64
  use battery_archive, only: archive_type
  use battery_error, only: error_type
  use battery_hdf5_attributes, only: write_attribute, write_text_attribute
  use battery_hdf5_datasets, only: dataset_type, prepare_dataset, serialize_slab, release_dataset, &
    write_scale, write_dimension
  use battery_hdf5_file, only: hdf5_file_type, make_group
  use battery_plan, only: plan_type
  use battery_quantities, only: quantity_type, averaged_quantities, place_of, flow_names, &
    unknown_count, unknown_real
  implicit none (type, external)
  private
  public :: task_output_type, serialize_output, ended_early, series, snapshots, final, events
  public :: output_file_type, prepare_outputs, serialize_slabs, close_outputs, &
    write_counting_scale, task_dimensions

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

  !> A file with the datasets of the output of its tasks, which are open as long as the file is.
  type, extends(hdf5_file_type) :: output_file_type
    !> Length of the first dimension of each group: greatest number of entries, or of particles, of
    !> any task; number of events. 0: the file has no series, no snapshots, no final states.
    integer :: length(4) = 0
    !> Number of snapshots, and of replicas of a point.
    integer, private :: times = 0, replicas = 1
    !> Datasets: (column, group).
    type(dataset_type), private :: dataset(maxval(columns), 4)
  end type output_file_type

  !> Paths of the dimension scales of numbers that every task has, in Fortran order.
  character(len=*), parameter :: task_dimensions(*) = [character(len=8) :: '/replica', '/point']

  !> Text for the meaning of times.
  character(len=*), parameter :: since_start = 'time since the start'

contains

  !> The datasets of a group.
  pure function outputs(group) result(list)
    integer, intent(in) :: group
    type(output_type) :: list(columns(group))
    type(quantity_type), allocatable :: quantities(:)
    integer :: k

    select case (group)
    case (series)
      list(1) = output_type('urn1_number', '1', 'particles at x < 0', .true.)
      quantities = averaged_quantities()
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
  subroutine prepare_outputs(file, plan, length, has_events, error)
    !> File, open.
    class(output_file_type), intent(inout) :: file
    !> Plan of the file.
    type(plan_type), intent(in) :: plan
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
    file%times = size(plan%snapshot_times)
    file%replicas = plan%replicas
    scales(2:) = [character(len=19) :: '/snapshots/time', task_dimensions]
    do group = series, events
      if (merge(.not. has_events, length(group) == 0, group == events)) cycle
      if (file%is_new) call write_group(file, plan, group, length(group), error)
      extents = [length(group), file%times, plan%replicas, plan%point_count]
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

  !> Makes a group in a new file, with its dimension scales.
  subroutine write_group(file, plan, group, length, error)
    class(hdf5_file_type), intent(in) :: file
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: group, length
    type(error_type), allocatable, intent(inout) :: error
    integer :: k

    call make_group(file, trim(group_path(group)), error)
    if (group == snapshots) call write_scale(file, '/snapshots/time', real(plan%snapshot_times, &
      dp), 'time', since_start, error)
    associate (path => trim(group_path(group))//trim(first_dimension(group)))
      select case (group)
      case (series)
        call write_scale(file, path, [(real(k - 1, dp)*real(plan%series_interval, dp), k=1, &
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
  subroutine serialize_slabs(file, task, number, output, error)
    !> File from `prepare_outputs`.
    class(output_file_type), intent(in) :: file
    !> Number of the task in the plan of the file, and its number of particles.
    integer, intent(in) :: task, number
    !> Output of the task; if it is written, all tables are allocated, at most as long as the
    !> datasets.
    type(task_output_type), intent(inout) :: output
    type(error_type), allocatable, intent(inout) :: error
    integer :: group, times, rows, replica, point, k

    point = (task - 1)/file%replicas + 1
    replica = task - (point - 1)*file%replicas
    do group = series, events
      times = merge(file%times, 1, group == snapshots)
      if (.not. file%is_new) then
        rows = merge(file%length(group), times*min(number, file%length(group)), group == series)
        if (allocated(output%of(group)%values)) deallocate (output%of(group)%values)
        allocate (output%of(group)%values(merge(0, rows, group == events), columns(group)), &
          source=unknown_real())
      end if
      rows = size(output%of(group)%values, 1)
      do k = 1, merge(columns(group), 0, rows > 0)
        call serialize_slab(file, file%dataset(k, group), output%of(group)%values(:, k), &
          pack([rows/times, times, 1, 1], has(:, group)), &
          pack([1, 1, replica, point], has(:, group)), error)
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

  !> Closes the datasets of a new file, which frees the memory of their chunks.
  subroutine close_outputs(file, error)
    !> File, still open.
    class(output_file_type), intent(inout) :: file
    !> Not all values could be written to the file; an earlier error is kept.
    type(error_type), allocatable, intent(inout) :: error
    integer :: group, k

    do group = series, events
      do k = 1, columns(group)
        call release_dataset(file, file%dataset(k, group), error)
      end do
    end do
  end subroutine close_outputs

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

    call write_scale(file, path, int([(first + k, k=0, length - 1)], int32), '1', long_name, error)
  end subroutine write_counting_scale

end module battery_task_output
