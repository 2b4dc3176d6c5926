!> The values of settings, as what uses them has them.
module battery_taking
  use battery_kinds, only: wp, int64
  use battery_settings, only: settings_type, find_setting
  implicit none (type, external)
  private
  public :: take, take_list

  !> Takes the `value` of a key, which stays as it was where there is none; `group` and `name` are
  !> in small letters. Of two numbers, one that is given counts for both.
  interface take
    module procedure :: take_integer, take_long, take_integers, take_real, take_reals, &
      take_text, take_logical
  end interface take

contains

  pure subroutine take_long(settings, group, name, value)
    type(settings_type), intent(in) :: settings
    character(len=*), intent(in) :: group, name
    integer(int64), intent(inout) :: value

    associate (setting => settings%all(find_setting(settings, group, name)))
      if (setting%known) value = setting%integers(1)
    end associate
  end subroutine take_long

  pure subroutine take_integer(settings, group, name, value)
    type(settings_type), intent(in) :: settings
    character(len=*), intent(in) :: group, name
    integer, intent(inout) :: value
    integer(int64) :: long

    long = value
    call take_long(settings, group, name, long)
    value = int(long)
  end subroutine take_integer

  pure subroutine take_integers(settings, group, name, value)
    type(settings_type), intent(in) :: settings
    character(len=*), intent(in) :: group, name
    integer, intent(inout) :: value(2)

    associate (setting => settings%all(find_setting(settings, group, name)))
      if (setting%known) value = int([setting%integers(1), &
        setting%integers(size(setting%integers))])
    end associate
  end subroutine take_integers

  pure subroutine take_real(settings, group, name, value)
    type(settings_type), intent(in) :: settings
    character(len=*), intent(in) :: group, name
    real(wp), intent(inout) :: value

    associate (setting => settings%all(find_setting(settings, group, name)))
      if (setting%known) value = setting%reals(1)
    end associate
  end subroutine take_real

  pure subroutine take_reals(settings, group, name, value)
    type(settings_type), intent(in) :: settings
    character(len=*), intent(in) :: group, name
    real(wp), intent(inout) :: value(2)

    associate (setting => settings%all(find_setting(settings, group, name)))
      if (setting%known) value = [setting%reals(1), setting%reals(size(setting%reals))]
    end associate
  end subroutine take_reals

  !> Takes all values of a key of numbers, `name` in its `group`, as `value`.
  pure subroutine take_list(settings, group, name, value)
    type(settings_type), intent(in) :: settings
    character(len=*), intent(in) :: group, name
    real(wp), allocatable, intent(inout) :: value(:)

    value = settings%all(find_setting(settings, group, name))%reals
  end subroutine take_list

  pure subroutine take_text(settings, group, name, value)
    type(settings_type), intent(in) :: settings
    character(len=*), intent(in) :: group, name
    character(len=:), allocatable, intent(inout) :: value

    value = settings%all(find_setting(settings, group, name))%text
  end subroutine take_text

  pure subroutine take_logical(settings, group, name, value)
    type(settings_type), intent(in) :: settings
    character(len=*), intent(in) :: group, name
    logical, intent(inout) :: value

    value = settings%all(find_setting(settings, group, name))%flag
  end subroutine take_logical

end module battery_taking
