!> A batch of visits to the urns: structure of arrays, and room for them.
module battery_visits
  use battery_kinds, only: wp, int64
  use battery_channel, only: gated, none => no_channel
  implicit none (type, external)
  private
  public :: visits_type, reserve_visits, split_visits_by_urn, together, no_channel, truncated, &
    many_hits

  !> Particles that the kernels treat together.
  integer, parameter :: together = 4

  !> In place of a channel: a particle that never leaves.
  integer(int64), parameter :: no_channel = none

  !> In place of a channel: a visit of which only a part is known yet. What is told of it is that of
  !> a particle that never leaves, at the end of the part; `through` is half the part's length.
  integer(int64), parameter :: truncated = -1

  !> Whole visits with fewer wall hits in the urn than this are nowhere on the list of those with
  !> many.
  real(wp), parameter :: many_hits = 112.0_wp

  !> A batch of visits, one entry a particle; arrays have room for whole groups of `together`.
  type :: visits_type
    integer :: count = 0
    !> How many there is room for; before there is any, less than anybody asks for.
    integer, private :: room = -1
    !> Who, and in which urn (1 or 2) the visit is.
    integer, allocatable :: particle(:), urn(:)
    !> In: when the particle entered the channel it comes from. Out of `cross_channels`: when it
    !> enters the urn.
    real(wp), allocatable :: time(:)
    !> When a gate turned it back in that channel; huge if none did. How long it has been in it.
    real(wp), allocatable :: turned(:), passage(:)
    !> In: the channel it comes from; out of `cross`: that which it goes to, or `no_channel`.
    integer(int64), allocatable :: channel(:)
    !> Out of `cross`: how long it would be in that channel, from end to end.
    real(wp), allocatable :: through(:)
    !> Position in the local frame. In: y at the channel's entrance; out of `cross_channels` at the
    !> chord where the urn begins; out of `cross` on the chord where the urn ends.
    real(wp), allocatable :: x(:), y(:)
    !> Velocity. In: |u_x| and u_y in the channel; out of `cross_channels` in the local frame; out
    !> of `cross` again |u_x| and u_y in the channel that is entered. For a particle that never
    !> leaves: cosine and sine of the incidence, and y is the angle of an impact.
    real(wp), allocatable :: u_axial(:), u_lateral(:)
    !> Out of `cross`: length of the way through the urn; for one that never leaves, until the
    !> impact at angle y, before which it had `impacts` of them.
    real(wp), allocatable :: length(:)
    !> Wall hits in the channel and in the urn, whole numbers.
    real(wp), allocatable :: hits(:)
    !> Out of `cross`: the sum of them.
    integer(int64) :: all_hits = 0
    !> Out of `cross`: how many visits have at least `many_hits` hits in the urn, never end, or are
    !> known in part only, and which of the batch they are. Others may be among them.
    integer :: many_count = 0
    integer, allocatable :: many(:)
    !> Work space of the kernel: impact, rotation, steps, and whose they are.
    real(wp), allocatable :: px(:), py(:), zx(:), zy(:), steps(:)
    integer, allocatable :: slot(:)
    !> Cosine and sine of the incidence, impact in the opening, impacts before it; a particle that
    !> never leaves has -1 less the impacts after which that was found out.
    real(wp), allocatable :: c(:), s(:), hit_x(:), hit_y(:), impacts(:)
    !> Length until the first impact.
    real(wp), allocatable :: first(:)
  end type visits_type

contains

  !> Makes room for `room` visits and empties the batch.
  subroutine reserve_visits(visits, room)
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: room

    visits%count = 0
    visits%many_count = 0
    if (room > visits%room) call make_room(visits, room)
  end subroutine reserve_visits

  !> Makes room for at least `room` visits in an empty batch.
  subroutine make_room(visits, room)
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: room
    integer :: n

    n = together*((max(room, 64) + max(room, 64)/2)/together + 1)
    visits = visits_type()
    visits%room = n
    allocate (visits%time(n), visits%passage(n), visits%turned(n), visits%through(n), visits%x(n), &
      visits%y(n), visits%u_axial(n), visits%u_lateral(n), visits%length(n), visits%hits(n), &
      visits%px(n), visits%py(n), visits%zx(n), visits%zy(n), visits%steps(n), visits%c(n), &
      visits%s(n), visits%hit_x(n), visits%hit_y(n), visits%impacts(n), visits%first(n), &
      source=0.5_wp)
    allocate (visits%particle(n), visits%urn(n), visits%slot(n), visits%many(n), source=0)
    ! Who fills up the last group comes from a channel that is always open.
    allocate (visits%channel(n), source=int(gated, int64))
  end subroutine make_room

  !> Those in urn 2 become a batch of their own: who, through which channel, and when turned back.
  subroutine split_visits_by_urn(visits, other)
    !> Before: all; after: those in urn 1.
    type(visits_type), intent(inout) :: visits
    !> Those in urn 2.
    type(visits_type), intent(inout) :: other
    logical :: second(visits%count)
    integer :: n, kept

    n = visits%count
    second = visits%urn(:n) == 2
    kept = n - count(second)
    call reserve_visits(other, n - kept)
    other%count = n - kept
    other%particle(:n - kept) = pack(visits%particle(:n), second)
    other%urn(:n - kept) = 2
    other%channel(:n - kept) = pack(visits%channel(:n), second)
    other%turned(:n - kept) = pack(visits%turned(:n), second)
    visits%particle(:kept) = pack(visits%particle(:n), .not. second)
    visits%urn(:kept) = 1
    visits%channel(:kept) = pack(visits%channel(:n), .not. second)
    visits%turned(:kept) = pack(visits%turned(:n), .not. second)
    visits%count = kept
  end subroutine split_visits_by_urn

end module battery_visits
