!> The results file: what `battery_results` holds, by name, with units and named dimensions.
!>
!> It is written whole under another name, read back and compared with its seal, and then renamed,
!> so that there is always either the old file or the new one. Not known are NaN and, where an
!> attribute `_FillValue` says so, -1.
module battery_results_file
  use battery_kinds, only: dp, int32, int64
  use battery_error, only: error_type
  use battery_files, only: publish_file, remove_file
  use battery_key, only: key_type, find_key
  use battery_keys, only: all_keys
  use battery_hdf5_file, only: hdf5_file_type, create_file, close_file, make_group
  use battery_hdf5_attributes, only: write_attribute
  use battery_seal, only: check_seal
  use battery_hdf5_datasets, only: write_dataset
  use battery_hdf5_scales, only: make_scale, make_dimension, attach_scales
  use battery_quantities, only: quantity_type, averaged_quantities, counted_quantities, place_of, &
    unknown_count
  use battery_results, only: results_type, scatter_of, task_complete, task_failed, task_not_done
  use battery_metadata, only: metadata_type, write_metadata
  implicit none (type, external)
  private
  public :: write_results

  !> Writes `values` as a dataset at the `path` of an open `file`, unless an error came before, with
  !> the scales at the paths of `dimensions`, in Fortran order, and its `units` and `long_name`.
  interface put
    module procedure :: put_real64, put_int32, put_int64
  end interface put

  !> Paths of the dimension scales, in Fortran order.
  character(len=*), parameter :: by_point(*) = ['/point']
  character(len=*), parameter :: by_gate(*) = [character(len=6) :: '/gate', '/point']
  character(len=*), parameter :: by_urn(*) = [character(len=6) :: '/urn', '/point']
  character(len=*), parameter :: by_task(*) = [character(len=8) :: '/replica', '/point']

