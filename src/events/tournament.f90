!> The pending events of many particles, one each: who is next?
!>
!> A winner tree. Particle i sits at leaf n - 1 + i; every node above holds the earlier of its two
!> children; the root, node 1, holds the next event of all. A new time is played upwards from its
!> leaf against one sibling a level. All siblings are known from the leaf, so that they are loaded
!> ahead, and what waits from level to level is one comparison and a selection without a branch.
!> Of events at one time the particle with the lowest number comes first, for any n.
module battery_tournament
  use battery_kinds, only: wp, int32, int64
  implicit none (type, external)
  private
  public :: tournament_type, new_tournament, set_time, time_of, shift_times

  !> Time and particle side by side: one line of the cache holds a match.
  type :: node_type
    real(wp) :: time = huge(1.0_wp)
    integer(int32) :: particle = 0
  end type node_type

  !> The events of `number` particles, in 2 `number` - 1 nodes.
  type :: tournament_type
    integer :: number = 0
    !> Node 1 is the root: `node(1)%time` and `node(1)%particle` are the next event.
    type(node_type), allocatable :: node(:)
  end type tournament_type

contains

  !> A tournament of the particles 1 ... size(time) with these times.
  pure subroutine new_tournament(tournament, time)
    type(tournament_type), intent(inout) :: tournament
    !> When each particle has its event; huge for never.
    real(wp), intent(in) :: time(:)
    integer :: i, k, n, winner

    n = size(time)
    tournament%number = n
    if (allocated(tournament%node)) deallocate (tournament%node)
    allocate (tournament%node(2*n - 1))
    do i = 1, n
      tournament%node(n - 1 + i) = node_type(time(i), int(i, int32))
    end do
    do k = n - 1, 1, -1
      winner = 2*k
      if (before(tournament%node(2*k + 1), tournament%node(2*k))) winner = 2*k + 1
      tournament%node(k) = tournament%node(winner)
    end do
  end subroutine new_tournament

  !> The event of `particle` is due at `time`.
  pure subroutine set_time(tournament, particle, time)
    type(tournament_type), intent(inout) :: tournament
    integer, intent(in) :: particle
    real(wp), intent(in) :: time

    call play(tournament%number, tournament%node, int(particle, int32), time)
  end subroutine set_time

  !> The matches from a leaf to the root.
  pure subroutine play(number, node, particle, time)
    integer, intent(in) :: number
    type(node_type), intent(inout) :: node(2*number - 1)
    integer(int32), intent(in) :: particle
    real(wp), intent(in) :: time
    type(node_type) :: sibling
    real(wp) :: earliest
    integer(int32) :: winner
    !> As long as an address, so that none has to be made longer.
    integer(int64) :: k
    logical :: lost

    earliest = time
    winner = particle
    k = number - 1 + particle
    node(k)%time = earliest
    node(k)%particle = winner
    do while (k > 1)
      sibling = node(ieor(k, 1_int64))
      lost = (sibling%time < earliest) &
        .or. (sibling%time <= earliest .and. sibling%particle < winner)
      earliest = merge(sibling%time, earliest, lost)
      winner = merge(sibling%particle, winner, lost)
      k = shiftr(k, 1)
      node(k)%time = earliest
      node(k)%particle = winner
    end do
  end subroutine play

  pure function before(one, other)
    type(node_type), intent(in) :: one, other
    logical :: before

    before = (one%time < other%time) &
      .or. (one%time <= other%time .and. one%particle < other%particle)
  end function before

  !> When the event of `particle` is due.
  elemental function time_of(tournament, particle) result(time)
    type(tournament_type), intent(in) :: tournament
    integer, intent(in) :: particle
    real(wp) :: time

    time = tournament%node(tournament%number - 1 + particle)%time
  end function time_of

  !> The clock is set back by `shift`. Winners stay winners if the times remain exact, as they do
  !> for a power of two that is not much longer than they are.
  pure subroutine shift_times(tournament, shift)
    type(tournament_type), intent(inout) :: tournament
    real(wp), intent(in) :: shift

    tournament%node%time = tournament%node%time - shift
  end subroutine shift_times

end module battery_tournament
