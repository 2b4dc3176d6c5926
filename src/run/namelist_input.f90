!> From a namelist file to a plan: reads, checks, and tells all problems in one error, each with
!> file, line, group, key, value and what is allowed.
module battery_namelist_input
  use battery_kinds, only: wp, int64
  use battery_error, only: error_type, fatal_error, exit_failure, exit_bad_input
  use battery_fingerprint, only: fingerprint_of, mix_word
  use battery_text, only: to_text, new_line_character
  use battery_file_text, only: read_text, read_input
  use battery_files, only: is_writable, file_exists
  use battery_paths, only: is_folder, is_pipe_or_device, same_file, folder_of, real_folder_of, &
    follow_links
  use battery_engine, only: particles_type
  use battery_remarks, only: remarks_type, add_remark, remarks_text, shown_text
  use battery_namelist_settings, only: settings_type, read_settings, find_setting
  use battery_initial_state, only: read_particles, are_inside
  use battery_plan, only: plan_type, point_type, problem_type, complete_plan, point_of, &
    table_of
  implicit none (type, external)
  private
  public :: read_namelist, parse_namelist, differing_keys, file_fingerprint

  !> Bytes of the longest namelist; what is longer is no namelist.
  integer(int64), parameter :: longest_namelist = 64000000_int64

