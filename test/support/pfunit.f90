!> Substitute for the part of pFUnit's module `pfunit` that the project's tests use: tests on
!> several MPI processes. See module `funit`. MPI is started only for suites with such tests.
module pfunit
  use, intrinsic :: ieee_exceptions, only: ieee_all, ieee_status_type, ieee_get_status, &
    ieee_set_status, ieee_set_halting_mode
  use mpi_f08, only: MPI_Comm, MPI_Comm_rank, MPI_Comm_size, MPI_Comm_split, MPI_Comm_free, &
    MPI_Gather, MPI_Gatherv, MPI_Bcast, MPI_Init, MPI_Initialized, MPI_Finalize, MPI_COMM_WORLD, &
    MPI_COMM_NULL, MPI_CHARACTER, MPI_INTEGER, MPI_LOGICAL, MPI_UNDEFINED
  use funit_exceptions, only: exception_type, same_exception, take_exceptions, throw
  use funit, only: SourceLocation, anyExceptions, assertTrue, assertFalse, assertEqual, &
    assertLessThan, Test, TestMethod, TestSuite, SerialContext, run_in, stub
  implicit none (type, external)
  private
  public :: SourceLocation, anyExceptions
  public :: assertTrue, assertFalse, assertEqual, assertLessThan
  public :: Test, TestMethod, TestSuite, MpiTestMethod
  public :: initialize, run, finalize, stub

  !> Fields of a failure in a message between processes.
  integer, parameter :: location_width = 255, line_width = 12, length_width = 12
  integer, parameter :: head_width = location_width + line_width + length_width

  !> All processes of the run.
  type, extends(SerialContext) :: MpiContext
    type(MPI_Comm) :: communicator = MPI_COMM_WORLD
  contains
    procedure :: gather
  end type MpiContext

  !> A test that runs on the first `processes` processes.
  type, extends(Test) :: MpiTestMethod
    private
    integer :: processes = 1
    type(MPI_Comm) :: communicator = MPI_COMM_NULL
    procedure(mpi_procedure), pointer, nopass :: method => null()
  contains
    procedure :: run => run_method
    procedure :: getMpiCommunicator
    procedure :: getProcessRank
    procedure :: getNumProcesses
  end type MpiTestMethod

  interface MpiTestMethod
    procedure new_mpi_test_method
  end interface MpiTestMethod

  abstract interface
    subroutine mpi_procedure(this)
      import :: MpiTestMethod
      implicit none (type, external)
      class(MpiTestMethod), intent(inout) :: this
    end subroutine mpi_procedure

    subroutine plain_procedure()
      implicit none (type, external)
    end subroutine plain_procedure

    function suite_loader() result(suite)
      import :: TestSuite
      implicit none (type, external)
      type(TestSuite) :: suite
    end function suite_loader
  end interface

