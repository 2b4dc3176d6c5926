!> Straight channels, and passages through them by unfolding.
!>
!> In the plane made of mirror images of the strip, the height after a time t is y + u_y t; the
!> number of strips crossed is the number of wall hits, and each changes the sign of y and u_y.
module battery_channel
  use battery_kinds, only: wp
  implicit none (type, external)
  private
  public :: channel_type, is_open, fold_into_channel, channel1, channel2, no_channel, facing

  !> Channel 1, with the gates; channel 2, which closes the circuit; and neither.
  integer, parameter :: channel1 = 1, channel2 = 2, no_channel = 0

  !> Direction along x from the middle of an urn to each channel, in the frame of the urn.
  real(wp), parameter :: facing(2) = [1.0_wp, -1.0_wp]

  !> Dimensions of a channel of the table.
  type :: channel_type
    !> Distance from wall to wall (0: closed), and from urn to urn, both halves together.
    real(wp) :: width = 0.0_wp, length = 1.0_wp
  end type channel_type

contains

  !> Whether a channel is wider than 0.
  elemental function is_open(channel)
    type(channel_type), intent(in) :: channel
    logical :: is_open

    is_open = channel%width > 0.0_wp
  end function is_open

  !> Height (y across the channel), sign of the lateral velocity and wall hits of a particle at the
  !> height `unfolded` of the unfolded plane, in a channel of the given `width` about y = 0.
  elemental subroutine fold_into_channel(unfolded, width, height, reflected, hits)
    real(wp), intent(in) :: unfolded, width
    !> Height within [-width/2, width/2].
    real(wp), intent(out) :: height
    !> -1 after an odd number of reflections, else 1.
    real(wp), intent(out) :: reflected
    !> Number of wall hits, a whole number.
    real(wp), intent(out) :: hits
    real(wp) :: strip

    strip = unfolded/width
    strip = aint(strip + sign(0.5_wp, strip))
    hits = abs(strip)
    reflected = 1.0_wp - 2.0_wp*abs(strip - 2.0_wp*aint(0.5_wp*strip))
    height = reflected*(unfolded - strip*width)
    height = sign(min(abs(height), 0.5_wp*width), height)
  end subroutine fold_into_channel

end module battery_channel
