!> Passages through a channel: unfolded, a particle in a strip flies straight.
!>
!> With the strip reflected over and over, the height after a time t is y + u_y t; the number of
!> strips passed is the number of wall hits, and each reflection turns y and u_y over.
module battery_channel
  use battery_kinds, only: wp
  implicit none (type, external)
  private
  public :: fold

contains

  !> Height, sign of the velocity across and wall hits of a particle whose unfolded height is
  !> `unfolded`, in a channel of width `width` about y = 0.
  elemental subroutine fold(unfolded, width, height, turned, hits)
    real(wp), intent(in) :: unfolded, width
    !> Height within [-width/2, width/2].
    real(wp), intent(out) :: height
    !> 1, or -1 if the velocity across the channel has turned over.
    real(wp), intent(out) :: turned
    !> Number of wall hits, a whole number.
    real(wp), intent(out) :: hits
    real(wp) :: strip

    strip = unfolded/width
    strip = aint(strip + sign(0.5_wp, strip))
    hits = abs(strip)
    turned = 1.0_wp - 2.0_wp*abs(strip - 2.0_wp*aint(0.5_wp*strip))
    height = turned*(unfolded - strip*width)
    height = sign(min(abs(height), 0.5_wp*width), height)
  end subroutine fold

end module battery_channel
