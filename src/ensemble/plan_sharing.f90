!> One rank reads and checks the input; the others get the plan from it.
module battery_plan_sharing
  use battery_kinds, only: wp
  use battery_communicator, only: communicator_type, share_error, share_words
  use battery_error, only: error_type
  use battery_input_files, only: read_namelist
  use battery_namelist_input, only: parse_namelist
  use battery_plan, only: plan_type
  use battery_signals, only: stop_requested, stopped_before_start
  use battery_stream, only: stream_type, new_stream, measuring_stream, stream_of
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
    type(plan_type) :: found
    type(stream_type) :: stream

    if (communicator%rank == 0) then
      call read_namelist(file, plan, error)
      if (stop_requested()) call stopped_before_start(error)
    end if
    call share_error(communicator, error)
    if (allocated(error) .or. communicator%size == 1) return
    if (communicator%rank == 0) then
      stream = measuring_stream()
      call pass_input(plan, stream)
      stream = new_stream(stream%length)
      call pass_input(plan, stream)
    end if
    call share_words(communicator, stream%word)
    if (communicator%rank == 0) return
    stream = stream_of(stream%word)
    call pass_input(found, stream)
    call parse_namelist(found%text, file, plan, error)
    plan%file = found%file
    plan%initial_fingerprint = found%initial_fingerprint
    if (plan%initial_fingerprint == 0) return
    plan%start = found%start
    plan%base%urn1_number = count(plan%start%x < 0.0_wp)
  end subroutine read_plan_once

  !> What rank 0 has read, through a stream.
  pure subroutine pass_input(plan, stream)
    type(plan_type), intent(inout) :: plan
    type(stream_type), intent(inout) :: stream

    call stream%pass_text('text', plan%text)
    call stream%pass_text('file', plan%file)
    call stream%pass('initial_fingerprint', plan%initial_fingerprint)
    if (plan%initial_fingerprint == 0) return
    call stream%pass_list('x', plan%start%x, 'y', plan%start%y, 'ux', plan%start%ux, &
      'uy', plan%start%uy)
  end subroutine pass_input

end module battery_plan_sharing
