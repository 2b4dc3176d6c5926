!> Result of one task of an ensemble, as a value and as a record for the disk.
module battery_task_result
  use battery_kinds, only: dp, int64
  use battery_clocks, only: utc_seconds
  use battery_results_file, only: task_output_type, serialize_output, series, snapshots, final, &
    events
  use battery_engine, only: particles_type
  use battery_process, only: machine_text
  use battery_observer, only: get_measured
  use battery_quantities, only: measured_type, new_measured, set_average, set_count, &
    unknown_real, fingerprint_of_quantities
  use battery_archive, only: archive_type, new_archive, measuring_archive
  use battery_simulation, only: simulation_type
  use battery_record_file, only: record_type, record_reader_type, next_record
  use battery_results, only: task_complete, task_failed, task_not_done
  use battery_tasks, only: task_type
  implicit none (type, external)
  private
  public :: task_result_type, result_of, failed_result, to_record, next_result

  !> Measurements and output of one task, or the reason for its failure.
  type, extends(task_output_type) :: task_result_type
    !> How the task ended.
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
    integer :: n, k

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
    associate (observer => simulation%observer, events_found => simulation%events)
      n = observer%entries
      allocate (found%of(series)%values(n, 5))
      found%of(series)%values(:, 1) = real(observer%series_urn1_number(:n), dp)
      found%of(series)%values(:, 2:) = real(transpose(observer%series_flow(:, :n)), dp)
      n = events_found%count
      allocate (found%of(events)%values(n, 4))
      if (n > 0) then
        associate (event => events_found%event(:n), table => found%of(events)%values)
          table(:, 1) = real(event%time, dp)
          table(:, 2) = real(event%kind, dp)
          table(:, 3) = real(event%where, dp)
          table(:, 4) = real(event%particle, dp)
        end associate
      end if
    end associate
    ! A run by collisions may end before the time of a snapshot.
    n = simulation%engine%number
    allocate (found%of(snapshots)%values(n*size(simulation%snapshot), 4), source=unknown_real())
    do k = 1, simulation%snapshots_taken
      found%of(snapshots)%values(n*(k - 1) + 1:n*k, :) = states_of(simulation%snapshot(k))
    end do
    if (task%setup%final_state) then
      call simulation%engine%get_particles(1, n, particles)
      found%of(final)%values = states_of(particles)
    end if
  end function result_of

  !> States of particles as columns: x, y, u_x, u_y.
  pure function states_of(particles) result(states)
    type(particles_type), intent(in) :: particles
    real(dp) :: states(size(particles%x), 4)

    states(:, 1) = real(particles%x, dp)
    states(:, 2) = real(particles%y, dp)
    states(:, 3) = real(particles%ux, dp)
    states(:, 4) = real(particles%uy, dp)
  end function states_of

  !> Result of a failed task, with the reason.
  function failed_result(task, message) result(failed)
    type(task_type), intent(in) :: task
    !> Why the task failed.
    character(len=*), intent(in) :: message
    type(task_result_type) :: failed

    failed%task_id = task%task_id
    failed%status = task_failed
    failed%message = message
    failed%host = machine_text()
    failed%measured = new_measured()
  end function failed_result

  !> A result as a record.
  function to_record(found) result(record)
    !> Result of a task, successful or failed; not changed.
    type(task_result_type), intent(inout) :: found
    type(record_type) :: record

    ! Its length is measured first: then there are no copies of large output while it grows.
    record%archive_type = measuring_archive()
    call serialize_result(found, record%archive_type)
    record%archive_type = new_archive(record%length)
    call serialize_result(found, record%archive_type)
    record%owner = found%task_id
  end function to_record

  !> Reads the next result of a file of records. A valid record may be a plan or a state under
  !> another name, or belong to a program with other quantities: it is passed over.
  subroutine next_result(reader, found, at, is_one)
    !> Reader of a record file, open.
    type(record_reader_type), intent(inout) :: reader
    !> Result of the next task in the file.
    type(task_result_type), intent(out) :: found
    !> Offset of the record in the file, in bytes; `reader%at` may be set to it.
    integer(int64), intent(out) :: at
    !> Whether there is such a record.
    logical, intent(out) :: is_one
    type(record_type) :: record
    logical :: is_record

    do
      call next_record(reader, record, is_record, at)
      is_one = .false.
      if (.not. is_record) return
      call serialize_result(found, record%archive_type)
      if (record%failed()) cycle
      is_one = record%at_end()
      if (is_one) exit
    end do
    found%task_id = record%owner
  end subroutine next_result

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
    call serialize_output(found%task_output_type, archive)
  end subroutine serialize_result

end module battery_task_result
