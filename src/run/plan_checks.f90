!> How the parts of a plan fit together.
submodule (battery_plan) battery_plan_checks
  use battery_text, only: to_text
  use battery_error, only: error_type
  use battery_engine, only: engine_type
  use battery_engines, only: new_engine, has_step, refusal
  use battery_identity, only: twelve_digits
  use battery_bounds, only: bounds_type, radius_bounds, length_bounds, width_bounds, time_bounds, &
    clock_bounds, complaint, whole_of, can_count_hits
  implicit none (type, external)

contains

  module procedure complete_plan
    class(engine_type), allocatable :: engine
    type(error_type), allocatable :: error
    integer :: at

    allocate (problems(0))
    if (plan%transient_collisions < 0) plan%transient_collisions = plan%collisions/2
    call check_given(plan, problems)
    call check_length(plan, problems)
    call check_output(plan, problems)
    plan%point_count = 0
    if (task_total(plan) > most_tasks) then
      call add(problems, 'scan', 'replicas', to_text(task_total(plan))//' tasks in all', &
        'up to '//to_text(most_tasks)//' points times replicas')
    else
      plan%point_count = int(task_total(plan)/plan%replicas)
      call check_repeats(plan, problems)
      call new_engine(plan%engine, engine, error)
      if (allocated(engine)) engine%time_step = plan%time_step
      do at = 1, plan%point_count
        call check_point(plan, point_of(plan, at), problems)
        if (size(problems) == 0) call check_engine(plan, engine, point_of(plan, at), problems)
        if (size(problems) > 0) exit
      end do
    end if
    if (size(problems) > 0) plan%point_count = 0
  end procedure complete_plan

  !> What must be given, and what must not be given twice.
  subroutine check_given(plan, problems)
    type(plan_type), intent(in) :: plan
    type(problem_type), allocatable, intent(inout) :: problems(:)
    logical :: as_number, as_fraction

    associate (base => plan%base)
      if (base%number == not_given .and. .not. is_scanned(plan, 'number')) &
        call add(problems, 'particles', 'number', 'is missing', 'one whole number from 1 up')
      as_number = base%threshold(1) /= not_given .or. is_scanned(plan, 'threshold')
      as_fraction = base%threshold_fraction(1) >= 0.0_wp .or. is_scanned(plan, 'threshold_fraction')
      if (.not. (as_number .or. as_fraction)) &
        call add(problems, 'gate', 'threshold', 'is missing', &
        'one whole number or two from 0 up, or threshold_fraction, or a list of either in &scan')
      if (as_number .and. as_fraction) &
        call add(problems, merge('gate', 'scan', base%threshold_fraction(1) >= 0.0_wp), &
        'threshold_fraction', 'is given beside threshold', 'one of the two')
      if (base%urn1_number /= not_given .and. (base%urn1_fraction >= 0.0_wp &
        .or. is_scanned(plan, 'urn1_fraction'))) call add(problems, 'particles', 'urn1_number', &
        'is given beside urn1_fraction', 'one of the two')
    end associate
    if (plan%shape == 'urn') then
      call refuse_scan('channel2_width', 'the shape ''urn'' has no channel 2')
      call refuse_scan('channel2_length', 'the shape ''urn'' has no channel 2')
      call refuse_scan('urn1_fraction', 'the shape ''urn'' has one urn')
    end if
    if (plan%initial_file /= '') then
      call refuse_scan('urn1_fraction', '&particles initial_file is given')
      if (values_of(plan, 'number') > 1) call add(problems, 'scan', 'number', &
        to_text(values_of(plan, 'number'))//' numbers', &
        'one, since &particles initial_file is given')
    end if

  contains

    subroutine refuse_scan(key, reason)
      character(len=*), intent(in) :: key, reason

      if (is_scanned(plan, key)) call add(problems, 'scan', key, 'is scanned', 'nothing, since ' &
        //reason)
    end subroutine refuse_scan

  end subroutine check_given

  !> How many values of a key are scanned; 0: it is not.
  pure function values_of(plan, key) result(count)
    type(plan_type), intent(in) :: plan
    character(len=*), intent(in) :: key
    integer :: count
    integer :: at

    count = 0
    do at = 1, size(plan%scanned)
      if (plan%scanned(at)%key == key) count = size(plan%scanned(at)%values)
    end do
  end function values_of

  !> The run is longer than its transient, and its engine has a step if it needs one.
  pure subroutine check_length(plan, problems)
    type(plan_type), intent(in) :: plan
    type(problem_type), allocatable, intent(inout) :: problems(:)

    if (plan%duration > 0.0_wp) then
      if (plan%transient_duration > whole_of(plan%duration)) &
        call add(problems, 'run', 'transient_duration', to_text(plan%transient_duration), &
        'below duration, which is '//to_text(plan%duration))
    else
      if (plan%transient_duration > 0.0_wp) &
        call add(problems, 'run', 'transient_duration', to_text(plan%transient_duration), &
        '0, unless duration is given')
      ! None are known where their number was refused.
      if (plan%collisions > 0 .and. plan%transient_collisions >= plan%collisions) &
        call add(problems, 'run', 'transient_collisions', to_text(plan%transient_collisions), &
        'below collisions, which is '//to_text(plan%collisions))
    end if
    if (has_step(plan%engine) .and. .not. plan%time_step > 0.0_wp) &
      call add(problems, 'run', 'time_step', 'is missing', &
      'one number above 0, since the engine is '''//plan%engine//'''')
  end subroutine check_length

  pure subroutine check_output(plan, problems)
    type(plan_type), intent(in) :: plan
    type(problem_type), allocatable, intent(inout) :: problems(:)
    integer :: at

    if (plan%file == '') call add(problems, 'output', 'file', '''''', 'the name of a file')
    associate (times => plan%snapshot_times)
      do at = 2, size(times)
        if (times(at) > times(at - 1)) cycle
        call add(problems, 'output', 'snapshot_times', to_text(times(at)), &
          'times that grow; the one before is '//to_text(times(at - 1)))
        exit
      end do
      if (plan%duration > 0.0_wp .and. any(times > plan%duration)) call add(problems, 'output', &
        'snapshot_times', to_text(maxval(times)), 'up to &run duration, which is ' &
        //to_text(plan%duration))
    end associate
    if (plan%event_log .and. task_total(plan) /= 1_int64) &
      call add(problems, 'output', 'event_log', '.true.', &
      '.false., since the scan has '//to_text(task_total(plan))//' tasks')
  end subroutine check_output

  !> Points times replicas; beyond `most_tasks`, some larger number.
  pure function task_total(plan) result(total)
    type(plan_type), intent(in) :: plan
    integer(int64) :: total
    integer :: at

    total = plan%replicas
    do at = 1, size(plan%scanned)
      if (total <= most_tasks) total = total*size(plan%scanned(at)%values)
    end do
  end function task_total

  !> No point may be there twice: the same task would be done twice. Whole numbers that come from
  !> shares count as the numbers.
  subroutine check_repeats(plan, problems)
    type(plan_type), intent(in) :: plan
    type(problem_type), allocatable, intent(inout) :: problems(:)
    real(wp), allocatable :: values(:), numbers(:)
    integer :: at, k, again

    numbers = [real(plan%base%number, wp)]
    if (plan%base%number == not_given) numbers = [real(wp) ::]
    do at = 1, size(plan%scanned)
      if (plan%scanned(at)%key == 'number') numbers = plan%scanned(at)%values
    end do
    do at = 1, size(plan%scanned)
      values = plan%scanned(at)%values
      again = first_repeat(values)
      if (index(plan%scanned(at)%key, '_fraction') > 0 .and. again == 0) then
        do k = 1, size(numbers)
          again = first_repeat(real(rounded(values*numbers(k)), wp))
          if (again > 0) exit
        end do
      end if
      ! A channel that is closed has no length.
      if (plan%scanned(at)%key == 'channel2_length' .and. size(values) > 1 .and. &
        may_be_closed(plan)) again = 2
      if (again > 0) call add(problems, 'scan', plan%scanned(at)%key, to_text(values(again)), &
        'every point once; this value makes one that is there already')
    end do
  end subroutine check_repeats

  !> Whether channel 2 is closed at some point.
  pure function may_be_closed(plan) result(closed)
    type(plan_type), intent(in) :: plan
    logical :: closed
    integer :: at

    closed = .not. plan%base%channel(ungated)%width > 0.0_wp
    do at = 1, size(plan%scanned)
      if (plan%scanned(at)%key == 'channel2_width') &
        closed = any(.not. plan%scanned(at)%values > 0.0_wp)
    end do
  end function may_be_closed

  !> Place of the first value that stands in a list before; 0 if there is none. Numbers are equal
  !> where those of tasks are (`battery_identity`).
  function first_repeat(values) result(place)
    real(wp), intent(in) :: values(:)
    integer :: place
    real(wp) :: known(size(values))
    integer :: order(size(values)), k

    known = twelve_digits(values)
    call sort(known, order)
    place = huge(1)
    do k = 2, size(order)
      if (known(order(k)) <= known(order(k - 1))) place = min(place, max(order(k), order(k - 1)))
    end do
    if (place == huge(1)) place = 0
  end function first_repeat

  !> The order in which values grow (a heap sort: a list may have 1e5).
  subroutine sort(values, order)
    real(wp), intent(in) :: values(:)
    integer, intent(out) :: order(size(values))
    integer :: last, at, moved

    order = [(at, at=1, size(values))]
    do at = size(values)/2, 1, -1
      call sift(at, size(values))
    end do
    do last = size(values), 2, -1
      moved = order(1)
      order(1) = order(last)
      order(last) = moved
      call sift(1, last - 1)
    end do

  contains

    subroutine sift(top, last)
      integer, intent(in) :: top, last
      integer :: at, child, kept

      at = top
      kept = order(at)
      do while (2*at <= last)
        child = 2*at
        if (child < last) then
          if (values(order(child + 1)) > values(order(child))) child = child + 1
        end if
        if (values(order(child)) <= values(kept)) exit
        order(at) = order(child)
        at = child
      end do
      order(at) = kept
    end subroutine sift

  end subroutine sort

  !> What is wrong with one point: lengths, times, numbers of particles.
  subroutine check_point(plan, point, problems)
    type(plan_type), intent(in) :: plan
    type(point_type), intent(in) :: point
    type(problem_type), allocatable, intent(inout) :: problems(:)
    integer :: before

    before = size(problems)
    call check_lengths(plan, point, problems)
    if (size(problems) == before) call check_times(plan, point, problems)
    if (point%urn1_fraction > 1.0_wp) call add(problems, group_of(plan, 'particles', &
      'urn1_fraction'), 'urn1_fraction', to_text(point%urn1_fraction), 'numbers from 0 to 1')
    if (point%number == not_given .or. size(problems) > before) return
    if (point%urn1_number > point%number) then
      call add(problems, 'particles', 'urn1_number', to_text(point%urn1_number), &
        'from 0 to number, which is '//to_text(point%number))
    else if (plan%shape == 'urn' .and. point%urn1_number /= point%number) then
      call add(problems, 'particles', 'urn1_number', to_text(point%urn1_number), &
        to_text(point%number)//', all particles, since the shape ''urn'' has one urn')
    end if
    if (.not. can_count_hits(table_of(plan, point), point%number, plan%duration)) &
      call add(problems, group_of(plan, 'particles', 'number'), 'number', to_text(point%number), &
      'fewer, or wider openings: such visits have more wall collisions than can be counted')
  end subroutine check_point

  !> Whether the engine can simulate the table of a point.
  subroutine check_engine(plan, engine, point, problems)
    type(plan_type), intent(in) :: plan
    class(engine_type), intent(in) :: engine
    type(point_type), intent(in) :: point
    type(problem_type), allocatable, intent(inout) :: problems(:)
    character(len=:), allocatable :: reason, others

    call refusal(engine, table_of(plan, point), reason, others)
    if (reason /= '') call add(problems, 'run', 'engine', ''''//plan%engine//''' '//reason, others)
  end subroutine check_engine

  !> The group in which a key has the value that counts.
  pure function group_of(plan, group, key) result(name)
    type(plan_type), intent(in) :: plan
    !> The key's own group.
    character(len=*), intent(in) :: group, key
    character(len=:), allocatable :: name

    name = group
    if (is_scanned(plan, key)) name = 'scan'
  end function group_of

  !> Openings must fit into the urns, and no length may be lost beside another.
  subroutine check_lengths(plan, point, problems)
    type(plan_type), intent(in) :: plan
    type(point_type), intent(in) :: point
    type(problem_type), allocatable, intent(inout) :: problems(:)
    real(wp) :: radii(2)
    integer :: before, urns

    before = size(problems)
    urns = merge(1, 2, plan%shape == 'urn')
    radii = [minval(point%urn_radius(:urns)), maxval(point%urn_radius(:urns))]
    call check_range(plan, 'table', 'urn_radius', radii(1), radius_bounds(), problems)
    if (size(problems) > before) return
    call check_range(plan, 'table', 'urn_radius', radii(2), length_bounds(radii(1), &
      longest_channel(point)), problems)
    call check_range(plan, 'table', 'channel1_length', point%channel(gated)%length, &
      length_bounds(radii(1), open_length(point)), problems)
    if (open_length(point) > 0.0_wp) call check_range(plan, 'table', 'channel2_length', &
      point%channel(ungated)%length, length_bounds(radii(1), point%channel(gated)%length), problems)
    ! Beside a length that is not allowed, no other makes sense.
    if (size(problems) > before) return
    call check_width('channel1_width', point%channel(gated)%width)
    call check_width('channel2_width', point%channel(ungated)%width)

  contains

    subroutine check_width(key, width)
      character(len=*), intent(in) :: key
      real(wp), intent(in) :: width

      if (width >= 2.0_wp*radii(1)) then
        call add(problems, group_of(plan, 'table', key), key, to_text(width), &
          'below 2 urn_radius, which is '//to_text(2.0_wp*radii(1)))
      else if (width > 0.0_wp) then
        call check_range(plan, 'table', key, width, width_bounds(radii(1), max(radii(2), &
          longest_channel(point))), problems)
      end if
    end subroutine check_width

  end subroutine check_lengths

  !> The clock must resolve the table, and the table the times.
  pure subroutine check_times(plan, point, problems)
    type(plan_type), intent(in) :: plan
    type(point_type), intent(in) :: point
    type(problem_type), allocatable, intent(inout) :: problems(:)
    type(bounds_type) :: bounds
    real(wp) :: radius
    integer :: urns

    urns = merge(1, 2, plan%shape == 'urn')
    radius = minval(point%urn_radius(:urns))
    bounds = time_bounds(radius, max(maxval(point%urn_radius(:urns)), longest_channel(point)))
    if (plan%duration > 0.0_wp) call check_range(plan, 'run', 'duration', plan%duration, bounds, &
      problems)
    if (plan%series_interval > 0.0_wp) call check_range(plan, 'output', 'series_interval', &
      plan%series_interval, bounds, problems)
    if (plan%time_step > 0.0_wp) call check_range(plan, 'run', 'time_step', plan%time_step, &
      bounds, problems)
    bounds = clock_bounds(radius)
    call check_range(plan, 'run', 'start_time', plan%start_time, bounds, problems)
    if (size(plan%snapshot_times) > 0) call check_range(plan, 'output', 'snapshot_times', &
      maxval(plan%snapshot_times), bounds, problems)
  end subroutine check_times

  !> A value within its bounds.
  pure subroutine check_range(plan, group, key, value, bounds, problems)
    type(plan_type), intent(in) :: plan
    character(len=*), intent(in) :: group, key
    real(wp), intent(in) :: value
    type(bounds_type), intent(in) :: bounds
    type(problem_type), allocatable, intent(inout) :: problems(:)

    if (complaint(value, bounds) /= '') call add(problems, group_of(plan, group, key), key, &
      to_text(value), complaint(value, bounds))
  end subroutine check_range

  !> Length of channel 2, or 0 if it is closed.
  pure function open_length(point) result(length)
    type(point_type), intent(in) :: point
    real(wp) :: length

    length = merge(point%channel(ungated)%length, 0.0_wp, point%channel(ungated)%width > 0.0_wp)
  end function open_length

  !> The longer of the open channels.
  pure function longest_channel(point) result(length)
    type(point_type), intent(in) :: point
    real(wp) :: length

    length = max(point%channel(gated)%length, open_length(point))
  end function longest_channel

  !> One more problem.
  pure subroutine add(problems, group, key, value, allowed)
    type(problem_type), allocatable, intent(inout) :: problems(:)
    character(len=*), intent(in) :: group, key, value, allowed

    problems = [problems, problem_type(group, key, value, allowed)]
  end subroutine add

end submodule battery_plan_checks