contains

  !> The plan that a file describes. Looks at files too: the initial file must be good, and
  !> the results must have a place to go. Writes nothing. The file may be a pipe, which can be read
  !> once only, so one rank calls this and passes on what it found.
  subroutine read_namelist(file, plan, error)
    character(len=*), intent(in) :: file
    type(plan_type), intent(out) :: plan
    !> Code `exit_bad_input`; all problems, one a line.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: text
    type(settings_type) :: settings

    call read_input(file, longest_namelist, text, error)
    if (allocated(error)) then
      if (error%code == exit_failure) error%code = exit_bad_input
      return
    end if
    call read_settings(text, settings)
    call fill_plan(settings, text, file, plan)
    call check_files(settings, plan)
    call report(file, settings%problems, error)
    call check_initial_file(plan, error)
    if (allocated(error) .or. plan%initial_file == '') return
    call file_fingerprint(plan%initial_file, plan%initial_fingerprint, error)
    call mix_word(plan%fingerprint, plan%initial_fingerprint)
  end subroutine read_namelist

  !> The fingerprint of what is in a file.
  subroutine file_fingerprint(file, fingerprint, error)
    character(len=*), intent(in) :: file
    integer(int64), intent(out) :: fingerprint
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: text

    call read_text(file, text, error)
    fingerprint = fingerprint_of(text)
  end subroutine file_fingerprint

  !> The plan that a text describes; `name` stands for the file in messages. Does not look at files.
  subroutine parse_namelist(text, name, plan, error)
    character(len=*), intent(in) :: text, name
    type(plan_type), intent(out) :: plan
    type(error_type), allocatable, intent(out) :: error
    type(settings_type) :: settings

    call read_settings(text, settings)
    call fill_plan(settings, text, name, plan)
    call report(name, settings%problems, error)
  end subroutine parse_namelist

  !> Sets the components of a plan, and lets it check itself.
  subroutine fill_plan(settings, text, name, plan)
    type(settings_type), intent(inout) :: settings
    character(len=*), intent(in) :: text, name
    type(plan_type), intent(out) :: plan
    type(problem_type), allocatable :: problems(:)
    integer :: at

    plan%text = text
    plan%input_file = name
    plan%fingerprint = fingerprint_of(deciding_text(settings))
    call fill_components(settings, plan)
    call fill_scan(settings, plan)
    call check_pairs(settings)
    call complete_plan(plan, problems)
    do at = 1, size(problems)
      call add_problem(settings, problems(at))
    end do
  end subroutine fill_plan

  subroutine fill_components(settings, plan)
    type(settings_type), intent(in) :: settings
    type(plan_type), intent(inout) :: plan

    plan%shape = text_of('table', 'shape')
    call set_real('table', 'urn_radius', plan%urn_radius)
    call set_real('table', 'channel1_width', plan%channel1_width)
    call set_real('table', 'channel1_length', plan%channel1_length)
    call set_real('table', 'channel2_width', plan%channel2_width)
    call set_real('table', 'channel2_length', plan%channel2_length)
    call set_integer('particles', 'number', plan%number)
    call set_integer('particles', 'urn1_number', plan%urn1_number)
    call set_long('particles', 'seed', plan%seed)
    plan%initial_file = text_of('particles', 'initial_file')
    call set_integer('gate', 'threshold', plan%threshold)
    call set_real('gate', 'threshold_fraction', plan%threshold_fraction)
    plan%engine = text_of('run', 'engine')
    call set_long('run', 'collisions', plan%collisions)
    call set_long('run', 'transient_collisions', plan%transient_collisions)
    call set_real('run', 'duration', plan%duration)
    call set_real('run', 'transient_duration', plan%transient_duration)
    call set_real('run', 'start_time', plan%start_time)
    call set_real('run', 'time_step', plan%time_step)
    call set_integer('scan', 'replicas', plan%replicas)
    plan%file = text_of('output', 'file')
    call set_real('output', 'series_interval', plan%series_interval)
    plan%snapshot_times = settings%all(find_setting(settings, 'output', 'snapshot_times'))%reals
    plan%event_log = settings%all(find_setting(settings, 'output', 'event_log'))%flag
    plan%final_state = settings%all(find_setting(settings, 'output', 'final_state'))%flag
    call set_real('limits', 'wall_minutes', plan%wall_minutes)
    call set_real('limits', 'checkpoint_minutes', plan%checkpoint_minutes)

  contains

    subroutine set_real(group, name, number)
      character(len=*), intent(in) :: group, name
      real(wp), intent(inout) :: number

      associate (setting => settings%all(find_setting(settings, group, name)))
        if (setting%known) number = setting%reals(1)
      end associate
    end subroutine set_real

    subroutine set_long(group, name, number)
      character(len=*), intent(in) :: group, name
      integer(int64), intent(inout) :: number

      associate (setting => settings%all(find_setting(settings, group, name)))
        if (setting%known) number = setting%integers(1)
      end associate
    end subroutine set_long

    subroutine set_integer(group, name, number)
      character(len=*), intent(in) :: group, name
      integer, intent(inout) :: number
      integer(int64) :: long

      long = number
      call set_long(group, name, long)
      number = int(long)
    end subroutine set_integer

    function text_of(group, name) result(text)
      character(len=*), intent(in) :: group, name
      character(len=:), allocatable :: text

      text = settings%all(find_setting(settings, group, name))%text
    end function text_of

  end subroutine fill_components

  !> Lists of the scan, each from itself or from its range.
  subroutine fill_scan(settings, plan)
    type(settings_type), intent(inout) :: settings
    type(plan_type), intent(inout) :: plan
    real(wp), allocatable :: list(:)

    call take_list(settings, 'threshold', list)
    plan%scan_threshold = nint(list)
    call take_list(settings, 'number', list)
    plan%scan_number = nint(list)
    call take_list(settings, 'threshold_fraction', plan%scan_threshold_fraction)
    call take_list(settings, 'channel1_width', plan%scan_channel1_width)
    call take_list(settings, 'channel2_width', plan%scan_channel2_width)
    call take_list(settings, 'urn1_fraction', plan%scan_urn1_fraction)
  end subroutine fill_scan

  !> The values of a list or of its range; a range of whole numbers is rounded by the caller.
  subroutine take_list(settings, name, list)
    type(settings_type), intent(inout) :: settings
    character(len=*), intent(in) :: name
    real(wp), allocatable, intent(out) :: list(:)
    real(wp) :: step
    integer :: at, count

    allocate (list(0))
    associate (setting => settings%all(find_setting(settings, 'scan', name)), &
      range => settings%all(find_setting(settings, 'scan', name//'_range')))
      if (setting%given .and. range%given) then
        call add_problem(settings, problem_type('scan', name//'_range', &
          'is given beside '//name, 'one of the two'))
      else if (setting%given .and. setting%known) then
        list = setting%reals
        if (size(list) == 0) list = real(setting%integers, wp)
      else if (range%given .and. range%known) then
        count = nint(range%reals(3))
        step = (range%reals(2) - range%reals(1))/max(count - 1, 1)
        list = [(range%reals(1) + at*step, at=0, count - 1)]
        if (count > 1) list(count) = range%reals(2)
        if (any(list > range%key%most) .and. (name == 'number' .or. name == 'threshold')) then
          call add_problem(settings, problem_type('scan', name//'_range', &
            to_text(maxval(list)), 'numbers up to '//to_text(range%key%most)))
          list = [real(wp) ::]
        end if
      end if
    end associate
  end subroutine take_list

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

  !> The results must have a place to go, which is no input's; an output that is a link is what it
  !> points to.
  subroutine check_files(settings, plan)
    type(settings_type), intent(inout) :: settings
    type(plan_type), intent(inout) :: plan
    type(error_type), allocatable :: trouble
    character(len=:), allocatable :: folder, reason

    if (is_pipe_or_device(plan%initial_file)) call add_problem(settings, problem_type('particles', &
      'initial_file', ''''//plan%initial_file//''': this is a pipe or a device', 'a file'))
    if (plan%file == '') return
    call follow_links(plan%file, trouble)
    folder = folder_of(plan%file)
    reason = ''
    if (allocated(trouble)) then
      reason = trouble%message
    else if (.not. is_folder(folder)) then
      reason = 'the folder '//folder//' does not exist'
    else if (.not. is_writable(folder)) then
      reason = 'the folder '//folder//' cannot be written to'
    else if (is_folder(plan%file)) then
      reason = 'this is a folder'
    else if (is_pipe_or_device(plan%file)) then
      reason = 'this is a pipe or a device'
    else if (file_exists(plan%file) .and. .not. is_writable(plan%file)) then
      reason = 'the file cannot be written to'
    else if (is_folder(plan%file//'.part')) then
      reason = 'there is a folder '//plan%file//'.part'
    end if
    if (reason == '') reason = trouble_with_input(plan%file, plan%input_file)
    if (reason == '' .and. plan%initial_file /= '') &
      reason = trouble_with_input(plan%file, plan%initial_file)
    if (reason /= '') call add_problem(settings, problem_type('output', 'file', ''''//plan%file &
      //''': '//reason, 'a file in a folder that exists and can be written to'))
  end subroutine check_files

  !> Whether what is written for an output would spoil an input, by whatever names and links; empty:
  !> it would not.
  function trouble_with_input(file, input) result(reason)
    character(len=*), intent(in) :: file, input
    character(len=:), allocatable :: reason

    reason = ''
    if (file == input .or. same_file(file, input)) then
      reason = 'this is an input file'
    else if (same_file(file//'.part', input)) then
      reason = file//'.part, under which it is written first, is an input file'
    else if (same_file(file//'.owner', input)) then
      reason = file//'.owner, which says who writes it, is an input file'
    else if (same_file(file//'.tasks', real_folder_of(input)) .or. &
      same_file(file//'.tasks', folder_of(input))) then
      reason = 'the folder '//file//'.tasks, which is removed in the end, has an input file in it'
    else if (same_file(file//'.tasks', input)) then
      reason = file//'.tasks, a folder for what is unfinished, is an input file'
    end if
  end function trouble_with_input

  !> The initial file must suit the table of every point; its problems join those of the namelist.
  !> It says how many start in urn 1.
  subroutine check_initial_file(plan, error)
    type(plan_type), intent(inout) :: plan
    type(error_type), allocatable, intent(inout) :: error
    type(point_type) :: point, before
    type(particles_type) :: particles
    integer :: at

    if (plan%initial_file == '') return
    if (allocated(error)) then
      point = point_type(plan%number, 0, 0, plan%channel1_width, plan%channel2_width)
      call try_initial_file(plan, point, particles, error)
      return
    end if
    before = point_of(plan, 1)
    call try_initial_file(plan, before, particles, error)
    do at = 2, plan%point_count
      if (allocated(error)) return
      point = point_of(plan, at)
      if (same_widths(point, before)) cycle
      ! Read again only to say what is wrong.
      if (.not. are_inside(table_of(plan, point), particles)) &
        call try_initial_file(plan, point, particles, error)
      before = point
    end do
    if (.not. allocated(error)) plan%urn1_number = count(particles%x < 0.0_wp)
  end subroutine check_initial_file

  !> Whether two points have the same table.
  pure function same_widths(one, other) result(same)
    type(point_type), intent(in) :: one, other
    logical :: same

    same = .not. (abs(one%channel1_width - other%channel1_width) > 0.0_wp .or. &
      abs(one%channel2_width - other%channel2_width) > 0.0_wp)
  end function same_widths

  !> Reads the initial file for one point; adds its problems to those there are. Where the widths or
  !> the number of the point are themselves wrong, there is nothing to hold the file against.
  subroutine try_initial_file(plan, point, particles, error)
    type(plan_type), intent(in) :: plan
    type(point_type), intent(in) :: point
    type(particles_type), intent(out) :: particles
    type(error_type), allocatable, intent(inout) :: error
    type(error_type), allocatable :: trouble
    character(len=:), allocatable :: message

    ! That is said already, and reading it might never end.
    if (is_pipe_or_device(plan%initial_file)) return
    if (file_exists(plan%initial_file)) then
      if (point%number < 1 .or. .not. max(point%channel1_width, point%channel2_width) &
        < 2.0_wp*plan%urn_radius) return
    end if
    call read_particles(plan%initial_file, table_of(plan, point), max(point%number, 0), particles, &
      trouble)
    if (.not. allocated(trouble)) return
    message = plan%input_file//': &particles initial_file = '''//plan%initial_file &
      //''' cannot be used:'//new_line_character//trouble%message
    if (allocated(error)) message = error%message//new_line_character//message
    call fatal_error(error, message, exit_bad_input)
  end subroutine try_initial_file

  !> Adds a problem of the plan, at the line where its key is.
  subroutine add_problem(settings, problem)
    type(settings_type), intent(inout) :: settings
    type(problem_type), intent(in) :: problem
    integer :: place, line
    character(len=:), allocatable :: joint

    place = find_setting(settings, problem%group, problem%key)
    if (problem%group == 'scan' .and. .not. settings%all(place)%given .and. &
      problem%key /= 'replicas') place = find_setting(settings, 'scan', problem%key//'_range')
    line = 0
    if (settings%all(place)%given) line = settings%all(place)%line
    ! A key that was refused already is not refused again.
    if (settings%all(place)%given .and. .not. settings%all(place)%known) return
    joint = ' = '
    if (index(problem%value, 'is ') == 1) joint = ' '
    call add_remark(settings%problems, line, '&'//problem%group//' ' &
      //settings%all(place)%key%name//joint//problem%value//'; allowed: '//problem%allowed)
  end subroutine add_problem

  !> One error from all problems, in the order of the lines; none if there are none.
  subroutine report(name, problems, error)
    character(len=*), intent(in) :: name
    type(remarks_type), intent(in) :: problems
    type(error_type), allocatable, intent(out) :: error

    if (problems%count > 0) call fatal_error(error, remarks_text(problems, name), exit_bad_input)
  end subroutine report

  !> The keys in which two inputs differ, one a line with both values; empty if they make the same
  !> run. Ways of writing, defaults, limits and the name of the output file make no difference.
  function differing_keys(old, new) result(text)
    character(len=*), intent(in) :: old, new
    character(len=:), allocatable :: text
    type(settings_type) :: before, now
    integer :: at

    call read_settings(old, before)
    call read_settings(new, now)
    text = ''
    do at = 1, size(now%all)
      if (.not. now%all(at)%key%decides) cycle
      if (before%all(at)%canonical == now%all(at)%canonical) cycle
      if (text /= '') text = text//new_line_character
      text = text//'&'//now%all(at)%key%group//' '//now%all(at)%key%name//': was ' &
        //value_text(before%all(at)%canonical)//', is '//value_text(now%all(at)%canonical)
    end do
  end function differing_keys

  !> All that decides the results, one key a line in one way of writing.
  pure function deciding_text(settings) result(text)
    type(settings_type), intent(in) :: settings
    character(len=:), allocatable :: text
    integer :: at

    text = ''
    do at = 1, size(settings%all)
      associate (setting => settings%all(at))
        if (setting%key%decides) text = text//setting%key%group//' '//setting%key%name//' ' &
          //setting%canonical//new_line_character
      end associate
    end do
  end function deciding_text

  pure function value_text(canonical) result(text)
    character(len=*), intent(in) :: canonical
    character(len=:), allocatable :: text

    text = shown_text(trim(adjustl(canonical)))
    if (text == '') text = 'not given'
  end function value_text

end module battery_namelist_input
