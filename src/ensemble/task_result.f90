!> What one task of an ensemble brings home, as a value and as a record for the disk.
module battery_task_result
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  use battery_kinds, only: wp, dp, int64
  use battery_engine, only: particles_type
  use battery_observer, only: averages_type, averages_of
  use battery_simulation, only: simulation_type
  use battery_record_file, only: record_type
  use battery_results, only: task_complete, task_failed, task_not_done
  implicit none (type, external)
  private
  public :: task_result_type, result_of, failed_result, to_record, is_result, from_record
  public :: task_complete, task_failed, task_not_done

  !> How many integers and reals every result has; arrays follow.
  integer, parameter :: integer_count = 11, real_count = 14

  type :: task_result_type
    !> Number of the task, from 1, and how it ended.
    integer :: task = 0
    integer :: status = task_not_done
    !> Why it failed.
    character(len=:), allocatable :: message
    integer(int64) :: collisions = 0, bounce_backs = 0, reversals = 0, trapped = 0
    real(dp) :: chi, chi_error, chi_collision, current1, current1_error, current2, current2_error
    real(dp) :: flow(4)
    real(dp) :: time, transient_time, cpu_seconds
    !> Series: N1, and flows as (4, entry).
    integer(int64), allocatable :: series_urn1_number(:)
    real(dp), allocatable :: series_flow(:)
    !> Snapshots one after the other: x, y, ux, uy of all particles; the final state likewise.
    real(dp), allocatable :: snapshots(:), final_state(:)
    !> Events: kind, where, particle one after the other; times.
    integer(int64), allocatable :: events(:)
    real(dp), allocatable :: event_times(:)
  end type task_result_type

