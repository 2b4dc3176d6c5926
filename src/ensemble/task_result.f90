!> What one task of an ensemble brings home, as a value and as a record for the disk.
module battery_task_result
  use battery_kinds, only: dp, int64
  use battery_engine, only: particles_type
  use battery_observer, only: measure
  use battery_quantities, only: measured_type, new_measured, set_average, set_count, unknown_real
  use battery_simulation, only: simulation_type
  use battery_record_file, only: record_type
  use battery_results, only: task_complete, task_failed, task_not_done
  implicit none (type, external)
  private
  public :: task_result_type, result_of, failed_result, to_record, is_result, from_record
  public :: task_complete, task_failed, task_not_done

  type :: task_result_type
    !> Number of the task, from 1, and how it ended.
    integer :: task = 0
    integer :: status = task_not_done
    !> `task_type%kept` of the task.
    integer(int64) :: kept = 0
    !> Why it failed.
    character(len=:), allocatable :: message
    type(measured_type) :: measured
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
  function result_of(task, kept, simulation, final_state, cpu_seconds) result(found)
    !> Number of the task, and what it is known by.
    integer, intent(in) :: task
    integer(int64), intent(in) :: kept
    type(simulation_type), intent(in) :: simulation
    logical, intent(in) :: final_state
    real(dp), intent(in) :: cpu_seconds
    type(task_result_type) :: found
    type(particles_type) :: particles
    integer(int64) :: n
    integer :: k

    found%task = task
    found%kept = kept
    found%status = task_complete
    found%message = ''
    found%measured = new_measured()
    call measure(simulation%observer, found%measured)
    call set_count(found%measured, 'collisions', simulation%collisions)
    call set_count(found%measured, 'trapped', simulation%engine%trapped())
    call set_average(found%measured, 'time', real(simulation%elapsed, dp))
    call set_average(found%measured, 'transient_time', real(simulation%transient_time, dp))
    call set_average(found%measured, 'cpu_seconds', cpu_seconds)
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
    allocate (found%snapshots(n*size(simulation%snapshot)), source=unknown_real())
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
  function failed_result(task, kept, message) result(failed)
    !> Number of the task, and what it is known by.
    integer, intent(in) :: task
    integer(int64), intent(in) :: kept
    character(len=*), intent(in) :: message
    type(task_result_type) :: failed

    failed%task = task
    failed%kept = kept
    failed%status = task_failed
    failed%message = message
    failed%measured = new_measured()
    allocate (failed%series_urn1_number(0), failed%series_flow(0), failed%snapshots(0))
    allocate (failed%final_state(0), failed%events(0), failed%event_times(0))
  end function failed_result

  pure function to_record(found) result(record)
    type(task_result_type), intent(in) :: found
    type(record_type) :: record

    record%owner = found%kept
    record%tag = found%task
    record%integers = [int(found%status, int64), size(found%series_urn1_number, kind=int64), &
      size(found%series_flow, kind=int64), size(found%snapshots, kind=int64), &
      size(found%final_state, kind=int64), size(found%events, kind=int64), &
      size(found%event_times, kind=int64), found%measured%counted, found%series_urn1_number, &
      found%events]
    record%reals = [found%measured%average, found%measured%error, found%series_flow, &
      found%snapshots, found%final_state, found%event_times]
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
    integer :: k, n

    found%task = int(record%tag)
    found%kept = record%owner
    found%status = int(record%integers(1))
    allocate (character(len=size(record%bytes)) :: found%message)
    do k = 1, size(record%bytes)
      found%message(k:k) = achar(record%bytes(k))
    end do
    found%measured = new_measured()
    sizes = record%integers(2:7)
    n = size(found%measured%average)
    associate (r => record%reals)
      found%measured%average = r(:n)
      found%measured%error = r(n + 1:2*n)
      at = 2*n
      found%series_flow = r(at + 1:at + sizes(2))
      at = at + sizes(2)
      found%snapshots = r(at + 1:at + sizes(3))
      at = at + sizes(3)
      found%final_state = r(at + 1:at + sizes(4))
      at = at + sizes(4)
      found%event_times = r(at + 1:at + sizes(6))
    end associate
    n = size(found%measured%counted)
    found%measured%counted = record%integers(8:7 + n)
    at = 7 + n
    found%series_urn1_number = record%integers(at + 1:at + sizes(1))
    found%events = record%integers(at + sizes(1) + 1:at + sizes(1) + sizes(5))
  end function from_record

end module battery_task_result
