!> The files of a journal by their names: listing them, finding obstacles, removing them.
module battery_journal_folder
  use battery_error, only: error_type, fatal_error
  use battery_files, only: files_matching, remove_file
  use battery_paths, only: is_folder
  use battery_text, only: string_type, to_text
  implicit none (type, external)
  private
  public :: numbers_in, check_journal, remove_journal

contains

  !> Numbers of the rank files in the folder, in any order. Names whose suffix is not the number of
  !> a rank file are ignored.
  function numbers_in(folder) result(numbers)
    !> Folder of a journal, which need not be there.
    character(len=*), intent(in) :: folder
    integer, allocatable :: numbers(:)
    type(string_type), allocatable :: names(:)
    integer :: k, found, status

    names = files_matching(folder, 'rank_*')
    allocate (numbers(size(names)))
    found = 0
    do k = 1, size(names)
      read (names(k)%text(6:), *, iostat=status) numbers(found + 1)
      if (status /= 0) cycle
      if (names(k)%text /= 'rank_'//to_text(numbers(found + 1))) cycle
      if (numbers(found + 1) >= 0 .and. numbers(found + 1) < huge(1)) found = found + 1
    end do
    numbers = numbers(:found)
  end function numbers_in

  !> An error if a folder has the name of a file of the journal.
  subroutine check_journal(folder, error)
    !> Folder of a journal, which need not be there.
    character(len=*), intent(in) :: folder
    type(error_type), allocatable, intent(out) :: error
    type(string_type), allocatable :: names(:)
    integer :: k

    names = journal_files(folder)
    do k = 1, size(names)
      if (.not. is_folder(folder//'/'//names(k)%text)) cycle
      call fatal_error(error, folder//'/'//names(k)%text &
        //': is a folder where a file should be; remove it')
      return
    end do
  end subroutine check_journal

  !> Names of all journal files in the folder, the plan last.
  function journal_files(folder) result(names)
    character(len=*), intent(in) :: folder
    type(string_type), allocatable :: names(:)

    names = [files_matching(folder, 'rank_*'), files_matching(folder, 'task_*.a'), &
      files_matching(folder, 'task_*.b'), files_matching(folder, 'plan.new'), &
      files_matching(folder, 'plan')]
  end function journal_files

  !> Removes the journal with all its files, the plan last. A folder with any other file stays.
  subroutine remove_journal(folder, error)
    !> Folder of a journal, which need not be there.
    character(len=*), intent(in) :: folder
    type(error_type), allocatable, intent(out) :: error
    type(string_type), allocatable :: names(:)
    integer :: k

    if (.not. is_folder(folder)) return
    names = journal_files(folder)
    do k = 1, size(names)
      call remove_file(folder//'/'//names(k)%text, error)
      if (allocated(error)) return
    end do
    if (size(files_matching(folder, '*')) == 0) call remove_file(folder, error)
  end subroutine remove_journal

end module battery_journal_folder
