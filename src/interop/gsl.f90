!> Random numbers from the GNU Scientific Library, with seeds of 64 bits; its sort; Student's
!> distribution.
!>
!> Seeds of GSL's generators have 32 bits. So there are two generators of different kind, `mt19937`
!> (Matsumoto and Nishimura, ACM TOMACS 8, 3 (1998), doi:10.1145/272991.272995) and `cmrg`
!> (L'Ecuyer, Operations Research 44, 816 (1996), doi:10.1287/opre.44.5.816), each with half of the
!> seed. Their numbers are added modulo one: the sum is uniform if either of them is.
module battery_gsl
  use, intrinsic :: iso_c_binding, only: c_ptr, c_null_ptr, c_double, c_int64_t, c_size_t, &
    c_associated
  use battery_c_shapes, only: action_on_address, returns_address
  use battery_paths, only: c_text_at
  use battery_kinds, only: dp, int64
  use battery_error, only: error_type, fatal_error
  implicit none (type, external)
  private
  public :: generator_type, new_generator, free_generator, uniform
  public :: sort_order, student_quantile, gsl_library

  !> One stream of random numbers; copies share the stream.
  type :: generator_type
    private
    type(c_ptr) :: handle = c_null_ptr
  end type generator_type

  procedure(action_on_address), bind(c, name='battery_generator_free') :: c_free
  procedure(returns_address), bind(c, name='battery_gsl_version') :: c_version

  interface
    type(c_ptr) function c_new(seed) bind(c, name='battery_generator_new')
      import :: c_ptr, c_int64_t
      implicit none (type, external)
      integer(c_int64_t), value, intent(in) :: seed
    end function c_new

    !> Quantile of Student's distribution with `freedom` degrees: `share` of it lies below.
    real(c_double) function student_quantile(share, freedom) bind(c, name='gsl_cdf_tdist_Pinv')
      import :: c_double
      implicit none (type, external)
      real(c_double), value, intent(in) :: share, freedom
    end function student_quantile

    real(c_double) function c_uniform(handle) bind(c, name='battery_generator_uniform')
      import :: c_ptr, c_double
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: handle
    end function c_uniform

    !> Sorting permutation: the indices, from 0, of `count` numbers in ascending order; the numbers
    !> are `stride` elements apart.
    subroutine sort_order(order, numbers, stride, count) bind(c, name='gsl_sort_index')
      import :: c_double, c_size_t
      implicit none (type, external)
      integer(c_size_t), value, intent(in) :: stride, count
      integer(c_size_t), intent(out) :: order(count)
      real(c_double), intent(in) :: numbers(*)
    end subroutine sort_order
  end interface

contains

  !> Name and version of the library.
  function gsl_library() result(version)
    character(len=:), allocatable :: version

    version = c_text_at(c_version())
  end function gsl_library

  !> Makes a generator, to be freed with `free_generator`; an error if there is no memory.
  subroutine new_generator(generator, seed, error)
    type(generator_type), intent(out) :: generator
    !> Seed: any 64 bits.
    integer(int64), intent(in) :: seed
    type(error_type), allocatable, intent(out) :: error

    generator%handle = c_new(seed)
    if (.not. c_associated(generator%handle)) &
      call fatal_error(error, 'GSL found no memory for a generator of random numbers')
  end subroutine new_generator

  !> Frees a generator; one that was never made is no error.
  subroutine free_generator(generator)
    type(generator_type), intent(inout) :: generator

    call c_free(generator%handle)
    generator%handle = c_null_ptr
  end subroutine free_generator

  !> Next number of a generator, uniform in [0, 1), a multiple of 2**(-53).
  real(dp) function uniform(generator) result(number)
    type(generator_type), intent(in) :: generator

    number = c_uniform(generator%handle)
  end function uniform

end module battery_gsl
