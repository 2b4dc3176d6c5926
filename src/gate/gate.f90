!> A threshold gate: who is counted in it, in the order in which they will reach the middle line.
!>
!> The particles that head for the other gate stand in a binary heap by the time at which they will
!> cross the middle line, so that an entry costs O(1) on average and a reversal just empties it.
!> Rule (paper, Sec. II; `physics.md` made exact): a particle is counted from its entry until it
!> crosses the middle line; when entries make the count exceed the threshold, all those counted turn
!> back, the entrants of that instant too. At one instant crossings come before entries, and all
!> entries of one gate count before the gate decides, so the order of particles in memory is nowhere
!> to be seen.
module battery_gate
  use battery_kinds, only: wp
  implicit none (type, external)
  private
  public :: gate_type, empty_gate, fill_gate, enter_gate, cross_middle, shift_gate

  type :: gate_type
    integer :: count = 0, room = 0
    !> When the first of those counted reaches the middle line; huge if there is none.
    real(wp) :: next_crossing = huge(1.0_wp)
    !> Heap: time of crossing, and whose.
    real(wp), allocatable :: time(:)
    integer, allocatable :: particle(:)
  end type gate_type

contains

  !> All counted particles leave the count at once (after a reversal, or at the start).
  pure subroutine empty_gate(gate)
    type(gate_type), intent(inout) :: gate

    if (gate%room == 0) then
      gate%room = 32
      allocate (gate%time(gate%room), gate%particle(gate%room))
    end if
    gate%count = 0
    gate%next_crossing = huge(1.0_wp)
  end subroutine empty_gate

  !> Counts a particle that will cross the middle line at `time`.
  pure subroutine enter_gate(gate, time, particle)
    type(gate_type), intent(inout) :: gate
    real(wp), intent(in) :: time
    integer, intent(in) :: particle
    integer :: at, parent
    real(wp) :: parent_time

    if (gate%count == gate%room) call grow(gate)
    at = gate%count + 1
    gate%count = at
    do while (at > 1)
      parent = at/2
      parent_time = gate%time(parent)
      if (time > parent_time) exit
      if (.not. time < parent_time .and. particle > gate%particle(parent)) exit
      gate%time(at) = parent_time
      gate%particle(at) = gate%particle(parent)
      at = parent
    end do
    gate%time(at) = time
    gate%particle(at) = particle
    if (at == 1) gate%next_crossing = time
  end subroutine enter_gate

  !> Counts particles that are inside at the start. Not the way of an entrant: `enter_gate` is
  !> called in one place only, where it is to be compiled in.
  pure subroutine fill_gate(gate, time, particle)
    type(gate_type), intent(inout) :: gate
    real(wp), intent(in) :: time(:)
    integer, intent(in) :: particle(:)
    integer :: at

    call empty_gate(gate)
    do while (gate%room < size(time))
      call grow(gate)
    end do
    gate%count = size(time)
    gate%time(:gate%count) = time
    gate%particle(:gate%count) = particle
    do at = gate%count/2, 1, -1
      call sift_down(gate, at, gate%time(at), gate%particle(at))
    end do
    if (gate%count > 0) gate%next_crossing = gate%time(1)
  end subroutine fill_gate

  pure subroutine grow(gate)
    type(gate_type), intent(inout) :: gate

    gate%time = [gate%time, gate%time]
    gate%particle = [gate%particle, gate%particle]
    gate%room = size(gate%time)
  end subroutine grow

  !> The next of those counted crosses the middle line and leaves the count.
  pure subroutine cross_middle(gate, particle)
    type(gate_type), intent(inout) :: gate
    integer, intent(out) :: particle
    integer :: last

    particle = gate%particle(1)
    last = gate%count
    gate%count = last - 1
    call sift_down(gate, 1, gate%time(last), gate%particle(last))
    gate%next_crossing = merge(gate%time(1), huge(1.0_wp), gate%count > 0)
  end subroutine cross_middle

  !> Puts a crossing into the heap at `place` or below.
  pure subroutine sift_down(gate, place, time, particle)
    type(gate_type), intent(inout) :: gate
    integer, intent(in) :: place
    integer, value, intent(in) :: particle
    real(wp), value, intent(in) :: time
    integer :: at, child

    at = place
    do
      child = 2*at
      if (child > gate%count) exit
      if (child < gate%count) then
        if (before(gate%time(child + 1), gate%particle(child + 1), gate%time(child), &
          gate%particle(child))) child = child + 1
      end if
      if (.not. before(gate%time(child), gate%particle(child), time, particle)) exit
      gate%time(at) = gate%time(child)
      gate%particle(at) = gate%particle(child)
      at = child
    end do
    gate%time(at) = time
    gate%particle(at) = particle
  end subroutine sift_down

  !> Earlier, or at the same time and with the lower number (a fixed order for the log).
  pure function before(time, particle, other_time, other_particle)
    real(wp), intent(in) :: time, other_time
    integer, intent(in) :: particle, other_particle
    logical :: before

    before = time < other_time
    if (.not. before) before = .not. time > other_time .and. particle < other_particle
  end function before

  !> The clock is set back by `shift`.
  pure subroutine shift_gate(gate, shift)
    type(gate_type), intent(inout) :: gate
    real(wp), intent(in) :: shift

    gate%time(:gate%count) = gate%time(:gate%count) - shift
    if (gate%count > 0) gate%next_crossing = gate%time(1)
  end subroutine shift_gate

end module battery_gate
