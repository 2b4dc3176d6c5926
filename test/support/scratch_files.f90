!> Files of a test, which belong to its process.
module scratch_files
  use battery_process, only: process_number
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: scratch, write_text

contains

  !> Path in the build folder, with a name at its end if one is given.
  function scratch(name) result(path)
    character(len=*), intent(in), optional :: name
    character(len=:), allocatable :: path

    path = 'build/test_'//to_text(process_number())
    if (present(name)) path = path//'_'//name
  end function scratch

  !> Writes a file that holds a text and nothing else.
  subroutine write_text(path, text)
    character(len=*), intent(in) :: path, text
    integer :: unit

    open (newunit=unit, file=path, access='stream', form='unformatted', status='replace')
    write (unit) text
    close (unit)
  end subroutine write_text

end module scratch_files
