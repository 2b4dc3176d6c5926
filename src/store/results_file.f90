!> The results file: what `battery_results` holds, by name, with units and named dimensions.
!>
!> It is written whole under another name, read back and compared with its seal, and then renamed,
!> so that there is always either the old file or the new one. Not known are NaN and, where an
!> attribute `_FillValue` says so, -1.
module battery_results_file
  use battery_kinds, only: wp, dp, int32, int64
  use battery_build_information, only: program_version
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_files, only: seen_type, sync_file, put_in_place, remove_file
  use battery_key, only: key_type, find_key
  use battery_keys, only: all_keys
  use battery_hdf5_file, only: hdf5_file_type, create_file, open_file, close_file, make_group, check
  use battery_hdf5_attributes, only: read_text, write_attribute, write_text
  use battery_hdf5_datasets, only: pass_dataset, write_dataset, write_scale, &
    write_dimension, extents_of
  use battery_quantities, only: quantity_type, averaged_quantities, counted_quantities, place_of, &
    flow_names, unknown_count, unknown_real
  use battery_results, only: results_type, new_results, scatter_of, task_complete, task_failed, &
    task_not_done, task_not_asked, point_precise, point_not_precise, point_two_states, &
    point_undecided
  use battery_metadata, only: metadata_type, write_metadata
  use battery_namelist_input, only: parse_namelist
  use battery_plan, only: plan_type, point_type, point_of, setup_of
  use battery_room, only: check_room, bytes_a_task, merged_entry, merged_state, most_numbers
  use battery_simulation, only: setup_type
  use battery_seal, only: check_seal
  use battery_table, only: gated, ungated
  use battery_text, only: lines_of, to_text
  implicit none (type, external)
  private
  public :: write_results, read_results

  !> Paths of the dimension scales, in Fortran order.
  character(len=*), parameter :: by_point(*) = ['/point']
  character(len=*), parameter :: by_gate(*) = [character(len=6) :: '/gate', '/point']
  character(len=*), parameter :: by_urn(*) = [character(len=6) :: '/urn', '/point']
  character(len=*), parameter :: by_task(*) = [character(len=8) :: '/replica', '/point']

  !> What times and numbers of particles mean.
  character(len=*), parameter :: since_start = 'time since the start'
  character(len=*), parameter :: in_order = 'particle, from 1, in the order of the initial file'

