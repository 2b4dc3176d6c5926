!> Makes a plan from the text of a namelist: parses, checks, and reports all problems in one error,
!> each with file, line, group, key, value and what is allowed. Does not access files.
module battery_namelist_input
  use battery_kinds, only: wp
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_text, only: to_text, numbers_text, new_line_character
  use battery_foreign_bytes, only: namelist_problem, is_results_file
  use battery_findings, only: finding_type, finding_of, add_finding, findings_text, &
    displayable_text, of_missing
  use battery_settings, only: settings_type, read_settings, find_setting, is_given, get_value
  use battery_key, only: whole_key, is_beyond, longest_range
  use battery_keys, only: all_keys, corner_keys
  use battery_identity, only: twelve_digits
  use battery_plan, only: plan_type, scanned_type, points_text, refuse_value, refuse_key, &
    is_scanned
  use battery_plan_checks, only: complete_plan
  implicit none (type, external)
  private
  public :: parse_namelist, check_bytes, read_plan, fill_plan, set_input_error, differing_keys

contains

  !> Makes a plan from the text of a namelist.
  subroutine parse_namelist(text, name, plan, error)
    !> Text of the namelist; name of its file in messages.
    character(len=*), intent(in) :: text, name
    type(plan_type), intent(out) :: plan
    !> All problems, one per line; code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error

    call check_bytes(text, name, error)
    call read_plan(text, name, plan)
    if (.not. allocated(error)) call set_input_error(plan, error)
  end subroutine parse_namelist

  !> Checks that a text may be a namelist: what is read into other bytes is not reported.
  subroutine check_bytes(text, name, error)
    !> Text of the whole file, and its name.
    character(len=*), intent(in) :: text, name
    !> One line, with the byte and its place; code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: message

    if (is_results_file(text)) then
      message = name//' is a results file, not a namelist'
    else
      message = namelist_problem(text, name)
    end if
    if (message /= '') call fatal_error(error, message, exit_bad_input)
  end subroutine check_bytes

  !> Parses a text, and makes a plan from it. Problems of the text are stored in its settings, those
  !> of the values in the plan.
  subroutine read_plan(text, name, plan)
    !> Text of the whole namelist, and the name of its file.
    character(len=*), intent(in) :: text, name
    type(plan_type), intent(out) :: plan

    call read_settings(text, all_keys(), plan%settings)
    plan%text = text
    plan%input_file = name
    call fill_plan(plan)
  end subroutine read_plan

  !> Sets the components of a plan from its settings, and checks the plan.
  subroutine fill_plan(plan)
    type(plan_type), intent(inout) :: plan

    allocate (plan%scanned(0), plan%problems(0))
    call fill_values(plan%settings, plan)
    call fill_points(plan%settings, plan)
    call complete_plan(plan)
  end subroutine fill_plan

  !> Sets the values that all tasks have in common.
  subroutine fill_values(settings, plan)
    type(settings_type), intent(in) :: settings
    type(plan_type), intent(inout) :: plan
    real(wp), allocatable :: times(:)

    plan%shape = settings%all(find_setting(settings, 'shape'))%text
    call fill_outlines(settings, plan)
    plan%scatterers = settings%all(find_setting(settings, 'scatterers'))%reals
    call get_value(settings, 'urn1_number', plan%base%urn1_number)
    call get_value(settings, 'seed', plan%seed)
    plan%initial_file = settings%all(find_setting(settings, 'initial_file'))%text
    plan%engine = settings%all(find_setting(settings, 'engine'))%text
    call get_value(settings, 'collisions', plan%collisions)
    call get_value(settings, 'transient_collisions', plan%transient_collisions)
    call get_value(settings, 'duration', plan%duration)
    call get_value(settings, 'transient_duration', plan%transient_duration)
    call get_value(settings, 'start_time', plan%start_time)
    call get_value(settings, 'time_step', plan%time_step)
    call get_value(settings, 'replicas', plan%first_replicas)
    call get_value(settings, 'chi_replica_error', plan%precision(1))
    call get_value(settings, 'polarised_current_replica_error', plan%precision(2))
    plan%replicas = plan%first_replicas
    if (any(plan%precision > 0.0_wp)) &
      call get_value(settings, 'largest_replicas', plan%replicas)
    plan%file = settings%all(find_setting(settings, 'file'))%text
    call get_value(settings, 'series_interval', plan%series_interval)
    call get_scan_values(settings, find_setting(settings, 'snapshot_times'), plan, times)
    call move_alloc(times, plan%snapshot_times)
    call get_value(settings, 'event_log', plan%event_log)
    call get_value(settings, 'final_state', plan%final_state)
    call get_value(settings, 'wall_minutes', plan%wall_minutes)
    call get_value(settings, 'checkpoint_minutes', plan%checkpoint_minutes)
  end subroutine fill_values

  !> Sets the shape of the urns. If the number of coordinates is odd, no corners are set.
  subroutine fill_outlines(settings, plan)
    type(settings_type), intent(in) :: settings
    type(plan_type), intent(inout) :: plan
    real(wp), allocatable :: numbers(:)
    integer :: urn

    plan%urn_shape = settings%all(find_setting(settings, 'urn_shape'))%text
    call get_value(settings, 'urn_sides', plan%urn_sides)
    do urn = 1, 2
      numbers = settings%all(find_setting(settings, trim(corner_keys(urn))))%reals
      if (size(numbers) == 0) cycle
      if (modulo(size(numbers), 2) /= 0 .and. plan%urn_shape /= 'disc') then
        call refuse_key(plan, trim(corner_keys(urn)), 'has '//to_text(size(numbers))//' numbers', &
          'two for each corner, x1, y1, x2, y2, ...')
        cycle
      end if
      plan%outline(urn)%corner = reshape(numbers, [2, size(numbers)/2])
      if (is_given(settings, 'urn_radius')) call refuse_key(plan, 'urn_radius', &
        'is given beside '//trim(corner_keys(urn)), 'one of the two')
    end do
  end subroutine fill_outlines

  !> Sets the keys that a scan can vary, in their order: their values, and the lists of the scan,
  !> each given as a list or as a range. A list for gate 2 or urn 2 forms pairs with the list before
  !> it, which is for gate 1 or urn 1 then.
  subroutine fill_points(settings, plan)
    type(settings_type), intent(in) :: settings
    type(plan_type), intent(inout) :: plan
    type(scanned_type) :: one
    integer :: at, last

    do at = 1, size(settings%all)
      associate (key => settings%all(at)%key)
        if (key%place == 0 .or. key%is_range) cycle
        if (key%group /= 'scan') then
          ! One number is the value of both.
          associate (values => plan%base%of(key%place), setting => settings%all(at))
            values%known = setting%known
            if (values%known .and. key%kind == whole_key) &
              values%whole = setting%integers([1, size(setting%integers)])
            if (values%known .and. key%kind /= whole_key) &
              values%real = setting%reals([1, size(setting%reals)])
          end associate
          cycle
        end if
        call get_scan_values(settings, at, plan, one%values)
        if (size(one%values) == 0) cycle
        one%key = trim(key%name)
        one%place = key%place
        one%is_whole = key%kind == whole_key
        one%first = merge(2, 1, key%is_second)
        last = size(plan%scanned)
        one%is_paired = last > 0 .and. key%is_second
        if (one%is_paired) one%is_paired = plan%scanned(last)%place == key%place
        if (one%is_paired) then
          if (size(one%values) /= size(plan%scanned(last)%values)) then
            call refuse_key(plan, one%key, 'has '//to_text(size(one%values))//' values', &
              to_text(size(plan%scanned(last)%values))//', one for each of ' &
              //plan%scanned(last)%key)
            cycle
          end if
          plan%scanned(last)%last = 1
        end if
        if (.not. key%is_second) plan%base%of(key%place)%known = .true.
        plan%scanned = [plan%scanned, one]
      end associate
    end do
  end subroutine fill_points

  !> Values of setting number `at`, a list, or of its range, which is the next setting; none if
  !> neither is given or valid.
  subroutine get_scan_values(settings, at, plan, values)
    type(settings_type), intent(in) :: settings
    integer, intent(in) :: at
    type(plan_type), intent(inout) :: plan
    real(wp), allocatable, intent(out) :: values(:)
    character(len=:), allocatable :: allowed

    allocate (values(0))
    associate (list => settings%all(at), range => settings%all(at + 1))
      if (list%given .and. range%given) then
        call refuse_key(plan, trim(range%key%name), 'is given beside '//trim(list%key%name), &
          'one of the two')
      else if (list%known) then
        ! The numbers of a key are either reals or integers.
        values = [list%reals, real(list%integers, wp)]
      else if (range%known) then
        values = range_of(range%reals, list%key%kind == whole_key)
        allowed = ''
        if (list%key%kind == whole_key) allowed = whole_ranges(range%reals)
        if (any(is_beyond(list%key, values))) then
          call refuse_value(plan, trim(range%key%name), to_text(maxval(values)), &
            'numbers up to '//to_text(list%key%greatest))
          values = values(:0)
        else if (allowed /= '') then
          call refuse_value(plan, trim(range%key%name), numbers_text(range%reals, ', '), allowed)
          ! The key is scanned all the same, and not missing.
          values = values(:1)
        end if
      end if
    end associate
  end subroutine get_scan_values

  !> Values of a range, evenly spaced: whole numbers, or numbers rounded to 12 digits, so that a
  !> value does not depend on the length of the range.
  pure function range_of(range, whole) result(values)
    !> First, last, how many.
    real(wp), intent(in) :: range(3)
    logical, intent(in) :: whole
    real(wp), allocatable :: values(:)
    integer :: at, count

    count = nint(range(3))
    associate (first => range(1), last => range(2))
      values = twelve_digits([(first + (at - 1)*((last - first)/max(count - 1, 1)), at=1, count)])
      if (whole) then
        values = anint(values)
      else
        ! The end points are not rounded.
        values(1) = first
        if (count > 1) values(count) = last
      end if
    end associate
  end function range_of

  !> The nearest ranges of whole numbers in whole steps; empty if a range is one of them.
  pure function whole_ranges(range) result(text)
    !> First, last, how many.
    real(wp), intent(in) :: range(3)
    character(len=:), allocatable :: text
    real(wp) :: first, last, steps, near(2)
    integer :: apart, place

    text = ''
    first = anint(range(1))
    last = anint(range(2))
    steps = max(1.0_wp, range(3) - 1.0_wp)
    if (all(abs(range(:2) - [first, last]) <= 0.0_wp) .and. abs(modulo(last - first, steps)) &
      <= 0.0_wp) return
    do apart = 0, longest_range
      near = max(1.0_wp, steps + [-apart, apart])
      place = findloc(abs(modulo(last - first, near)) <= 0.0_wp, .true., dim=1)
      if (place > 0) exit
    end do
    text = 'whole numbers in whole steps, such as '//numbers_text([first, last, near(place) &
      + 1.0_wp], ', ')
    if (apart > 0 .and. steps <= abs(last - first)) text = text//' or '//numbers_text([first, &
      first + anint((last - first)/steps)*steps, range(3)], ', ')
  end function whole_ranges

  !> Adds a problem of the plan to the settings, at the line of its key.
  subroutine add_problem(plan, problem)
    type(plan_type), intent(inout) :: plan
    type(finding_type), intent(in) :: problem
    logical, allocatable :: refused(:)
    integer :: place, next

    associate (all => plan%settings%all)
      ! A key comes before its list in &scan, and a list before its range.
      place = findloc(all%key%name == problem%key, .true., dim=1, &
        back=is_scanned(plan, problem%key))
      next = min(place + 1, size(all))
      if (all(next)%key%is_range .and. all(next)%given .and. .not. all(place)%given) place = next
      ! A key that was refused already is neither refused again nor reported as missing, also if it
      ! may be given in another form: as a list, as a fraction.
      refused = all%given .and. .not. all%known
      if (refused(place)) return
      if (problem%kind == of_missing .and. any(refused .and. index(all%key%name, problem%key) &
        == 1)) return
      call add_finding(plan%settings%problems, finding_of(all(place)%line, problem%value, &
        problem%allowed//points_text(plan, problem), trim(all(place)%key%group), &
        trim(all(place)%key%name), problem%kind))
    end associate
  end subroutine add_problem

  !> Makes one error from all problems, in the order of the lines; none if there are none. If
  !> several problems belong to points of the scan, the first line has the number of invalid points.
  subroutine set_input_error(plan, error)
    type(plan_type), intent(inout) :: plan
    !> Code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: text
    integer :: at

    ! Values of a text that could not be read as a whole are not judged together.
    if (plan%settings%has_skipped_text) plan%problems = plan%problems(:0)
    if (count(plan%problems%points > 0 .and. plan%problems%points < plan%checked_points) > 1) then
      text = to_text(plan%of_points%points)//' of '//to_text(plan%checked_points) &
        //' points of the scan cannot be simulated'
      if (plan%of_points%more) text = text//'; the first of them:'
      call add_finding(plan%settings%problems, finding_of(0, text))
    end if
    ! In a text without a key of the program it is not the keys that are missing.
    do at = 1, merge(0, size(plan%problems), plan%settings%problems%count > 0 .and. .not. any( &
      plan%settings%all%given))
      call add_problem(plan, plan%problems(at))
    end do
    if (plan%settings%problems%count > 0) call fatal_error(error, &
      findings_text(plan%settings%problems, plan%input_file), exit_bad_input)
  end subroutine set_input_error

  !> Keys in which two inputs differ, one per line with both values; empty if they describe the same
  !> run. Notation, defaults, limits and the name of the output file make no difference.
  pure function differing_keys(old, new) result(text)
    !> Settings of two plans.
    type(settings_type), intent(in) :: old, new
    character(len=:), allocatable :: text
    integer :: at

    text = ''
    do at = 1, size(new%all)
      associate (key => new%all(at)%key, was => old%all(at)%canonical, &
        is => new%all(at)%canonical)
        if (was == is .or. .not. key%changes_results) cycle
        if (text /= '') text = text//new_line_character
        text = text//'&'//trim(key%group)//' '//trim(key%name)//': was '//value_text(was) &
          //', is '//value_text(is)
      end associate
    end do
  end function differing_keys

  !> A value as in the list of keys that differ; `not given` if it is empty.
  pure function value_text(canonical) result(text)
    character(len=*), intent(in) :: canonical
    character(len=:), allocatable :: text

    text = displayable_text(trim(adjustl(canonical)))
    if (text == '') text = 'not given'
  end function value_text

end module battery_namelist_input
