!> Checks that the parts of a plan fit together.
module battery_plan_checks
  use, intrinsic :: iso_c_binding, only: c_size_t
  use battery_kinds, only: wp, dp, int64
  use battery_error, only: error_type
  use battery_engine, only: engine_type
  use battery_engines, only: new_engine, has_step, explain_refusal
  use battery_keys, only: key_threshold, key_threshold_fraction, key_number, key_width, &
    key_length, key_radius, key_urn1_fraction
  use battery_plan, only: plan_type, point_type, refuse_value, refuse_key, is_scanned, values_of, &
    point_of, table_of, rounded, not_given
  use battery_scatterer_checks, only: check_scatterers
  use battery_settings, only: is_given, is_refused
  use battery_table, only: channel1, channel2, is_open, longest_run
  use battery_text, only: to_text
  use battery_gsl, only: sort_order
  use battery_identity, only: twelve_digits
  use battery_findings, only: finding_type, add_point_findings, of_missing
  use battery_outline_checks, only: check_outlines, check_outline_at, has_outline, &
    has_valid_outlines
  use battery_bounds, only: can_count_hits, finest, greatest_radius
  implicit none (type, external)
  private
  public :: complete_plan, are_lengths_known

  !> Largest number of tasks: points times replicas.
  integer(int64), parameter :: most_tasks = 10000000_int64

  !> Reasons for bounds of a value.
  integer, parameter :: of_powers = 1, of_lengths = 2, of_widths = 3, of_times = 4, of_clocks = 5

