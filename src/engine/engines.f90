!> The engines by their names in the namelist: the only list of them.
module battery_engines
  use battery_kinds, only: wp, dp
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_table, only: table_type
  use battery_engine, only: engine_type
  use battery_excursion, only: excursion_type
  use battery_collision, only: collision_type
  use battery_synchronous, only: synchronous_type
  use battery_timestep, only: timestep_type
  use battery_reservoir, only: reservoir_type
  implicit none (type, external)
  private
  public :: engine_names, new_engine, engine_choices, has_step, bytes_per_particle, explain_refusal

  !> Properties of an engine that are needed before one is made.
  type :: engine_info_type
    character(len=11) :: name
    !> Largest number of bytes per particle: with the initial positions and velocities, with arrays
    !> whose size is a power of two, and with two copies of the state, as while it is saved or read.
    !> Measured: 196, 177, 140, 109, 244; without copies of the state 93, 87, 93, 65, 89.
    real(dp) :: bytes
    !> Whether the engine needs `time_step`.
    logical :: has_step
  end type engine_info_type

  !> All engines, in the order of the cases of `new_engine`.
  type(engine_info_type), parameter :: engines(*) = [ &
    engine_info_type('excursion', 208.0_dp, .false.), &
    engine_info_type('collision', 192.0_dp, .false.), &
    engine_info_type('synchronous', 152.0_dp, .false.), &
    engine_info_type('timestep', 120.0_dp, .true.), &
    engine_info_type('reservoir', 256.0_dp, .false.)]

  character(len=11), parameter :: engine_names(size(engines)) = engines%name

contains

  !> Makes the engine called `name`, not yet started.
  subroutine new_engine(name, engine, error)
    character(len=*), intent(in) :: name
    class(engine_type), allocatable, intent(out) :: engine
    type(error_type), allocatable, intent(out) :: error

    select case (findloc(engine_names, name, dim=1))
    case (1)
      allocate (excursion_type :: engine)
    case (2)
      allocate (collision_type :: engine)
    case (3)
      allocate (synchronous_type :: engine)
    case (4)
      allocate (timestep_type :: engine)
    case (5)
      allocate (reservoir_type :: engine)
    case default
      call fatal_error(error, 'engine '''//name//''' is not known', exit_bad_input)
    end select
  end subroutine new_engine

  !> All names, separated by blanks.
  pure function engine_choices() result(names)
    character(len=:), allocatable :: names
    integer :: at

    names = trim(engine_names(1))
    do at = 2, size(engines)
      names = names//' '//trim(engine_names(at))
    end do
  end function engine_choices

  !> Whether an engine needs `time_step`.
  pure function has_step(name)
    !> As in the namelist.
    character(len=*), intent(in) :: name
    logical :: has_step

    has_step = any(engines%has_step .and. engine_names == name)
  end function has_step

  !> Largest number of bytes per particle that an engine allocates.
  pure function bytes_per_particle(name, polygons) result(bytes)
    !> As in the namelist.
    character(len=*), intent(in) :: name
    !> Whether an urn is a polygon: then `excursion` has the start of each passage, and two copies.
    logical, intent(in) :: polygons
    real(dp) :: bytes

    bytes = sum(engines%bytes, mask=engine_names == name)
    if (polygons .and. name == 'excursion') bytes = bytes + 120.0_dp
  end function bytes_per_particle

  !> Why an engine cannot simulate a table: `reason`, in words for the user, empty if it can; and
  !> the engines that can: `others`.
  subroutine explain_refusal(engine, table, reason, others)
    !> Engine whose step is set.
    class(engine_type), intent(in) :: engine
    type(table_type), intent(in) :: table
    character(len=:), allocatable, intent(out) :: reason, others
    class(engine_type), allocatable :: other
    type(error_type), allocatable :: error
    integer :: at

    others = ''
    reason = engine%reason_unsupported(table)
    if (reason == '') return
    reason = 'cannot simulate this table: '//reason
    do at = 1, size(engines)
      call new_engine(trim(engine_names(at)), other, error)
      other%time_step = engine%time_step
      if (other%reason_unsupported(table) == '') others = others//', '''//trim(engine_names(at)) &
        //''''
    end do
    others = others(min(3, len(others) + 1):)
    if (others == '') others = 'another table: no engine can'
  end subroutine explain_refusal

end module battery_engines
