!> The courses of runs in a results file: series, snapshots, final states, events.
!>
!> They are what is large in it, so no more than one task's is ever in memory. The datasets are
!> prepared for all tasks, (.., replica, point), where nothing is known yet; then the course of each
!> task goes into its place, straight from where it was kept. Reading goes the same way: one
!> procedure says what is in either. Columns are the values of one task in a dataset; tasks are best
!> passed in the order of their numbers (`serialize_column`).
module battery_courses
  use battery_kinds, only: dp, int32
  use battery_error, only: error_type
  use battery_hdf5_file, only: hdf5_file_type, make_group
  use battery_hdf5_attributes, only: write_attribute, write_text
  use battery_hdf5_datasets, only: dataset_type, prepare_dataset, serialize_column, &
    release_dataset, write_dataset, write_scale, write_dimension
  use battery_quantities, only: quantity_type, averaged_quantities, place_of, flow_names, &
    unknown_count, unknown_real
  implicit none (type, external)
  private
  public :: course_type, extents_type, courses_type, by_task
  public :: prepare_courses, write_course, read_course, close_courses, write_events, write_count

  !> The course of one task. Arrays are empty or not allocated where there is nothing; those read
  !> are allocated.
  type :: course_type
    !> Series: N1, and flows as (4, entry), which is 1_12, 1_21, 2_12, 2_21.
    integer(int32), allocatable :: series_urn1_number(:)
    real(dp), allocatable :: series_flow(:)
    !> Snapshots one after the other: x, y, ux, uy of all particles; the final state likewise.
    real(dp), allocatable :: snapshots(:), final_state(:)
    !> Events: kind, where, particle one after the other; times.
    integer(int32), allocatable :: events(:)
    real(dp), allocatable :: event_times(:)
  end type course_type

  !> The most that any task of a file has; 0: the file has no such dataset.
  type :: extents_type
    !> Entries of the series; snapshots.
    integer :: entries = 0, snapshots = 0
    !> Particles of snapshots and of final states.
    integer :: particles = 0, final_particles = 0
    !> All replicas and points, complete or not.
    integer :: replicas = 0, points = 0
  end type extents_type

  !> The datasets of an open file that have a column, or some, of each task.
  type :: courses_type
    type(extents_type) :: most
    !> N1 and the flows; x, y, ux, uy.
    type(dataset_type), private :: urn1_number, flow(4), snapshot(4), final(4)
  end type courses_type

  !> Paths of the dimension scales of what every task has, in Fortran order.
  character(len=*), parameter :: by_task(*) = [character(len=8) :: '/replica', '/point']

  !> What times and numbers of particles mean.
  character(len=*), parameter :: since_start = 'time since the start'
  character(len=*), parameter :: in_order = 'particle, from 1, in the order of the initial file'

