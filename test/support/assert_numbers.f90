!> The asserts on numbers, one module a kind; `funit` joins them under their generic names.
module funit_int8
  use, intrinsic :: iso_fortran_env, only: ik => int8
  use funit_exceptions, only: SourceLocation, fail_with
  implicit none (type, external)
  private
  include 'assert_integer.inc'
end module funit_int8

module funit_int32
  use, intrinsic :: iso_fortran_env, only: ik => int32
  use funit_exceptions, only: SourceLocation, fail_with
  implicit none (type, external)
  private
  include 'assert_integer.inc'
end module funit_int32

module funit_int64
  use, intrinsic :: iso_fortran_env, only: ik => int64
  use funit_exceptions, only: SourceLocation, fail_with
  implicit none (type, external)
  private
  include 'assert_integer.inc'
end module funit_int64

module funit_real32
  use, intrinsic :: iso_fortran_env, only: rk => real32
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_is_finite
  use funit_exceptions, only: SourceLocation, fail_with
  implicit none (type, external)
  private
  include 'assert_real.inc'
end module funit_real32

module funit_real64
  use, intrinsic :: iso_fortran_env, only: rk => real64
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_is_finite
  use funit_exceptions, only: SourceLocation, fail_with
  implicit none (type, external)
  private
  include 'assert_real.inc'
end module funit_real64

module funit_widest_real
  use, intrinsic :: iso_fortran_env, only: real128
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_is_finite
  use funit_exceptions, only: SourceLocation, fail_with
  implicit none (type, external)
  private
  !> Kind of reals with 128 bits, or with 80 where a compiler has none with 128.
  integer, parameter :: rk = merge(real128, selected_real_kind(18), real128 > 0)
  include 'assert_real.inc'
end module funit_widest_real
