!> A batch of visits to the urns: structure of arrays, and room for them.
module battery_visits
  use battery_kinds, only: wp, int64
  implicit none (type, external)
  private
  public :: visits_type, reserve_visits, lanes

  !> Particles that the kernels treat together.
  integer, parameter :: lanes = 4

  !> A batch of visits, one entry a particle; arrays have room for whole groups of `lanes`.
  type :: visits_type
    integer :: count = 0
    !> Who, and in which urn (1 or 2) the visit is.
    integer, allocatable :: particle(:), urn(:)
    !> In: when the particle entered the channel it comes from, and how long it has been in it.
    !> Out of `leave_channels`: when it enters the urn; the passage is then unchanged.
    !> Out of `cross_urns`: how long it would be in the channel it enters, from end to end.
    real(wp), allocatable :: time(:), passage(:)
    !> 1 for channel 1, -1 for channel 2, 0 for a particle that never leaves.
    !> In: where it comes from; out of `cross_urns`: where it goes.
    real(wp), allocatable :: opening(:)
    !> Position in the local frame. In: y at the channel's entrance; out of `leave_channels` at the
    !> chord where the urn begins; out of `cross_urns` on the chord where the urn ends.
    real(wp), allocatable :: x(:), y(:)
    !> Velocity. In: |u_x| and u_y in the channel; out of `leave_channels` in the local frame; out
    !> of `cross_urns` again |u_x| and u_y in the channel that is entered. For a particle that never
    !> leaves: cosine and sine of the incidence, and y is the angle of an impact.
    real(wp), allocatable :: along(:), across(:)
    !> Out of `cross_urns`: length of the way through the urn; for one that never leaves, until the
    !> impact at angle y, before which it had `impacts` of them.
    real(wp), allocatable :: length(:)
    !> Wall hits in the channel and in the urn, whole numbers.
    real(wp), allocatable :: hits(:)
    !> Out of `cross_urns`: the sum of them.
    integer(int64) :: all_hits = 0
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
    integer :: n

    visits%count = 0
    if (allocated(visits%particle)) then
      if (size(visits%particle) >= room) return
    end if
    n = lanes*((max(room, 64) + max(room, 64)/2)/lanes + 1)
    call renew(visits%time)
    call renew(visits%passage)
    call renew(visits%opening)
    call renew(visits%x)
    call renew(visits%y)
    call renew(visits%along)
    call renew(visits%across)
    call renew(visits%length)
    call renew(visits%px)
    call renew(visits%py)
    call renew(visits%zx)
    call renew(visits%zy)
    call renew(visits%steps)
    call renew(visits%c)
    call renew(visits%s)
    call renew(visits%hit_x)
    call renew(visits%hit_y)
    call renew(visits%impacts)
    call renew(visits%first)
    call renew(visits%hits)
    if (allocated(visits%particle)) deallocate (visits%particle, visits%urn, visits%slot)
    allocate (visits%particle(n), visits%urn(n), visits%slot(n), source=0)

  contains

    subroutine renew(array)
      real(wp), allocatable, intent(inout) :: array(:)

      if (allocated(array)) deallocate (array)
      allocate (array(n), source=0.5_wp)
    end subroutine renew

  end subroutine reserve_visits

end module battery_visits
