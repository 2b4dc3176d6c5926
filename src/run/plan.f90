!> Plan of a run: table, particles, gates, length, scan, output and limits.
!>
!> A plan is filled from the namelist; `complete_plan` checks that its parts fit together, collects
!> all problems, and counts the parameter points of the scan. The first of the lists of &scan varies
!> slowest, the last fastest; every point has all replicas. A list replaces the value that the key
!> has in its own group; a single value is a list of one.
!>
!> Points are made one by one from their indices (`point_of`): every rank has the plan, and must not
!> store a list that grows with the scan.
module battery_plan
  use battery_kinds, only: wp, int64
  use battery_urn, only: shape_polygon
  use battery_table, only: table_type, urn_type, channel_type, new_table, shape_circuit, &
    shape_urn, channel2
  use battery_corners, only: regular_corners
  use battery_engine, only: particles_type
  use battery_setup, only: run_type, setup_type
  use battery_identity, only: identity_of
  use battery_findings, only: finding_type, point_findings_type, finding_of, of_state, &
    of_remark
  use battery_keys, only: scannable, key_threshold, key_threshold_fraction, key_number, key_width, &
    key_length, key_radius, key_urn1_fraction
  use battery_settings, only: settings_type
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: plan_type, point_type, scanned_type, refuse_value, refuse_key
  public :: corners_of
  public :: point_of, point_text, points_text, table_of, setup_of, is_scanned, values_of, rounded

  !> Value of whole numbers and shares that were not given.
  integer, parameter, public :: not_given = -1

  !> The values of a key that a scan can vary: two, of urn 1 and urn 2 or of their gates, which are
  !> equal if the key has one. The kind of the key determines the component that is used.
  type :: values_type
    !> Whether there is a value, given, by default, or of a scan.
    logical :: known = .false.
    integer(int64) :: whole(2) = 0
    real(wp) :: real(2) = 0.0_wp
  end type values_type

  !> What the namelist says of the parameter points: the values of keys by their places in
  !> `battery_keys`, and how many particles start in urn 1.
  type :: base_type
    type(values_type) :: of(scannable)
    integer :: urn1_number = not_given
  end type base_type

  !> One parameter point. Components are named like the keys of the namelist, those of a channel
  !> have its index; pairs are of urn 1 and urn 2, or of their gates.
  type :: point_type
    integer :: number = 0, urn1_number = 0, threshold(2) = 0
    real(wp) :: urn_radius(2) = 0.0_wp
    type(channel_type) :: channel(2)
  end type point_type

  !> The corners of an urn, (x, y) in columns, counterclockwise; whether they were given clockwise.
  type :: outline_type
    real(wp), allocatable :: corner(:, :)
    logical :: was_clockwise = .false.
  end type outline_type

  !> A key that is scanned, and its values; whole numbers as reals.
  type :: scanned_type
    character(len=:), allocatable :: key
    !> Its place, and the first and the last of the two values there that it sets: a list for gate 2
    !> or urn 2 only the second, the list that it forms pairs with only the first.
    integer :: place = 0, first = 1, last = 2
    logical :: is_whole = .false.
    !> Whether its values form pairs with those of the key before it.
    logical :: is_paired = .false.
    real(wp), allocatable :: values(:)
  end type scanned_type

  !> The plan. Components are named like the keys of the namelist; the unit of length is free.
  type, extends(run_type) :: plan_type
    !> Text of the whole namelist, the name of its file, and the keys that it sets.
    character(len=:), allocatable :: text, input_file
    type(settings_type) :: settings
    character(len=:), allocatable :: shape, urn_shape
    !> Number of sides of urns that are regular polygons; outline of each urn that is given by its
    !> corners, in a frame of its own with x towards channel 1.
    integer :: urn_sides = not_given
    type(outline_type) :: outline(2)
    !> z, y, radius of each disc in channel 2, the same at all points.
    real(wp), allocatable :: scatterers(:)
    !> The values of keys that are not scanned.
    type(base_type) :: base
    !> Keys that are scanned, the slowest first.
    type(scanned_type), allocatable :: scanned(:)
    !> Largest number of replicas of a point, and number of those that are run in any case.
    integer :: replicas = 1, first_replicas = 1
    !> Required standard errors over replicas of chi and polarised_current; 0: none required.
    real(wp) :: precision(2) = 0.0_wp
    integer(int64) :: seed = 1
    character(len=:), allocatable :: initial_file
    !> Particles of the initial file; without one, the arrays are not allocated.
    type(particles_type) :: file_particles
    !> Name of the results file.
    character(len=:), allocatable :: file
    real(wp) :: wall_minutes = 0.0_wp, checkpoint_minutes = 0.0_wp
    !> Problems of the plan.
    type(finding_type), allocatable :: problems(:)
    !> Problems of points of the scan, and number of points checked.
    type(point_findings_type) :: of_points
    integer :: checked_points = 0
    !> Number of points of the scan, from `complete_plan`; 0 if there are problems.
    integer :: point_count = 0
    !> Fingerprint of the contents of the initial file; 0: there is none.
    integer(int64) :: initial_fingerprint = 0
  end type plan_type

