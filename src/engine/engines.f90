!> The engines by the names they have in the namelist.
module battery_engines
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_engine, only: engine_type
  use battery_excursion, only: excursion_type
  use battery_collision, only: collision_type
  use battery_synchronous, only: synchronous_type
  use battery_timestep, only: timestep_type
  use battery_reservoir, only: reservoir_type
  implicit none (type, external)
  private
  public :: new_engine

contains

  !> The engine called `name`, not yet started.
  subroutine new_engine(name, engine, error)
    character(len=*), intent(in) :: name
    class(engine_type), allocatable, intent(out) :: engine
    type(error_type), allocatable, intent(out) :: error

    select case (name)
    case ('excursion')
      allocate (excursion_type :: engine)
    case ('collision')
      allocate (collision_type :: engine)
    case ('synchronous')
      allocate (synchronous_type :: engine)
    case ('timestep')
      allocate (timestep_type :: engine)
    case ('reservoir')
      allocate (reservoir_type :: engine)
    case default
      call fatal_error(error, 'engine '''//name//''' is not known', exit_bad_input)
    end select
  end subroutine new_engine

end module battery_engines
