!> SHA-256 of any number of bytes, by OpenSSL's libcrypto, on which HDF5 depends; `sha256sum` and
!> Python's `hashlib` give the same digits.
module battery_digest
  use, intrinsic :: iso_c_binding, only: c_int, c_size_t, c_int8_t, c_ptr, c_null_ptr, c_associated
  use battery_c_shapes, only: returns_address, action_on_address
  use battery_kinds, only: int8
  use battery_text, only: lower_case
  implicit none (type, external)
  private
  public :: digest_type, begin_digest, add_to_digest, end_digest, digest_length

  !> Hexadecimal digits of a digest.
  integer, parameter :: digest_length = 64

  !> A digest being computed.
  type :: digest_type
    private
    type(c_ptr) :: context = c_null_ptr
    !> Whether all calls of the library have succeeded.
    logical :: is_good = .false.
  end type digest_type

  procedure(returns_address), bind(c, name='EVP_sha256') :: c_sha256
  procedure(returns_address), bind(c, name='EVP_MD_CTX_new') :: c_new
  procedure(action_on_address), bind(c, name='EVP_MD_CTX_free') :: c_free

  interface
    integer(c_int) function c_init(context, method, engine) bind(c, name='EVP_DigestInit_ex')
      import :: c_ptr, c_int
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: context, method, engine
    end function c_init

    integer(c_int) function c_update(context, bytes, count) bind(c, name='EVP_DigestUpdate')
      import :: c_ptr, c_int, c_int8_t, c_size_t
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: context
      integer(c_int8_t), intent(in) :: bytes(*)
      integer(c_size_t), value, intent(in) :: count
    end function c_update

    integer(c_int) function c_final(context, bytes, count) bind(c, name='EVP_DigestFinal_ex')
      import :: c_ptr, c_int, c_int8_t
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: context
      integer(c_int8_t), intent(out) :: bytes(*)
      integer(c_int), intent(out) :: count
    end function c_final
  end interface

contains

  !> Starts a digest; `end_digest` must follow.
  subroutine begin_digest(digest)
    !> Digest, ready for its first bytes.
    type(digest_type), intent(out) :: digest

    digest%context = c_new()
    digest%is_good = c_associated(digest%context)
    if (digest%is_good) digest%is_good = c_init(digest%context, c_sha256(), c_null_ptr) == 1
  end subroutine begin_digest

  !> Adds bytes to a digest.
  subroutine add_to_digest(digest, bytes)
    !> A digest that was begun.
    type(digest_type), intent(inout) :: digest
    !> The next bytes, of any number.
    integer(int8), intent(in), contiguous :: bytes(:)

    if (digest%is_good) digest%is_good = &
      c_update(digest%context, bytes, size(bytes, kind=c_size_t)) == 1
  end subroutine add_to_digest

  !> Ends a digest.
  subroutine end_digest(digest, text)
    !> A digest that was begun; nothing can be added afterwards.
    type(digest_type), intent(inout) :: digest
    !> `digest_length` hexadecimal digits, in small letters; empty if the library has failed, for
    !> instance for lack of memory.
    character(len=:), allocatable, intent(out) :: text
    integer(c_int8_t) :: bytes(digest_length/2)
    integer(c_int) :: count
    character(len=digest_length) :: digits

    if (digest%is_good) digest%is_good = c_final(digest%context, bytes, count) == 1
    if (c_associated(digest%context)) call c_free(digest%context)
    digest%context = c_null_ptr
    text = ''
    if (.not. digest%is_good) return
    write (digits, '(*(z2.2))') bytes
    text = lower_case(digits)
  end subroutine end_digest

end module battery_digest
