!> Random numbers from the GNU Scientific Library, with seeds of 64 bits; its sort; Student's
!> and the beta distribution.
!>
!> Seeds of GSL's generators have 32 bits. So there are two generators of different kind, `mt19937`
!> (Matsumoto and Nishimura, ACM TOMACS 8, 3 (1998), doi:10.1145/272991.272995) and `cmrg`
!> (L'Ecuyer, Operations Research 44, 816 (1996), doi:10.1287/opre.44.5.816), each with half of the
!> seed. Their numbers are added modulo one: the sum is uniform if either of them is.
module battery_gsl
  use, intrinsic :: iso_c_binding, only: c_int, c_double, c_int64_t, c_size_t, c_ptr
  use battery_paths, only: c_text_at
  use battery_kinds, only: int64
  use battery_error, only: error_type, fatal_error
  implicit none (type, external)
  private
  public :: seed_generator, uniform
  public :: sort_order, student_quantile, beta_below, gsl_library

  interface
    type(c_ptr) function c_version() bind(c, name='battery_gsl_version')
      import :: c_ptr
      implicit none (type, external)
    end function c_version

    integer(c_int) function c_seed(seed) bind(c, name='battery_seed')
      import :: c_int, c_int64_t
      implicit none (type, external)
      integer(c_int64_t), value, intent(in) :: seed
    end function c_seed

    !> Next number of the generator, uniform in [0, 1), a multiple of 2**(-53).
    real(c_double) function uniform() bind(c, name='battery_uniform')
      import :: c_double
      implicit none (type, external)
    end function uniform

    !> Quantile of Student's distribution with `freedom` degrees: `share` of it lies below.
    real(c_double) function student_quantile(share, freedom) bind(c, name='gsl_cdf_tdist_Pinv')
      import :: c_double
      implicit none (type, external)
      real(c_double), value, intent(in) :: share, freedom
    end function student_quantile

    !> Share of the beta distribution of `a` and `b` that lies below `x`.
    real(c_double) function beta_below(x, a, b) bind(c, name='gsl_cdf_beta_P')
      import :: c_double
      implicit none (type, external)
      real(c_double), value, intent(in) :: x, a, b
    end function beta_below

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

  !> Seeds the generator, of which there is one; an error if there is no memory.
  subroutine seed_generator(seed, error)
    !> Any 64 bits.
    integer(int64), intent(in) :: seed
    type(error_type), allocatable, intent(out) :: error

    if (c_seed(seed) == 0) &
      call fatal_error(error, 'GSL found no memory for a generator of random numbers')
  end subroutine seed_generator

end module battery_gsl
