!> A batch of visits, as a structure of arrays. A visit is the passage of a particle through a
!> channel (`cross_channels`) and then through the urn behind it, up to an opening
!> (`compute_passages`).
module battery_visits
  use battery_kinds, only: wp, int64
  use battery_channel, only: channel1, none => no_channel
  implicit none (type, external)
  private
  public :: visits_type, reserve_visits, split_visits_by_urn, group_size, no_channel, truncated, &
    many_hits, longest_time, longest_hits_time

  !> Number of particles that the kernels process together.
  integer, parameter :: group_size = 4

  !> In place of a channel: the particle never leaves.
  integer(int64), parameter :: no_channel = none

  !> In place of a channel: the visit is truncated after a part of it. It is described as that of a
  !> particle that never leaves, at the end of the part. `through` is then half the length of the
  !> part: the time before its end at which the next part is computed.
  integer(int64), parameter :: truncated = -1

  !> Least number of wall hits in the urn that puts a visit on the list `many_hits_index`.
  real(wp), parameter :: many_hits = 112.0_wp

  !> Traced back through chords of the length c (in units of the radius) a velocity has an error of
  !> epsilon/c**2, or epsilon/c for each of many chords, and the place in the channel before one
  !> that grows with the time spent there. The start of a passage is stored where that time exceeds
  !> this many times c**2 radii, or ten times that many c radii over the number of hits: there the
  !> errors are some 1e-11 radii.
  real(wp), parameter :: longest_time = 1.0e4_wp, longest_hits_time = 10.0_wp*longest_time

  !> A batch of visits; arrays are padded to whole groups of `group_size`.
  type :: visits_type
    integer :: count = 0
    !> Visits that the arrays can hold.
    integer, private :: capacity = 0
    !> Particle of each visit, and its urn (1 or 2).
    integer, allocatable :: particle(:), urn(:)
    !> Before `cross_channels`: time of entry into the channel before the urn; after it: time of
    !> entry into the urn.
    real(wp), allocatable :: time(:)
    !> Time at which a gate reversed the particle in that channel, or huge; time spent in that
    !> channel.
    real(wp), allocatable :: reversal_time(:), passage(:)
    !> Before `compute_passages`: the channel before the urn; after it: the next channel, or
    !> `no_channel`.
    integer(int64), allocatable :: channel(:)
    !> After `compute_passages`: time through the next channel, from end to end; of a truncated
    !> visit, half the length of the part.
    real(wp), allocatable :: through(:)
    !> Position in the frame of the urn. Before `cross_channels`: y at the channel's entrance; after
    !> it: on the chord through which it enters the urn; after `compute_passages`: on the one
    !> through which it leaves.
    real(wp), allocatable :: x(:), y(:)
    !> Velocity. Before `cross_channels`: |u_x| and u_y in the channel; after it: in the frame of
    !> the urn; after `compute_passages`: |u_x| and u_y in the next channel.
    !>
    !> For a particle that never leaves, and for a truncated visit, y and the velocity describe an
    !> impact. In a disc: its angle, and cosine and sine of the incidence. In a polygon: its place,
    !> an arc length along the outline, and u_x and u_y after it in the frame of the urn.
    real(wp), allocatable :: u_axial(:), u_lateral(:)
    !> After `compute_passages`: length of the path through the urn, or until that impact.
    real(wp), allocatable :: length(:)
    !> Wall hits in the channel and in the urn, whole numbers.
    real(wp), allocatable :: hits(:)
    !> After `compute_passages`: sum of the wall hits of all visits.
    integer(int64) :: all_hits = 0
    !> After `compute_passages`: number of visits that have at least `many_hits` hits in the urn,
    !> never end, or are truncated, and their indices. The list may contain others too.
    integer :: many_hits_count = 0
    integer, allocatable :: many_hits_index(:)
    !> The same of the visits whose passage through the urn cannot be traced back to its start: it
    !> starts on the wall of a disc within rounding, or errors of its hits, by rounding, grow with
    !> the time that a slow particle spends in the channel before.
    integer :: untraceable_count = 0
    integer, allocatable :: untraceable_index(:)
    !> Work space of the kernels, of which each has its own use for it. An element belongs to the
    !> visit `slot`. In a disc: impact, rotation from one impact to the next, number of rotations.
    !> In a polygon: position, velocity, hits so far.
    real(wp), allocatable :: px(:), py(:), zx(:), zy(:), steps(:)
    integer, allocatable :: slot(:)
    !> In a disc: cosine and sine of the incidence, impact in the opening, number of impacts before
    !> it; for a particle that never leaves, -1 minus the number of impacts after which that was
    !> found. In a polygon `c` is 1 until the visit ends, then 0, `s` has what rounding took from
    !> `first`, and the others are not used.
    real(wp), allocatable :: c(:), s(:), hit_x(:), hit_y(:), impacts(:)
    !> In a disc: length until the first impact. In a polygon: length so far.
    real(wp), allocatable :: first(:)
  end type visits_type

contains

  !> Empties the batch, and allocates it for `capacity` visits, or none, if it is not larger.
  subroutine reserve_visits(visits, capacity)
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: capacity

    visits%count = 0
    visits%many_hits_count = 0
    visits%untraceable_count = 0
    if (capacity >= visits%capacity) call allocate_visits(visits, capacity)
  end subroutine reserve_visits

  !> Allocates an empty batch for at least `capacity` visits.
  subroutine allocate_visits(visits, capacity)
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: capacity
    integer :: n

    n = group_size*((max(capacity, 64) + max(capacity, 64)/2)/group_size + 1)
    visits = visits_type()
    visits%capacity = n
    allocate (visits%time(n), visits%passage(n), visits%reversal_time(n), visits%through(n), &
      visits%x(n), visits%y(n), visits%u_axial(n), visits%u_lateral(n), visits%length(n), &
      visits%hits(n), visits%px(n), visits%py(n), visits%zx(n), visits%zy(n), visits%steps(n), &
      visits%c(n), visits%s(n), visits%hit_x(n), visits%hit_y(n), visits%impacts(n), &
      visits%first(n), source=0.5_wp)
    allocate (visits%particle(n), visits%urn(n), visits%slot(n), visits%many_hits_index(n), &
      source=0)
    allocate (visits%untraceable_index(n))
    ! Padding lanes of the last group: particles from channel 1, which is never closed.
    allocate (visits%channel(n), source=int(channel1, int64))
  end subroutine allocate_visits

  !> Moves the visits to urn 2 into a batch of their own: particle, channel and time of reversal.
  subroutine split_visits_by_urn(visits, other)
    !> In: all visits; out: those to urn 1.
    type(visits_type), intent(inout) :: visits
    !> Out: those to urn 2.
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
    other%reversal_time(:n - kept) = pack(visits%reversal_time(:n), second)
    visits%particle(:kept) = pack(visits%particle(:n), .not. second)
    visits%urn(:kept) = 1
    visits%channel(:kept) = pack(visits%channel(:n), .not. second)
    visits%reversal_time(:kept) = pack(visits%reversal_time(:n), .not. second)
    visits%count = kept
  end subroutine split_visits_by_urn

end module battery_visits