contains

  !> Writes the file `name`, replacing what is there; on an error that stays as it was.
  subroutine write_results(name, results, metadata, error)
    character(len=*), intent(in) :: name
    type(results_type), intent(in) :: results
    type(metadata_type), intent(in) :: metadata
    type(error_type), allocatable, intent(out) :: error
    type(error_type), allocatable :: other
    type(hdf5_file_type) :: file
    character(len=:), allocatable :: temporary

    temporary = name//'.part'
    call create_file(file, temporary, error)
    if (allocated(error)) return
    call write_metadata(file, metadata, error)
    call write_scan(file, results, error)
    call write_points(file, results, error)
    call write_measured(file, results, error)
    call write_series(file, results, error)
    call write_snapshots(file, results, error)
    call write_events(file, results, error)
    call write_final(file, results, error)
    call close_file(file, other)
    if (.not. allocated(error)) call move_alloc(other, error)
    if (.not. allocated(error)) call check_seal(temporary, error)
    if (.not. allocated(error)) call publish_file(temporary, name, error)
    if (allocated(error)) call remove_file(temporary, other)
  end subroutine write_results

  !> The grid of the scan: its keys in the attribute `scan` of the root, the slowest first, and the
  !> values of each in the group of that name.
  subroutine write_scan(file, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error
    type(key_type), allocatable :: keys(:)
    character(len=:), allocatable :: names
    integer :: k

    if (allocated(error)) return
    names = ''
    keys = all_keys()
    if (size(results%scanned) > 0) call make_group(file, '/scan', error)
    do k = 1, size(results%scanned)
      associate (key => keys(find_key(keys, 'scan', results%scanned(k)%key)))
        names = names//' '//key%name
        if (.not. allocated(error)) call write_dataset(file, '/scan/'//key%name, &
          real(results%scanned(k)%values, dp), key%unit//repeat('1', merge(1, 0, key%unit == '')), &
          key%meaning, error)
        if (.not. allocated(error)) call make_scale(file, '/scan/'//key%name, error)
      end associate
    end do
    if (.not. allocated(error)) call write_attribute(file, '/', 'scan', names(2:), error)
  end subroutine write_scan

  !> Dimensions, points of the scan, seeds.
  subroutine write_points(file, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error

    call put_scale(file, '/point', 0, results%points, 'point of the scan, from 0', error)
    call put_scale(file, '/replica', 0, results%replicas, 'replica of a point, from 0', error)
    call put(file, '/number', results%number, by_point, '1', 'particles N', error)
    call put(file, '/threshold', results%threshold, by_point, '1', &
      'threshold T of gate 1: a gate reverses when more particles head for the other', error)
    call put(file, '/urn1_number', results%urn1_number, by_point, '1', &
      'particles in urn 1 at the start', error)
    call put_scale(file, '/gate', 1, 2, 'gate, that of urn 1 and that of urn 2', error)
    call put_scale(file, '/urn', 1, 2, 'urn', error)
    call put(file, '/gate_threshold', results%gate_threshold, by_gate, '1', &
      'threshold T of each gate', error)
    call put(file, '/urn_radius', results%urn_radius, by_urn, 'length', 'radius r of each urn', &
      error)
    call put(file, '/channel1_width', results%channel1_width, by_point, 'length', &
      'width w of channel 1', error)
    call put(file, '/channel1_length', results%channel1_length, by_point, 'length', &
      'length l of channel 1', error)
    call put(file, '/channel2_width', results%channel2_width, by_point, 'length', &
      'width w'' of channel 2', error)
    call put(file, '/channel2_length', results%channel2_length, by_point, 'length', &
      'length l'' of channel 2', error)
    call put(file, '/seed', results%seed, by_task, '1', 'seed of the random start', error)
  end subroutine write_points

  !> What was measured by every task, and how it scatters over the replicas of a point.
  subroutine write_measured(file, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: blocks = ', standard error from blocks of the run'
    character(len=*), parameter :: scatter = ', standard error from the scatter of the replicas'
    type(quantity_type), allocatable :: list(:)
    integer :: q

    list = averaged_quantities()
    do q = 1, size(list)
      associate (path => '/'//list(q)%name, unit => list(q)%unit, meaning => list(q)%meaning)
        call put(file, path, results%average(:, :, q), by_task, unit, meaning, error)
        if (.not. list(q)%has_error) cycle
        call put(file, path//'_error', results%error(:, :, q), by_task, unit, meaning//blocks, &
          error)
        call put(file, path//'_spread', scatter_of(results%average(:, :, q), &
          results%task_status), by_point, unit, meaning//scatter, error)
      end associate
    end do
    list = counted_quantities()
    do q = 1, size(list)
      call put(file, '/'//list(q)%name, results%counted(:, :, q), by_task, list(q)%unit, &
        list(q)%meaning, error)
      if (.not. allocated(error)) call write_attribute(file, '/'//list(q)%name, '_FillValue', &
        unknown_count, error)
    end do
    call put(file, '/task_status', results%task_status, by_task, '1', 'how the task ended', error)
    if (.not. allocated(error)) call write_attribute(file, '/task_status', 'flag_values', &
      [task_complete, task_failed, task_not_done], error)
    if (.not. allocated(error)) call write_attribute(file, '/task_status', 'flag_meanings', &
      'complete failed not_done', error)
  end subroutine write_measured

  !> The course of N1 and of the flows.
  subroutine write_series(file, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: by_time(*) = [character(len=12) :: '/series/time', by_task]
    character(len=*), parameter :: names(4) = ['flow1_12', 'flow1_21', 'flow2_12', 'flow2_21']
    type(quantity_type), allocatable :: list(:)
    integer :: which

    if (.not. allocated(results%series_time) .or. allocated(error)) return
    call make_group(file, '/series', error)
    call put_time(file, '/series/time', results%series_time, error)
    call put(file, '/series/urn1_number', results%series_urn1_number, by_time, '1', &
      'particles at x < 0', error)
    if (.not. allocated(error)) call write_attribute(file, '/series/urn1_number', '_FillValue', &
      int(unknown_count, int32), error)
    list = averaged_quantities()
    do which = 1, 4
      associate (flow => list(place_of(names(which), list)))
        call put(file, '/series/'//flow%name, results%series_flow(:, :, :, which), by_time, &
          flow%unit, flow%meaning//', since the entry before', error)
      end associate
    end do
  end subroutine write_series

  !> Positions and velocities at chosen times.
  subroutine write_snapshots(file, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: dimensions(*) = [character(len=19) :: '/snapshots/particle', &
      '/snapshots/time', by_task]

    if (.not. allocated(results%snapshot_time) .or. allocated(error)) return
    call make_group(file, '/snapshots', error)
    call put_time(file, '/snapshots/time', results%snapshot_time, error)
    associate (r => results)
      call put_particles(file, '/snapshots', size(r%snapshot_x, 1), error)
      call put(file, '/snapshots/x', r%snapshot_x, dimensions, 'length', 'position x', error)
      call put(file, '/snapshots/y', r%snapshot_y, dimensions, 'length', 'position y', error)
      call put(file, '/snapshots/ux', r%snapshot_ux, dimensions, '1', 'velocity x', error)
      call put(file, '/snapshots/uy', r%snapshot_uy, dimensions, '1', 'velocity y', error)
    end associate
  end subroutine write_snapshots

  !> The event log.
  subroutine write_events(file, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: by_event(*) = ['/events/event']

    if (.not. allocated(results%event_time) .or. allocated(error)) return
    call make_group(file, '/events', error)
    if (.not. allocated(error)) call make_dimension(file, '/events/event', &
      size(results%event_time), 'events in the order of time', error)
    associate (r => results)
      call put(file, '/events/time', r%event_time, by_event, 'time', 'time since the start', error)
      call put(file, '/events/kind', r%event_kind, by_event, '1', 'what happens', error)
      if (.not. allocated(error)) call write_attribute(file, '/events/kind', 'flag_values', &
        [1_int32, 2_int32, 3_int32, 4_int32], error)
      if (.not. allocated(error)) call write_attribute(file, '/events/kind', 'flag_meanings', &
        'enters_gate gate_reverses crosses_channel_1 crosses_channel_2', error)
      call put(file, '/events/where', r%event_where, by_event, '1', &
        'gate (1 or 2), or direction of a crossing (12 or 21)', error)
      call put(file, '/events/particle', r%event_particle, by_event, '1', &
        'particle, from 1; where a gate reverses, how many turn back', error)
    end associate
  end subroutine write_events

  !> Positions and velocities at the end.
  subroutine write_final(file, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: dimensions(*) = [character(len=15) :: '/final/particle', by_task]

    if (.not. allocated(results%final_x) .or. allocated(error)) return
    call make_group(file, '/final', error)
    associate (r => results)
      call put_particles(file, '/final', size(r%final_x, 1), error)
      call put(file, '/final/x', r%final_x, dimensions, 'length', 'position x', error)
      call put(file, '/final/y', r%final_y, dimensions, 'length', 'position y', error)
      call put(file, '/final/ux', r%final_ux, dimensions, '1', 'velocity x', error)
      call put(file, '/final/uy', r%final_uy, dimensions, '1', 'velocity y', error)
    end associate
  end subroutine write_final

  subroutine put_real64(file, path, values, dimensions, units, long_name, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, dimensions(:), units, long_name
    real(dp), intent(in), contiguous, target :: values(..)
    type(error_type), allocatable, intent(inout) :: error

    if (allocated(error)) return
    call write_dataset(file, path, values, units, long_name, error)
    if (.not. allocated(error)) call attach_scales(file, path, dimensions, error)
  end subroutine put_real64

  subroutine put_int32(file, path, values, dimensions, units, long_name, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, dimensions(:), units, long_name
    integer(int32), intent(in), contiguous, target :: values(..)
    type(error_type), allocatable, intent(inout) :: error

    if (allocated(error)) return
    call write_dataset(file, path, values, units, long_name, error)
    if (.not. allocated(error)) call attach_scales(file, path, dimensions, error)
  end subroutine put_int32

  subroutine put_int64(file, path, values, dimensions, units, long_name, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, dimensions(:), units, long_name
    integer(int64), intent(in), contiguous, target :: values(..)
    type(error_type), allocatable, intent(inout) :: error

    if (allocated(error)) return
    call write_dataset(file, path, values, units, long_name, error)
    if (.not. allocated(error)) call attach_scales(file, path, dimensions, error)
  end subroutine put_int64

  !> A dimension whose coordinates count up from `first`.
  subroutine put_scale(file, path, first, length, long_name, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path
    integer, intent(in) :: first, length
    character(len=*), intent(in) :: long_name
    type(error_type), allocatable, intent(inout) :: error
    integer(int32), allocatable :: coordinates(:)
    integer :: k

    if (allocated(error)) return
    allocate (coordinates(length))
    do k = 1, length
      coordinates(k) = first + k - 1
    end do
    call write_dataset(file, path, coordinates, '1', long_name, error)
    if (.not. allocated(error)) call make_scale(file, path, error)
  end subroutine put_scale

  !> The dimension of particles of a group, from 1 as in the event log.
  subroutine put_particles(file, group, number, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: group
    integer, intent(in) :: number
    type(error_type), allocatable, intent(inout) :: error

    call put_scale(file, group//'/particle', 1, number, &
      'particle, from 1, in the order of the initial file', error)
  end subroutine put_particles

  !> The dimension of time of a group.
  subroutine put_time(file, path, times, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path
    real(dp), intent(in), contiguous :: times(:)
    type(error_type), allocatable, intent(inout) :: error

    if (allocated(error)) return
    call write_dataset(file, path, times, 'time', 'time since the start', error)
    if (.not. allocated(error)) call make_scale(file, path, error)
  end subroutine put_time

end module battery_results_file
