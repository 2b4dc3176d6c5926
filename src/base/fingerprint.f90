!> Fingerprints: hashes of 64 bits of texts and numbers.
!>
!> FNV-1a (Fowler, Noll, Vo; IETF draft-eastlake-fnv) over words instead of bytes, with a shift that
!> mixes high bits into low ones; additions and products wrap (-fwrapv). It detects accidental
!> changes, but is not cryptographic.
module battery_fingerprint
  use battery_kinds, only: int64
  implicit none (type, external)
  private
  public :: fingerprint_start, mix_word, fingerprint_of, fingerprint_text

  integer(int64), parameter :: fingerprint_start = -3750763034362895579_int64
  integer(int64), parameter :: prime = 1099511628211_int64

contains

  !> Mixes one more word into a fingerprint.
  pure subroutine mix_word(fingerprint, word)
    !> `fingerprint_start`, or the fingerprint of the words before.
    integer(int64), intent(inout) :: fingerprint
    !> Word to mix in: any 64 bits.
    integer(int64), intent(in) :: word

    fingerprint = ieor(fingerprint, word)*prime
    fingerprint = ieor(fingerprint, ishft(fingerprint, -29))
  end subroutine mix_word

  !> The fingerprint of a text.
  pure integer(int64) function fingerprint_of(text) result(fingerprint)
    !> Text of any bytes; a blank at the end counts.
    character(len=*), intent(in) :: text
    integer :: k

    fingerprint = fingerprint_start
    call mix_word(fingerprint, len(text, kind=int64))
    do k = 1, len(text)
      call mix_word(fingerprint, int(iachar(text(k:k)), int64))
    end do
  end function fingerprint_of

  !> A fingerprint in sixteen hexadecimal digits.
  pure function fingerprint_text(fingerprint) result(text)
    !> Fingerprint: any 64 bits.
    integer(int64), intent(in) :: fingerprint
    character(len=16) :: text

    write (text, '(z16.16)') fingerprint
  end function fingerprint_text

end module battery_fingerprint
