!> Substitute for the part of pFUnit's module `funit` that the project's tests use.
!>
!> Tests are written for pFUnit 4 and run with it unchanged; where it is not installed, this module
!> replaces it. Names and the format of the report are those of pFUnit.
module funit
  use, intrinsic :: iso_fortran_env, only: output_unit
  use funit_exceptions, only: SourceLocation, exception_type, anyExceptions, fail_with, &
    take_exceptions
  use funit_int8, only: assertEqual, assertLessThan
  use funit_int32, only: assertEqual, assertLessThan
  use funit_int64, only: assertEqual, assertLessThan
  use funit_real32, only: assertEqual, assertLessThan
  use funit_real64, only: assertEqual, assertLessThan
  use funit_widest_real, only: assertEqual, assertLessThan
  implicit none (type, external)
  private
  public :: SourceLocation, anyExceptions
  public :: assertTrue, assertFalse, assertEqual, assertLessThan
  public :: Test, TestMethod, TestSuite, SerialContext
  public :: initialize, run, run_in, finalize, stub

  interface assertTrue
    procedure true_scalar, true_vector
  end interface assertTrue

  interface assertFalse
    procedure false_scalar, false_vector
  end interface assertFalse

  interface assertEqual
    procedure equal_character, equal_logical
  end interface assertEqual

  !> The processes that run a test: here one; module `pfunit` extends it to several.
  type :: SerialContext
    !> Whether this process reports.
    logical :: root = .true.
  contains
    procedure :: gather
  end type SerialContext

  !> One test of any kind.
  type, abstract :: Test
    character(len=:), allocatable :: name
  contains
    procedure(run_test), deferred :: run
  end type Test

  abstract interface
    !> Runs the test; failures are thrown.
    subroutine run_test(this)
      import :: Test
      implicit none (type, external)
      class(Test), intent(inout) :: this
    end subroutine run_test

    !> A test procedure.
    subroutine plain_procedure()
      implicit none (type, external)
    end subroutine plain_procedure
  end interface

  !> A test that is a procedure without arguments.
  type, extends(Test) :: TestMethod
    procedure(plain_procedure), pointer, nopass :: method => null()
  contains
    procedure :: run => run_method
  end type TestMethod

  interface TestMethod
    procedure new_test_method
  end interface TestMethod

  type :: test_holder
    class(Test), allocatable :: item
  end type test_holder

  !> Tests in the order they were added, under their full names.
  type :: TestSuite
    character(len=:), allocatable :: name
    type(test_holder), allocatable :: tests(:)
  contains
    procedure, private :: add_one, add_suite
    generic :: addTest => add_one, add_suite
  end type TestSuite

  interface TestSuite
    procedure new_test_suite
  end interface TestSuite

  abstract interface
    function suite_loader() result(suite)
      import :: TestSuite
      implicit none (type, external)
      type(TestSuite) :: suite
    end function suite_loader
  end interface

