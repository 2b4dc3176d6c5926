!> Room in memory: what the parts of a run take, and whether that can be had.
!>
!> The numbers are bounds of what was measured: the peak of the process over that of a run without
!> the part, divided by how many there were (docs/ensembles.md says how).
module battery_room
  use battery_kinds, only: dp
  use battery_error, only: error_type, fatal_error
  use battery_engines, only: bytes_a_particle
  use battery_limits, only: memory_type, memory_left
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: particle_bytes, bytes_an_entry, bytes_a_state, bytes_an_event, bytes_a_task
  public :: merged_entry, merged_state, base_bytes, most_numbers
  public :: check_room, enough_room, size_text

  !> Bytes of an entry of the series, of a particle's state that is kept (a snapshot's or the final
  !> one) and of an event, at the peak, when the result of the task is written.
  real(dp), parameter :: bytes_an_entry = 130.0_dp, bytes_a_state = 140.0_dp, &
    bytes_an_event = 160.0_dp

  !> Bytes of each task on rank 0 at the end, and of an entry and a state of one task of many there:
  !> these are in the results file, which is made in memory, where they are compressed more or less.
  real(dp), parameter :: bytes_a_task = 800.0_dp, merged_entry = 40.0_dp, merged_state = 35.0_dp

  !> Bytes that every process takes beside all these, and may still take once it has started.
  real(dp), parameter :: base_bytes = 16.0e6_dp

  !> So little is not asked for: it is among `base_bytes`, and a task of next to no work would spend
  !> more time on reading what the system says of its memory than on all else.
  real(dp), parameter :: little = 1.0e6_dp

  !> Most entries of a series, and most states of one task: four numbers of each are counted by
  !> default integers.
  real(dp), parameter :: most_numbers = 0.25_dp*real(huge(1), dp)

contains

  !> Bytes that `number` particles take in an engine, with what they start from.
  pure real(dp) function particle_bytes(engine, number) result(bytes)
    !> Its name in the namelist.
    character(len=*), intent(in) :: engine
    integer, intent(in) :: number

    bytes = bytes_a_particle(engine)*number
  end function particle_bytes

  !> Whether this process can have so many bytes, and then some to work with.
  logical function enough_room(bytes) result(enough)
    !> Beside those that the process has already.
    real(dp), intent(in) :: bytes
    type(memory_type) :: left

    if (bytes > little) left = memory_left(1)
    enough = bytes <= little .or. bytes + base_bytes <= left%bytes
  end function enough_room

  !> An error if so many bytes for `what` cannot be had: allocating without asking would end the
  !> program, and where memory is promised that is not there, the system would.
  subroutine check_room(bytes, what, error)
    !> Beside those that the process has already.
    real(dp), intent(in) :: bytes
    character(len=*), intent(in) :: what
    type(error_type), allocatable, intent(out) :: error
    type(memory_type) :: left

    if (enough_room(bytes)) return
    left = memory_left(1)
    call fatal_error(error, 'no memory for '//what//': '//size_text(bytes + base_bytes) &
      //' are needed, there are '//size_text(left%bytes)//' ('//left%limit//')')
  end subroutine check_room

  !> A number of bytes as a reader would say it: `35 MB`, `1.2 GB`.
  pure function size_text(bytes) result(text)
    !> Not negative.
    real(dp), intent(in) :: bytes
    character(len=:), allocatable :: text
    character(len=32) :: buffer

    if (bytes < 9.995e9_dp) then
      text = to_text(ceiling(bytes/1.0e6_dp))//' MB'
    else if (bytes < 9.995e15_dp) then
      text = to_text(ceiling(bytes/1.0e9_dp))//' GB'
    else
      write (buffer, '(es8.1, a)') bytes, ' bytes'
      text = trim(adjustl(buffer))
    end if
  end function size_text

end module battery_room
