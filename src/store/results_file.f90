!> The results file of a run: the layout that users and their scripts rely on.
!>
!> Arrays are (replica, point) here and (point, replica) for readers in C or Python. A file is written
!> under a temporary name and renamed when it is whole. What was not done is NaN, or -1 for integers.
module battery_results_file
  use battery_kinds, only: dp, int32, int64
  use battery_error, only: error_type
  use battery_files, only: publish_file, remove_file
  use battery_hdf5_file, only: hdf5_file_type, create_file, close_file, make_group
  use battery_hdf5_datasets, only: write_dataset
  use battery_hdf5_scales, only: make_scale, attach_scales
  use battery_metadata, only: metadata_type, write_metadata
  use battery_results, only: results_type, spread_of
  implicit none (type, external)
  private
  public :: write_results

  character(len=*), parameter :: by_task(2) = [character(len=8) :: '/point', '/replica']

  !> A file under way: after the first error nothing more is done.
  type :: writer_type
    type(hdf5_file_type) :: file
    type(error_type), allocatable :: error
  contains
    procedure :: real_numbers
    procedure :: integers
    procedure :: long_integers
  end type writer_type

contains

  !> Writes all to a temporary file and renames it to `name`; after an error, what was there under
  !> that name is still there.
  subroutine write_results(name, results, metadata, error)
    character(len=*), intent(in) :: name
    type(results_type), intent(in) :: results
    type(metadata_type), intent(in) :: metadata
    type(error_type), allocatable, intent(out) :: error
    type(writer_type) :: writer
    type(error_type), allocatable :: trouble
    character(len=:), allocatable :: temporary

    temporary = name//'.new'
    call create_file(writer%file, temporary, writer%error)
    if (.not. allocated(writer%error)) call write_metadata(writer%file, metadata, writer%error)
    call write_points(writer, results)
    call write_tasks(writer, results)
    if (allocated(results%series_time)) call write_series(writer, results)
    if (allocated(results%snapshot_time)) call write_snapshots(writer, results)
    if (allocated(results%event_time)) call write_events(writer, results)
    if (allocated(results%final_x)) call write_final(writer, results)
    call close_file(writer%file, trouble)
    if (.not. allocated(writer%error) .and. allocated(trouble)) call move_alloc(trouble, writer%error)
    if (.not. allocated(writer%error)) call publish_file(temporary, name, writer%error)
    if (allocated(writer%error)) call remove_file(temporary, trouble)
    call move_alloc(writer%error, error)
  end subroutine write_results

  subroutine write_points(writer, results)
    type(writer_type), intent(inout) :: writer
    type(results_type), intent(in) :: results
    character(len=*), parameter :: by_point(1) = ['/point']

    call dimension_of(writer, '/point', size(results%number), 'parameter point')
    call dimension_of(writer, '/replica', size(results%chi, 1), 'replica')
    call writer%integers('/number', results%number, 'number of particles', by_point)
    call writer%integers('/threshold', results%threshold, 'threshold T of the gates', by_point)
    call writer%integers('/urn1_number', results%urn1_number, 'particles that start in urn 1', by_point)
    call writer%real_numbers('/channel1_width', results%channel1_width, 'length', 'width w of channel 1', &
      by_point)
    call writer%real_numbers('/channel2_width', results%channel2_width, 'length', 'width w'' of channel 2', &
      by_point)
    call write_spread('/chi_spread', results%chi, '1', 'mass spread')
    ! Which urn fills up is a matter of chance, and with it the sign of the currents.
    call write_spread('/current1_spread', abs(results%current1), '1/time', 'size of the net current of channel 1')
    call write_spread('/current2_spread', abs(results%current2), '1/time', 'size of the net current of channel 2')

  contains

    subroutine write_spread(path, values, units, what)
      character(len=*), intent(in) :: path, units, what
      real(dp), intent(in) :: values(:, :)

      call writer%real_numbers(path, spread_of(values, results%task_status), units, &
        what//': standard error of the mean from the scatter of the replicas', by_point)
    end subroutine write_spread

  end subroutine write_points

  !> A dimension whose coordinates are 0, 1, 2, ...
  subroutine dimension_of(writer, path, length, long_name)
    type(writer_type), intent(inout) :: writer
    character(len=*), intent(in) :: path, long_name
    integer, intent(in) :: length
    integer(int32) :: k

    if (allocated(writer%error)) return
    call write_dataset(writer%file, path, [(k, k=0, int(length - 1, int32))], '1', long_name, writer%error)
    if (.not. allocated(writer%error)) call make_scale(writer%file, path, writer%error)
  end subroutine dimension_of

  subroutine write_tasks(writer, r)
    type(writer_type), intent(inout) :: writer
    type(results_type), intent(in) :: r
    character(len=*), parameter :: rate = '1/time'

    call writer%long_integers('/seed', r%seed, 'seed of the random start', by_task)
    call writer%real_numbers('/chi', r%chi, '1', 'mass spread |N1 - N2|/N, time average', by_task)
    call writer%real_numbers('/chi_error', r%chi_error, '1', 'its standard error from blocks', by_task)
    call writer%real_numbers('/chi_collision', r%chi_collision, '1', &
      'mass spread averaged over the states after each wall collision', by_task)
    call writer%real_numbers('/current1', r%current1, rate, &
      'net current of channel 1 from urn 1 to urn 2', by_task)
    call writer%real_numbers('/current1_error', r%current1_error, rate, &
      'its standard error from blocks', by_task)
    call writer%real_numbers('/current2', r%current2, rate, &
      'net current of channel 2 from urn 1 to urn 2', by_task)
    call writer%real_numbers('/current2_error', r%current2_error, rate, &
      'its standard error from blocks', by_task)
    call writer%real_numbers('/flow1_12', r%flow1_12, rate, 'crossings of channel 1 from urn 1', by_task)
    call writer%real_numbers('/flow1_21', r%flow1_21, rate, 'crossings of channel 1 from urn 2', by_task)
    call writer%real_numbers('/flow2_12', r%flow2_12, rate, 'crossings of channel 2 from urn 1', by_task)
    call writer%real_numbers('/flow2_21', r%flow2_21, rate, 'crossings of channel 2 from urn 2', by_task)
    call writer%real_numbers('/time', r%time, 'time', 'length of the run, transient included', by_task)
    call writer%real_numbers('/transient_time', r%transient_time, 'time', &
      'length of the transient, which the averages leave out', by_task)
    call writer%real_numbers('/cpu_seconds', r%cpu_seconds, 's', 'processor time', by_task)
    call writer%long_integers('/collisions', r%collisions, 'wall collisions, transient included', by_task)
    call writer%long_integers('/bounce_backs', r%bounce_backs, 'particles turned back by the gates', by_task)
    call writer%long_integers('/reversals', r%reversals, 'how often a gate reversed', by_task)
    call writer%long_integers('/trapped', r%trapped, 'particles on orbits that never leave', by_task)
    call writer%integers('/task_status', r%task_status, '0 complete, 1 failed, 2 not done', by_task)
  end subroutine write_tasks

  subroutine write_series(writer, r)
    type(writer_type), intent(inout) :: writer
    type(results_type), intent(in) :: r
    character(len=*), parameter :: axes(3) = [character(len=12) :: '/point', '/replica', '/series/time']

    call group(writer, '/series')
    call scale(writer, '/series/time', r%series_time, 'time since the start')
    call writer%integers('/series/urn1_number', r%series_urn1_number, 'particles in half 1 then', axes)
    call writer%real_numbers('/series/flow1_12', r%series_flow(:, :, :, 1), '1/time', &
      'crossings of channel 1 from urn 1 since the entry before', axes)
    call writer%real_numbers('/series/flow1_21', r%series_flow(:, :, :, 2), '1/time', &
      'crossings of channel 1 from urn 2 since the entry before', axes)
    call writer%real_numbers('/series/flow2_12', r%series_flow(:, :, :, 3), '1/time', &
      'crossings of channel 2 from urn 1 since the entry before', axes)
    call writer%real_numbers('/series/flow2_21', r%series_flow(:, :, :, 4), '1/time', &
      'crossings of channel 2 from urn 2 since the entry before', axes)
  end subroutine write_series

  subroutine write_snapshots(writer, r)
    type(writer_type), intent(inout) :: writer
    type(results_type), intent(in) :: r
    character(len=*), parameter :: axes(4) = [character(len=19) :: '/point', '/replica', &
      '/snapshots/snapshot', '/snapshots/particle']
    character(len=*), parameter :: by_snapshot(1) = ['/snapshots/snapshot']

    call group(writer, '/snapshots')
    call dimension_of(writer, '/snapshots/particle', size(r%snapshot_x, 1), 'particle')
    call dimension_of(writer, '/snapshots/snapshot', size(r%snapshot_time), 'snapshot')
    call writer%real_numbers('/snapshots/time', r%snapshot_time, 'time', 'time since the start', by_snapshot)
    call writer%real_numbers('/snapshots/x', r%snapshot_x, 'length', 'position along channel 1', axes)
    call writer%real_numbers('/snapshots/y', r%snapshot_y, 'length', 'position across channel 1', axes)
    call writer%real_numbers('/snapshots/ux', r%snapshot_ux, '1', 'velocity along channel 1', axes)
    call writer%real_numbers('/snapshots/uy', r%snapshot_uy, '1', 'velocity across channel 1', axes)
  end subroutine write_snapshots

  subroutine write_events(writer, r)
    type(writer_type), intent(inout) :: writer
    type(results_type), intent(in) :: r
    character(len=*), parameter :: axes(1) = ['/events/event']

    call group(writer, '/events')
    call dimension_of(writer, '/events/event', size(r%event_time), 'event')
    call writer%real_numbers('/events/time', r%event_time, 'time', 'time since the start', axes)
    call writer%integers('/events/kind', r%event_kind, &
      '1 enters a gate, 2 a gate reverses, 3 crosses channel 1, 4 crosses channel 2', axes)
    call writer%integers('/events/where', r%event_where, 'gate 1 or 2; or 12 or 21: from which urn to which', axes)
    call writer%integers('/events/particle', r%event_particle, &
      'particle, from 1; when a gate reverses, how many turn back', axes)
  end subroutine write_events

  subroutine write_final(writer, r)
    type(writer_type), intent(inout) :: writer
    type(results_type), intent(in) :: r
    character(len=*), parameter :: axes(3) = [character(len=15) :: '/point', '/replica', '/final/particle']

    call group(writer, '/final')
    call dimension_of(writer, '/final/particle', size(r%final_x, 1), 'particle')
    call writer%real_numbers('/final/x', r%final_x, 'length', 'position along channel 1 at the end', axes)
    call writer%real_numbers('/final/y', r%final_y, 'length', 'position across channel 1 at the end', axes)
    call writer%real_numbers('/final/ux', r%final_ux, '1', 'velocity along channel 1 at the end', axes)
    call writer%real_numbers('/final/uy', r%final_uy, '1', 'velocity across channel 1 at the end', axes)
  end subroutine write_final

  subroutine group(writer, path)
    type(writer_type), intent(inout) :: writer
    character(len=*), intent(in) :: path

    if (.not. allocated(writer%error)) call make_group(writer%file, path, writer%error)
  end subroutine group

  !> A dimension with coordinates in time.
  subroutine scale(writer, path, values, long_name)
    type(writer_type), intent(inout) :: writer
    character(len=*), intent(in) :: path, long_name
    real(dp), intent(in) :: values(:)

    if (allocated(writer%error)) return
    call write_dataset(writer%file, path, values, 'time', long_name, writer%error)
    if (.not. allocated(writer%error)) call make_scale(writer%file, path, writer%error)
  end subroutine scale

  subroutine real_numbers(self, path, values, units, long_name, axes)
    class(writer_type), intent(inout) :: self
    character(len=*), intent(in) :: path, units, long_name, axes(:)
    real(dp), intent(in), contiguous :: values(..)

    if (allocated(self%error)) return
    call write_dataset(self%file, path, values, units, long_name, self%error)
    if (.not. allocated(self%error)) call attach_scales(self%file, path, axes, self%error)
  end subroutine real_numbers

  subroutine integers(self, path, values, long_name, axes)
    class(writer_type), intent(inout) :: self
    character(len=*), intent(in) :: path, long_name, axes(:)
    integer(int32), intent(in), contiguous :: values(..)

    if (allocated(self%error)) return
    call write_dataset(self%file, path, values, '1', long_name, self%error)
    if (.not. allocated(self%error)) call attach_scales(self%file, path, axes, self%error)
  end subroutine integers

  subroutine long_integers(self, path, values, long_name, axes)
    class(writer_type), intent(inout) :: self
    character(len=*), intent(in) :: path, long_name, axes(:)
    integer(int64), intent(in), contiguous :: values(..)

    if (allocated(self%error)) return
    call write_dataset(self%file, path, values, '1', long_name, self%error)
    if (.not. allocated(self%error)) call attach_scales(self%file, path, axes, self%error)
  end subroutine long_integers

end module battery_results_file
