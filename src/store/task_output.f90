!> Output of tasks over time in a results file: series, snapshots, final states, events.
!>
!> These are the large part of the file, so the output of at most one task is in memory. The
!> datasets are prepared for all tasks, (.., replica, point), filled with NaN or -1; then the output
!> of each task is read from its record and written into its hyperslab. Reading uses the same code:
!> one procedure names the datasets for both, and `file%is_new` says which is meant. A column has
!> the values of one task in a dataset; tasks should be passed in the order of their numbers
!> (`serialize_column`).
module battery_task_output
  use battery_kinds, only: dp, int32
  use battery_error, only: error_type
  use battery_hdf5_file, only: hdf5_file_type, make_group
  use battery_hdf5_attributes, only: write_attribute, write_text_attribute
  use battery_hdf5_datasets, only: dataset_type, prepare_dataset, serialize_column, &
    release_dataset, write_dataset, write_scale, write_dimension
  use battery_quantities, only: quantity_type, averaged_quantities, place_of, flow_names, &
    unknown_count, unknown_real
  implicit none (type, external)
  private
  public :: task_output_type, output_extents_type, output_datasets_type, task_dimensions
  public :: prepare_output_datasets, write_task_output, read_task_output, close_output_datasets, &
    write_events, write_counting_scale

  !> Output of one task over time. Arrays without contents are empty or not allocated; after
  !> reading, all are allocated.
  type :: task_output_type
    !> Series: N1, and flows as (4, entry), which is 1_12, 1_21, 2_12, 2_21.
    integer(int32), allocatable :: series_urn1_number(:)
    real(dp), allocatable :: series_flow(:)
    !> Snapshots one after the other: x, y, ux, uy of all particles; the final state likewise.
    real(dp), allocatable :: snapshots(:), final_state(:)
    !> Events: kind, where, particle one after the other; times.
    integer(int32), allocatable :: events(:)
    real(dp), allocatable :: event_times(:)
  end type task_output_type

  !> Greatest extents over all tasks of a file; 0: the file has no such dataset.
  type :: output_extents_type
    !> Number of entries of the series, and of snapshots.
    integer :: entries = 0, snapshots = 0
    !> Number of particles of snapshots, and of final states.
    integer :: particles = 0, final_particles = 0
    !> Number of replicas and of points, complete or not.
    integer :: replicas = 0, points = 0
  end type output_extents_type

  !> Datasets of an open file that hold one or more columns for each task.
  type :: output_datasets_type
    type(output_extents_type) :: largest
    !> N1 and the flows; x, y, ux, uy.
    type(dataset_type), private :: urn1_number, flow(4), snapshot(4), final(4)
  end type output_datasets_type

  !> Paths of the dimension scales of numbers that every task has, in Fortran order.
  character(len=*), parameter :: task_dimensions(*) = [character(len=8) :: '/replica', '/point']

  !> Texts for the meaning of times and of numbers of particles.
  character(len=*), parameter :: since_start = 'time since the start'
  character(len=*), parameter :: in_order = 'particle, from 1, in the order of the initial file'

