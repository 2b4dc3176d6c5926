!> What programs of several studies share: entries into an urn by the invariant measure, and the
!> events of a run.
module battery_sampling
  use battery_kinds, only: wp, int64
  use battery_table, only: table_type, channel1, channel2
  use battery_event_record, only: event_record_type
  implicit none (type, external)
  private
  public :: entry_of, event_log_type, append_events

  !> Events of a run in the order of time, as in `event_record_type`; times since its start.
  type :: event_log_type
    real(wp), allocatable :: time(:)
    integer, allocatable :: kind(:), where(:), particle(:)
  end type event_log_type

contains

  !> The entry into an urn that belongs to two numbers uniform in (0, 1), in the frame of the urn:
  !> position uniform on the openings, direction by the cosine law.
  pure subroutine entry_of(table, urn, place, direction, channel, x, y, ux, uy)
    type(table_type), intent(in) :: table
    !> Its index.
    integer, intent(in) :: urn
    real(wp), intent(in) :: place, direction
    !> Channel that it comes from.
    integer(int64), intent(out) :: channel
    real(wp), intent(out) :: x, y, ux, uy
    real(wp) :: position

    associate (width => table%channel%width, chord => table%urn(urn)%chord)
      position = sum(width)*place
      uy = 2.0_wp*direction - 1.0_wp
      ux = sqrt((1.0_wp - uy)*(1.0_wp + uy))
      if (position < width(channel1)) then
        channel = channel1
        x = chord(channel1)
        y = position - 0.5_wp*width(channel1)
        ux = -ux
      else
        channel = channel2
        x = -chord(channel2)
        y = position - width(channel1) - 0.5_wp*width(channel2)
      end if
    end associate
  end subroutine entry_of

  !> Appends the events of a window that started at time `window_start`; a log begins empty.
  pure subroutine append_events(log, event_record, window_start)
    type(event_log_type), intent(inout) :: log
    type(event_record_type), intent(in) :: event_record
    real(wp), intent(in) :: window_start

    if (.not. allocated(log%time)) allocate (log%time(0), log%kind(0), log%where(0), &
      log%particle(0))
    associate (n => event_record%events)
      log%time = [log%time, window_start + event_record%event(:n)%time]
      log%kind = [log%kind, int(event_record%event(:n)%kind)]
      log%where = [log%where, int(event_record%event(:n)%where)]
      log%particle = [log%particle, int(event_record%event(:n)%particle)]
    end associate
  end subroutine append_events

end module battery_sampling
