!> Access by name to the quantities that observers have measured, for tests.
module measurements
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use battery_kinds, only: wp
  use battery_observer, only: observer_type, get_measured
  use battery_quantities, only: measured_type, new_measured, real_quantities, place_of
  implicit none (type, external)
  private
  public :: seen_by, average, error, flows, known

contains

  !> All that an observer has measured so far.
  pure function seen_by(observer) result(averages)
    type(observer_type), intent(in) :: observer
    type(measured_type) :: averages

    averages = new_measured()
    call get_measured(observer, averages)
  end function seen_by

  !> The average of a quantity.
  pure function average(averages, name)
    type(measured_type), intent(in) :: averages
    character(len=*), intent(in) :: name
    real(wp) :: average

    average = real(averages%average(place_of(name, real_quantities())), wp)
  end function average

  !> The error of a quantity.
  pure function error(averages, name)
    type(measured_type), intent(in) :: averages
    character(len=*), intent(in) :: name
    real(wp) :: error

    error = real(averages%error(place_of(name, real_quantities())), wp)
  end function error

  !> The four flows: channel 1 from urn 1 to urn 2 and back, channel 2 likewise.
  pure function flows(averages)
    type(measured_type), intent(in) :: averages
    real(wp) :: flows(4)

    flows = [average(averages, 'flow1_12'), average(averages, 'flow1_21'), &
      average(averages, 'flow2_12'), average(averages, 'flow2_21')]
  end function flows

  !> Whether a number is not NaN.
  pure function known(number)
    real(wp), intent(in) :: number
    logical :: known

    known = .not. ieee_is_nan(number)
  end function known

end module measurements
