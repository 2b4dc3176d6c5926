!> The event log of a run, which is enlarged as long as there is memory for it.
module battery_event_log
  use battery_kinds, only: wp
  use battery_event_record, only: event_type, event_record_type
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: event_log_type, append_events, serialize_events

  !> The event log of a run; times count from its start.
  type :: event_log_type
    !> Number of events; the array may be longer.
    integer :: count = 0
    type(event_type), allocatable :: event(:)
  end type event_log_type

contains

  !> Adds the events of a window that began `elapsed` after the start of the run.
  subroutine append_events(log, event_record, elapsed, out_of_room)
    !> Log of one run, in the order of time.
    type(event_log_type), intent(inout) :: log
    type(event_record_type), intent(in) :: event_record
    real(wp), intent(in) :: elapsed
    !> Set if there is no memory for the events; then the log does not change.
    logical, intent(inout) :: out_of_room
    type(event_type), allocatable :: longer(:)
    real(wp) :: last
    integer :: total, status

    if (.not. allocated(log%event)) allocate (log%event(0))
    ! Events one rounding apart in two windows, whose starts are rounded, keep their order.
    last = 0.0_wp
    if (log%count > 0) last = log%event(log%count)%time
    total = log%count + event_record%events
    if (total > size(log%event)) then
      allocate (longer(max(total, 2*size(log%event), 1024)), stat=status)
      out_of_room = out_of_room .or. status /= 0
      if (out_of_room) return
      longer(:log%count) = log%event(:log%count)
      call move_alloc(longer, log%event)
    end if
    associate (added => log%event(log%count + 1:total))
      added = event_record%event(:event_record%events)
      added%time = max(last, elapsed + added%time)
    end associate
    log%count = total
  end subroutine append_events

  !> Saves or restores the event log.
  subroutine serialize_events(log, archive)
    !> Log of one run.
    type(event_log_type), intent(inout) :: log
    type(archive_type), intent(inout) :: archive

    call archive%serialize('events', log%count)
    if (archive%failed() .or. log%count == 0) return
    if (archive%reading) allocate (log%event(log%count))
    call archive%serialize('event_time', log%event(:log%count)%time)
    call archive%serialize('event_kind', log%event(:log%count)%kind)
    call archive%serialize('event_where', log%event(:log%count)%where)
    call archive%serialize('event_particle', log%event(:log%count)%particle)
  end subroutine serialize_events

end module battery_event_log
