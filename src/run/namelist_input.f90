!> From the text of a namelist to a plan: reads, checks, and tells all problems in one error, each
!> with file, line, group, key, value and what is allowed. Does not look at files.
module battery_namelist_input
  use battery_kinds, only: wp
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_text, only: to_text, new_line_character
  use battery_table, only: gated, ungated
  use battery_remarks, only: add_remark, remarks_text, shown_text
  use battery_settings, only: settings_type, setting_type, read_settings, find_setting, take, &
    take_list, take_text
  use battery_key, only: key_type, whole_key
  use battery_keys, only: all_keys
  use battery_identity, only: twelve_digits
  use battery_plan, only: plan_type, scanned_type, problem_type, complete_plan
  implicit none (type, external)
  private
  public :: parse_namelist, fill_plan, add_problem, report, differing_keys

contains

  !> The plan that a text describes.
  subroutine parse_namelist(text, name, plan, error)
    !> The namelist; `name` stands for its file in messages.
    character(len=*), intent(in) :: text, name
    type(plan_type), intent(out) :: plan
    !> Code `exit_bad_input`; all problems, one a line.
    type(error_type), allocatable, intent(out) :: error
    type(settings_type) :: settings

    call fill_plan(text, name, settings, plan)
    call report(name, settings, error)
  end subroutine parse_namelist

  !> Reads a text, sets the components of a plan, and lets it check itself. The problems are in the
  !> settings.
  subroutine fill_plan(text, name, settings, plan)
    !> All of the namelist, and the name of its file.
    character(len=*), intent(in) :: text, name
    type(settings_type), intent(out) :: settings
    type(plan_type), intent(out) :: plan
    type(problem_type), allocatable :: problems(:)
    integer :: at

    call read_settings(text, all_keys(), settings)
    plan%text = text
    plan%input_file = name
    call fill_point(settings, plan)
    call fill_run(settings, plan)
    call fill_scan(settings, plan)
    call check_pairs(settings)
    call complete_plan(plan, problems)
    do at = 1, size(problems)
      call add_problem(settings, problems(at))
    end do
  end subroutine fill_plan

  !> What may differ between the points of a scan.
  subroutine fill_point(settings, plan)
    type(settings_type), intent(in) :: settings
    type(plan_type), intent(inout) :: plan

    associate (base => plan%base)
      call take_text(settings, 'table', 'shape', plan%shape)
      call take(settings, 'table', 'urn_radius', base%urn_radius)
      call take(settings, 'table', 'channel1_width', base%channel(gated)%width)
      call take(settings, 'table', 'channel1_length', base%channel(gated)%length)
      call take(settings, 'table', 'channel2_width', base%channel(ungated)%width)
      call take(settings, 'table', 'channel2_length', base%channel(ungated)%length)
      call take(settings, 'particles', 'number', base%number)
      call take(settings, 'particles', 'urn1_number', base%urn1_number)
      call take(settings, 'particles', 'urn1_fraction', base%urn1_fraction)
      call take(settings, 'gate', 'threshold', base%threshold)
      call take(settings, 'gate', 'threshold_fraction', base%threshold_fraction)
    end associate
  end subroutine fill_point

  !> What all tasks have in common.
  subroutine fill_run(settings, plan)
    type(settings_type), intent(in) :: settings
    type(plan_type), intent(inout) :: plan

    call take(settings, 'particles', 'seed', plan%seed)
    call take_text(settings, 'particles', 'initial_file', plan%initial_file)
    call take_text(settings, 'run', 'engine', plan%engine)
    call take(settings, 'run', 'collisions', plan%collisions)
    call take(settings, 'run', 'transient_collisions', plan%transient_collisions)
    call take(settings, 'run', 'duration', plan%duration)
    call take(settings, 'run', 'transient_duration', plan%transient_duration)
    call take(settings, 'run', 'start_time', plan%start_time)
    call take(settings, 'run', 'time_step', plan%time_step)
    call take(settings, 'scan', 'replicas', plan%replicas)
    call take_text(settings, 'output', 'file', plan%file)
    call take(settings, 'output', 'series_interval', plan%series_interval)
    call take_list(settings, 'output', 'snapshot_times', plan%snapshot_times)
    call take(settings, 'output', 'event_log', plan%event_log)
    call take(settings, 'output', 'final_state', plan%final_state)
    call take(settings, 'limits', 'wall_minutes', plan%wall_minutes)
    call take(settings, 'limits', 'checkpoint_minutes', plan%checkpoint_minutes)
  end subroutine fill_run

  !> Lists of the scan, each from itself or from its range, in the order of the keys.
  subroutine fill_scan(settings, plan)
    type(settings_type), intent(inout) :: settings
    type(plan_type), intent(inout) :: plan
    type(scanned_type) :: one
    integer :: at

    allocate (plan%scanned(0))
    do at = 1, size(settings%all) - 1
      ! A list stands before its range.
      if (settings%all(at)%key%group /= 'scan' .or. .not. settings%all(at + 1)%key%is_range) cycle
      one%key = trim(settings%all(at)%key%name)
      if (settings%all(at)%given .and. settings%all(at + 1)%given) then
        call refuse_range('is given beside '//one%key, 'one of the two')
      else if (settings%all(at)%given .and. settings%all(at)%known) then
        one%values = values_of(settings%all(at))
        plan%scanned = [plan%scanned, one]
      else if (settings%all(at + 1)%given .and. settings%all(at + 1)%known) then
        one%values = range_of(settings%all(at + 1), settings%all(at)%key%kind == whole_key)
        if (settings%all(at)%key%kind == whole_key .and. &
          any(one%values > settings%all(at)%key%greatest)) then
          call refuse_range(to_text(maxval(one%values)), 'numbers up to ' &
            //to_text(settings%all(at)%key%greatest))
        else
          plan%scanned = [plan%scanned, one]
        end if
      end if
    end do

  contains

    subroutine refuse_range(value, allowed)
      character(len=*), intent(in) :: value, allowed
      type(problem_type) :: problem

      ! One by one: gfortran 12 loses a component's text in a structure constructor.
      problem%group = 'scan'
      problem%key = trim(settings%all(at + 1)%key%name)
      problem%value = value
      problem%allowed = allowed
      call add_problem(settings, problem)
    end subroutine refuse_range

  end subroutine fill_scan

  !> The values of a list.
  pure function values_of(setting) result(values)
    type(setting_type), intent(in) :: setting
    real(wp), allocatable :: values(:)

    if (setting%key%kind == whole_key) then
      values = real(setting%integers, wp)
    else
      values = setting%reals
    end if
  end function values_of

  !> The values of a range, evenly spaced: whole numbers, or numbers of 12 digits, so that a value
  !> is the same in ranges of other lengths.
  pure function range_of(setting, whole) result(values)
    type(setting_type), intent(in) :: setting
    logical, intent(in) :: whole
    real(wp), allocatable :: values(:)
    integer :: at, count

    count = nint(setting%reals(3))
    associate (first => setting%reals(1), last => setting%reals(2))
      allocate (values(count))
      do at = 1, count
        values(at) = first + (at - 1)*((last - first)/max(count - 1, 1))
      end do
      values = twelve_digits(values)
      if (whole) values = anint(values)
      ! What the user wrote stays as it is.
      if (.not. whole) values(1) = first
      if (.not. whole .and. count > 1) values(count) = last
    end associate
  end function range_of

  !> A run has one length: in collisions or in time.
  subroutine check_pairs(settings)
    type(settings_type), intent(inout) :: settings
    integer :: duration, other
    logical :: in_time

    duration = find_setting(settings, 'run', 'duration')
    in_time = .false.
    if (settings%all(duration)%known) in_time = settings%all(duration)%reals(1) > 0.0_wp
    if (.not. in_time) return
    other = find_setting(settings, 'run', 'collisions')
    if (settings%all(other)%given) call add_problem(settings, problem_type('run', 'collisions', &
      'is given beside duration', 'one of the two'))
    other = find_setting(settings, 'run', 'transient_collisions')
    if (settings%all(other)%given) call add_problem(settings, problem_type('run', &
      'transient_collisions', 'is given beside duration', 'transient_duration'))
  end subroutine check_pairs

  !> Adds a problem of the plan, at the line where its key is.
  subroutine add_problem(settings, problem)
    type(settings_type), intent(inout) :: settings
    type(problem_type), intent(in) :: problem
    integer :: place, line
    character(len=:), allocatable :: joint

    place = find_setting(settings, problem%group, problem%key)
    if (problem%group == 'scan' .and. .not. settings%all(place)%given .and. &
      settings%all(min(place + 1, size(settings%all)))%key%is_range) place = place + 1
    line = 0
    if (settings%all(place)%given) line = settings%all(place)%line
    ! A key that was refused already is not refused again.
    if (settings%all(place)%given .and. .not. settings%all(place)%known) return
    joint = ' = '
    if (index(problem%value, 'is ') == 1) joint = ' '
    call add_remark(settings%problems, line, '&'//problem%group//' ' &
      //trim(settings%all(place)%key%name)//joint//problem%value//'; allowed: '//problem%allowed)
  end subroutine add_problem

  !> One error from all problems, in the order of the lines; none if there are none.
  subroutine report(name, settings, error)
    !> Stands for the file in the message.
    character(len=*), intent(in) :: name
    type(settings_type), intent(in) :: settings
    !> Code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error

    if (settings%problems%count > 0) &
      call fatal_error(error, remarks_text(settings%problems, name), exit_bad_input)
  end subroutine report

  !> The keys in which two inputs differ, one a line with both values; empty if they make the same
  !> run. Ways of writing, defaults, limits and the name of the output file make no difference.
  function differing_keys(old, new) result(text)
    !> Texts of two namelists that were read without an error.
    character(len=*), intent(in) :: old, new
    character(len=:), allocatable :: text
    type(settings_type) :: before, now
    integer :: at

    call read_settings(old, all_keys(), before)
    call read_settings(new, all_keys(), now)
    text = ''
    do at = 1, size(now%all)
      if (.not. now%all(at)%key%decides) cycle
      if (before%all(at)%canonical == now%all(at)%canonical) cycle
      if (text /= '') text = text//new_line_character
      text = text//'&'//trim(now%all(at)%key%group)//' '//trim(now%all(at)%key%name)//': was ' &
        //value_text(before%all(at)%canonical)//', is '//value_text(now%all(at)%canonical)
    end do
  end function differing_keys

  pure function value_text(canonical) result(text)
    character(len=*), intent(in) :: canonical
    character(len=:), allocatable :: text

    text = shown_text(trim(adjustl(canonical)))
    if (text == '') text = 'not given'
  end function value_text

end module battery_namelist_input
