!> Output of tasks over time: series, snapshots, final states, events.
!>
!> Each dataset of it is declared once, in `outputs`: from this list a task's output is written to a
!> record and read from it (`serialize_outputs`), and written to its hyperslabs of a results file
!> and read from them (`serialize_slabs`). These are the large part of a results file, so the output
!> of at most one task is in memory: the datasets are prepared for all tasks, (.., replica, point),
!> filled with NaN or -1; then the output of each task is exchanged, in the order of the tasks, which
!> fills one chunk after the other. Events are those of the only task (`write_events`).
module battery_task_output
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use battery_kinds, only: dp, int32, int64
  use battery_archive, only: archive_type
  use battery_error, only: error_type
  use battery_hdf5_attributes, only: write_attribute, write_text_attribute
  use battery_hdf5_datasets, only: dataset_type, prepare_dataset, serialize_slab, release_dataset, &
    write_dataset, write_scale, write_dimension
  use battery_hdf5_file, only: hdf5_file_type, make_group
  use battery_plan, only: plan_type
  use battery_quantities, only: quantity_type, averaged_quantities, place_of, flow_names, &
    unknown_count, unknown_real
  implicit none (type, external)
  private
  public :: task_output_type, values_type, serialize_outputs, ended_early
  public :: output_datasets_type, prepare_outputs, serialize_slabs, close_outputs, write_events, &
    write_counting_scale, task_dimensions
  public :: series, snapshots, final, events, first_of

  !> Groups of datasets, and the place of the first of each in the list: N1 and the four flows; x, y,
  !> ux, uy; the same; time, kind, where, particle.
  integer, parameter :: series = 1, snapshots = 2, final = 3, events = 4
  integer, parameter :: first_of(5) = [1, 6, 10, 14, 18]
  character(len=*), parameter :: group_path(4) = [character(len=10) :: '/series', '/snapshots', &
    '/final', '/events']

  !> A dataset of task output.
  type :: output_type
    character(len=21) :: path = ''
    character(len=6) :: unit = ''
    character(len=112) :: meaning = ''
    integer :: group = 0
    !> Whether the dataset has integers of 32 bits.
    logical :: is_count = .false.
  end type output_type

  !> Values of a task in one dataset.
  type :: values_type
    real(dp), allocatable :: values(:)
  end type values_type

  !> Output of one task, in the order of `outputs`: values along time, or of all particles, those of
  !> one snapshot after the other. Values that a task does not have are empty or not allocated.
  type :: task_output_type
    type(values_type) :: of(first_of(5) - 1)
  end type task_output_type

  !> Datasets of an open file, all but those of events.
  type :: output_datasets_type
    !> Length of the first dimension of each group: greatest number of entries, or of particles, of
    !> any task; 0: the file has no such group.
    integer :: length(3) = 0
    !> Number of snapshots.
    integer, private :: times = 0
    type(dataset_type), private :: dataset(first_of(4) - 1)
  end type output_datasets_type

  !> Paths of the dimension scales of numbers that every task has, in Fortran order.
  character(len=*), parameter :: task_dimensions(*) = [character(len=8) :: '/replica', '/point']

  !> Text for the meaning of times.
  character(len=*), parameter :: since_start = 'time since the start'