contains

  !> The result of a simulation that is done.
  function result_of(task, simulation, final_state, cpu_seconds) result(found)
    integer, intent(in) :: task
    type(simulation_type), intent(in) :: simulation
    logical, intent(in) :: final_state
    real(dp), intent(in) :: cpu_seconds
    type(task_result_type) :: found
    type(averages_type) :: averages
    type(particles_type) :: particles
    real(dp) :: unknown
    integer(int64) :: n
    integer :: k

    unknown = ieee_value(unknown, ieee_quiet_nan)
    averages = averages_of(simulation%observer)
    found%task = task
    found%status = task_complete
    found%message = ''
    found%collisions = simulation%collisions
    found%bounce_backs = simulation%observer%bounce_backs
    found%reversals = simulation%observer%reversals
    found%trapped = simulation%engine%trapped()
    found%chi = real(averages%chi, dp)
    found%current1 = real(averages%current1, dp)
    found%current2 = real(averages%current2, dp)
    found%chi_error = merge(real(averages%chi_error, dp), unknown, averages%errors_known)
    found%current1_error = merge(real(averages%current1_error, dp), unknown, averages%errors_known)
    found%current2_error = merge(real(averages%current2_error, dp), unknown, averages%errors_known)
    found%chi_collision = merge(real(averages%chi_collision, dp), unknown, &
      averages%chi_collision_known)
    if (.not. simulation%observer%two_halves) then
      found%chi = unknown
      found%chi_error = unknown
      found%chi_collision = unknown
    end if
    found%flow = real(averages%flow, dp)
    found%time = real(simulation%elapsed, dp)
    found%transient_time = real(simulation%transient_time, dp)
    found%cpu_seconds = cpu_seconds
    associate (observer => simulation%observer, events => simulation%events)
      found%series_urn1_number = int(observer%series_urn1_number(:observer%entries), int64)
      found%series_flow = reshape(real(observer%series_flow(:, :observer%entries), dp), &
        [4*observer%entries])
      allocate (found%events(0), found%event_times(0))
      if (events%count > 0) then
        found%events = int([events%kind(:events%count), events%where(:events%count), &
          events%particle(:events%count)], int64)
        found%event_times = real(events%time(:events%count), dp)
      end if
    end associate
    ! A run by collisions may end before the time of a snapshot.
    n = 4_int64*simulation%engine%number
    allocate (found%snapshots(n*size(simulation%snapshot)), source=unknown)
    do k = 1, simulation%snapshots_taken
      found%snapshots(n*(k - 1) + 1:n*k) = flat(simulation%snapshot(k))
    end do
    allocate (found%final_state(0))
    if (final_state) then
      call simulation%engine%particles(1, simulation%engine%number, particles)
      found%final_state = flat(particles)
    end if
  end function result_of

  pure function flat(particles) result(array)
    type(particles_type), intent(in) :: particles
    real(dp), allocatable :: array(:)

    array = real([particles%x, particles%y, particles%ux, particles%uy], dp)
  end function flat

  !> The result of a task that could not be done, with the reason.
  function failed_result(task, message) result(failed)
    integer, intent(in) :: task
    character(len=*), intent(in) :: message
    type(task_result_type) :: failed
    real(dp) :: unknown

    unknown = ieee_value(unknown, ieee_quiet_nan)
    failed = task_result_type(task, task_failed, message, 0_int64, 0_int64, 0_int64, 0_int64, &
      unknown, &
      unknown, unknown, unknown, unknown, unknown, unknown, spread(unknown, 1, 4), unknown, &
      unknown, unknown, null(), null(), null(), null(), null(), null())
    allocate (failed%series_urn1_number(0), failed%series_flow(0), failed%snapshots(0))
    allocate (failed%final_state(0), failed%events(0), failed%event_times(0))
  end function failed_result

  pure function to_record(found) result(record)
    type(task_result_type), intent(in) :: found
    type(record_type) :: record

    record%tag = found%task
    record%integers = [int(found%status, int64), found%collisions, found%bounce_backs, &
      found%reversals, &
      found%trapped, size(found%series_urn1_number, kind=int64), size(found%series_flow, &
      kind=int64), size(found%snapshots, kind=int64), size(found%final_state, kind=int64), &
      size(found%events, kind=int64), size(found%event_times, kind=int64), &
      found%series_urn1_number, found%events]
    record%reals = [found%chi, found%chi_error, found%chi_collision, found%current1, &
      found%current1_error, found%current2, found%current2_error, found%flow, found%time, &
      found%transient_time, found%cpu_seconds, found%series_flow, found%snapshots, &
      found%final_state, found%event_times]
    record%bytes = int(iachar(transfer(found%message, 'a', len(found%message))), kind(record%bytes))
  end function to_record

  !> Whether a record is a result: a good record may still be a plan or a state under another name.
  pure function is_result(record) result(yes)
    type(record_type), intent(in) :: record
    logical :: yes
    integer(int64) :: left

    yes = .false.
    if (size(record%integers) < integer_count .or. size(record%reals) < real_count) return
    if (any(record%integers(6:11) < 0)) return
    left = size(record%integers, kind=int64) - integer_count
    if (record%integers(6) > left .or. record%integers(10) /= left - record%integers(6)) return
    left = size(record%reals, kind=int64) - real_count
    associate (sizes => record%integers([7, 8, 9, 11]))
      yes = all(sizes <= left) .and. sum(min(sizes, left)) == left
    end associate
  end function is_result

  !> The result in a record that is one.
  pure function from_record(record) result(found)
    type(record_type), intent(in) :: record
    type(task_result_type) :: found
    integer(int64) :: sizes(6), at
    integer :: k

    found%task = int(record%tag)
    found%status = int(record%integers(1))
    allocate (character(len=size(record%bytes)) :: found%message)
    do k = 1, size(record%bytes)
      found%message(k:k) = achar(record%bytes(k))
    end do
    found%collisions = record%integers(2)
    found%bounce_backs = record%integers(3)
    found%reversals = record%integers(4)
    found%trapped = record%integers(5)
    sizes = record%integers(6:11)
    associate (r => record%reals)
      found%chi = r(1)
      found%chi_error = r(2)
      found%chi_collision = r(3)
      found%current1 = r(4)
      found%current1_error = r(5)
      found%current2 = r(6)
      found%current2_error = r(7)
      found%flow = r(8:11)
      found%time = r(12)
      found%transient_time = r(13)
      found%cpu_seconds = r(14)
      at = real_count
      found%series_flow = r(at + 1:at + sizes(2))
      at = at + sizes(2)
      found%snapshots = r(at + 1:at + sizes(3))
      at = at + sizes(3)
      found%final_state = r(at + 1:at + sizes(4))
      at = at + sizes(4)
      found%event_times = r(at + 1:at + sizes(6))
    end associate
    found%series_urn1_number = record%integers(integer_count + 1:integer_count + sizes(1))
    found%events = record%integers(integer_count + sizes(1) + 1:integer_count + sizes(1) + sizes(5))
  end function from_record

end module battery_task_result
