!> The files of a run: the namelist, the initial file, and the results file.
module battery_input_files
  use battery_kinds, only: wp, int64
  use battery_error, only: error_type, fatal_error, exit_failure, exit_bad_input
  use battery_fingerprint, only: fingerprint_of
  use battery_text, only: to_text, new_line_character
  use battery_file_text, only: read_file, read_input
  use battery_files, only: is_writable, file_exists
  use battery_paths, only: is_folder, is_pipe_or_device, same_file, folder_of, real_folder_of, &
    follow_links
  use battery_foreign_bytes, only: is_results_file
  use battery_namelist_input, only: check_bytes, read_plan, set_input_error
  use battery_plan_checks, only: are_lengths_known
  use battery_initial_state, only: parse_particles, are_inside, before_crossing
  use battery_plan, only: plan_type, point_type, refuse_value, point_of, point_text, table_of
  implicit none (type, external)
  private
  public :: read_namelist, part_of_output, reason_unwritable

  !> Bytes of the longest namelist; a longer file is taken for no namelist.
  integer(int64), parameter :: longest_namelist = 64000000_int64

contains

  !> Reads a plan from a namelist file, with the particles of its initial file. The initial file
  !> must be valid, and the results file must be writable. Writes nothing. The namelist may be a
  !> pipe, which can be read only once: one rank calls this and shares the plan.
  subroutine read_namelist(file, plan, error)
    !> Path of the namelist.
    character(len=*), intent(in) :: file
    type(plan_type), intent(out) :: plan
    !> All problems, one per line; code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: text

    call read_input(file, longest_namelist, text, error)
    ! Of a file that is too long the first bytes are there.
    if (allocated(error) .and. is_results_file(text)) deallocate (error)
    if (.not. allocated(error)) call check_bytes(text, file, error)
    if (allocated(error)) then
      if (error%code == exit_failure) error%code = exit_bad_input
      return
    end if
    call read_plan(text, file, plan)
    call check_files(plan)
    call set_input_error(plan, error)
    ! Without its lengths there is no table to check the file with.
    if (.not. (plan%settings%has_skipped_text .or. plan%settings%may_lack_a_length) &
      .and. are_lengths_known(plan)) call use_initial_file(plan, error)
  end subroutine read_namelist

  !> Checks that an initial file is no pipe and begins one run, and that a new results file can be
  !> written and would replace no input file; of an output that is a link, the target is checked.
  !> One that is there may be complete and protected: see `check_writable` in `battery_startup`.
  subroutine check_files(plan)
    type(plan_type), intent(inout) :: plan
    type(error_type), allocatable :: error
    character(len=:), allocatable :: reason

    if (is_pipe_or_device(plan%initial_file)) call refuse_value(plan, 'initial_file', &
      ''''//plan%initial_file//''': this is a pipe or a device', 'a file')
    if (plan%initial_file /= '' .and. plan%first_replicas > 1 .and. plan%engine /= 'reservoir') &
      call refuse_value(plan, 'replicas', to_text(plan%first_replicas), &
      '1, and no &precision, since all would be one run, from &particles initial_file')
    if (plan%file == '') return
    call follow_links(plan%file, error)
    if (allocated(error)) then
      reason = error%message
    else
      reason = ''
      if (is_pipe_or_device(plan%file) .or. is_folder(plan%file) .or. .not. &
        file_exists(plan%file)) reason = reason_unwritable(plan%file, .true.)
    end if
    if (reason == '' .and. is_folder(plan%file//'.part')) &
      reason = 'there is a folder '//plan%file//'.part'
    if (reason == '') then
      reason = part_of_output(plan%file, plan%input_file)
      if (reason == '' .and. plan%initial_file /= '') &
        reason = part_of_output(plan%file, plan%initial_file)
      if (reason /= '') reason = 'an input file is '//reason
    end if
    if (reason /= '') call refuse_value(plan, 'file', ''''//plan%file//''': '//reason, &
      'a file in a folder that exists and can be written to')
  end subroutine check_files

  !> Why a file cannot be written; empty: it can.
  function reason_unwritable(path, is_replaced) result(reason)
    !> Path of the file, which need not exist.
    character(len=*), intent(in) :: path
    !> Whether a new file takes its place if it exists: then its folder must be writable.
    logical, intent(in) :: is_replaced
    character(len=:), allocatable :: reason, folder

    folder = folder_of(path)
    reason = ''
    if (.not. is_folder(folder)) then
      reason = 'the folder '//folder//' does not exist'
    else if (.not. is_writable(folder) .and. (is_replaced .or. .not. file_exists(path))) then
      reason = 'the folder '//folder//' cannot be written to'
    else if (is_folder(path)) then
      reason = 'this is a folder'
    else if (is_pipe_or_device(path)) then
      reason = 'this is a pipe or a device'
    else if (file_exists(path) .and. .not. is_writable(path)) then
      reason = 'the file cannot be written to'
    end if
  end function reason_unwritable

  !> What a path is to the output, by whatever names and links; empty: nothing. Such an input file
  !> would be destroyed by the results; such a file of an option would destroy them.
  function part_of_output(file, path) result(part)
    !> Path of the results file, and of the other file, which need not exist.
    character(len=*), intent(in) :: file, path
    character(len=:), allocatable :: part

    part = ''
    if (file == path .or. same_file(file, path)) then
      part = 'the results file'
    else if (same_file(file//'.part', path)) then
      part = file//'.part, under which the results are written first'
    else if (same_file(file//'.owner', path)) then
      part = file//'.owner, which says who writes the results'
    else if (same_file(file//'.partial.h5', path)) then
      part = file//'.partial.h5, the partial results file'
    else if (same_file(file//'.damaged', path)) then
      part = file//'.damaged, the name of a results file that is damaged'
    else if (same_file(file//'.tasks', path)) then
      part = file//'.tasks, the folder for what is unfinished'
    else if (same_file(file//'.tasks', real_folder_of(path)) .or. &
      same_file(file//'.tasks', folder_of(path))) then
      part = 'in the folder '//file//'.tasks, which is removed in the end'
    end if
  end function part_of_output

  !> Reads the initial file, once, and counts its particles in urn 1. All particles must be inside
  !> the table of every point; problems are added to those of the values of the namelist.
  subroutine use_initial_file(plan, error)
    type(plan_type), intent(inout) :: plan
    type(error_type), allocatable, intent(inout) :: error
    type(error_type), allocatable :: particle_error
    character(len=:), allocatable :: text, message, place
    type(point_type) :: point
    integer :: at

    ! A pipe has been refused already, and reading it might never end.
    if (plan%initial_file == '' .or. is_pipe_or_device(plan%initial_file)) return
    call read_file(plan%initial_file, text, particle_error)
    place = ''
    do at = 1, max(1, plan%point_count)
      if (allocated(particle_error)) exit
      point = point_of(plan, at)
      ! If the lengths themselves are wrong, there is no table to check the file with.
      if (allocated(error) .and. .not. (point%number > 0 .and. maxval(point%channel%width) &
        < 2.0_wp*minval(point%urn_radius) .and. plan%urn_shape == 'disc')) return
      ! At further points the file is parsed only for the message.
      if (at > 1) then
        if (are_inside(table_of(plan, point), plan%file_particles)) cycle
      end if
      call parse_particles(text, plan%initial_file, table_of(plan, point), max(point%number, 0), &
        plan%file_particles, particle_error)
      if (allocated(particle_error) .and. at > 1) place = ' where ' &
        //point_text(plan, at, 'initial_file')
    end do
    if (allocated(particle_error)) then
      message = plan%input_file//': &particles initial_file = '''//plan%initial_file &
        //''' cannot be used'//place//':'//new_line_character//particle_error%message
      if (allocated(error)) message = error%message//new_line_character//message
      call fatal_error(error, message, exit_bad_input)
    end if
    if (allocated(error)) return
    plan%initial_fingerprint = fingerprint_of(text)
    associate (start => plan%file_particles)
      plan%base%urn1_number = count(before_crossing(table_of(plan, point_of(plan, 1)), &
        plan%start_time, start%x, start%y, start%ux, start%uy) < 0.0_wp)
    end associate
  end subroutine use_initial_file

end module battery_input_files