contains

  !> Adds a problem to a plan: a value that is not allowed, or what `kind` says.
  pure subroutine refuse_value(plan, key, value, allowed, kind)
    type(plan_type), intent(inout) :: plan
    !> Name of the key, its value, and what is allowed instead.
    character(len=*), intent(in) :: key, value, allowed
    !> Kind of the finding, if not `of_value`.
    integer, intent(in), optional :: kind

    plan%problems = [plan%problems, finding_of(0, value, allowed, key=key, kind=kind)]
  end subroutine refuse_value

  !> Adds a problem to a plan: a key in a state that is not allowed.
  pure subroutine refuse_key(plan, key, state, allowed)
    type(plan_type), intent(inout) :: plan
    !> Name of the key, its state, such as `is scanned`, and what is allowed instead.
    character(len=*), intent(in) :: key, state, allowed

    call refuse_value(plan, key, state, allowed, of_state)
  end subroutine refuse_key

  !> Whether a key is scanned.
  pure logical function is_scanned(plan, key) result(yes)
    type(plan_type), intent(in) :: plan
    !> Name of the key.
    character(len=*), intent(in) :: key

    yes = size(values_of(plan, key)) > 0
  end function is_scanned

  !> Values of a key that is scanned; none if it is not.
  pure function values_of(plan, key) result(values)
    type(plan_type), intent(in) :: plan
    !> Name of the key.
    character(len=*), intent(in) :: key
    real(wp), allocatable :: values(:)
    integer :: at

    allocate (values(0))
    do at = 1, size(plan%scanned)
      if (plan%scanned(at)%key == key) values = plan%scanned(at)%values
    end do
  end function values_of

  !> Point `number` of the scan, from 1 to `plan%point_count`; threshold and urn1_number are derived
  !> from fractions and defaults.
  pure type(point_type) function point_of(plan, number) result(point)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: number
    type(values_type) :: of(scannable)
    integer :: at(size(plan%scanned)), k

    of = plan%base%of
    at = places_at(plan, number)
    do k = 1, size(at)
      associate (one => plan%scanned(k), value => plan%scanned(k)%values(at(k)))
        if (one%is_whole) then
          of(one%place)%whole(one%first:one%last) = nint(value, int64)
        else
          of(one%place)%real(one%first:one%last) = value
        end if
      end associate
    end do
    point%number = int(of(key_number)%whole(1))
    point%threshold = int(of(key_threshold)%whole)
    if (of(key_threshold_fraction)%known) &
      point%threshold = rounded(of(key_threshold_fraction)%real*point%number)
    point%urn_radius = of(key_radius)%real
    do k = 1, 2
      point%channel(k) = channel_type(of(key_width(k))%real(1), of(key_length(k))%real(1))
    end do
    point%urn1_number = plan%base%urn1_number
    if (plan%shape == 'urn') then
      point%channel(channel2)%width = 0.0_wp
      if (point%urn1_number == not_given) point%urn1_number = point%number
    else if (of(key_urn1_fraction)%known .and. plan%initial_file == '') then
      point%urn1_number = rounded(of(key_urn1_fraction)%real(1)*point%number)
    else if (point%urn1_number == not_given) then
      point%urn1_number = point%number/2
    end if
  end function point_of

  !> Which of its values each key that is scanned has at point `number`.
  pure function places_at(plan, number) result(at)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: number
    integer :: at(size(plan%scanned)), left, k

    left = number - 1
    do k = size(at), 1, -1
      at(k) = 1 + mod(left, size(plan%scanned(k)%values))
      if (.not. plan%scanned(k)%is_paired) left = left/size(plan%scanned(k)%values)
    end do
  end function places_at

  !> Text for point `number`: its values of all keys that have several values in the scan.
  pure function point_text(plan, number, but) result(text)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: number
    !> A key to be left out.
    character(len=*), intent(in) :: but
    character(len=:), allocatable :: text
    integer :: at(size(plan%scanned)), k

    text = ''
    at = places_at(plan, number)
    do k = 1, size(at)
      associate (one => plan%scanned(k))
        if (size(one%values) == 1 .or. one%key == but) cycle
        if (text /= '') text = text//', '
        text = text//one%key//' = '//to_text(one%values(at(k)))
      end associate
    end do
  end function point_text

  !> Text for the points of the scan that a finding is about, if it is about some only.
  pure function points_text(plan, finding) result(text)
    type(plan_type), intent(in) :: plan
    type(finding_type), intent(in) :: finding
    character(len=:), allocatable :: text, first

    text = ''
    if (finding%points == 0 .or. finding%points == plan%checked_points) return
    text = ' ('//to_text(finding%points)//' of '//to_text(plan%checked_points)//' points'
    first = point_text(plan, finding%first_point, finding%key)
    ! Where only the key itself is scanned, its value has been told.
    if (first /= '' .and. finding%points == 1 .and. finding%kind /= of_remark) then
      text = text//': '//first
    else if (first /= '') then
      text = text//', the first: '//first
      if (finding%kind /= of_remark) text = text//', the last: '//point_text(plan, &
        finding%last_point, finding%key)
    end if
    text = text//')'
  end function points_text

  !> The nearest integer; the largest one if the number is beyond it.
  elemental integer function rounded(number)
    !> Value, of either sign.
    real(wp), intent(in) :: number

    rounded = huge(1)
    if (number < 0.999_wp*huge(1)) rounded = nint(number)
  end function rounded

  !> The table of a point.
  pure type(table_type) function table_of(plan, point) result(table)
    type(plan_type), intent(in) :: plan
    type(point_type), intent(in) :: point
    type(urn_type) :: urn(2)
    integer :: k

    urn%radius = point%urn_radius
    if (plan%urn_shape == 'polygon') then
      do k = 1, 2
        urn(k)%shape = shape_polygon
        urn(k)%corner = corners_of(plan, point, k)
      end do
    end if
    table = new_table(merge(shape_urn, shape_circuit, plan%shape == 'urn'), urn, point%channel, &
      reshape(plan%scatterers, [3, size(plan%scatterers)/3]))
  end function table_of

  !> The corners of an urn that is a polygon, 1 or 2, at a point: (x, y) in columns.
  pure function corners_of(plan, point, urn) result(corner)
    type(plan_type), intent(in) :: plan
    type(point_type), intent(in) :: point
    !> 1 or 2.
    integer, intent(in) :: urn
    real(wp), allocatable :: corner(:, :)

    if (plan%urn_sides > 0) then
      corner = regular_corners(plan%urn_sides, point%urn_radius(urn))
    else
      corner = plan%outline(urn)%corner
    end if
  end function corners_of

  !> Setup of the simulation of point `point` and replica `replica`, both from 1. The seed is the
  !> task's identity.
  type(setup_type) function setup_of(plan, point, replica) result(setup)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: point, replica
    type(point_type) :: at

    at = point_of(plan, point)
    setup%run_type = plan%run_type
    setup%table = table_of(plan, at)
    setup%number = at%number
    setup%urn1_number = at%urn1_number
    setup%threshold = at%threshold
    setup%seed = identity_of(setup, plan%initial_fingerprint, plan%seed, replica)
  end function setup_of

end module battery_plan