contains

  !> All datasets of task output.
  pure function outputs() result(list)
    type(output_type) :: list(first_of(5) - 1)
    type(quantity_type), allocatable :: quantities(:)
    integer :: k

    quantities = averaged_quantities()
    list(1) = output_type('/series/urn1_number', '1', 'particles at x < 0', series, .true.)
    do k = 1, 4
      associate (flow => quantities(place_of(flow_names(k), quantities)))
        list(1 + k) = output_type('/series/'//flow%name, flow%unit, trim(flow%meaning) &
          //', since the previous entry', series)
      end associate
    end do
    do k = snapshots, final
      list(first_of(k):first_of(k) + 3) = [ &
        output_type(trim(group_path(k))//'/x', 'length', 'position x', k), &
        output_type(trim(group_path(k))//'/y', 'length', 'position y', k), &
        output_type(trim(group_path(k))//'/ux', '1', 'velocity x', k), &
        output_type(trim(group_path(k))//'/uy', '1', 'velocity y', k)]
    end do
    list(first_of(events):) = [ &
      output_type('/events/time', 'time', since_start, events), &
      output_type('/events/kind', '1', 'what happens', events, .true.), &
      output_type('/events/where', '1', 'gate (1 or 2), or direction of a crossing (12 or 21)', &
      events, .true.), &
      output_type('/events/particle', '1', &
      'particle, from 1; of a reversal, how many particles it reverses', events, .true.)]
  end function outputs

  !> Writes the output of a task to an archive, or reads it; then all values are allocated.
  subroutine serialize_outputs(output, archive)
    type(task_output_type), intent(inout) :: output
    type(archive_type), intent(inout) :: archive
    type(output_type) :: list(size(output%of))
    integer(int64) :: length(size(output%of))
    integer :: k

    list = outputs()
    do k = 1, size(list)
      if (.not. allocated(output%of(k)%values)) allocate (output%of(k)%values(0))
      length(k) = size(output%of(k)%values)
    end do
    call archive%serialize('lengths', length)
    if (archive%reading .and. any(length < 0 .or. length > size(archive%word, kind=int64))) &
      archive%problem = 'the output has a length that it cannot have'
    if (archive%failed()) return
    do k = 1, size(list)
      if (archive%reading) then
        deallocate (output%of(k)%values)
        allocate (output%of(k)%values(length(k)))
      end if
      if (length(k) > 0) call archive%serialize(trim(list(k)%path), output%of(k)%values)
    end do
  end subroutine serialize_outputs

  !> Creates the datasets of a new file, or opens those of a file that is read, which must have
  !> these extents. Does nothing after an error.
  subroutine prepare_outputs(file, plan, length, datasets, error)
    !> File, open.
    type(hdf5_file_type), intent(in) :: file
    !> Plan of the file.
    type(plan_type), intent(in) :: plan
    !> Length of the first dimension of each group.
    integer, intent(in) :: length(3)
    !> Open datasets, to be closed with `close_outputs`.
    type(output_datasets_type), intent(out) :: datasets
    type(error_type), allocatable, intent(inout) :: error
    type(output_type) :: list(first_of(5) - 1)
    character(len=19) :: scales(4)
    integer, allocatable :: extents(:)
    integer :: k

    list = outputs()
    datasets%length = length
    datasets%times = size(plan%snapshot_times)
    do k = 1, size(datasets%dataset)
      associate (one => list(k), group => group_path(list(k)%group))
        if (length(one%group) == 0) cycle
        if (file%is_new .and. k == first_of(one%group)) &
          call write_group(file, plan, one%group, length(one%group), error)
        scales = [character(len=19) :: trim(group)//merge('/time    ', '/particle', one%group &
          == series), '/snapshots/time', task_dimensions]
        extents = in_group(one%group, [length(one%group), datasets%times, plan%replicas, &
          plan%point_count])
        if (one%is_count) then
          call prepare_dataset(file, trim(one%path), extents, int(unknown_count, int32), &
            trim(one%unit), trim(one%meaning), error, pack(scales, has_dimension(one%group)), &
            datasets%dataset(k))
          call write_attribute(file, trim(one%path), '_FillValue', int(unknown_count, int32), error)
        else
          call prepare_dataset(file, trim(one%path), extents, unknown_real(), trim(one%unit), &
            trim(one%meaning), error, pack(scales, has_dimension(one%group)), datasets%dataset(k))
        end if
      end associate
    end do
  end subroutine prepare_outputs

  !> Which of the dimensions (entry or particle, snapshot, replica, point) a group has.
  pure function has_dimension(group) result(yes)
    integer, intent(in) :: group
    logical :: yes(4)

    yes = [.true., group == snapshots, .true., .true.]
  end function has_dimension

  !> The numbers of those dimensions that a group has.
  pure function in_group(group, numbers) result(chosen)
    integer, intent(in) :: group, numbers(4)
    integer, allocatable :: chosen(:)

    chosen = pack(numbers, has_dimension(group))
  end function in_group

  !> Makes a group in a new file, with its dimension scales.
  subroutine write_group(file, plan, group, length, error)
    type(hdf5_file_type), intent(in) :: file
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: group, length
    type(error_type), allocatable, intent(inout) :: error
    integer :: k

    call make_group(file, trim(group_path(group)), error)
    if (group == series) call write_scale(file, '/series/time', [(real(k - 1, dp) &
      *real(plan%series_interval, dp), k=1, length)], 'time', since_start, error)
    if (group == snapshots) call write_scale(file, '/snapshots/time', real(plan%snapshot_times, &
      dp), 'time', since_start, error)
    if (group /= series) call write_counting_scale(file, trim(group_path(group))//'/particle', 1, &
      length, 'particle, from 1, in the order of the initial file', error)
  end subroutine write_group

  !> Writes the output of a task, all but events, to its hyperslabs of a new file, or reads it; then
  !> all values are allocated. Does nothing after an error.
  subroutine serialize_slabs(file, datasets, replica, point, number, output, error)
    !> File, open, as the datasets in it are.
    type(hdf5_file_type), intent(in) :: file
    type(output_datasets_type), intent(in) :: datasets
    !> Indices of the task, from 1, and its number of particles.
    integer, intent(in) :: replica, point, number
    !> Output of the task; if it is written, all values are allocated, at most as long as the
    !> datasets.
    type(task_output_type), intent(inout) :: output
    type(error_type), allocatable, intent(inout) :: error
    integer :: k, group, times, length(4)

    associate (longest => datasets%length)
      length = [longest(series), min(number, longest(snapshots))*datasets%times, &
        min(number, longest(final)), 0]
    end associate
    do k = 1, size(output%of)
      group = count(k >= first_of(:4))
      times = merge(datasets%times, 1, group == snapshots)
      if (.not. file%is_new) then
        if (allocated(output%of(k)%values)) deallocate (output%of(k)%values)
        allocate (output%of(k)%values(length(group)), source=-1.0_dp)
      end if
      associate (values => output%of(k)%values)
        if (group < events .and. size(values) > 0) call serialize_slab(file, datasets%dataset(k), &
          values, in_group(group, [size(values)/times, times, 1, 1]), &
          in_group(group, [1, 1, replica, point]), error)
      end associate
    end do
    if (.not. file%is_new) call drop_padding(output)
  end subroutine serialize_slabs

  !> Drops the unknown values at the end of series: they may be shorter than the datasets.
  subroutine drop_padding(output)
    type(task_output_type), intent(inout) :: output
    integer :: k, entries

    entries = count(output%of(first_of(series))%values >= 0.0_dp)
    do k = first_of(series), first_of(series + 1) - 1
      output%of(k)%values = output%of(k)%values(:entries)
    end do
  end subroutine drop_padding

  !> Whether a run with a given number of collisions ended before the last of `times` snapshots: its
  !> first number is NaN. The summary counts such runs.
  pure logical function ended_early(output, times) result(yes)
    type(task_output_type), intent(in) :: output
    integer, intent(in) :: times

    yes = .false.
    associate (x => output%of(first_of(snapshots))%values)
      if (size(x) > 0) yes = ieee_is_nan(x(1 + size(x)/times*(times - 1)))
    end associate
  end function ended_early

  !> Closes the datasets of a file that is still open.
  subroutine close_outputs(file, datasets, error)
    !> File, still open.
    type(hdf5_file_type), intent(in) :: file
    !> Datasets, which may be open.
    type(output_datasets_type), intent(inout) :: datasets
    !> Not all values could be written to a new file; an earlier error is kept.
    type(error_type), allocatable, intent(inout) :: error
    integer :: k

    do k = 1, size(datasets%dataset)
      call release_dataset(file, datasets%dataset(k), error)
    end do
  end subroutine close_outputs

  !> Writes the event log of the only task. Does nothing after an error.
  subroutine write_events(file, output, error)
    !> New file, open for writing.
    type(hdf5_file_type), intent(in) :: file
    !> Output of the task, all values allocated.
    type(task_output_type), intent(in) :: output
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: by_event(*) = ['/events/event']
    type(output_type) :: list(size(output%of))
    integer :: k

    list = outputs()
    call make_group(file, '/events', error)
    call write_dimension(file, '/events/event', size(output%of(first_of(events))%values), &
      'events in the order of time', error)
    do k = first_of(events), size(list)
      associate (one => list(k), values => output%of(k)%values)
        if (one%is_count) then
          call write_dataset(file, trim(one%path), int(values, int32), trim(one%unit), &
            trim(one%meaning), error, by_event)
        else
          call write_dataset(file, trim(one%path), values, trim(one%unit), trim(one%meaning), &
            error, by_event)
        end if
      end associate
    end do
    call write_attribute(file, '/events/kind', 'flag_values', [1_int32, 2_int32, 3_int32, &
      4_int32], error)
    call write_text_attribute(file, '/events/kind', 'flag_meanings', &
      'enters_gate gate_reverses crosses_channel_1 crosses_channel_2', error)
  end subroutine write_events

  !> Writes a dimension scale with the coordinates `first`, `first` + 1, ... Does nothing after an
  !> error.
  subroutine write_counting_scale(file, path, first, length, long_name, error)
    !> New file, open for writing.
    type(hdf5_file_type), intent(in) :: file
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
