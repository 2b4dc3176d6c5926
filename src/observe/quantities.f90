!> The quantities that a run measures, each declared once by name, unit and meaning.
!>
!> A new quantity needs its line here and the line that sets it (`set_average` or `set_count`).
!> Records, results files and the summary are written from these lists. Lengths are in the unit of
!> the namelist, times in lengths over the speed.
module battery_quantities
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  use battery_kinds, only: dp, int64
  use battery_fingerprint, only: fingerprint_start, fingerprint_of, mix_word
  implicit none (type, external)
  private
  public :: quantity_type, real_quantities, integer_quantities, place_of
  public :: measured_type, new_measured, set_average, set_count
  public :: fingerprint_of_quantities, flow_names, unknown_real, unknown_count

  !> A measured quantity. Texts have a fixed length: gfortran 12 leaks memory from lists with
  !> allocatable texts, and the lists are made for each task.
  type :: quantity_type
    character(len=24) :: name = ''
    character(len=40) :: unit = ''
    character(len=80) :: meaning = ''
    !> Whether its standard error is computed from the run (`error_of` of `battery_observer`).
    logical :: has_error = .false.
  end type quantity_type

  !> The values of one run, in the order of the lists.
  type :: measured_type
    real(dp), allocatable :: average(:), error(:)
    integer(int64), allocatable :: counted(:)
  end type measured_type

  !> Names of the flows, in the order of crossings (`battery_event_record`).
  character(len=*), parameter :: flow_names(4) = ['flow1_12', 'flow1_21', 'flow2_12', 'flow2_21']

  !> Unit of the time of day.
  character(len=*), parameter :: since_1970 = 'seconds since 1970-01-01T00:00:00Z'

  !> Stands for an unknown count.
  integer(int64), parameter :: unknown_count = -1

contains

  !> All real quantities.
  pure function real_quantities() result(list)
    type(quantity_type), allocatable :: list(:)

    list = [ &
      quantity_type('chi', '1', 'mass spread |N1 - N2|/N, time average', has_error=.true.), &
      quantity_type('chi_collision', '1', &
      'mass spread, average over the states after each wall collision'), &
      quantity_type('current1', '1/time', 'net current of channel 1 from urn 1 to urn 2', &
      has_error=.true.), &
      quantity_type('current2', '1/time', 'net current of channel 2 from urn 1 to urn 2', &
      has_error=.true.), &
      quantity_type('polarised_current', '1/time', &
      'current of channel 2 from the fuller half to the emptier', has_error=.true.), &
      quantity_type('flow1_12', '1/time', &
      'crossings per unit time of the middle line of channel 1 from urn 1 to urn 2'), &
      quantity_type('flow1_21', '1/time', &
      'crossings per unit time of the middle line of channel 1 from urn 2 to urn 1'), &
      quantity_type('flow2_12', '1/time', &
      'crossings per unit time of the periodic line of channel 2 from urn 1 to urn 2'), &
      quantity_type('flow2_21', '1/time', &
      'crossings per unit time of the periodic line of channel 2 from urn 2 to urn 1'), &
      quantity_type('time', 'time', 'time of the run, the transient included'), &
      quantity_type('transient_time', 'time', 'length of the transient; averages omit it'), &
      quantity_type('cpu_seconds', 's', 'processor time'), &
      quantity_type('provenance/begun', since_1970, 'when the task began or was last resumed'), &
      quantity_type('provenance/ended', since_1970, 'when the task ended')]
  end function real_quantities

  !> All integer quantities.
  pure function integer_quantities() result(list)
    type(quantity_type), allocatable :: list(:)

    list = [ &
      quantity_type('collisions', '1', 'wall collisions, those of the transient included'), &
      quantity_type('bounce_backs', '1', &
      'particles reversed by gates, those of the transient included'), &
      quantity_type('reversals', '1', 'reversals of gates, those of the transient included'), &
      quantity_type('trapped', '1', 'particles that never leave their urn or channel'), &
      quantity_type('provenance/host', '1', 'line of the attribute hosts of /provenance, from 0')]
  end function integer_quantities

  !> Index of a quantity in a list; 0 if the list does not have it.
  pure function place_of(name, list) result(place)
    !> As in results files.
    character(len=*), intent(in) :: name
    !> `real_quantities()` or `integer_quantities()`.
    type(quantity_type), intent(in) :: list(:)
    integer :: place

    do place = size(list), 1, -1
      if (list(place)%name == name) return
    end do
  end function place_of

  !> Values of a run, all unknown.
  pure function new_measured() result(measured)
    type(measured_type) :: measured

    allocate (measured%average(size(real_quantities())), source=unknown_real())
    allocate (measured%error(size(measured%average)), source=unknown_real())
    allocate (measured%counted(size(integer_quantities())), source=unknown_count)
  end function new_measured

  !> Sets an average.
  pure subroutine set_average(measured, name, value, error)
    type(measured_type), intent(inout) :: measured
    !> Name in the list of real quantities.
    character(len=*), intent(in) :: name
    !> In the unit of the quantity; NaN if unknown.
    real(dp), intent(in) :: value
    !> Standard error of the average; NaN if unknown.
    real(dp), intent(in), optional :: error
    integer :: place

    place = place_of(name, real_quantities())
    if (place == 0) error stop 'a quantity is measured that is not declared'
    measured%average(place) = value
    if (present(error)) measured%error(place) = error
  end subroutine set_average

  !> Sets a count.
  pure subroutine set_count(measured, name, count)
    type(measured_type), intent(inout) :: measured
    !> Name in the list of integer quantities.
    character(len=*), intent(in) :: name
    !> The count.
    integer(int64), intent(in) :: count
    integer :: place

    place = place_of(name, integer_quantities())
    if (place == 0) error stop 'a quantity is counted that is not declared'
    measured%counted(place) = count
  end subroutine set_count

  !> Fingerprint of the names in their order, and of the version of their meaning: values stored
  !> with another fingerprint belong to other lists.
  pure function fingerprint_of_quantities() result(fingerprint)
    integer(int64) :: fingerprint
    !> Incremented when a quantity or its error changes under the same name.
    integer(int64), parameter :: meaning = 2
    type(quantity_type), allocatable :: list(:)
    integer :: k

    fingerprint = fingerprint_start
    call mix_word(fingerprint, meaning)
    list = [real_quantities(), integer_quantities()]
    do k = 1, size(list)
      call mix_word(fingerprint, fingerprint_of(trim(list(k)%name)))
    end do
  end function fingerprint_of_quantities

  !> NaN, which stands for an unknown real.
  pure function unknown_real() result(value)
    real(dp) :: value

    value = ieee_value(value, ieee_quiet_nan)
  end function unknown_real

end module battery_quantities
