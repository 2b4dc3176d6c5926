!> Straight motion of one particle between two events.
module battery_motion
  use battery_kinds, only: wp, int8, int16
  implicit none (type, external)
  private
  public :: motion_type, move_straight, slowest, least_across, outside, in_urn, in_gate, in_channel2
  public :: wall_kind, meets_nothing, meets_gate, meets_channel2, meets_urn, meets_line, &
    meets_channel_wall, meets_wall

  !> Chambers, the three regions that belong to an urn: the urn itself, its half of channel 1 (its
  !> gate), its half of channel 2; `outside` is none of them.
  integer, parameter :: outside = 0, in_urn = 1, in_gate = 2, in_channel2 = 3

  !> Kinds of walls and lines that a particle reaches next: none; the chord where channel 1 or
  !> channel 2 starts; the chord where an urn starts; the line of its channel (the middle line or
  !> the periodic line); the wall of its channel; from 1 on, the wall of its urn, or the disc in its
  !> channel, with that number.
  integer, parameter :: wall_kind = int16
  integer(wall_kind), parameter :: meets_nothing = -5_wall_kind, meets_gate = -4_wall_kind, &
    meets_channel2 = -3_wall_kind, meets_urn = -2_wall_kind, meets_line = -1_wall_kind, &
    meets_channel_wall = 0_wall_kind, meets_wall = 1_wall_kind

  !> A velocity component below this counts as 0: a division by it gives a huge number but does not
  !> overflow.
  real(wp), parameter :: slowest = sqrt(tiny(1.0_wp))

  !> Who moves through an opening with a component across it not above this runs along it, up to
  !> rounding: it does not enter the channel, in which it would never come to an end. In a disc the
  !> bound is larger by the length of the longest open channel over r (`least_across` of the urn):
  !> `synchronous` moves all particles in each event, and their rounding grows with the table.
  real(wp), parameter :: least_across = 1.0e-12_wp

  !> State of a particle at its last event.
  type :: motion_type
    real(wp) :: x = 0.0_wp, y = 0.0_wp, ux = 0.0_wp, uy = 0.0_wp
    !> Time of that event.
    real(wp) :: time = 0.0_wp
    !> Index of its urn, and chamber (`in_urn` ...).
    integer(int8) :: urn = 0_int8, chamber = 0_int8
    !> Kind of the next wall or line; a wall, until it is computed.
    integer(wall_kind) :: next = meets_wall
  end type motion_type

contains

  !> Moves a particle along a straight line.
  elemental subroutine move_straight(motion, time)
    type(motion_type), intent(inout) :: motion
    !> Duration of the motion.
    real(wp), intent(in) :: time

    motion%x = motion%x + motion%ux*time
    motion%y = motion%y + motion%uy*time
  end subroutine move_straight

end module battery_motion