contains

  !> Fills in what follows from other keys, checks that the parts of a plan fit together, and counts
  !> the points. Adds all problems to the plan: of each list the first value that repeats a point; a
  !> problem of points of the scan once, with the number of points that have it.
  subroutine complete_plan(plan)
    type(plan_type), intent(inout) :: plan
    integer :: before

    before = size(plan%problems)
    if (plan%transient_collisions < 0) plan%transient_collisions = plan%collisions/2
    call check_given(plan)
    call check_outlines(plan)
    call check_length(plan)
    call check_output(plan)
    call check_precision(plan)
    plan%point_count = 0
    if (task_total(plan) > most_tasks) then
      call refuse_value(plan, trim(merge('largest_replicas', 'replicas        ', plan%replicas &
        > plan%first_replicas)), to_text(task_total(plan))//' tasks in all', 'up to ' &
        //to_text(most_tasks)//' points times replicas')
    else
      plan%point_count = int(task_total(plan)/plan%replicas)
      call check_repeats(plan)
      call check_points(plan)
    end if
    if (size(plan%problems) > before) plan%point_count = 0
  end subroutine complete_plan

  !> Checks that required keys are given, and no two keys that exclude each other: a run has one
  !> length, in collisions or in time; a limit of the replicas requires a precision.
  subroutine check_given(plan)
    type(plan_type), intent(inout) :: plan

    if (is_given(plan%settings, 'largest_replicas') .and. .not. (any(plan%precision > 0.0_wp) .or. &
      is_refused(plan%settings, 'chi_replica_error') .or. &
      is_refused(plan%settings, 'polarised_current_replica_error'))) &
      call refuse_key(plan, 'largest_replicas', 'is given without a precision', &
      'beside chi_replica_error or polarised_current_replica_error')
    if (plan%duration > 0.0_wp) then
      if (is_given(plan%settings, 'collisions')) call refuse_key(plan, 'collisions', &
        'is given beside duration', 'one of the two')
      if (is_given(plan%settings, 'transient_collisions')) call refuse_key(plan, &
        'transient_collisions', 'is given beside duration', 'transient_duration')
    end if
    associate (base => plan%base%of)
      if (.not. base(key_number)%known) call refuse_value(plan, 'number', 'is missing', &
        'one whole number from 1 up', of_missing)
      if (.not. any(base([key_threshold, key_threshold_fraction])%known)) call refuse_value(plan, &
        'threshold', 'is missing', 'one whole number or two from 0 up, or threshold_fraction, or ' &
        //'a list of either in &scan', of_missing)
      if ((base(key_threshold)%known .or. is_scanned(plan, 'threshold2')) .and. &
        base(key_threshold_fraction)%known) call refuse_key(plan, 'threshold_fraction', &
        'is given beside '//trim(merge('threshold ', 'threshold2', base(key_threshold)%known)), &
        'one of the two')
      if (plan%base%urn1_number /= not_given .and. base(key_urn1_fraction)%known) call refuse_key( &
        plan, 'urn1_number', 'is given beside urn1_fraction', 'one of the two')
    end associate
    if (plan%shape == 'urn') then
      call refuse_scan('channel2_width', 'the shape ''urn'' has no channel 2')
      call refuse_scan('channel2_length', 'the shape ''urn'' has no channel 2')
      call refuse_scan('urn1_fraction', 'the shape ''urn'' has one urn')
      call refuse_scan('urn_radius2', 'the shape ''urn'' has one urn')
      call refuse_scan('threshold2', 'the shape ''urn'' has one gate')
    end if
    if (plan%initial_file /= '') then
      call refuse_scan('urn1_fraction', '&particles initial_file is given')
      if (size(values_of(plan, 'number')) > 1) call refuse_value(plan, 'number', &
        to_text(size(values_of(plan, 'number')))//' numbers', &
        'one, since &particles initial_file is given')
    end if

  contains

    !> Adds a problem to the plan if `key` is scanned, which `reason` forbids.
    subroutine refuse_scan(key, reason)
      character(len=*), intent(in) :: key, reason

      if (is_scanned(plan, key)) call refuse_key(plan, key, 'is scanned', 'nothing, since ' &
        //reason)
    end subroutine refuse_scan

  end subroutine check_given

  !> Checks that the run is longer than its transient, and that a step is given if the engine needs
  !> one.
  pure subroutine check_length(plan)
    type(plan_type), intent(inout) :: plan

    if (plan%duration > 0.0_wp) then
      ! The measured time must be more than the rounding of the duration.
      if (plan%transient_duration > (1.0_wp - finest)*plan%duration) &
        call refuse_value(plan, 'transient_duration', to_text(plan%transient_duration), &
        'below duration, which is '//to_text(plan%duration))
    else
      ! A duration that was refused has no value here.
      if (plan%transient_duration > 0.0_wp .and. .not. is_refused(plan%settings, 'duration')) &
        call refuse_value(plan, 'transient_duration', to_text(plan%transient_duration), &
        '0, unless duration is given')
      ! Collisions are 0 here if their value was refused.
      if (plan%collisions > 0 .and. plan%transient_collisions >= plan%collisions) &
        call refuse_value(plan, 'transient_collisions', to_text(plan%transient_collisions), &
        'below collisions, which is '//to_text(plan%collisions))
    end if
    if (has_step(plan%engine) .and. .not. plan%time_step > 0.0_wp) &
      call refuse_value(plan, 'time_step', 'is missing', &
      'one number above 0, since the engine is '''//plan%engine//'''', of_missing)
  end subroutine check_length

  !> Checks that a required precision has enough first replicas to estimate their scatter.
  pure subroutine check_precision(plan)
    type(plan_type), intent(inout) :: plan
    integer, parameter :: fewest = 16
    character(len=*), parameter :: names(2) = [character(len=31) :: 'chi_replica_error', &
      'polarised_current_replica_error']
    character(len=*), parameter :: lacks(2) = ['has no chi      ', 'has no channel 2']
    integer :: at

    if (.not. any(plan%precision > 0.0_wp)) return
    if (plan%first_replicas < fewest) call refuse_value(plan, 'replicas', &
      to_text(plan%first_replicas), 'from '//to_text(fewest)//' up, since a precision is asked for')
    if (plan%replicas < plan%first_replicas) call refuse_value(plan, 'largest_replicas', &
      to_text(plan%replicas), 'from &scan replicas up, which is '//to_text(plan%first_replicas))
    if (plan%shape /= 'urn') return
    do at = 1, 2
      if (plan%precision(at) > 0.0_wp) call refuse_value(plan, trim(names(at)), &
        to_text(plan%precision(at)), 'nothing, since the shape ''urn'' '//trim(lacks(at)))
    end do
  end subroutine check_precision

  !> Checks the keys of &output; adds what is wrong to the problems of the plan.
  pure subroutine check_output(plan)
    type(plan_type), intent(inout) :: plan
    integer :: at

    associate (times => plan%snapshot_times)
      do at = 2, size(times)
        if (times(at) > times(at - 1)) cycle
        call refuse_value(plan, 'snapshot_times', to_text(times(at)), &
          'times that grow; the one before is '//to_text(times(at - 1)))
        exit
      end do
      if (plan%duration > 0.0_wp .and. any(times > plan%duration)) call refuse_value(plan, &
        'snapshot_times', to_text(maxval(times)), 'up to &run duration, which is ' &
        //to_text(plan%duration))
    end associate
    if (plan%event_log .and. task_total(plan) /= 1_int64) call refuse_value(plan, 'event_log', &
      '.true.', '.false., since the scan has '//to_text(task_total(plan))//' tasks')
  end subroutine check_output

  !> Number of points times replicas; beyond `most_tasks`, any larger number.
  pure integer(int64) function task_total(plan) result(total)
    type(plan_type), intent(in) :: plan
    integer :: at

    total = plan%replicas
    do at = 1, size(plan%scanned)
      if (total <= most_tasks .and. .not. plan%scanned(at)%is_paired) &
        total = total*size(plan%scanned(at)%values)
    end do
  end function task_total

  !> Checks that no point occurs twice: the same task would be run twice. Of fractions the integers
  !> that follow from them are compared.
  subroutine check_repeats(plan)
    type(plan_type), intent(inout) :: plan
    real(wp), allocatable :: values(:), numbers(:), widths(:)
    integer, allocatable :: rank(:)
    integer :: at, k, again

    numbers = values_of(plan, 'number')
    if (size(numbers) == 0 .and. plan%base%of(key_number)%known) &
      numbers = [real(plan%base%of(key_number)%whole(1), wp)]
    ! A closed channel has no length.
    widths = values_of(plan, 'channel2_width')
    if (size(widths) == 0) widths = plan%base%of(key_width(channel2))%real(:1)
    do at = 1, size(plan%scanned)
      if (plan%scanned(at)%is_paired) cycle
      values = plan%scanned(at)%values
      rank = ranks_of(values)
      ! The second values of pairs are those of the next key.
      if (plan%scanned(at)%last == 1) rank = ranks_of(real(rank, wp)*size(rank) &
        + ranks_of(plan%scanned(at + 1)%values))
      again = first_repeat(rank)
      if (index(plan%scanned(at)%key, '_fraction') > 0 .and. again == 0) then
        do k = 1, size(numbers)
          again = first_repeat(ranks_of(real(rounded(values*numbers(k)), wp)))
          if (again > 0) exit
        end do
      end if
      if (plan%scanned(at)%key == 'channel2_length' .and. size(values) > 1 .and. &
        any(.not. widths > 0.0_wp) .and. are_lengths_known(plan)) then
        call refuse_value(plan, plan%scanned(at)%key, to_text(values(2)), &
          'every point once; this value repeats a point where channel2_width = 0')
      else if (again > 0) then
        call refuse_value(plan, plan%scanned(at)%key, to_text(values(again)), &
          'every point once; this value repeats a point')
      end if
    end do
  end subroutine check_repeats

  !> Place of the first value, or pair of values, that repeats an earlier one; 0 if there is none.
  pure integer function first_repeat(rank) result(place)
    !> Ranks of the values, from `ranks_of`.
    integer, intent(in) :: rank(:)
    logical :: seen(size(rank))

    seen = .false.
    do place = 1, size(rank)
      if (seen(rank(place))) return
      seen(rank(place)) = .true.
    end do
    place = 0
  end function first_repeat

  !> Rank of each value among the different values in ascending order. Values are equal if they are
  !> to `battery_identity`.
  function ranks_of(values) result(rank)
    real(wp), intent(in) :: values(:)
    integer :: rank(size(values))
    real(wp) :: known(size(values))
    integer(c_size_t) :: order(size(values)), k

    known = twelve_digits(values)
    call sort_order(order, real(known, dp), 1_c_size_t, size(order, kind=c_size_t))
    order = order + 1
    if (size(order) > 0) rank(order(1)) = 1
    do k = 2, size(order)
      rank(order(k)) = rank(order(k - 1)) + merge(1, 0, known(order(k)) > known(order(k - 1)))
    end do
  end function ranks_of

  !> Whether no length was refused when it was parsed.
  pure logical function are_lengths_known(plan) result(known)
    type(plan_type), intent(in) :: plan
    integer :: k

    associate (all => plan%settings%all)
      known = .not. any(all%given .and. .not. all%known .and. &
        [(any(all(k)%key%place == [key_radius, key_width, key_length]), k=1, size(all))])
    end associate
  end function are_lengths_known

  !> Checks all points of the scan. Whether the engine can simulate a point is checked only if there
  !> is no other problem.
  subroutine check_points(plan)
    type(plan_type), intent(inout) :: plan
    type(finding_type), allocatable :: others(:)
    class(engine_type), allocatable :: engine
    type(error_type), allocatable :: error
    type(point_type) :: point
    character(len=:), allocatable :: reason, allowed
    logical :: table_known
    integer :: at

    call new_engine(plan%engine, engine, error)
    if (allocated(engine)) engine%time_step = plan%time_step
    table_known = has_valid_outlines(plan) .and. are_lengths_known(plan)
    call move_alloc(plan%problems, others)
    allocate (plan%problems(0), plan%of_points%list(0))
    do at = 1, plan%point_count
      point = point_of(plan, at)
      call check_point(plan, point, table_known)
      if (table_known .and. size(others) + size(plan%problems) == 0) then
        call explain_refusal(engine, table_of(plan, point), reason, allowed)
        if (reason /= '') &
          call refuse_value(plan, 'engine', ''''//plan%engine//''' '//reason, allowed)
        call check_scatterers(plan, point)
      end if
      if (size(plan%problems) == 0) cycle
      call add_point_findings(plan%of_points, plan%problems, at)
      deallocate (plan%problems)
      allocate (plan%problems(0))
    end do
    plan%checked_points = plan%point_count
    plan%problems = [others, plan%of_points%list]
  end subroutine check_points

  !> Checks one point: lengths, times, numbers of particles.
  subroutine check_point(plan, point, table_known)
    type(plan_type), intent(inout) :: plan
    type(point_type), intent(in) :: point
    !> Whether the outlines of its urns are valid, and no length was refused.
    logical, intent(in) :: table_known
    real(wp) :: radii(2), longest
    integer :: before

    before = size(plan%problems)
    radii = [minval(point%urn_radius), maxval(point%urn_radius)]
    if (plan%shape == 'urn') radii = point%urn_radius(1)
    longest = max(point%channel(channel1)%length, open_length(point))
    ! No length is judged beside one that is not known.
    if (table_known) call check_lengths(plan, point, radii)
    if (table_known .and. size(plan%problems) == before) call check_outline_at(plan, point)
    if (table_known .and. size(plan%problems) == before) call check_times(plan, radii(1), &
      max(radii(2), longest))
    if (point%number == 0 .or. size(plan%problems) > before .or. .not. table_known) return
    if (.not. plan%duration > 0.0_wp .and. plan%transient_collisions > 0 .and. &
      plan%transient_collisions < plan%collisions .and. plan%collisions <= point%number) &
      call refuse_value(plan, 'collisions', to_text(plan%collisions), 'above number, which is ' &
      //to_text(point%number)//', or transient_collisions = 0, since a run goes on by about one ' &
      //'wall collision of each particle')
    if (point%urn1_number > point%number) then
      call refuse_value(plan, 'urn1_number', to_text(point%urn1_number), &
        'from 0 to number, which is '//to_text(point%number))
    else if (plan%shape == 'urn' .and. point%urn1_number /= point%number) then
      call refuse_value(plan, 'urn1_number', to_text(point%urn1_number), &
        to_text(point%number)//', all particles, since the shape ''urn'' has one urn')
    end if
    ! Refused widths and lengths have no values here.
    if (any(plan%settings%all%given .and. .not. plan%settings%all%known)) return
    if (.not. can_count_hits(table_of(plan, point), point%number, plan%duration)) &
      call refuse_value(plan, 'number', to_text(point%number), &
      'fewer, or wider openings: such visits have more wall collisions than can be counted')
  end subroutine check_point

  !> Checks that openings fit into the urns, and that no length is too small relative to another.
  subroutine check_lengths(plan, point, radii)
    type(plan_type), intent(inout) :: plan
    type(point_type), intent(in) :: point
    !> Least and greatest radius.
    real(wp), intent(in) :: radii(2)
    character(len=*), parameter :: width_keys(2) = ['channel1_width', 'channel2_width']
    character(len=*), parameter :: length_keys(2) = ['channel1_length', 'channel2_length']
    character(len=12) :: size_key
    integer :: before, k

    before = size(plan%problems)
    size_key = merge('urn_vertices', 'urn_radius  ', has_outline(plan))
    call check_range(plan, trim(size_key), radii(1), 1.0_wp/greatest_radius, greatest_radius, &
      of_powers)
    if (size(plan%problems) > before) return
    call check_proportions()
    ! Relative to a length that is not allowed, no other can be checked.
    if (size(plan%problems) > before) return
    ! Close to the diameter, the remaining arcs and area lose their digits as well.
    do k = channel1, channel2
      associate (key => width_keys(k), width => point%channel(k)%width)
        if (width >= 2.0_wp*radii(1)) then
          call refuse_value(plan, key, to_text(width), &
            'below 2 urn_radius, which is '//to_text(2.0_wp*radii(1)))
        else
          call check_range(plan, key, width, 0.0_wp, (2.0_wp - finest)*radii(1), of_widths)
        end if
      end associate
    end do

  contains

    !> Refuses the longest length if the shortest is too small relative to it; the shortest, if of
    !> the two it alone is given. A closed channel has no length.
    subroutine check_proportions()
      character(len=15) :: keys(6)
      real(wp) :: lengths(6)
      logical :: is_there(6), others(6)
      integer :: shortest, longest, refused
      real(wp) :: most

      keys(:2) = size_key
      keys(3:4) = length_keys
      keys(5:) = width_keys
      lengths = [radii, point%channel%length, point%channel%width]
      is_there(:2) = .true.
      is_there(3:4) = is_open(point%channel)
      is_there(5:) = is_open(point%channel)
      longest = maxloc(lengths, 1, is_there)
      shortest = minloc(lengths, 1, is_there)
      if (lengths(shortest) >= finest*lengths(longest)) return
      refused = longest
      if (is_given(plan%settings, trim(keys(shortest))) .and. &
        .not. is_given(plan%settings, trim(keys(longest)))) refused = shortest
      others = is_there .and. abs(lengths - lengths(refused)) > 0.0_wp
      most = minval(lengths, others)/finest
      if (refused > 4) most = min(most, (2.0_wp - finest)*radii(1))
      call check_range(plan, trim(keys(refused)), lengths(refused), &
        finest*maxval(lengths, others), most, of_lengths)
    end subroutine check_proportions

  end subroutine check_lengths

  !> Checks that the clock resolves the lengths of the table, and that no time is too small relative
  !> to them.
  subroutine check_times(plan, radius, longest)
    type(plan_type), intent(inout) :: plan
    !> The least radius, and the longest length of the table.
    real(wp), intent(in) :: radius, longest
    character(len=*), parameter :: keys(3) = [character(len=15) :: 'duration', 'series_interval', &
      'time_step']
    !> Times of these keys; 0: not given.
    real(wp) :: times(3)
    integer :: k

    times = [plan%duration, plan%series_interval, plan%time_step]
    do k = 1, size(times)
      if (times(k) > 0.0_wp) call check_range(plan, trim(keys(k)), times(k), finest*longest, &
        longest_run*radius, of_times)
    end do
    call check_range(plan, 'start_time', plan%start_time, 0.0_wp, longest_run*radius, of_clocks)
    if (size(plan%snapshot_times) > 0) call check_range(plan, 'snapshot_times', &
      maxval(plan%snapshot_times), 0.0_wp, longest_run*radius, of_clocks)
  end subroutine check_times

  !> Refuses a value outside its bounds.
  pure subroutine check_range(plan, key, value, least, most, reason)
    type(plan_type), intent(inout) :: plan
    character(len=*), intent(in) :: key
    !> The value, its bounds, and the reason for them.
    real(wp), intent(in) :: value, least, most
    integer, intent(in) :: reason
    character(len=:), allocatable :: why

    if (value >= least .and. value <= most) return
    select case (reason)
    case (of_powers)
      why = 'whose fourth powers are finite'
    case (of_lengths)
      why = 'so that '//to_text(finest)//' of the longest length of the table is no longer than ' &
        //'the shortest'
    case (of_widths)
      why = 'which is 2 urn_radius less '//to_text(finest)//' of it'
    case (of_times)
      why = 'which are '//to_text(finest)//' of the longest length of the table, and ' &
        //to_text(longest_run)//' urn_radius'
    case default
      why = 'which is '//to_text(longest_run)//' urn_radius'
    end select
    call refuse_value(plan, key, to_text(value), 'from '//to_text(least)//' to '//to_text(most) &
      //', '//why)
  end subroutine check_range

  !> Length of channel 2, or 0 if it is closed.
  pure real(wp) function open_length(point) result(length)
    type(point_type), intent(in) :: point

    length = merge(point%channel(channel2)%length, 0.0_wp, point%channel(channel2)%width > 0.0_wp)
  end function open_length

end module battery_plan_checks
