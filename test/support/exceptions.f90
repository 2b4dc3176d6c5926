!> Failures of asserts, for the substitute of pFUnit: each has a message and a source location.
!>
!> Names that tests or pFUnit's preprocessor write are spelt as pFUnit spells them.
module funit_exceptions
  implicit none (type, external)
  private
  public :: SourceLocation, exception_type, throw, anyExceptions, fail_with
  public :: take_exceptions, same_exception

  !> A line of a test file.
  type :: SourceLocation
    character(len=255) :: fileName = ""
    integer :: lineNumber = -1
  end type SourceLocation

  !> One failure.
  type :: exception_type
    character(len=:), allocatable :: message
    type(SourceLocation) :: location
  end type exception_type

  !> Failures of the test that runs; one test runs at a time.
  type(exception_type), allocatable :: pending(:)

contains

  !> Adds a failure; the test continues until it calls `anyExceptions`.
  subroutine throw(message, location)
    character(len=*), intent(in) :: message
    type(SourceLocation), intent(in), optional :: location
    type(exception_type), allocatable :: longer(:)
    integer :: n

    n = 0
    if (allocated(pending)) n = size(pending)
    allocate (longer(n + 1))
    if (n > 0) longer(:n) = pending
    longer(n + 1)%message = trim(message)
    if (present(location)) longer(n + 1)%location = location
    call move_alloc(longer, pending)
  end subroutine throw

  !> Throws the finding of an assert, after the test's own message if there is one.
  subroutine fail_with(finding, message, location)
    character(len=*), intent(in) :: finding
    character(len=*), intent(in), optional :: message
    type(SourceLocation), intent(in), optional :: location

    if (present(message)) then
      call throw(trim(message)//new_line("a")//finding, location)
    else
      call throw(finding, location)
    end if
  end subroutine fail_with

  !> Whether the test that runs has failed so far.
  logical function anyExceptions() result(any_pending)
    any_pending = allocated(pending)
  end function anyExceptions

  !> Returns all failures and clears the list.
  subroutine take_exceptions(taken)
    type(exception_type), allocatable, intent(out) :: taken(:)

    if (allocated(pending)) then
      call move_alloc(pending, taken)
    else
      allocate (taken(0))
    end if
  end subroutine take_exceptions

  !> Whether two failures have the same message and the same line.
  pure logical function same_exception(one, other) result(same)
    type(exception_type), intent(in) :: one, other

    same = one%message == other%message .and. one%location%fileName == other%location%fileName &
      .and. one%location%lineNumber == other%location%lineNumber
  end function same_exception

end module funit_exceptions
