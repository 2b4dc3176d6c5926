!> The event log of a run, which grows as long as there is memory for it.
module battery_event_log
  use battery_kinds, only: wp, int32
  use battery_history, only: history_type
  use battery_stream, only: stream_type
  implicit none (type, external)
  private
  public :: event_log_type, append_events, pass_events

  !> The event log of a run: times since its start; kinds, places and particles as in the engine.
  type :: event_log_type
    integer :: count = 0
    real(wp), allocatable :: time(:)
    integer(int32), allocatable :: kind(:), where(:), particle(:)
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
    integer :: total

    if (.not. allocated(log%time)) allocate (log%time(0), log%kind(0), log%where(0), &
      log%particle(0))
    total = log%count + history%events
    if (total > size(log%time)) call lengthen_log(log, max(total, 2*size(log%time), 1024), &
      out_of_room)
    if (out_of_room) return
    log%time(log%count + 1:total) = elapsed + history%event_time(:history%events)
    log%kind(log%count + 1:total) = history%event_kind(:history%events)
    log%where(log%count + 1:total) = history%event_where(:history%events)
    log%particle(log%count + 1:total) = history%event_particle(:history%events)
    log%count = total
  end subroutine append_events

  !> Makes room in the event log for so many events, if there is memory for it.
  subroutine lengthen_log(log, room, out_of_room)
    type(event_log_type), intent(inout) :: log
    integer, intent(in) :: room
    logical, intent(inout) :: out_of_room
    type(event_log_type) :: longer
    integer :: status

    allocate (longer%time(room), stat=status)
    if (status == 0) allocate (longer%kind(room), stat=status)
    if (status == 0) allocate (longer%where(room), stat=status)
    if (status == 0) allocate (longer%particle(room), stat=status)
    if (status /= 0) then
      out_of_room = .true.
      return
    end if
    longer%time(:log%count) = log%time(:log%count)
    longer%kind(:log%count) = log%kind(:log%count)
    longer%where(:log%count) = log%where(:log%count)
    longer%particle(:log%count) = log%particle(:log%count)
    call move_alloc(longer%time, log%time)
    call move_alloc(longer%kind, log%kind)
    call move_alloc(longer%where, log%where)
    call move_alloc(longer%particle, log%particle)
  end subroutine lengthen_log

  !> The event log so far.
  subroutine pass_events(log, stream)
    !> Of one run; in a stream that is read, it is filled.
    type(event_log_type), intent(inout) :: log
    type(stream_type), intent(inout) :: stream

    call stream%pass('events', log%count)
    if (stream%failed() .or. log%count == 0) return
    if (stream%reading) allocate (log%time(log%count), log%kind(log%count), log%where(log%count), &
      log%particle(log%count))
    call stream%pass('event_time', log%time(:log%count))
    call stream%pass('event_kind', log%kind(:log%count))
    call stream%pass('event_where', log%where(:log%count))
    call stream%pass('event_particle', log%particle(:log%count))
  end subroutine pass_events

end module battery_event_log
