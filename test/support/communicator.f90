!> Communicator of a test, as `mpi_f08` has it, however pFUnit was built.
module test_communicator
  use mpi_f08, only: MPI_Comm
  implicit none (type, external)
  private
  public :: as_communicator

  !> pFUnit returns an integer, or a communicator if it was built with its option for mpi_f08. Tests
  !> write `as_communicator(this%getMpiCommunicator())`.
  interface as_communicator
    procedure from_integer, from_communicator
  end interface as_communicator

contains

  pure type(MPI_Comm) function from_integer(handle) result(communicator)
    integer, intent(in) :: handle

    communicator%mpi_val = handle
  end function from_integer

  pure type(MPI_Comm) function from_communicator(handle) result(communicator)
    type(MPI_Comm), intent(in) :: handle

    communicator = handle
  end function from_communicator

end module test_communicator
