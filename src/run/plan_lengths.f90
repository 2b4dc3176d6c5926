!> How the lengths and times of a plan fit together.
submodule (battery_plan) battery_plan_lengths
  use battery_bounds, only: bounds_type, radius_bounds, length_bounds, width_bounds, time_bounds, &
    clock_bounds, complaint
  implicit none (type, external)
contains

  !> Openings must fit into the urn, and no length may be lost beside another.
  module subroutine check_widths(plan, problems)
    type(plan_type), intent(in) :: plan
    type(problem_type), allocatable, intent(inout) :: problems(:)
    type(bounds_type) :: width
    integer :: at, before

    do at = 1, size(plan%scan_urn1_fraction)
      if (plan%scan_urn1_fraction(at) > 1.0_wp) call add(problems, 'scan', 'urn1_fraction', &
        to_text(plan%scan_urn1_fraction(at)), 'numbers from 0 to 1')
    end do
    before = size(problems)
    call check_range('table', 'urn_radius', plan%urn_radius, radius_bounds(), problems)
    if (complaint(plan%urn_radius, radius_bounds()) /= '') return
    call check_range('table', 'channel1_length', plan%channel1_length, &
      length_bounds(plan%urn_radius, open_length2(plan)), problems)
    if (open_length2(plan) > 0.0_wp) call check_range('table', 'channel2_length', &
      plan%channel2_length, length_bounds(plan%urn_radius, plan%channel1_length), problems)
    ! Beside a length that is not allowed, no other makes sense.
    if (size(problems) > before) return
    width = width_bounds(plan%urn_radius, longest_length(plan))
    if (size(plan%scan_channel1_width) == 0) call check('table', 'channel1_width', &
      plan%channel1_width)
    if (size(plan%scan_channel2_width) == 0 .and. plan%shape /= 'urn') call check('table', &
      'channel2_width', plan%channel2_width)
    call check_list('channel1_width', plan%scan_channel1_width)
    call check_list('channel2_width', plan%scan_channel2_width)

  contains

    !> The first value of a list that does not fit.
    subroutine check_list(key, list)
      character(len=*), intent(in) :: key
      real(wp), intent(in) :: list(:)
      integer :: before

      before = size(problems)
      do at = 1, size(list)
        call check('scan', key, list(at))
        if (size(problems) > before) exit
      end do
    end subroutine check_list

    subroutine check(group, key, value)
      character(len=*), intent(in) :: group, key
      real(wp), intent(in) :: value

      if (value >= 2.0_wp*plan%urn_radius) then
        call add(problems, group, key, to_text(value), 'below 2 urn_radius, which is ' &
          //to_text(2.0_wp*plan%urn_radius))
      else if (value > 0.0_wp) then
        call check_range(group, key, value, width, problems)
      end if
    end subroutine check

  end subroutine check_widths

  !> The clock must resolve the table, and the table the times.
  pure module subroutine check_times(plan, problems)
    type(plan_type), intent(in) :: plan
    type(problem_type), allocatable, intent(inout) :: problems(:)
    type(bounds_type) :: bounds

    if (complaint(plan%urn_radius, radius_bounds()) /= '') return
    bounds = time_bounds(plan%urn_radius, longest_length(plan))
    if (plan%duration > 0.0_wp) call check_range('run', 'duration', plan%duration, bounds, problems)
    if (plan%time_step > 0.0_wp) call check_range('run', 'time_step', plan%time_step, bounds, &
      problems)
    if (plan%series_interval > 0.0_wp) call check_range('output', 'series_interval', &
      plan%series_interval, bounds, problems)
    bounds = clock_bounds(plan%urn_radius)
    call check_range('run', 'start_time', plan%start_time, bounds, problems)
    if (size(plan%snapshot_times) > 0) call check_range('output', 'snapshot_times', &
      maxval(plan%snapshot_times), bounds, problems)
  end subroutine check_times

  !> A value within its bounds.
  pure subroutine check_range(group, key, value, bounds, problems)
    character(len=*), intent(in) :: group, key
    real(wp), intent(in) :: value
    type(bounds_type), intent(in) :: bounds
    type(problem_type), allocatable, intent(inout) :: problems(:)

    if (complaint(value, bounds) /= '') call add(problems, group, key, to_text(value), &
      complaint(value, bounds))
  end subroutine check_range

  !> Length of channel 2, or 0 if it is closed at all points.
  pure function open_length2(plan) result(length)
    type(plan_type), intent(in) :: plan
    real(wp) :: length
    logical :: open

    open = plan%channel2_width > 0.0_wp
    if (size(plan%scan_channel2_width) > 0) open = maxval(plan%scan_channel2_width) > 0.0_wp
    length = merge(plan%channel2_length, 0.0_wp, open .and. plan%shape /= 'urn')
  end function open_length2

  !> The longest of radius and lengths of channels; openings are narrower than the diameter.
  pure function longest_length(plan) result(length)
    type(plan_type), intent(in) :: plan
    real(wp) :: length

    length = max(plan%urn_radius, plan%channel1_length, open_length2(plan))
  end function longest_length

  !> One more problem.
  pure module subroutine add(problems, group, key, value, allowed)
    type(problem_type), allocatable, intent(inout) :: problems(:)
    character(len=*), intent(in) :: group, key, value, allowed

    problems = [problems, problem_type(group, key, value, allowed)]
  end subroutine add

end submodule battery_plan_lengths