contains

  !> A test of `method`.
  function new_test_method(name, method) result(this)
    character(len=*), intent(in) :: name
    procedure(plain_procedure) :: method
    type(TestMethod) :: this

    this%name = name
    this%method => method
  end function new_test_method

  subroutine run_method(this)
    class(TestMethod), intent(inout) :: this

    call this%method()
  end subroutine run_method

  !> An empty suite.
  function new_test_suite(name) result(suite)
    character(len=*), intent(in), optional :: name
    type(TestSuite) :: suite

    suite%name = ""
    if (present(name)) suite%name = name
    allocate (suite%tests(0))
  end function new_test_suite

  subroutine add_one(this, one)
    class(TestSuite), intent(inout) :: this
    class(Test), intent(in) :: one
    type(test_holder), allocatable :: longer(:)
    integer :: i, n

    n = size(this%tests)
    allocate (longer(n + 1))
    do i = 1, n
      call move_alloc(this%tests(i)%item, longer(i)%item)
    end do
    allocate (longer(n + 1)%item, source=one)
    if (len(this%name) > 0) longer(n + 1)%item%name = this%name//"."//one%name
    call move_alloc(longer, this%tests)
  end subroutine add_one

  subroutine add_suite(this, suite)
    class(TestSuite), intent(inout) :: this
    type(TestSuite), intent(in) :: suite
    integer :: i

    do i = 1, size(suite%tests)
      call this%addTest(suite%tests(i)%item)
    end do
  end subroutine add_suite

  !> Gathers all failures of a test on the root process; a single process has them already.
  subroutine gather(this, failures)
    class(SerialContext), intent(in) :: this
    type(exception_type), allocatable, intent(out) :: failures(:)

    if (this%root) call take_exceptions(failures)
  end subroutine gather

  !> Prepares for the tests; `extra` is the user's own preparation.
  subroutine initialize(extra)
    procedure(plain_procedure) :: extra

    call extra()
  end subroutine initialize

  !> Runs the tests of `load_tests` on this one process; returns whether all passed.
  logical function run(load_tests) result(passed)
    procedure(suite_loader) :: load_tests
    type(TestSuite) :: suite

    suite = load_tests()
    passed = run_in(suite, SerialContext())
  end function run

  !> Runs a suite on the processes of `context`; the root reports.
  logical function run_in(suite, context) result(passed)
    type(TestSuite), intent(inout) :: suite
    class(SerialContext), intent(in) :: context
    integer :: i, failed

    failed = 0
    do i = 1, size(suite%tests)
      if (.not. passes(suite%tests(i)%item, context)) failed = failed + 1
    end do
    passed = failed == 0
    if (.not. context%root) return
    write (output_unit, "(a)") merge("OK         ", "FAILURES!!!", passed)
    write (output_unit, "(a,i0,a,i0,a)") "Tests run: ", size(suite%tests), ", Failures: ", failed, &
      ", Errors: 0, Disabled: 0"
  end function run_in

  !> Runs one test and reports it at once, so that it is reported even if the next test crashes.
  logical function passes(one, context)
    class(Test), intent(inout) :: one
    class(SerialContext), intent(in) :: context
    type(exception_type), allocatable :: failures(:)
    integer :: i

    if (context%root) write (output_unit, "(a)") "Start: <"//one%name//">"
    flush (output_unit)
    call one%run()
    call context%gather(failures)
    passes = size(failures) == 0
    if (.not. context%root) return
    do i = 1, size(failures)
      write (output_unit, "(a)") "Failure", " in: ", one%name, "  Location: "
      write (output_unit, "(a,i0,a)") "["//trim(failures(i)%location%fileName)//":", &
        failures(i)%location%lineNumber, "]"
      write (output_unit, "(a)") failures(i)%message, ""
    end do
    write (output_unit, "(a)") "  end: <"//one%name//">"
    flush (output_unit)
  end function passes

  !> Ends the program, with exit code 2 if a test failed.
  subroutine finalize(extra, successful)
    procedure(plain_procedure) :: extra
    logical, intent(in) :: successful

    call extra()
    if (.not. successful) stop 2
  end subroutine finalize

  !> Does nothing; for drivers that need no preparation of their own.
  subroutine stub()
  end subroutine stub

  subroutine true_scalar(condition, message, location)
    logical, intent(in) :: condition
    character(len=*), intent(in), optional :: message
    type(SourceLocation), intent(in), optional :: location

    if (.not. condition) call fail_with("false, not true", message, location)
  end subroutine true_scalar

  subroutine true_vector(condition, message, location)
    logical, intent(in) :: condition(:)
    character(len=*), intent(in), optional :: message
    type(SourceLocation), intent(in), optional :: location

    if (.not. all(condition)) call fail_with("not all are true", message, location)
  end subroutine true_vector

  subroutine false_scalar(condition, message, location)
    logical, intent(in) :: condition
    character(len=*), intent(in), optional :: message
    type(SourceLocation), intent(in), optional :: location

    if (condition) call fail_with("true, not false", message, location)
  end subroutine false_scalar

  subroutine false_vector(condition, message, location)
    logical, intent(in) :: condition(:)
    character(len=*), intent(in), optional :: message
    type(SourceLocation), intent(in), optional :: location

    if (any(condition)) call fail_with("not all are false", message, location)
  end subroutine false_vector

  subroutine equal_logical(expected, actual, message, location)
    logical, intent(in) :: expected, actual
    character(len=*), intent(in), optional :: message
    type(SourceLocation), intent(in), optional :: location

    if (expected .neqv. actual) call fail_with(merge("found true ", "found false", actual), &
      message, location)
  end subroutine equal_logical

  !> Equal but for blanks at both ends, as pFUnit compares by default.
  subroutine equal_character(expected, actual, message, location)
    character(len=*), intent(in) :: expected, actual
    character(len=*), intent(in), optional :: message
    type(SourceLocation), intent(in), optional :: location

    if (adjustl(expected) /= adjustl(actual)) call fail_with("expected <"// &
      trim(adjustl(expected))//">, found <"//trim(adjustl(actual))//">", message, location)
  end subroutine equal_character

end module funit
