!> How one particle moves between two events: straight on.
module battery_motion
  use battery_kinds, only: wp, int8, int16
  implicit none (type, external)
  private
  public :: motion_type, move_straight, slowest, outside, in_urn, in_gate, in_return
  public :: wall_kind, meets_nothing, meets_gate, meets_return, meets_urn, meets_line, &
    meets_channel_wall, meets_wall

  !> Chambers of a side; `outside` is none of them.
  integer, parameter :: outside = 0, in_urn = 1, in_gate = 2, in_return = 3

  !> What a particle meets next: nothing at all, the chord where channel 1 or channel 2 begins, the
  !> chord where an urn begins, the line of its channel (the middle line or the periodic one), the
  !> wall of its channel; from 1 on, a wall of its urn, by the number that it has there.
  integer, parameter :: wall_kind = int16
  integer(wall_kind), parameter :: meets_nothing = -5_wall_kind, meets_gate = -4_wall_kind, &
    meets_return = -3_wall_kind, meets_urn = -2_wall_kind, meets_line = -1_wall_kind, &
    meets_channel_wall = 0_wall_kind, meets_wall = 1_wall_kind

  !> A velocity across or along a channel below this is as good as none: a division by it is huge,
  !> but does not overflow.
  real(wp), parameter :: slowest = sqrt(tiny(1.0_wp))

  !> Where a particle was at its last event, and how it has been moving since.
  type :: motion_type
    real(wp) :: x = 0.0_wp, y = 0.0_wp, ux = 0.0_wp, uy = 0.0_wp
    !> When that was.
    real(wp) :: time = 0.0_wp
    !> Side and chamber (`in_urn` ...) it is in.
    integer(int8) :: side = 0_int8, chamber = 0_int8
    !> What it meets next; some wall, until that is known.
    integer(wall_kind) :: next = meets_wall
  end type motion_type

contains

  !> Moves straight on for a while.
  elemental subroutine move_straight(motion, time)
    type(motion_type), intent(inout) :: motion
    !> How long.
    real(wp), intent(in) :: time

    motion%x = motion%x + motion%ux*time
    motion%y = motion%y + motion%uy*time
  end subroutine move_straight

end module battery_motion
