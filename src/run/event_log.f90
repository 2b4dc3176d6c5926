!> The event log of a run, which grows as long as there is memory for it.
module battery_event_log
  use battery_kinds, only: wp, int32
  use battery_history, only: history_type
  use battery_stream, only: stream_type
  implicit none (type, external)
  private
  public :: event_log_type, append_events, pass_events

  !> An event: its time since the start of the run; kind, place and particle as in the engine.
  type :: event_type
    real(wp) :: time
    integer(int32) :: kind, where, particle
  end type event_type

  !> The event log of a run.
  type :: event_log_type
    !> The first `count` count.
    integer :: count = 0
    type(event_type), allocatable :: event(:)
  end type event_log_type

contains

  !> Adds the events of a window that began `elapsed` after the start of the run.
  subroutine append_events(log, history, elapsed, out_of_room)
    !> Of one run, in the order of time.
    type(event_log_type), intent(inout) :: log
    type(history_type), intent(in) :: history
    real(wp), intent(in) :: elapsed
    !> Set if there is no memory for them; then the log stays as it is.
    logical, intent(inout) :: out_of_room
    type(event_type), allocatable :: longer(:)
    integer :: total, status, k

    if (.not. allocated(log%event)) allocate (log%event(0))
    total = log%count + history%events
    if (total > size(log%event)) then
      allocate (longer(max(total, 2*size(log%event), 1024)), stat=status)
      out_of_room = out_of_room .or. status /= 0
      if (out_of_room) return
      longer(:log%count) = log%event(:log%count)
      call move_alloc(longer, log%event)
    end if
    do k = 1, history%events
      log%event(log%count + k) = event_type(elapsed + history%event_time(k), &
        history%event_kind(k), history%event_where(k), history%event_particle(k))
    end do
    log%count = total
  end subroutine append_events

  !> The event log so far.
  subroutine pass_events(log, stream)
    !> Of one run; in a stream that is read, it is filled.
    type(event_log_type), intent(inout) :: log
    type(stream_type), intent(inout) :: stream

    call stream%pass('events', log%count)
    if (stream%failed() .or. log%count == 0) return
    if (stream%reading) allocate (log%event(log%count))
    call stream%pass('event_time', log%event(:log%count)%time)
    call stream%pass('event_kind', log%event(:log%count)%kind)
    call stream%pass('event_where', log%event(:log%count)%where)
    call stream%pass('event_particle', log%event(:log%count)%particle)
  end subroutine pass_events

end module battery_event_log
