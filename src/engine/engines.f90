!> The engines by the names they have in the namelist.
module battery_engines
  use battery_kinds, only: wp, int64
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_engine, only: engine_type
  use battery_excursion, only: excursion_type
  use battery_collision, only: collision_type
  implicit none (type, external)
  private
  public :: new_engine

contains

  !> The engine called `name`; `time_step` and `seed` matter to those that have them.
  subroutine new_engine(name, time_step, seed, engine, error)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: time_step
    integer(int64), intent(in) :: seed
    class(engine_type), allocatable, intent(out) :: engine
    type(error_type), allocatable, intent(out) :: error

    select case (name)
    case ('excursion')
      allocate (excursion_type :: engine)
    case ('collision')
      allocate (collision_type :: engine)
    case default
      call fatal_error(error, 'engine '''//name//''' is not there yet', exit_bad_input)
    end select
  end subroutine new_engine

end module battery_engines