contains

  !> Creates the datasets of a new file, or opens those of a file that is read, which must have
  !> these extents. Does nothing after an error.
  subroutine prepare_output_datasets(file, largest, series_interval, snapshot_time, &
    output_datasets, error)
    !> File, open.
    type(hdf5_file_type), intent(in) :: file
    !> Extents of the datasets; a dataset with an extent of 0 does not exist.
    type(output_extents_type), intent(in) :: largest
    !> Time between two entries, and times of the snapshots, since the start: for the dimension
    !> scales of a new file.
    real(dp), intent(in) :: series_interval, snapshot_time(:)
    !> Open datasets, to be closed with `close_output_datasets`.
    type(output_datasets_type), intent(out) :: output_datasets
    type(error_type), allocatable, intent(inout) :: error

    output_datasets%largest = largest
    if (largest%entries > 0) call prepare_series(file, largest, series_interval, output_datasets, &
      error)
    if (largest%snapshots > 0 .and. largest%particles > 0) then
      if (file%is_new) then
        call make_group(file, '/snapshots', error)
        call write_scale(file, '/snapshots/time', snapshot_time, 'time', since_start, error)
        call write_counting_scale(file, '/snapshots/particle', 1, largest%particles, in_order, &
          error)
      end if
      call prepare_states(file, '/snapshots', [largest%particles, largest%snapshots, &
        largest%replicas, largest%points], [character(len=19) :: '/snapshots/particle', &
        '/snapshots/time', task_dimensions], output_datasets%snapshot, error)
    end if
    if (largest%final_particles > 0) then
      if (file%is_new) then
        call make_group(file, '/final', error)
        call write_counting_scale(file, '/final/particle', 1, largest%final_particles, in_order, &
          error)
      end if
      call prepare_states(file, '/final', [largest%final_particles, largest%replicas, &
        largest%points], [character(len=15) :: '/final/particle', task_dimensions], &
        output_datasets%final, error)
    end if
  end subroutine prepare_output_datasets

  !> Prepares the datasets of the series: N1 and the flows.
  subroutine prepare_series(file, largest, interval, output_datasets, error)
    type(hdf5_file_type), intent(in) :: file
    type(output_extents_type), intent(in) :: largest
    real(dp), intent(in) :: interval
    type(output_datasets_type), intent(inout) :: output_datasets
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: by_time(*) = [character(len=12) :: '/series/time', &
      task_dimensions]
    type(quantity_type), allocatable :: list(:)
    integer :: extents(3), k

    extents = [largest%entries, largest%replicas, largest%points]
    if (file%is_new) then
      call make_group(file, '/series', error)
      call write_scale(file, '/series/time', [(real(k - 1, dp)*interval, k=1, largest%entries)], &
        'time', since_start, error)
    end if
    call prepare_dataset(file, '/series/urn1_number', extents, int(unknown_count, int32), '1', &
      'particles at x < 0', error, by_time, output_datasets%urn1_number)
    call write_attribute(file, '/series/urn1_number', '_FillValue', int(unknown_count, int32), &
      error)
    list = averaged_quantities()
    do k = 1, 4
      associate (flow => list(place_of(flow_names(k), list)))
        call prepare_dataset(file, '/series/'//trim(flow%name), extents, unknown_real(), &
          trim(flow%unit), trim(flow%meaning)//', since the previous entry', error, by_time, &
          output_datasets%flow(k))
      end associate
    end do
  end subroutine prepare_series

  !> Prepares datasets of positions and velocities.
  subroutine prepare_states(file, group, extents, scales, states, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: group, scales(:)
    integer, intent(in) :: extents(:)
    type(dataset_type), intent(inout) :: states(4)
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: names(4) = [character(len=2) :: 'x', 'y', 'ux', 'uy']
    character(len=*), parameter :: units(4) = [character(len=6) :: 'length', 'length', '1', '1']
    character(len=*), parameter :: meanings(4) = [character(len=10) :: 'position x', &
      'position y', 'velocity x', 'velocity y']
    integer :: k

    do k = 1, 4
      call prepare_dataset(file, group//'/'//trim(names(k)), extents, unknown_real(), &
        trim(units(k)), meanings(k), error, scales, states(k))
    end do
  end subroutine prepare_states

  !> Writes the output of a task into its hyperslabs of a new file. Does nothing after an error.
  subroutine write_task_output(file, output_datasets, replica, point, task_output, error)
    !> File, open, as the datasets in it are.
    type(hdf5_file_type), intent(in) :: file
    type(output_datasets_type), intent(in) :: output_datasets
    !> Indices of the task, from 1.
    integer, intent(in) :: replica, point
    !> Output of the task, at most as long as the datasets; not changed.
    type(task_output_type), intent(inout) :: task_output
    type(error_type), allocatable, intent(inout) :: error

    call serialize_series(file, output_datasets, replica, point, task_output, error)
    call serialize_states(file, output_datasets%snapshot, [replica, point], &
      output_datasets%largest%snapshots, task_output%snapshots, error)
    call serialize_states(file, output_datasets%final, [replica, point], 0, &
      task_output%final_state, error)
  end subroutine write_task_output

  !> Reads the output of a task without its events; empty after an error.
  subroutine read_task_output(file, output_datasets, replica, point, number, task_output, error)
    !> File, open, as the datasets in it are.
    type(hdf5_file_type), intent(in) :: file
    type(output_datasets_type), intent(in) :: output_datasets
    !> Replica and point of the task, from 1; number of its particles.
    integer, intent(in) :: replica, point, number
    type(task_output_type), intent(out) :: task_output
    type(error_type), allocatable, intent(inout) :: error
    integer :: entries

    associate (largest => output_datasets%largest)
      allocate (task_output%series_urn1_number(largest%entries), &
        task_output%series_flow(4*largest%entries))
      allocate (task_output%snapshots(4*min(number, largest%particles)*largest%snapshots))
      allocate (task_output%final_state(4*min(number, largest%final_particles)))
      allocate (task_output%events(0), task_output%event_times(0))
      call serialize_series(file, output_datasets, replica, point, task_output, error)
      call serialize_states(file, output_datasets%snapshot, [replica, point], largest%snapshots, &
        task_output%snapshots, error)
      call serialize_states(file, output_datasets%final, [replica, point], 0, &
        task_output%final_state, error)
    end associate
    ! Series may have fewer entries than the dataset.
    entries = 0
    if (.not. allocated(error)) entries = count(task_output%series_urn1_number >= 0)
    task_output%series_urn1_number = task_output%series_urn1_number(:entries)
    task_output%series_flow = task_output%series_flow(:4*entries)
  end subroutine read_task_output

  !> Writes or reads the series of a task.
  subroutine serialize_series(file, output_datasets, replica, point, task_output, error)
    type(hdf5_file_type), intent(in) :: file
    type(output_datasets_type), intent(in) :: output_datasets
    integer, intent(in) :: replica, point
    type(task_output_type), intent(inout) :: task_output
    type(error_type), allocatable, intent(inout) :: error
    real(dp), allocatable :: flow(:)
    integer :: first(3), k

    if (size(task_output%series_urn1_number) == 0) return
    first = [1, replica, point]
    call serialize_column(file, output_datasets%urn1_number, task_output%series_urn1_number, &
      first, error)
    do k = 1, 4
      flow = task_output%series_flow(k::4)
      call serialize_column(file, output_datasets%flow(k), flow, first, error)
      if (.not. file%is_new) task_output%series_flow(k::4) = flow
    end do
  end subroutine serialize_series

  !> Writes or reads the states of a task at `times` times; 0: the datasets have no dimension of
  !> time.
  subroutine serialize_states(file, states, task, times, flat, error)
    type(hdf5_file_type), intent(in) :: file
    type(dataset_type), intent(in) :: states(4)
    !> Replica and point.
    integer, intent(in) :: task(2), times
    !> States, one time after the other: x, y, ux, uy of all particles.
    real(dp), intent(inout) :: flat(:)
    type(error_type), allocatable, intent(inout) :: error
    integer :: n, at, time, k

    if (size(flat) == 0) return
    n = size(flat)/(4*max(times, 1))
    at = 0
    do time = 1, max(times, 1)
      do k = 1, 4
        call serialize_column(file, states(k), flat(at + 1:at + n), [1, pack([time], times > 0), &
          task], error)
        at = at + n
      end do
    end do
  end subroutine serialize_states

  !> Closes the datasets of a file that is still open.
  subroutine close_output_datasets(file, output_datasets, error)
    !> File, still open.
    type(hdf5_file_type), intent(in) :: file
    !> Datasets, which may be open.
    type(output_datasets_type), intent(inout) :: output_datasets
    !> Not all values could be written to a new file; an earlier error is kept.
    type(error_type), allocatable, intent(inout) :: error
    integer :: k

    call release_dataset(file, output_datasets%urn1_number, error)
    do k = 1, 4
      call release_dataset(file, output_datasets%flow(k), error)
      call release_dataset(file, output_datasets%snapshot(k), error)
      call release_dataset(file, output_datasets%final(k), error)
    end do
  end subroutine close_output_datasets

  !> Writes the event log of the only task. Does nothing after an error.
  subroutine write_events(file, task_output, error)
    !> New file, open for writing.
    type(hdf5_file_type), intent(in) :: file
    type(task_output_type), intent(in) :: task_output
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: by_event(*) = ['/events/event']
    integer :: n

    n = size(task_output%event_times)
    call make_group(file, '/events', error)
    call write_dimension(file, '/events/event', n, 'events in the order of time', error)
    call write_dataset(file, '/events/time', task_output%event_times, 'time', since_start, error, &
      by_event)
    call write_dataset(file, '/events/kind', task_output%events(:n), '1', 'what happens', error, &
      by_event)
    call write_attribute(file, '/events/kind', 'flag_values', [1_int32, 2_int32, 3_int32, &
      4_int32], error)
    call write_text_attribute(file, '/events/kind', 'flag_meanings', &
      'enters_gate gate_reverses crosses_channel_1 crosses_channel_2', error)
    call write_dataset(file, '/events/where', task_output%events(n + 1:2*n), '1', &
      'gate (1 or 2), or direction of a crossing (12 or 21)', error, by_event)
    call write_dataset(file, '/events/particle', task_output%events(2*n + 1:3*n), '1', &
      'particle, from 1; of a reversal, how many particles it reverses', error, by_event)
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
