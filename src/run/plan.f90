!> What a run is: table, particles, gate, length, scan, output and limits.
!>
!> A plan is made of components; `complete_plan` checks how they fit together, tells all problems at
!> once, and counts the parameter points of the scan. The first of the lists threshold (or
!> threshold_fraction), number, channel1_width, channel2_width, urn1_fraction varies slowest, the
!> last fastest; every point has all replicas. A list replaces what its own group says.
!>
!> Points are made one by one from their numbers (`point_of`): every rank has the plan, and must not
!> hold a list that grows with the scan.
module battery_plan
  use battery_kinds, only: wp, int64
  use battery_text, only: to_text
  use battery_table, only: table_type, new_table, shape_circuit, shape_urn
  use battery_bounds, only: whole_of, can_count_hits
  use battery_simulation, only: setup_type
  use battery_seeds, only: task_seed
  implicit none (type, external)
  private
  public :: plan_type, point_type, problem_type, complete_plan, point_of, table_of, setup_of
  public :: task_seed
  public :: not_given

  !> Value of whole numbers that were not given.
  integer, parameter :: not_given = -1

  !> Most points times replicas.
  integer(int64), parameter :: most_tasks = 10000000_int64

  !> One parameter point of a scan.
  type :: point_type
    integer :: number = 0, urn1_number = 0, threshold = 0
    real(wp) :: channel1_width = 0.0_wp, channel2_width = 0.0_wp
  end type point_type

  !> Something wrong with a plan: the key, its value, and what is allowed instead.
  type :: problem_type
    character(len=:), allocatable :: group, key, value, allowed
  end type problem_type

  !> Components are named like the keys of the namelist, lengths in units of choice, and
  !> times in lengths over the speed.
  type :: plan_type
    !> The whole input, and the file it came from.
    character(len=:), allocatable :: text, input_file
    character(len=:), allocatable :: shape
    real(wp) :: urn_radius = 1.0_wp, channel1_width = 0.3_wp, channel1_length = 1.0_wp
    real(wp) :: channel2_width = 0.01_wp, channel2_length = 1.0_wp
    integer :: number = not_given, urn1_number = not_given
    integer(int64) :: seed = 1
    character(len=:), allocatable :: initial_file
    integer :: threshold = not_given
    !> T/N; negative: not given.
    real(wp) :: threshold_fraction = -1.0_wp
    character(len=:), allocatable :: engine
    integer(int64) :: collisions = 100000000_int64
    !> Negative: half of the collisions.
    integer(int64) :: transient_collisions = -1
    real(wp) :: duration = 0.0_wp, transient_duration = 0.0_wp
    real(wp) :: start_time = 0.0_wp
    !> Step of the engine `timestep`; 0: not given.
    real(wp) :: time_step = 0.0_wp
    !> Lists of the scan; empty: not scanned.
    integer, allocatable :: scan_threshold(:), scan_number(:)
    real(wp), allocatable :: scan_threshold_fraction(:), scan_channel1_width(:)
    real(wp), allocatable :: scan_channel2_width(:), scan_urn1_fraction(:)
    integer :: replicas = 1
    !> Where the results go.
    character(len=:), allocatable :: file
    real(wp) :: series_interval = 0.0_wp
    real(wp), allocatable :: snapshot_times(:)
    logical :: event_log = .false., final_state = .false.
    real(wp) :: wall_minutes = 0.0_wp, checkpoint_minutes = 10.0_wp
    !> Points of the scan, from `complete_plan`; 0 if there are problems.
    integer :: point_count = 0
    !> Fingerprints of the initial file, and of all of the input that decides the results.
    integer(int64) :: initial_fingerprint = 0, fingerprint = 0
  end type plan_type

  ! Lengths and times, whose bounds follow from each other: `plan_lengths.f90`.
  interface
    module subroutine check_widths(plan, problems)
      implicit none (type, external)
      type(plan_type), intent(in) :: plan
      type(problem_type), allocatable, intent(inout) :: problems(:)
    end subroutine check_widths

    pure module subroutine check_times(plan, problems)
      implicit none (type, external)
      type(plan_type), intent(in) :: plan
      type(problem_type), allocatable, intent(inout) :: problems(:)
    end subroutine check_times

    pure module subroutine add(problems, group, key, value, allowed)
      implicit none (type, external)
      type(problem_type), allocatable, intent(inout) :: problems(:)
      character(len=*), intent(in) :: group, key, value, allowed
    end subroutine add
  end interface

