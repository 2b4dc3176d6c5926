!> One rank reads and checks the input; the others get the plan from it.
module battery_plan_sharing
  use battery_kinds, only: int64
  use battery_communicator, only: communicator_type, share_error, share_text
  use battery_error, only: error_type
  use battery_namelist_input, only: read_namelist, parse_namelist
  use battery_plan, only: plan_type
  use battery_signals, only: stop_requested, stopped_before_start
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: read_plan_once

contains

  !> The plan that a namelist file describes, on all ranks. Rank 0 alone looks at files: a namelist
  !> that comes through a pipe is there once. What its text does not say comes beside it.
  subroutine read_plan_once(file, communicator, plan, error)
    character(len=*), intent(in) :: file
    type(communicator_type), intent(in) :: communicator
    type(plan_type), intent(out) :: plan
    !> The same on all ranks; code `exit_bad_input`, or that of a run that a signal has stopped.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: text, output, numbers
    integer(int64) :: found(3)

    if (communicator%rank == 0) then
      call read_namelist(file, plan, error)
      if (stop_requested()) call stopped_before_start(error)
      if (.not. allocated(error)) then
        text = plan%text
        output = plan%file
        numbers = to_text(plan%initial_fingerprint)//' '//to_text(plan%fingerprint)//' ' &
          //to_text(plan%urn1_number)
      end if
    end if
    call share_error(communicator, error)
    if (allocated(error)) return
    call share_text(communicator, text, 0)
    call share_text(communicator, output, 0)
    call share_text(communicator, numbers, 0)
    if (communicator%rank == 0) return
    call parse_namelist(text, file, plan, error)
    read (numbers, *) found
    plan%file = output
    plan%initial_fingerprint = found(1)
    plan%fingerprint = found(2)
    plan%urn1_number = int(found(3))
  end subroutine read_plan_once

end module battery_plan_sharing
