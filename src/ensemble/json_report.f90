!> JSON report of a run or a plan for scripts, written to a file: standard output is for people, and
!> a launcher may change it.
module battery_json_report
  use battery_kinds, only: dp
  use battery_error, only: error_type, fatal_error, exit_failure
  use battery_paths, only: real_folder_of
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: write_run_json, write_plan_json

contains

  !> Writes the absolute path of the results file; null if there is none.
  subroutine write_run_json(path, results, error)
    !> Path of the JSON file; empty: none is written.
    character(len=*), intent(in) :: path
    !> Path of the results file, relative to the working directory.
    character(len=*), intent(in) :: results
    !> The JSON file cannot be written.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: folder, place

    folder = real_folder_of(results)
    place = 'null'
    if (folder /= '') &
      place = json_text(folder//'/'//results(index(results, '/', back=.true.) + 1:))
    call write_members(path, '"results": '//place, error)
  end subroutine write_run_json

  !> Writes the number of tasks of a plan, and its estimated time and memory.
  subroutine write_plan_json(path, tasks, pending, seconds, memory, error)
    !> Path of the JSON file; empty: none is written.
    character(len=*), intent(in) :: path
    !> All tasks, and those that are still to be done.
    integer, intent(in) :: tasks, pending
    !> Processor time of one task in seconds; bytes of memory per rank.
    real(dp), intent(in) :: seconds, memory
    !> The JSON file cannot be written.
    type(error_type), allocatable, intent(out) :: error
    character(len=24) :: numbers(2)

    write (numbers, '(es24.9e3)') seconds, memory
    call write_members(path, '"tasks": '//to_text(tasks)//', "pending": '//to_text(pending) &
      //', "seconds_a_task": '//trim(adjustl(numbers(1)))//', "memory_a_rank": ' &
      //trim(adjustl(numbers(2))), error)
  end subroutine write_plan_json

  !> Writes an object with these members.
  subroutine write_members(path, members, error)
    character(len=*), intent(in) :: path, members
    type(error_type), allocatable, intent(out) :: error
    character(len=256) :: reason
    integer :: unit, status

    if (path == '') return
    open (newunit=unit, file=path, status='replace', action='write', form='unformatted', &
      access='stream', iostat=status, iomsg=reason)
    if (status == 0) write (unit, iostat=status, iomsg=reason) '{'//members//'}'//achar(10)
    if (status == 0) close (unit, iostat=status, iomsg=reason)
    if (status /= 0) call fatal_error(error, '--json '//path//': '//trim(reason), exit_failure)
  end subroutine write_members

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
