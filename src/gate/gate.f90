!> The threshold gate: who is counted, when it turns, whom it turns, what happens at one instant.
!>
!> **The rule** (paper, Sec. II; `physics.md` made exact). A gate counts the particles that are
!> inside and head for the other gate: from their entry until they cross the middle line. When
!> entries make the count exceed the threshold, all those counted turn back, the entrants of that
!> instant too; then nobody is counted. Only an entry can make a gate turn. Particles from the other
!> gate, and those on their way out, are not counted and not touched.
!>
!> **One instant.** Crossings of the middle line come before entries, that of gate 1 first, and all
!> entries of one gate count before the gate decides: so the order of particles in memory is nowhere
!> to be seen.
!>
!> Those counted stand in a queue by the time at which they will reach the middle line. Engines ask
!> the gate at entries and crossings; no engine knows the rule.
module battery_gate
  use battery_kinds, only: wp
  use battery_queue, only: queue_type, empty_queue, push, pop, remove, shift_queue, pass_queue
  use battery_stream, only: stream_type
  implicit none (type, external)
  private
  public :: gate_type, new_gate, hold, enter, must_turn, undecided, decide, turned_back
  public :: first_to_cross, cross_first, cross, shift_gate, pass_gate

  !> The gate of one side: its rule, and whom it counts.
  type :: gate_type
    !> More than so many turn.
    integer :: threshold = 0
    !> Whether somebody has entered since the gate last decided.
    logical :: entered = .false.
    !> Those counted, by when each will reach the middle line.
    type(queue_type) :: counted
  end type gate_type

contains

  !> A gate that counts nobody yet.
  pure subroutine new_gate(gate, threshold)
    type(gate_type), intent(inout) :: gate
    !> How many it lets head for the other gate at a time, 0 or more.
    integer, intent(in) :: threshold

    gate%threshold = threshold
    gate%entered = .false.
    call empty_queue(gate%counted)
  end subroutine new_gate

  !> Counts a particle that is inside from the start and heads for the middle line: no entry.
  pure subroutine hold(gate, crossing_time, particle)
    type(gate_type), intent(inout) :: gate
    !> When it will reach the middle line, on the clock of the engine.
    real(wp), intent(in) :: crossing_time
    !> Its number, from 1.
    integer, intent(in) :: particle

    call push(gate%counted, crossing_time, particle)
  end subroutine hold

  !> A particle enters from the urn.
  pure subroutine enter(gate, crossing_time, particle)
    type(gate_type), intent(inout) :: gate
    !> When it will reach the middle line, on the clock of the engine.
    real(wp), intent(in) :: crossing_time
    !> Its number, from 1.
    integer, intent(in) :: particle

    call push(gate%counted, crossing_time, particle)
    gate%entered = .true.
  end subroutine enter

  !> Whether the gate turns if nobody else enters at this instant.
  pure function must_turn(gate)
    type(gate_type), intent(in) :: gate
    logical :: must_turn

    must_turn = gate%counted%count > gate%threshold
  end function must_turn

  !> Whether any gate has something to decide when the instant is over.
  pure function undecided(gate)
    type(gate_type), intent(in) :: gate(2)
    logical :: undecided

    undecided = gate(1)%entered .or. gate(2)%entered
  end function undecided

  !> The instant is over: whether the gate turns back those counted, `gate%counted%who(:count)`.
  pure subroutine decide(gate, turns)
    type(gate_type), intent(inout) :: gate
    !> Whether all those counted are to be turned back.
    logical, intent(out) :: turns

    turns = gate%entered .and. must_turn(gate)
    gate%entered = .false.
  end subroutine decide

  !> Which of the two gates is first to have somebody cross the middle line.
  pure function first_to_cross(gate) result(side)
    type(gate_type), intent(in) :: gate(2)
    integer :: side

    side = merge(1, 2, gate(1)%counted%next <= gate(2)%counted%next)
  end function first_to_cross

  !> The first of those counted crosses the middle line.
  pure subroutine cross_first(gate, particle)
    type(gate_type), intent(inout) :: gate
    !> Who that is; not counted any more.
    integer, intent(out) :: particle

    call pop(gate%counted, particle)
  end subroutine cross_first

  !> This particle, which is counted, crosses the middle line.
  pure subroutine cross(gate, particle)
    type(gate_type), intent(inout) :: gate
    !> Its number; not counted any more.
    integer, intent(in) :: particle

    call remove(gate%counted, particle)
  end subroutine cross

  !> All those counted have been turned back.
  pure subroutine turned_back(gate)
    type(gate_type), intent(inout) :: gate

    call empty_queue(gate%counted)
    gate%entered = .false.
  end subroutine turned_back

  !> The clock is set back by `shift`.
  pure subroutine shift_gate(gate, shift)
    type(gate_type), intent(inout) :: gate
    real(wp), intent(in) :: shift

    call shift_queue(gate%counted, shift)
  end subroutine shift_gate

  !> Who is counted, through a stream; the threshold belongs to what is simulated.
  pure subroutine pass_gate(gate, stream)
    type(gate_type), intent(inout) :: gate
    type(stream_type), intent(inout) :: stream

    call stream%pass('entered', gate%entered)
    call pass_queue(gate%counted, stream)
  end subroutine pass_gate

end module battery_gate
