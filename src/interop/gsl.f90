!> Random numbers from the GNU Scientific Library: its Mersenne Twister `mt19937`.
!>
!> The generator type is looked up by name in the table of `gsl_rng_types_setup`: the C variable
!> `gsl_rng_mt19937` cannot be bound safely, since the program would get a null copy of its own.
module battery_gsl
  use, intrinsic :: iso_c_binding, only: c_ptr, c_null_ptr, c_char, c_double, c_int8_t, c_long, &
    c_size_t, c_associated, c_f_pointer, c_null_char
  use battery_kinds, only: dp, int8, int64
  use battery_error, only: error_type, fatal_error
  implicit none (type, external)
  private
  public :: generator_type, new_generator, free_generator
  public :: uniform, uniform_fine, exponential, save_generator, restore_generator, largest_seed

  !> Seeds are 32 bits for this generator; 0 is taken as 4357.
  integer(int64), parameter :: largest_seed = 4294967295_int64

  !> Longest list of generators and longest name that are searched.
  integer, parameter :: most_generators = 1000, longest_name = 32

  character(len=*), parameter :: generator_name = 'mt19937'

  !> One stream of random numbers; copies share the stream.
  type :: generator_type
    private
    type(c_ptr) :: handle = c_null_ptr
  end type generator_type

  !> Beginning of GSL's `gsl_rng_type`.
  type, bind(c) :: generator_kind_type
    type(c_ptr) :: name
  end type generator_kind_type

  interface
    function gsl_set_error_handler_off() result(old) bind(c)
      import :: c_ptr
      implicit none (type, external)
      type(c_ptr) :: old
    end function gsl_set_error_handler_off

    function gsl_rng_types_setup() result(kinds) bind(c)
      import :: c_ptr
      implicit none (type, external)
      type(c_ptr) :: kinds
    end function gsl_rng_types_setup

    function gsl_rng_alloc(kind) result(handle) bind(c)
      import :: c_ptr
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: kind
      type(c_ptr) :: handle
    end function gsl_rng_alloc

    subroutine gsl_rng_free(handle) bind(c)
      import :: c_ptr
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: handle
    end subroutine gsl_rng_free

    subroutine gsl_rng_set(handle, seed) bind(c)
      import :: c_ptr, c_long
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: handle
      integer(c_long), value, intent(in) :: seed
    end subroutine gsl_rng_set

    function gsl_rng_get(handle) result(number) bind(c)
      import :: c_ptr, c_long
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: handle
      integer(c_long) :: number
    end function gsl_rng_get

    function gsl_rng_uniform(handle) result(number) bind(c)
      import :: c_ptr, c_double
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: handle
      real(c_double) :: number
    end function gsl_rng_uniform

    function gsl_rng_size(handle) result(bytes) bind(c)
      import :: c_ptr, c_size_t
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: handle
      integer(c_size_t) :: bytes
    end function gsl_rng_size

    function gsl_rng_state(handle) result(state) bind(c)
      import :: c_ptr
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: handle
      type(c_ptr) :: state
    end function gsl_rng_state
  end interface

contains

  !> A generator with a seed from 0 to `largest_seed`; give it back with `free_generator`.
  !> Switches GSL's error handler off, which would abort the program.
  subroutine new_generator(generator, seed, error)
    type(generator_type), intent(out) :: generator
    integer(int64), intent(in) :: seed
    type(error_type), allocatable, intent(out) :: error
    type(c_ptr) :: kind, unused

    unused = gsl_set_error_handler_off()
    kind = find_kind()
    if (.not. c_associated(kind)) then
      call fatal_error(error, 'the installed GSL has no generator '//generator_name)
      return
    end if
    generator%handle = gsl_rng_alloc(kind)
    if (.not. c_associated(generator%handle)) then
      call fatal_error(error, 'GSL found no memory for a generator of random numbers')
      return
    end if
    call gsl_rng_set(generator%handle, int(seed, c_long))
  end subroutine new_generator

  !> Gives the memory of a generator back; harmless for one that was never made.
  subroutine free_generator(generator)
    type(generator_type), intent(inout) :: generator

    if (c_associated(generator%handle)) call gsl_rng_free(generator%handle)
    generator%handle = c_null_ptr
  end subroutine free_generator

  !> GSL's type of the generator, by its name; null if there is none.
  function find_kind() result(kind)
    type(c_ptr) :: kind
    type(c_ptr), pointer :: kinds(:)
    type(generator_kind_type), pointer :: candidate
    integer :: at

    call c_f_pointer(gsl_rng_types_setup(), kinds, [most_generators])
    kind = c_null_ptr
    do at = 1, most_generators
      if (.not. c_associated(kinds(at))) exit
      call c_f_pointer(kinds(at), candidate)
      if (.not. has_name(candidate%name)) cycle
      kind = kinds(at)
      exit
    end do
  end function find_kind

  !> Whether a C string is the name of the generator that is used.
  function has_name(name) result(same)
    type(c_ptr), intent(in) :: name
    logical :: same
    character(kind=c_char), pointer :: letters(:)
    integer :: at

    call c_f_pointer(name, letters, [longest_name])
    same = .true.
    do at = 1, len(generator_name)
      same = same .and. letters(at) == generator_name(at:at)
      if (.not. same) return
    end do
    same = letters(len(generator_name) + 1) == c_null_char
  end function has_name

  !> Next number, uniform in [0, 1), a multiple of 2**(-32).
  function uniform(generator) result(number)
    type(generator_type), intent(in) :: generator
    real(dp) :: number

    number = gsl_rng_uniform(generator%handle)
  end function uniform

  !> Next number, uniform in [0, 1), a multiple of 2**(-53): two draws.
  function uniform_fine(generator) result(number)
    type(generator_type), intent(in) :: generator
    real(dp) :: number
    integer(int64) :: high, low

    high = shiftr(int(gsl_rng_get(generator%handle), int64), 5)
    low = shiftr(int(gsl_rng_get(generator%handle), int64), 6)
    number = scale(real(ior(shiftl(high, 26), low), dp), -53)
  end function uniform_fine

  !> Next number, exponential with mean 1.
  function exponential(generator) result(number)
    type(generator_type), intent(in) :: generator
    real(dp) :: number

    number = -log(1.0_dp - uniform_fine(generator))
  end function exponential

  !> State of a generator, to go on with the same numbers later.
  subroutine save_generator(generator, state)
    type(generator_type), intent(in) :: generator
    integer(int8), allocatable, intent(out) :: state(:)
    integer(c_int8_t), pointer :: bytes(:)

    call c_f_pointer(gsl_rng_state(generator%handle), bytes, [gsl_rng_size(generator%handle)])
    state = bytes
  end subroutine save_generator

  !> Goes on where `save_generator` was; the generator has been made before.
  subroutine restore_generator(generator, state, error)
    type(generator_type), intent(in) :: generator
    integer(int8), intent(in) :: state(:)
    type(error_type), allocatable, intent(out) :: error
    integer(c_int8_t), pointer :: bytes(:)

    if (size(state, kind=c_size_t) /= gsl_rng_size(generator%handle)) then
      call fatal_error(error, 'a saved state of the random numbers has the wrong length')
      return
    end if
    call c_f_pointer(gsl_rng_state(generator%handle), bytes, [gsl_rng_size(generator%handle)])
    bytes = state
  end subroutine restore_generator

end module battery_gsl