contains

  !> Writes the file `name`, replacing what was there before; on an error that stays as it was. If
  !> something else is there by now, the results stay in `name.part`.
  subroutine write_results(name, results, metadata, before, error)
    character(len=*), intent(in) :: name
    type(results_type), intent(inout) :: results
    type(metadata_type), intent(in) :: metadata
    !> What may be replaced.
    type(seen_type), intent(in) :: before
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
    call pass_measured(file, results, error)
    call write_precision(file, results, error)
    call pass_series(file, results, error)
    call pass_states(file, results, error)
    call write_events(file, results, error)
    call close_file(file, other)
    if (.not. allocated(error)) call move_alloc(other, error)
    if (.not. allocated(error)) call check_seal(temporary, error)
    if (.not. allocated(error)) call sync_file(temporary, error)
    if (allocated(error)) then
      call remove_file(temporary, other)
    else
      call put_in_place(temporary, name, before, error)
    end if
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

    names = ''
    keys = all_keys()
    if (size(results%scanned) > 0) call make_group(file, '/scan', error)
    do k = 1, size(results%scanned)
      associate (key => keys(find_key(keys, 'scan', results%scanned(k)%key)))
        names = names//' '//trim(key%name)
        call write_scale(file, '/scan/'//trim(key%name), real(results%scanned(k)%values, dp), &
          trim(key%unit)//repeat('1', merge(1, 0, key%unit == '')), trim(key%meaning), error)
      end associate
    end do
    call write_text(file, '/', 'scan', names(2:), error)
  end subroutine write_scan

  !> Reads what `write_results` wrote but for points and events, once its seal was found right. The
  !> file may be of anyone: what it must have follows from the namelist in it, and anything else is
  !> refused with the code `exit_bad_input`, also in what is not read. A file of another version has
  !> its own datasets; it is an error of the code `exit_failure`, as a damaged one.
  subroutine read_results(name, whole, results, error)
    !> Path of the file.
    character(len=*), intent(in) :: name
    !> Whether series and states are read as well.
    logical, intent(in) :: whole
    type(results_type), intent(out) :: results
    type(error_type), allocatable, intent(out) :: error
    type(error_type), allocatable :: other
    type(hdf5_file_type) :: file
    type(plan_type) :: plan

    call check_seal(name, error)
    if (.not. allocated(error)) call open_file(file, name, error)
    if (allocated(error)) return
    call read_plan(file, plan, error)
    if (.not. allocated(error)) call read_tasks(file, plan, results, error)
    if (.not. allocated(error)) call read_courses(file, plan, whole, results, error)
    call close_file(file, other)
    if (.not. allocated(error)) call move_alloc(other, error)
  end subroutine read_results

  !> The plan that a file was made from, by this version.
  subroutine read_plan(file, plan, error)
    type(hdf5_file_type), intent(in) :: file
    type(plan_type), intent(out) :: plan
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: version, namelist, fingerprint
    integer :: status

    call read_text(file, '/', 'version', version, error)
    call read_text(file, '/', 'namelist', namelist, error)
    call read_text(file, '/', 'initial_file_fingerprint', fingerprint, error)
    if (allocated(error)) return
    if (version /= program_version) then
      call fatal_error(error, file%name//' is of another version')
    else
      call parse_namelist(namelist, file%name, plan, error)
    end if
    read (fingerprint, '(z16)', iostat=status) plan%initial_fingerprint
    if (status /= 0) plan%initial_fingerprint = 0
  end subroutine read_plan

  !> What was measured by every task. Statuses, seeds and hosts choose what is done with the rest:
  !> each must be one that there is.
  subroutine read_tasks(file, plan, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(plan_type), intent(in) :: plan
    type(results_type), intent(out) :: results
    type(error_type), allocatable, intent(inout) :: error
    type(setup_type) :: setup
    character(len=:), allocatable :: hosts
    integer :: p, r, host

    call check_memory(bytes_a_task*plan%point_count*plan%replicas, 'tasks', file, error)
    if (allocated(error)) return
    call new_results(results, plan%point_count, plan%replicas)
    call pass_measured(file, results, error)
    call read_text(file, '/provenance', 'hosts', hosts, error)
    if (allocated(error)) return
    results%host = lines_of(hosts)
    host = place_of('provenance/host', counted_quantities())
    do p = 1, plan%point_count
      do r = 1, plan%replicas
        if (results%task_status(r, p) < task_complete .or. results%task_status(r, p) &
          > task_not_asked) call check(file, '/task_status', 'has a number without meaning', 1, &
          error)
        if (allocated(error)) return
        if (results%task_status(r, p) /= task_complete) cycle
        setup = setup_of(plan, p, r)
        if (results%seed(r, p) /= setup%seed) &
          call check(file, '/seed', 'has a seed that the namelist in the file does not', 1, error)
        if (.not. allocated(error) .and. (results%counted(r, p, host) < 0 .or. &
          results%counted(r, p, host) >= size(results%host))) &
          call check(file, '/provenance/host', 'has a host that is not in the list', 1, error)
        if (allocated(error)) return
      end do
    end do
  end subroutine read_tasks

  !> Series and states of those replicas that any point has complete; of the others nothing is
  !> known. What is not read is checked all the same.
  subroutine read_courses(file, plan, whole, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(plan_type), intent(in) :: plan
    logical, intent(in) :: whole
    type(results_type), intent(inout) :: results
    type(error_type), allocatable, intent(inout) :: error
    integer(int64) :: series(3)
    real(dp) :: entries
    integer :: complete, held, points, most, times, r

    complete = findloc([(any(results%task_status(r, :) == task_complete), r=1, plan%replicas)], &
      .true., dim=1, back=.true.)
    if (complete == 0) return
    held = merge(complete, 0, whole)
    points = plan%point_count
    times = size(plan%snapshot_times)
    if (plan%series_interval > 0.0_wp) then
      series = extents_of(file, '/series/urn1_number', 3, error)
      if (allocated(error)) return
      entries = real(series(1), dp)
      if (entries < 1.0_dp .or. entries > most_numbers .or. (plan%duration > 0.0_wp .and. entries &
        > real(2.0_wp + plan%duration/plan%series_interval, dp))) then
        call check(file, '/series/urn1_number', 'has '//to_text(series(1))//' entries, which is ' &
          //'not the length of a series by the namelist in the file', 1, error)
      else
        call check_memory(merged_entry*entries*held*points, '/series', file, error)
      end if
      if (allocated(error)) return
      allocate (results%series_time(series(1)), results%series_flow(series(1), held, points, 4))
      allocate (results%series_urn1_number(series(1), held, points))
      call pass_series(file, results, error)
    end if
    most = most_particles(plan, results)
    call check_memory(merged_state*most*held*points*(times + merge(1, 0, plan%final_state)), &
      '/snapshots and /final', file, error)
    if (allocated(error)) return
    if (times > 0) allocate (results%snapshots(most, times, held, points, 4))
    if (plan%final_state) allocate (results%final_state(most, 1, held, points, 4))
    call pass_states(file, results, error)
    if (whole) return
    if (allocated(results%series_time)) deallocate (results%series_time, results%series_flow, &
      results%series_urn1_number)
    if (allocated(results%snapshots)) deallocate (results%snapshots)
    if (allocated(results%final_state)) deallocate (results%final_state)
  end subroutine read_courses

  !> An error if there is no memory for so many bytes of a file. Does nothing after an error.
  subroutine check_memory(bytes, what, file, error)
    real(dp), intent(in) :: bytes
    !> Datasets that ask for them.
    character(len=*), intent(in) :: what
    type(hdf5_file_type), intent(in) :: file
    type(error_type), allocatable, intent(inout) :: error

    if (allocated(error)) return
    call check_room(bytes, what//' in '//file%name, error)
    if (allocated(error)) error%code = exit_bad_input
  end subroutine check_memory

  !> Particles of the largest point that has a complete task: there is room for so many in a file.
  integer function most_particles(plan, results) result(most)
    type(plan_type), intent(in) :: plan
    type(results_type), intent(in) :: results
    type(point_type) :: point
    integer :: p

    most = 0
    do p = 1, plan%point_count
      if (all(results%task_status(:, p) /= task_complete)) cycle
      point = point_of(plan, p)
      most = max(most, point%number)
    end do
  end function most_particles

  !> Dimensions, points of the scan.
  subroutine write_points(file, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error

    call write_count(file, '/point', 0, size(results%point), 'point of the scan, from 0', error)
    call write_count(file, '/replica', 0, results%replicas, 'replica of a point, from 0', error)
    call write_count(file, '/gate', 1, 2, 'gate, that of urn 1 and that of urn 2', error)
    call write_count(file, '/urn', 1, 2, 'urn', error)
    associate (p => results%point)
      call write_dataset(file, '/number', p%number, '1', 'particles N', error, by_point)
      call write_dataset(file, '/threshold', p%threshold(1), '1', &
        'threshold T of gate 1: a gate reverses when more particles head for the other', error, &
        by_point)
      call write_dataset(file, '/urn1_number', p%urn1_number, '1', &
        'particles in urn 1 at the start', error, by_point)
      call write_dataset(file, '/gate_threshold', reshape([p%threshold(1), p%threshold(2)], &
        [2, size(p)], order=[2, 1]), '1', 'threshold T of each gate', error, by_gate)
      call write_dataset(file, '/urn_radius', reshape([p%urn_radius(1), p%urn_radius(2)], &
        [2, size(p)], order=[2, 1]), 'length', 'radius r of each urn', error, by_urn)
      call write_dataset(file, '/channel1_width', p%channel(gated)%width, 'length', &
        'width w of channel 1', error, by_point)
      call write_dataset(file, '/channel1_length', p%channel(gated)%length, 'length', &
        'length l of channel 1', error, by_point)
      call write_dataset(file, '/channel2_width', p%channel(ungated)%width, 'length', &
        'width w'' of channel 2', error, by_point)
      call write_dataset(file, '/channel2_length', p%channel(ungated)%length, 'length', &
        'length l'' of channel 2', error, by_point)
    end associate
  end subroutine write_points

  !> What was measured by every task, and how it scatters over the replicas of a point.
  subroutine pass_measured(file, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(results_type), intent(inout) :: results
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: blocks = ', standard error from the run; NaN: too short'
    character(len=*), parameter :: scatter = ', standard error from the scatter of the replicas'
    type(quantity_type), allocatable :: list(:)
    character(len=:), allocatable :: path, unit, meaning
    integer :: q

    call pass_dataset(file, '/seed', results%seed, '1', 'seed of the random start', error, by_task)
    call pass_dataset(file, '/task_status', results%task_status, '1', 'how the task ended', &
      error, by_task)
    call write_attribute(file, '/task_status', 'flag_values', [task_complete, task_failed, &
      task_not_done, task_not_asked], error)
    call write_text(file, '/task_status', 'flag_meanings', 'complete failed not_done not_asked', &
      error)
    list = averaged_quantities()
    do q = 1, size(list)
      path = '/'//trim(list(q)%name)
      unit = trim(list(q)%unit)
      meaning = trim(list(q)%meaning)
      call pass_dataset(file, path, results%average(:, :, q), unit, meaning, error, by_task)
      if (.not. list(q)%has_error) cycle
      call pass_dataset(file, path//'_error', results%error(:, :, q), unit, meaning//blocks, &
        error, by_task)
      if (file%is_new) call write_dataset(file, path//'_spread', scatter_of(results%average(:, &
        :, q), results%task_status), unit, meaning//scatter, error, by_point)
    end do
    list = counted_quantities()
    do q = 1, size(list)
      path = '/'//trim(list(q)%name)
      call pass_dataset(file, path, results%counted(:, :, q), trim(list(q)%unit), &
        trim(list(q)%meaning), error, by_task)
      call write_attribute(file, path, '_FillValue', unknown_count, error)
    end do
  end subroutine pass_measured

  !> What came of the precision that was asked for.
  subroutine write_precision(file, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: meaning = 'standard error over replicas, with Student''s ' &
      //'factor of the first ones, of '

    if (.not. allocated(results%point_status)) return
    call write_dataset(file, '/chi_replica_error', results%replica_error(:, 1), '1', &
      meaning//'chi', error, by_point)
    call write_dataset(file, '/polarised_current_replica_error', results%replica_error(:, 2), &
      '1/time', meaning//'polarised_current', error, by_point)
    call write_dataset(file, '/point_status', results%point_status, '1', &
      'whether the precision was reached', error, by_point)
    call write_attribute(file, '/point_status', 'flag_values', [point_precise, point_not_precise, &
      point_two_states, point_undecided], error)
    call write_text(file, '/point_status', 'flag_meanings', &
      'reached not_reached two_states undecided', error)
  end subroutine write_precision

  !> The course of N1 and of the flows.
  subroutine pass_series(file, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(results_type), intent(inout) :: results
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: by_time(*) = [character(len=12) :: '/series/time', by_task]
    type(quantity_type), allocatable :: list(:)
    integer :: which, extents(3)

    if (.not. allocated(results%series_time)) return
    extents = [size(results%series_time), shape(results%seed)]
    if (file%is_new) then
      call make_group(file, '/series', error)
      call write_scale(file, '/series/time', results%series_time, 'time', since_start, error)
    end if
    call pass_dataset(file, '/series/urn1_number', results%series_urn1_number, '1', &
      'particles at x < 0', error, by_time, extents, int(unknown_count, int32))
    call write_attribute(file, '/series/urn1_number', '_FillValue', int(unknown_count, int32), &
      error)
    list = averaged_quantities()
    do which = 1, 4
      associate (flow => list(place_of(flow_names(which), list)))
        call pass_dataset(file, '/series/'//trim(flow%name), results%series_flow(:, :, :, which), &
          trim(flow%unit), trim(flow%meaning)//', since the entry before', error, by_time, &
          extents, unknown_real())
      end associate
    end do
  end subroutine pass_series

  !> Positions and velocities at chosen times, and at the end.
  subroutine pass_states(file, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(results_type), intent(inout) :: results
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: names(4) = [character(len=2) :: 'x', 'y', 'ux', 'uy']
    character(len=*), parameter :: units(4) = [character(len=6) :: 'length', 'length', '1', '1']
    character(len=*), parameter :: meanings(4) = [character(len=10) :: 'position x', &
      'position y', 'velocity x', 'velocity y']
    character(len=*), parameter :: by_particle(*) = [character(len=19) :: &
      '/snapshots/particle', '/snapshots/time', by_task]
    character(len=*), parameter :: by_last(*) = [character(len=15) :: '/final/particle', by_task]
    integer :: which

    if (allocated(results%snapshots) .and. file%is_new) then
      call make_group(file, '/snapshots', error)
      call write_scale(file, '/snapshots/time', results%snapshot_time, 'time', since_start, error)
      call write_count(file, '/snapshots/particle', 1, size(results%snapshots, 1), in_order, error)
    end if
    if (allocated(results%final_state) .and. file%is_new) then
      call make_group(file, '/final', error)
      call write_count(file, '/final/particle', 1, size(results%final_state, 1), in_order, error)
    end if
    do which = 1, 4
      if (allocated(results%snapshots)) call pass_dataset(file, &
        '/snapshots/'//trim(names(which)), results%snapshots(:, :, :, :, which), &
        trim(units(which)), meanings(which), error, by_particle, &
        [size(results%snapshots, 1), size(results%snapshots, 2), shape(results%seed)], &
        unknown_real())
      if (allocated(results%final_state)) call pass_dataset(file, '/final/'//trim(names(which)), &
        results%final_state(:, 1, :, :, which), trim(units(which)), meanings(which), error, &
        by_last, [size(results%final_state, 1), shape(results%seed)], unknown_real())
    end do
  end subroutine pass_states

  !> The event log.
  subroutine write_events(file, results, error)
    type(hdf5_file_type), intent(in) :: file
    type(results_type), intent(in) :: results
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: by_event(*) = ['/events/event']

    if (.not. allocated(results%event_time)) return
    call make_group(file, '/events', error)
    call write_dimension(file, '/events/event', size(results%event_time), &
      'events in the order of time', error)
    call write_dataset(file, '/events/time', results%event_time, 'time', since_start, error, &
      by_event)
    call write_dataset(file, '/events/kind', results%event_kind, '1', 'what happens', error, &
      by_event)
    call write_attribute(file, '/events/kind', 'flag_values', [1_int32, 2_int32, 3_int32, &
      4_int32], error)
    call write_text(file, '/events/kind', 'flag_meanings', &
      'enters_gate gate_reverses crosses_channel_1 crosses_channel_2', error)
    call write_dataset(file, '/events/where', results%event_where, '1', &
      'gate (1 or 2), or direction of a crossing (12 or 21)', error, by_event)
    call write_dataset(file, '/events/particle', results%event_particle, '1', &
      'particle, from 1; where a gate reverses, how many turn back', error, by_event)
  end subroutine write_events

  !> A dimension whose coordinates count up from `first`.
  subroutine write_count(file, path, first, length, long_name, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path
    integer, intent(in) :: first, length
    character(len=*), intent(in) :: long_name
    type(error_type), allocatable, intent(inout) :: error
    integer :: k

    call write_scale(file, path, int([(first + k, k=0, length - 1)], int32), '1', long_name, error)
  end subroutine write_count

end module battery_results_file
