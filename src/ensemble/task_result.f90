!> Result of one task of an ensemble, as a value and as a record for the disk.
module battery_task_result
  use battery_kinds, only: dp, int32, int64
  use battery_clocks, only: utc_seconds
  use battery_task_output, only: task_output_type
  use battery_engine, only: particles_type
  use battery_machine, only: machine_text
  use battery_observer, only: get_measured
  use battery_quantities, only: measured_type, new_measured, set_average, set_count, &
    unknown_real, fingerprint_of_quantities
  use battery_archive, only: archive_type, new_archive, archive_of
  use battery_simulation, only: simulation_type
  use battery_record_file, only: record_type
  use battery_results, only: task_complete, task_failed, task_not_done
  use battery_tasks, only: task_type
  implicit none (type, external)
  private
  public :: task_result_type, result_of, failed_result, to_record, from_record

  !> Measurements and output of one task, or the reason for its failure.
  type, extends(task_output_type) :: task_result_type
    !> Number of the task, from 1, and its status.
    integer :: task = 0
    integer :: status = task_not_done
    !> `task_type%task_id` of the task.
    integer(int64) :: task_id = 0
    !> Reason for its failure; name of the machine that it ran on.
    character(len=:), allocatable :: message, host
    type(measured_type) :: measured
  end type task_result_type

contains

  !> Result of a finished simulation.
  function result_of(task, simulation, cpu_seconds, start_date) result(found)
    type(task_type), intent(in) :: task
    type(simulation_type), intent(in) :: simulation
    !> Processor seconds of the task; its start, or last restart, on the clock of `utc_seconds`.
    real(dp), intent(in) :: cpu_seconds, start_date
    type(task_result_type) :: found
    type(particles_type) :: particles
    integer(int64) :: n
    integer :: k

    found%task = task%task
    found%task_id = task%task_id
    found%status = task_complete
    found%message = ''
    found%measured = new_measured()
    call get_measured(simulation%observer, found%measured)
    call set_count(found%measured, 'collisions', simulation%collisions)
    call set_count(found%measured, 'trapped', simulation%engine%trapped())
    call set_average(found%measured, 'time', real(simulation%elapsed, dp))
    call set_average(found%measured, 'transient_time', real(simulation%transient_time, dp))
    call set_average(found%measured, 'cpu_seconds', cpu_seconds)
    call set_average(found%measured, 'provenance/begun', start_date)
    call set_average(found%measured, 'provenance/ended', utc_seconds())
    found%host = machine_text()
    associate (observer => simulation%observer, events => simulation%events)
      found%series_urn1_number = int(observer%series_urn1_number(:observer%entries), int32)
      found%series_flow = reshape(real(observer%series_flow(:, :observer%entries), dp), &
        [4*observer%entries])
      if (events%count > 0) then
        associate (event => events%event(:events%count))
          found%events = [event%kind, event%where, event%particle]
          found%event_times = real(event%time, dp)
        end associate
      end if
    end associate
    ! A run by collisions may end before the time of a snapshot.
    n = 4_int64*simulation%engine%number
    allocate (found%snapshots(n*size(simulation%snapshot)), source=unknown_real())
    do k = 1, simulation%snapshots_taken
      found%snapshots(n*(k - 1) + 1:n*k) = flattened_states(simulation%snapshot(k))
    end do
    if (task%final_state) then
      call simulation%engine%get_particles(1, simulation%engine%number, particles)
      found%final_state = flattened_states(particles)
    end if
  end function result_of

  !> States of particles as one array: x, y, u_x, u_y of all of them, in this order.
  pure function flattened_states(particles) result(array)
    type(particles_type), intent(in) :: particles
    real(dp), allocatable :: array(:)

    array = real([particles%x, particles%y, particles%ux, particles%uy], dp)
  end function flattened_states

  !> Result of a failed task, with the reason.
  function failed_result(task, message) result(failed)
    type(task_type), intent(in) :: task
    !> Why the task failed.
    character(len=*), intent(in) :: message
    type(task_result_type) :: failed

    failed%task = task%task
    failed%task_id = task%task_id
    failed%status = task_failed
    failed%message = message
    failed%host = machine_text()
    failed%measured = new_measured()
  end function failed_result

  !> A result as a record.
  function to_record(found) result(record)
    !> Result of a task, successful or failed.
    type(task_result_type), intent(in) :: found
    type(record_type) :: record
    type(task_result_type) :: copy
    type(archive_type) :: archive

    copy = found
    archive = new_archive()
    call serialize_result(copy, archive)
    record%owner = found%task_id
    record%tag = found%task
    record%word = archive%word(:archive%length)
  end function to_record

  !> Makes a result of a record. A valid record may still be a plan or a state under another name,
  !> or belong to a program with other quantities.
  subroutine from_record(record, found, is_one)
    type(record_type), intent(in) :: record
    !> Result, if the record is one.
    type(task_result_type), intent(out) :: found
    !> Whether the record is a result.
    logical, intent(out) :: is_one
    type(archive_type) :: archive

    archive = archive_of(record%word)
    call serialize_result(found, archive)
    is_one = .not. archive%failed()
    if (is_one) is_one = archive%at_end() .and. abs(record%tag) <= huge(found%task)
    if (.not. is_one) return
    found%task = int(record%tag)
    found%task_id = record%owner
  end subroutine from_record

  !> Writes a result to an archive or reads it.
  subroutine serialize_result(found, archive)
    type(task_result_type), intent(inout) :: found
    type(archive_type), intent(inout) :: archive
    integer(int64) :: quantities

    call archive%serialize('status', found%status)
    call archive%serialize_text('message', found%message)
    call archive%serialize_text('host', found%host)
    quantities = fingerprint_of_quantities()
    call archive%serialize('quantities', quantities)
    if (archive%failed()) return
    if (quantities /= fingerprint_of_quantities()) then
      archive%problem = 'the result is one of other quantities'
      return
    end if
    if (archive%reading) found%measured = new_measured()
    call archive%serialize('average', found%measured%average)
    call archive%serialize('error', found%measured%error)
    call archive%serialize('counted', found%measured%counted)
    call archive%serialize_list('series_urn1_number', found%series_urn1_number)
    call archive%serialize_list('series_flow', found%series_flow, 'snapshots', found%snapshots, &
      'final_state', found%final_state, 'event_times', found%event_times)
    call archive%serialize_list('events', found%events)
  end subroutine serialize_result

end module battery_task_result
