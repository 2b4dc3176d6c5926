!> One rank reads and checks the input; the others get the plan from it.
module battery_plan_sharing
  use battery_kinds, only: wp, int64
  use battery_communicator, only: communicator_type, share_error, share_text, share_number, &
    share_reals
  use battery_error, only: error_type
  use battery_engine, only: particles_type
  use battery_input_files, only: read_namelist
  use battery_namelist_input, only: parse_namelist
  use battery_plan, only: plan_type
  use battery_signals, only: stop_requested, stopped_before_start
  implicit none (type, external)
  private
  public :: read_plan_once

contains

  !> The plan that a namelist file describes, on all ranks. Rank 0 alone looks at files: a namelist
  !> that comes through a pipe is there once. What its text does not say comes beside it.
  subroutine read_plan_once(file, communicator, plan, error)
    !> Path of the namelist.
    character(len=*), intent(in) :: file
    type(communicator_type), intent(in) :: communicator
    type(plan_type), intent(out) :: plan
    !> The same on all ranks; code `exit_bad_input`, or that of a run that a signal has stopped.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: text, output
    integer(int64) :: fingerprint
    type(particles_type) :: start

    if (communicator%rank == 0) then
      call read_namelist(file, plan, error)
      if (stop_requested()) call stopped_before_start(error)
      if (.not. allocated(error)) then
        text = plan%text
        output = plan%file
        fingerprint = plan%initial_fingerprint
        call move_alloc(plan%start%x, start%x)
        call move_alloc(plan%start%y, start%y)
        call move_alloc(plan%start%ux, start%ux)
        call move_alloc(plan%start%uy, start%uy)
      end if
    end if
    call share_error(communicator, error)
    if (allocated(error)) return
    call share_text(communicator, text, 0)
    call share_text(communicator, output, 0)
    call share_number(communicator, fingerprint)
    if (communicator%rank /= 0) then
      call parse_namelist(text, file, plan, error)
      plan%file = output
      plan%initial_fingerprint = fingerprint
    end if
    if (plan%initial_file == '') return
    call share_reals(communicator, start%x)
    call share_reals(communicator, start%y)
    call share_reals(communicator, start%ux)
    call share_reals(communicator, start%uy)
    plan%start = start
    plan%base%urn1_number = count(start%x < 0.0_wp)
  end subroutine read_plan_once

end module battery_plan_sharing
