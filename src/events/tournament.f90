!> A winner tree: the pending events of many particles, one for each.
!>
!> Each leaf is a particle, from left to right by index; every node holds the earlier of its two
!> children; the root, node 1, holds the next event of all. A new time is compared upwards from its
!> leaf with one sibling per level. All siblings follow from the leaf and are loaded ahead, so the
!> dependent work at each level is one comparison and a selection without a branch. Of events at the
!> same time the left one comes first: that of the particle with the lowest index.
!>
!> Times are 0 or more. Such numbers are ordered like the integers with the same bits; adding 1 to
!> the right one of two equal integers makes the left one win.
module battery_tournament
  use battery_kinds, only: wp, int32, int64, bits_kind
  implicit none (type, external)
  private
  public :: tournament_type, new_tournament, set_event_time, event_time_of, rebase_tournament

  !> Time and particle side by side: one cache line holds both nodes of a comparison.
  type :: node_type
    real(wp) :: time = huge(1.0_wp)
    integer(int32) :: particle = 0
  end type node_type

  !> The events of `number` particles, in 2 `number` - 1 nodes.
  type :: tournament_type
    integer :: number = 0
    !> Node of the first particle: the leftmost of the lowest level.
    integer :: first = 1
    !> Node 1 is the root: `node(1)%time` and `node(1)%particle` are the next event.
    type(node_type), allocatable :: node(:)
  end type tournament_type

contains

  !> A tournament of the particles 1 ... size(time) with these times.
  pure subroutine new_tournament(tournament, time)
    type(tournament_type), intent(inout) :: tournament
    !> Time of each event; huge for never.
    real(wp), intent(in) :: time(:)
    integer :: i, k, n, winner

    n = size(time)
    tournament%number = n
    tournament%first = shiftl(1, bit_size(n) - leadz(n - 1))
    if (allocated(tournament%node)) deallocate (tournament%node)
    allocate (tournament%node(2*n - 1))
    do i = 1, n
      tournament%node(leaf_of(tournament, i)) = node_type(time(i), int(i, int32))
    end do
    do k = n - 1, 1, -1
      winner = 2*k
      if (tournament%node(2*k + 1)%time < tournament%node(2*k)%time) winner = 2*k + 1
      tournament%node(k) = tournament%node(winner)
    end do
  end subroutine new_tournament

  !> Node of a particle: on the lowest level, or one level above if that is full.
  elemental function leaf_of(tournament, particle) result(k)
    type(tournament_type), intent(in) :: tournament
    integer, intent(in) :: particle
    integer :: k

    k = tournament%first - 1 + particle
    if (k >= 2*tournament%number) k = k - tournament%number
  end function leaf_of

  !> Sets the event of `particle` to `time`.
  pure subroutine set_event_time(tournament, particle, time)
    type(tournament_type), intent(inout) :: tournament
    integer, intent(in) :: particle
    real(wp), intent(in) :: time

    call play_matches(tournament%number, tournament%node, leaf_of(tournament, particle), &
      int(particle, int32), time)
  end subroutine set_event_time

  !> Updates the nodes from a leaf to the root.
  pure subroutine play_matches(number, node, leaf, particle, time)
    integer, intent(in) :: number, leaf
    type(node_type), intent(inout) :: node(2*number - 1)
    integer(int32), intent(in) :: particle
    real(wp), intent(in) :: time
    integer(bits_kind) :: earliest, other, lost
    integer(int32) :: winner, rival
    !> Integers as long as an address, so that no index has to be converted.
    integer(int64) :: k, sibling

    earliest = transfer(time, earliest)
    winner = particle
    k = leaf
    node(k)%time = time
    node(k)%particle = winner
    do while (k > 1)
      sibling = ieor(k, 1_int64)
      other = transfer(node(sibling)%time, other)
      rival = node(sibling)%particle
      ! All bits are set if the sibling is earlier; the right one of two siblings has an odd index.
      lost = shifta(other - int(iand(k, 1_int64), bits_kind) - earliest, bit_size(earliest) - 1)
      earliest = earliest + iand(other - earliest, lost)
      winner = ieor(winner, iand(ieor(winner, rival), int(lost, int32)))
      k = shiftr(k, 1)
      node(k)%time = transfer(earliest, time)
      node(k)%particle = winner
    end do
  end subroutine play_matches

  !> Time of the event of `particle`.
  elemental function event_time_of(tournament, particle) result(time)
    type(tournament_type), intent(in) :: tournament
    integer, intent(in) :: particle
    real(wp) :: time

    time = tournament%node(leaf_of(tournament, particle))%time
  end function event_time_of

  !> Subtracts `shift` from all times. Winners stay winners if the differences are exact, as they
  !> are for a power of two that is not much greater than the times.
  pure subroutine rebase_tournament(tournament, shift)
    type(tournament_type), intent(inout) :: tournament
    real(wp), intent(in) :: shift

    tournament%node%time = tournament%node%time - shift
  end subroutine rebase_tournament

end module battery_tournament