contains

  !> A test of `method` on `npes` processes.
  function new_mpi_test_method(name, method, npes) result(this)
    character(len=*), intent(in) :: name
    procedure(mpi_procedure) :: method
    integer, intent(in) :: npes
    type(MpiTestMethod) :: this
    character(len=16) :: label

    write (label, "(a,i0,a)") "[npes=", npes, "]"
    this%name = name//trim(label)
    this%processes = npes
    this%method => method
  end function new_mpi_test_method

  !> Runs the test on a communicator of its own; the other processes wait for its failures.
  subroutine run_method(this)
    class(MpiTestMethod), intent(inout) :: this
    integer :: rank, available
    logical :: takes_part

    call MPI_Comm_rank(MPI_COMM_WORLD, rank)
    call MPI_Comm_size(MPI_COMM_WORLD, available)
    if (available < this%processes) then
      if (rank == 0) call throw("Insufficient processes to run this test.")
      return
    end if
    takes_part = rank < this%processes
    call MPI_Comm_split(MPI_COMM_WORLD, merge(0, MPI_UNDEFINED, takes_part), rank, &
      this%communicator)
    ! By the rank, not the communicator: gfortran 11 finds no operator(==) in Open MPI's mpi_f08.
    if (.not. takes_part) return
    call this%method(this)
    call MPI_Comm_free(this%communicator)
  end subroutine run_method

  !> Communicator of the processes of this test.
  function getMpiCommunicator(this) result(communicator)
    class(MpiTestMethod), intent(in) :: this
    type(MPI_Comm) :: communicator

    communicator = this%communicator
  end function getMpiCommunicator

  !> Rank of this process in the test's communicator, from 0.
  integer function getProcessRank(this) result(rank)
    class(MpiTestMethod), intent(in) :: this

    call MPI_Comm_rank(this%communicator, rank)
  end function getProcessRank

  !> Number of processes of the test's communicator.
  integer function getNumProcesses(this) result(processes)
    class(MpiTestMethod), intent(in) :: this

    call MPI_Comm_size(this%communicator, processes)
  end function getNumProcesses

  !> Gathers the failures of all processes on the root, each once, with the ranks that had it.
  subroutine gather(this, failures)
    class(MpiContext), intent(in) :: this
    type(exception_type), allocatable, intent(out) :: failures(:)
    type(exception_type), allocatable :: own(:)
    character(len=:), allocatable :: packed, all_packed
    integer, allocatable :: lengths(:), offsets(:)
    integer :: processes, i

    call take_exceptions(own)
    packed = pack_failures(own)
    call MPI_Comm_size(this%communicator, processes)
    allocate (lengths(processes), offsets(processes))
    lengths = 0
    call MPI_Gather(len(packed), 1, MPI_INTEGER, lengths, 1, MPI_INTEGER, 0, this%communicator)
    offsets = [(sum(lengths(:i - 1)), i=1, processes)]
    allocate (character(len=sum(lengths)) :: all_packed)
    call MPI_Gatherv(packed, len(packed), MPI_CHARACTER, all_packed, lengths, offsets, &
      MPI_CHARACTER, 0, this%communicator)
    call unpack_failures(all_packed, lengths, failures)
  end subroutine gather

  !> The failures as one text: file name, line, length of the message, message.
  pure function pack_failures(failures) result(packed)
    type(exception_type), intent(in) :: failures(:)
    character(len=:), allocatable :: packed
    character(len=head_width) :: head
    integer :: i

    packed = ""
    do i = 1, size(failures)
      write (head, "(a,i12,i12)") failures(i)%location%fileName, failures(i)%location%lineNumber, &
        len(failures(i)%message)
      packed = packed//head//failures(i)%message
    end do
  end function pack_failures

  !> The failures of all processes; `lengths` are those of their texts.
  pure subroutine unpack_failures(packed, lengths, failures)
    character(len=*), intent(in) :: packed
    integer, intent(in) :: lengths(:)
    type(exception_type), allocatable, intent(out) :: failures(:)
    type(exception_type) :: failure
    type(exception_type), allocatable :: found(:)
    character(len=:), allocatable :: ranks(:)
    integer :: position, rank, finish, message_length, i, n

    n = 0
    position = 0
    finish = 0
    allocate (found(len(packed)/head_width))
    allocate (character(len=8*size(lengths)) :: ranks(size(found)))
    do rank = 1, size(lengths)
      finish = finish + lengths(rank)
      do while (position < finish)
        failure%location%fileName = packed(position + 1:position + location_width)
        read (packed(position + location_width + 1:position + head_width), "(i12,i12)") &
          failure%location%lineNumber, message_length
        position = position + head_width
        failure%message = packed(position + 1:position + message_length)
        position = position + message_length
        do i = 1, n
          if (same_exception(found(i), failure)) exit
        end do
        if (i > n) then
          n = i
          found(n) = failure
          ranks(n) = ""
        end if
        write (ranks(i), '(a,",",i0)') trim(ranks(i)), rank - 1
      end do
    end do
    allocate (failures(n))
    do i = 1, n
      failures(i)%location = found(i)%location
      failures(i)%message = found(i)%message//" (PE="//trim(ranks(i)(2:))//")"
    end do
  end subroutine unpack_failures

  !> Prepares for the tests; `extra` is the user's own preparation.
  subroutine initialize(extra)
    procedure(plain_procedure) :: extra

    call extra()
  end subroutine initialize

  !> Starts MPI. Open MPI 5 makes a NaN on purpose while it starts.
  subroutine start_mpi()
    type(ieee_status_type) :: status

    call ieee_get_status(status)
    call ieee_set_halting_mode(ieee_all, .false.)
    call MPI_Init()
    call ieee_set_status(status)
  end subroutine start_mpi

  !> Runs the tests of `load_tests` on all processes; returns on each of them whether all passed.
  logical function run(load_tests) result(passed)
    procedure(suite_loader) :: load_tests
    type(TestSuite) :: suite
    type(MpiContext) :: context
    integer :: rank

    suite = load_tests()
    if (.not. has_mpi_tests(suite)) then
      passed = run_in(suite, SerialContext())
      return
    end if
    call start_mpi()
    call MPI_Comm_rank(context%communicator, rank)
    context%root = rank == 0
    passed = run_in(suite, context)
    call MPI_Bcast(passed, 1, MPI_LOGICAL, 0, MPI_COMM_WORLD)
  end function run

  !> Whether a test of the suite runs on several processes.
  pure logical function has_mpi_tests(suite)
    type(TestSuite), intent(in) :: suite
    integer :: i

    has_mpi_tests = .false.
    do i = 1, size(suite%tests)
      select type (one => suite%tests(i)%item)
      type is (MpiTestMethod)
        has_mpi_tests = .true.
      end select
    end do
  end function has_mpi_tests

  !> Ends MPI and the program, with exit code 2 from the root if a test failed.
  subroutine finalize(extra, successful)
    procedure(plain_procedure) :: extra
    logical, intent(in) :: successful
    integer :: rank
    logical :: has_mpi

    call extra()
    rank = 0
    call MPI_Initialized(has_mpi)
    if (has_mpi) then
      call MPI_Comm_rank(MPI_COMM_WORLD, rank)
      call MPI_Finalize()
    end if
    if (rank == 0 .and. .not. successful) stop 2
  end subroutine finalize

end module pfunit
