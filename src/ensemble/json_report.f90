!> JSON report of a run or a plan for scripts, written to a file: standard output is for people, and
!> a launcher may change it. No file is replaced but one that this module wrote.
module battery_json_report
  use battery_error, only: error_type, fatal_error, exit_failure, exit_bad_input
  use battery_file_text, only: read_input, write_file, is_standard_output
  use battery_files, only: file_exists
  use battery_input_files, only: part_of_output, reason_unwritable
  use battery_kinds, only: int64
  use battery_paths, only: is_pipe_or_device, same_file, real_folder_of
  use battery_plan, only: plan_type
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: check_json_file, write_run_json, write_json

  !> First member of each object, by which its file is recognised.
  character(len=*), parameter :: mark = '{"written_by": "battery --json"'

contains

  !> Checks, before anything is run, that the JSON file can be written and would replace nothing: it
  !> is new, empty, a pipe, a device, standard output, or a file that this module wrote.
  subroutine check_json_file(path, plan, error)
    !> Path of the JSON file; empty: none is written.
    character(len=*), intent(in) :: path
    !> The plan, whose files it must not be.
    type(plan_type), intent(in) :: plan
    !> The file is another one; code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: reason

    if (path == '') return
    reason = part_of_output(plan%file, path)
    if (same_file(path, plan%input_file)) reason = 'the namelist'
    if (same_file(path, plan%initial_file)) reason = 'the initial file'
    ! /dev/null may be the namelist as well.
    if (is_pipe_or_device(path)) reason = ''
    if (reason /= '') then
      reason = 'this is '//reason
    else
      reason = reason_to_keep(path)
    end if
    if (reason /= '') call fatal_error(error, 'battery: --json '//path//': '//reason &
      //'; allowed: a new file, an empty one, a pipe, a device, or what --json wrote before', &
      exit_bad_input)
  end subroutine check_json_file

  !> Why a path cannot be written to, or must not be replaced; empty: it can.
  function reason_to_keep(path) result(reason)
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: reason
    !> Bytes of the longest file of this module: a path has up to 4096, each written as up to six.
    integer(int64), parameter :: longest = 40000_int64
    character(len=:), allocatable :: text
    type(error_type), allocatable :: error

    reason = ''
    if (is_pipe_or_device(path) .or. is_standard_output(path)) return
    reason = reason_unwritable(path, .false.)
    if (reason == '' .and. file_exists(path)) then
      call read_input(path, longest, text, error)
      ! One line: several may be what somebody collected from standard output.
      if (allocated(error) .or. (text /= '' .and. (index(text, mark) /= 1 .or. &
        index(text, achar(10)) /= len(text)))) reason = 'the file has other contents, and is kept'
    end if
  end function reason_to_keep

  !> Writes the absolute path of the results file, null if there is none, and the exit code.
  subroutine write_run_json(path, results, exit_code, error)
    !> Path of the JSON file; empty: none is written.
    character(len=*), intent(in) :: path
    !> Path of the results file, relative to the working directory.
    character(len=*), intent(in) :: results
    integer, intent(in) :: exit_code
    !> The JSON file cannot be written.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: folder, place

    folder = real_folder_of(results)
    place = 'null'
    if (folder /= '') &
      place = json_text(folder//'/'//results(index(results, '/', back=.true.) + 1:))
    call write_json(path, '"results": '//place//', "exit_code": '//to_text(exit_code), error)
  end subroutine write_run_json

  !> Writes an object with these members behind its mark.
  subroutine write_json(path, members, error)
    !> Path of the JSON file; empty: none is written.
    character(len=*), intent(in) :: path
    !> Names and values, separated by commas.
    character(len=*), intent(in) :: members
    !> The JSON file cannot be written.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: reason

    if (path == '') return
    ! Another program may have put a file there during the run.
    reason = reason_to_keep(path)
    if (reason == '') then
      call write_file(path, mark//', '//members//'}'//achar(10), error)
    else
      call fatal_error(error, path//': '//reason)
    end if
    if (.not. allocated(error)) return
    error%message = 'battery: --json '//error%message
    error%code = exit_failure
  end subroutine write_json

  !> A text as a JSON string, with quotes and escapes.
  pure function json_text(text) result(quoted)
    !> Text of any bytes.
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: quoted
    integer, parameter :: first_printable = 32
    character(len=2) :: hexadecimal
    integer :: at

    quoted = '"'
    do at = 1, len(text)
      if (iachar(text(at:at)) < first_printable) then
        write (hexadecimal, '(z2.2)') iachar(text(at:at))
        quoted = quoted//achar(92)//'u00'//hexadecimal
      else
        if (scan(text(at:at), achar(92)//'"') > 0) quoted = quoted//achar(92)
        quoted = quoted//text(at:at)
      end if
    end do
    quoted = quoted//'"'
  end function json_text

end module battery_json_report