contains

  !> Fills in what was not given, checks how the components fit together and counts the points.
  subroutine complete_plan(plan, problems)
    type(plan_type), intent(inout) :: plan
    type(problem_type), allocatable, intent(out) :: problems(:)

    allocate (problems(0))
    call fill_defaults(plan)
    call check_given(plan, problems)
    call check_widths(plan, problems)
    call check_times(plan, problems)
    call check_length(plan, problems)
    call check_step(plan, problems)
    call check_output(plan, problems)
    plan%point_count = 0
    if (size(problems) > 0) return
    plan%point_count = product(list_lengths(plan))
    call check_points(plan, problems)
    if (size(problems) > 0) plan%point_count = 0
  end subroutine complete_plan

  pure subroutine fill_defaults(plan)
    type(plan_type), intent(inout) :: plan

    if (.not. allocated(plan%text)) plan%text = ''
    if (.not. allocated(plan%input_file)) plan%input_file = ''
    if (.not. allocated(plan%shape)) plan%shape = 'circuit'
    if (.not. allocated(plan%initial_file)) plan%initial_file = ''
    if (.not. allocated(plan%engine)) plan%engine = 'excursion'
    if (.not. allocated(plan%file)) plan%file = 'battery.h5'
    if (.not. allocated(plan%scan_threshold)) allocate (plan%scan_threshold(0))
    if (.not. allocated(plan%scan_number)) allocate (plan%scan_number(0))
    if (.not. allocated(plan%scan_threshold_fraction)) allocate (plan%scan_threshold_fraction(0))
    if (.not. allocated(plan%scan_channel1_width)) allocate (plan%scan_channel1_width(0))
    if (.not. allocated(plan%scan_channel2_width)) allocate (plan%scan_channel2_width(0))
    if (.not. allocated(plan%scan_urn1_fraction)) allocate (plan%scan_urn1_fraction(0))
    if (.not. allocated(plan%snapshot_times)) allocate (plan%snapshot_times(0))
  end subroutine fill_defaults

  !> What must be given, and what must not be given twice.
  pure subroutine check_given(plan, problems)
    type(plan_type), intent(in) :: plan
    type(problem_type), allocatable, intent(inout) :: problems(:)
    logical :: as_number, as_fraction

    if (plan%number == not_given .and. size(plan%scan_number) == 0) &
      call add(problems, 'particles', 'number', 'is missing', 'one whole number from 1 up')
    as_number = plan%threshold /= not_given .or. size(plan%scan_threshold) > 0
    as_fraction = plan%threshold_fraction >= 0.0_wp .or. size(plan%scan_threshold_fraction) > 0
    if (.not. (as_number .or. as_fraction)) &
      call add(problems, 'gate', 'threshold', 'is missing', &
      'one whole number from 0 up, or threshold_fraction, or a list of either in &scan')
    if (as_number .and. as_fraction) &
      call add(problems, merge('gate', 'scan', plan%threshold_fraction >= 0.0_wp), &
      'threshold_fraction', 'is given beside threshold', 'one of the two')
    if (size(plan%scan_number) == 0 .and. size(plan%scan_urn1_fraction) == 0 .and. &
      plan%number /= not_given .and. plan%urn1_number > plan%number) &
      call add(problems, 'particles', 'urn1_number', to_text(plan%urn1_number), &
      'from 0 to number, which is '//to_text(plan%number))
    if (plan%shape == 'urn' .and. size(plan%scan_channel2_width) > 0) &
      call add(problems, 'scan', 'channel2_width', 'is scanned', &
      'nothing: the shape ''urn'' has no channel 2')
    if (plan%shape == 'urn' .and. size(plan%scan_urn1_fraction) > 0) &
      call add(problems, 'scan', 'urn1_fraction', 'is scanned', &
      'nothing: the shape ''urn'' has one urn')
    if (plan%initial_file /= '' .and. size(plan%scan_number) > 1) &
      call add(problems, 'scan', 'number', to_text(size(plan%scan_number))//' numbers', &
      'one, since &particles initial_file is given')
    if (plan%initial_file /= '' .and. size(plan%scan_urn1_fraction) > 0) &
      call add(problems, 'scan', 'urn1_fraction', 'is scanned', &
      'nothing, since &particles initial_file is given')
  end subroutine check_given

  !> The run is longer than its transient.
  pure subroutine check_length(plan, problems)
    type(plan_type), intent(inout) :: plan
    type(problem_type), allocatable, intent(inout) :: problems(:)

    if (plan%transient_collisions < 0) plan%transient_collisions = plan%collisions/2
    if (plan%duration > 0.0_wp) then
      if (plan%transient_duration > whole_of(plan%duration)) &
        call add(problems, 'run', 'transient_duration', to_text(plan%transient_duration), &
        'below duration, which is '//to_text(plan%duration))
    else
      if (plan%transient_duration > 0.0_wp) &
        call add(problems, 'run', 'transient_duration', to_text(plan%transient_duration), &
        '0, unless duration is given')
      if (plan%transient_collisions >= plan%collisions) &
        call add(problems, 'run', 'transient_collisions', to_text(plan%transient_collisions), &
        'below collisions, which is '//to_text(plan%collisions))
    end if
  end subroutine check_length

  !> The engine `timestep` needs a step, one that cannot jump over a gate or out of an urn.
  pure subroutine check_step(plan, problems)
    type(plan_type), intent(in) :: plan
    type(problem_type), allocatable, intent(inout) :: problems(:)
    real(wp) :: longest

    if (plan%engine /= 'timestep') return
    longest = min(plan%urn_radius, 0.5_wp*plan%channel1_length)
    if (plan%shape /= 'urn') longest = min(longest, 0.5_wp*plan%channel2_length)
    if (.not. plan%time_step > 0.0_wp) then
      call add(problems, 'run', 'time_step', 'is missing', &
        'one number above 0, since the engine is ''timestep''')
    else if (plan%time_step >= longest) then
      call add(problems, 'run', 'time_step', to_text(plan%time_step), 'below ' &
        //to_text(longest)//', the least of urn_radius and half of each channel''s length')
    end if
  end subroutine check_step

  pure subroutine check_output(plan, problems)
    type(plan_type), intent(in) :: plan
    type(problem_type), allocatable, intent(inout) :: problems(:)
    integer :: at

    if (plan%file == '') call add(problems, 'output', 'file', '''''', 'the name of a file')
    do at = 2, size(plan%snapshot_times)
      if (plan%snapshot_times(at) > plan%snapshot_times(at - 1)) cycle
      call add(problems, 'output', 'snapshot_times', to_text(plan%snapshot_times(at)), &
        'times that grow; the one before is '//to_text(plan%snapshot_times(at - 1)))
      exit
    end do
    if (plan%duration > 0.0_wp .and. size(plan%snapshot_times) > 0) then
      if (plan%snapshot_times(size(plan%snapshot_times)) > plan%duration) &
        call add(problems, 'output', 'snapshot_times', &
        to_text(plan%snapshot_times(size(plan%snapshot_times))), &
        'up to &run duration, which is '//to_text(plan%duration))
    end if
    if (task_total(plan) > most_tasks) &
      call add(problems, 'scan', 'replicas', to_text(task_total(plan))//' tasks in all', &
      'up to '//to_text(most_tasks)//' points times replicas')
    if (plan%event_log .and. task_total(plan) /= 1_int64) &
      call add(problems, 'output', 'event_log', '.true.', &
      '.false., since the scan has '//to_text(task_total(plan))//' tasks')
  end subroutine check_output

  !> Points times replicas; beyond `most_tasks`, some larger number.
  pure function task_total(plan) result(total)
    type(plan_type), intent(in) :: plan
    integer(int64) :: total
    integer :: lengths(6), at

    lengths = [list_lengths(plan), plan%replicas]
    total = 1
    do at = 1, size(lengths)
      if (total <= most_tasks) total = total*max(lengths(at), 1)
    end do
  end function task_total

  !> How many values the lists threshold, number, widths and urn1_fraction have; 1: not scanned.
  pure function list_lengths(plan) result(lengths)
    type(plan_type), intent(in) :: plan
    integer :: lengths(5)

    lengths = [size(plan%scan_threshold) + size(plan%scan_threshold_fraction), &
      size(plan%scan_number), size(plan%scan_channel1_width), size(plan%scan_channel2_width), &
      size(plan%scan_urn1_fraction)]
    lengths = max(lengths, 1)
  end function list_lengths

  !> Point `number` of the scan, from 1 to `plan%point_count`.
  pure function point_of(plan, number) result(point)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: number
    type(point_type) :: point
    integer :: lengths(5), place(5), list, left

    lengths = list_lengths(plan)
    left = number - 1
    do list = 5, 1, -1
      place(list) = 1 + mod(left, lengths(list))
      left = left/lengths(list)
    end do
    point = point_at(plan, place)
  end function point_of

  !> The point at the places `place` in the lists threshold, number, widths and urn1_fraction.
  pure function point_at(plan, place) result(point)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: place(5)
    type(point_type) :: point
    real(wp) :: threshold_fraction

    point%number = plan%number
    if (size(plan%scan_number) > 0) point%number = plan%scan_number(place(2))
    point%threshold = plan%threshold
    if (size(plan%scan_threshold) > 0) point%threshold = plan%scan_threshold(place(1))
    threshold_fraction = plan%threshold_fraction
    if (size(plan%scan_threshold_fraction) > 0) &
      threshold_fraction = plan%scan_threshold_fraction(place(1))
    if (threshold_fraction >= 0.0_wp) point%threshold = rounded(threshold_fraction*point%number)
    point%channel1_width = plan%channel1_width
    if (size(plan%scan_channel1_width) > 0) &
      point%channel1_width = plan%scan_channel1_width(place(3))
    point%channel2_width = plan%channel2_width
    if (size(plan%scan_channel2_width) > 0) &
      point%channel2_width = plan%scan_channel2_width(place(4))
    if (plan%shape == 'urn') point%channel2_width = 0.0_wp
    point%urn1_number = plan%urn1_number
    if (size(plan%scan_urn1_fraction) > 0) then
      point%urn1_number = rounded(plan%scan_urn1_fraction(place(5))*point%number)
    else if (plan%urn1_number == not_given) then
      point%urn1_number = merge(point%number, point%number/2, plan%shape == 'urn')
    end if
  end function point_at

  !> The nearest whole number, at most the largest there is.
  pure function rounded(number)
    real(wp), intent(in) :: number
    integer :: rounded

    rounded = huge(1)
    if (number < 0.999_wp*huge(1)) rounded = nint(number)
  end function rounded

  !> urn1_number must fit each point's number.
  pure subroutine check_points(plan, problems)
    type(plan_type), intent(in) :: plan
    type(problem_type), allocatable, intent(inout) :: problems(:)
    type(point_type) :: point
    integer :: at

    do at = 1, plan%point_count
      point = point_of(plan, at)
      if (point%urn1_number > point%number) then
        call add(problems, 'particles', 'urn1_number', to_text(point%urn1_number), &
          'from 0 to number, which is '//to_text(point%number))
      else if (plan%shape == 'urn' .and. point%urn1_number /= point%number) then
        call add(problems, 'particles', 'urn1_number', to_text(point%urn1_number), &
          to_text(point%number)//', all particles, since the shape ''urn'' has one urn')
      end if
      if (.not. can_count_hits(table_of(plan, point), point%number, plan%duration)) &
        call add(problems, 'particles', 'number', to_text(point%number), &
        'fewer, or wider openings: such visits have more wall collisions than can be counted')
      if (size(problems) > 0) return
    end do
  end subroutine check_points

  !> The table of a point.
  pure function table_of(plan, point) result(table)
    type(plan_type), intent(in) :: plan
    type(point_type), intent(in) :: point
    type(table_type) :: table

    table = new_table(merge(shape_urn, shape_circuit, plan%shape == 'urn'), plan%urn_radius, &
      point%channel1_width, plan%channel1_length, point%channel2_width, plan%channel2_length)
  end function table_of

  !> What the simulation of point number `point` and replica `replica`, from 1, is set up with.
  pure function setup_of(plan, point, replica) result(setup)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: point, replica
    type(setup_type) :: setup
    type(point_type) :: at

    at = point_of(plan, point)
    setup%engine = plan%engine
    setup%table = table_of(plan, at)
    setup%threshold = at%threshold
    setup%collisions = plan%collisions
    setup%transient_collisions = plan%transient_collisions
    setup%duration = plan%duration
    setup%transient_duration = plan%transient_duration
    setup%start_time = plan%start_time
    setup%time_step = plan%time_step
    setup%seed = task_seed(plan%seed, point, replica)
    setup%series_interval = plan%series_interval
    setup%snapshot_times = plan%snapshot_times
    setup%event_log = plan%event_log
  end function setup_of

end module battery_plan