contains

  !> Makes the datasets for so much in a new file, or opens those of a file that is read; there they
  !> must be as large. Does nothing after an error.
  subroutine prepare_courses(file, most, series_interval, snapshot_time, courses, error)
    !> Open.
    type(hdf5_file_type), intent(in) :: file
    !> For how much; what is 0 is not there.
    type(extents_type), intent(in) :: most
    !> Time between two entries, and times of the snapshots, since the start: for the dimension
    !> scales of a new file.
    real(dp), intent(in) :: series_interval, snapshot_time(:)
    !> To be closed with `close_courses`.
    type(courses_type), intent(out) :: courses
    type(error_type), allocatable, intent(inout) :: error

    courses%most = most
    if (most%entries > 0) call prepare_series(file, most, series_interval, courses, error)
    if (most%snapshots > 0 .and. most%particles > 0) then
      if (file%is_new) then
        call make_group(file, '/snapshots', error)
        call write_scale(file, '/snapshots/time', snapshot_time, 'time', since_start, error)
        call write_count(file, '/snapshots/particle', 1, most%particles, in_order, error)
      end if
      call prepare_states(file, '/snapshots', [most%particles, most%snapshots, most%replicas, &
        most%points], [character(len=19) :: '/snapshots/particle', '/snapshots/time', by_task], &
        courses%snapshot, error)
    end if
    if (most%final_particles > 0) then
      if (file%is_new) then
        call make_group(file, '/final', error)
        call write_count(file, '/final/particle', 1, most%final_particles, in_order, error)
      end if
      call prepare_states(file, '/final', [most%final_particles, most%replicas, most%points], &
        [character(len=15) :: '/final/particle', by_task], courses%final, error)
    end if
  end subroutine prepare_courses

  !> The course of N1 and of the flows.
  subroutine prepare_series(file, most, interval, courses, error)
    type(hdf5_file_type), intent(in) :: file
    type(extents_type), intent(in) :: most
    real(dp), intent(in) :: interval
    type(courses_type), intent(inout) :: courses
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: by_time(*) = [character(len=12) :: '/series/time', by_task]
    type(quantity_type), allocatable :: list(:)
    integer :: extents(3), k

    extents = [most%entries, most%replicas, most%points]
    if (file%is_new) then
      call make_group(file, '/series', error)
      call write_scale(file, '/series/time', [(real(k - 1, dp)*interval, k=1, most%entries)], &
        'time', since_start, error)
    end if
    call prepare_dataset(file, '/series/urn1_number', extents, int(unknown_count, int32), '1', &
      'particles at x < 0', error, by_time, courses%urn1_number)
    call write_attribute(file, '/series/urn1_number', '_FillValue', int(unknown_count, int32), &
      error)
    list = averaged_quantities()
    do k = 1, 4
      associate (flow => list(place_of(flow_names(k), list)))
        call prepare_dataset(file, '/series/'//trim(flow%name), extents, unknown_real(), &
          trim(flow%unit), trim(flow%meaning)//', since the entry before', error, by_time, &
          courses%flow(k))
      end associate
    end do
  end subroutine prepare_series

  !> Positions and velocities.
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

  !> Puts the course of a task into its place in a new file. Does nothing after an error.
  subroutine write_course(file, courses, replica, point, course, error)
    !> Open, as the datasets in it are.
    type(hdf5_file_type), intent(in) :: file
    type(courses_type), intent(in) :: courses
    !> Which task.
    integer, intent(in) :: replica, point
    !> No more of anything than there is room for; stays as it is.
    type(course_type), intent(inout) :: course
    type(error_type), allocatable, intent(inout) :: error

    call serialize_series(file, courses, replica, point, course, error)
    call serialize_states(file, courses%snapshot, [replica, point], courses%most%snapshots, &
      course%snapshots, error)
    call serialize_states(file, courses%final, [replica, point], 0, course%final_state, error)
  end subroutine write_course

  !> The course of a task in a file that is read, but for events; empty after an error.
  subroutine read_course(file, courses, replica, point, number, course, error)
    !> Open, as the datasets in it are.
    type(hdf5_file_type), intent(in) :: file
    type(courses_type), intent(in) :: courses
    !> Which task, and how many particles it has.
    integer, intent(in) :: replica, point, number
    type(course_type), intent(out) :: course
    type(error_type), allocatable, intent(inout) :: error
    integer :: entries

    associate (most => courses%most)
      allocate (course%series_urn1_number(most%entries), course%series_flow(4*most%entries))
      allocate (course%snapshots(4*min(number, most%particles)*most%snapshots))
      allocate (course%final_state(4*min(number, most%final_particles)))
      allocate (course%events(0), course%event_times(0))
      call serialize_series(file, courses, replica, point, course, error)
      call serialize_states(file, courses%snapshot, [replica, point], most%snapshots, &
        course%snapshots, error)
      call serialize_states(file, courses%final, [replica, point], 0, course%final_state, error)
    end associate
    ! Runs may be of unequal length.
    entries = 0
    if (.not. allocated(error)) entries = count(course%series_urn1_number >= 0)
    course%series_urn1_number = course%series_urn1_number(:entries)
    course%series_flow = course%series_flow(:4*entries)
  end subroutine read_course

  subroutine serialize_series(file, courses, replica, point, course, error)
    type(hdf5_file_type), intent(in) :: file
    type(courses_type), intent(in) :: courses
    integer, intent(in) :: replica, point
    type(course_type), intent(inout) :: course
    type(error_type), allocatable, intent(inout) :: error
    real(dp), allocatable :: flow(:)
    integer :: first(3), k

    if (size(course%series_urn1_number) == 0) return
    first = [1, replica, point]
    call serialize_column(file, courses%urn1_number, course%series_urn1_number, first, error)
    do k = 1, 4
      flow = course%series_flow(k::4)
      call serialize_column(file, courses%flow(k), flow, first, error)
      if (.not. file%is_new) course%series_flow(k::4) = flow
    end do
  end subroutine serialize_series

  !> States of a task at some times, or, where that is 0, at the one that has no dimension.
  subroutine serialize_states(file, states, task, times, flat, error)
    type(hdf5_file_type), intent(in) :: file
    type(dataset_type), intent(in) :: states(4)
    !> Replica and point.
    integer, intent(in) :: task(2), times
    !> One time after the other: x, y, ux, uy of all particles.
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
  subroutine close_courses(file, courses, error)
    !> Open still.
    type(hdf5_file_type), intent(in) :: file
    !> Open, or not.
    type(courses_type), intent(inout) :: courses
    !> Not all may have been brought into a new file. Stays as it is after an error.
    type(error_type), allocatable, intent(inout) :: error
    integer :: k

    call release_dataset(file, courses%urn1_number, error)
    do k = 1, 4
      call release_dataset(file, courses%flow(k), error)
      call release_dataset(file, courses%snapshot(k), error)
      call release_dataset(file, courses%final(k), error)
    end do
  end subroutine close_courses

  !> The event log of the only task. Does nothing after an error.
  subroutine write_events(file, course, error)
    !> New, open.
    type(hdf5_file_type), intent(in) :: file
    type(course_type), intent(in) :: course
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: by_event(*) = ['/events/event']
    integer :: n

    n = size(course%event_times)
    call make_group(file, '/events', error)
    call write_dimension(file, '/events/event', n, 'events in the order of time', error)
    call write_dataset(file, '/events/time', course%event_times, 'time', since_start, error, &
      by_event)
    call write_dataset(file, '/events/kind', course%events(:n), '1', 'what happens', error, &
      by_event)
    call write_attribute(file, '/events/kind', 'flag_values', [1_int32, 2_int32, 3_int32, &
      4_int32], error)
    call write_text(file, '/events/kind', 'flag_meanings', &
      'enters_gate gate_reverses crosses_channel_1 crosses_channel_2', error)
    call write_dataset(file, '/events/where', course%events(n + 1:2*n), '1', &
      'gate (1 or 2), or direction of a crossing (12 or 21)', error, by_event)
    call write_dataset(file, '/events/particle', course%events(2*n + 1:3*n), '1', &
      'particle, from 1; where a gate reverses, how many turn back', error, by_event)
  end subroutine write_events

  !> A dimension whose coordinates count up from `first`. Does nothing after an error.
  subroutine write_count(file, path, first, length, long_name, error)
    !> New, open.
    type(hdf5_file_type), intent(in) :: file
    !> From the root.
    character(len=*), intent(in) :: path
    !> The first coordinate, and how many there are.
    integer, intent(in) :: first, length
    !> What it counts.
    character(len=*), intent(in) :: long_name
    type(error_type), allocatable, intent(inout) :: error
    integer :: k

    call write_scale(file, path, int([(first + k, k=0, length - 1)], int32), '1', long_name, error)
  end subroutine write_count

end module battery_courses
