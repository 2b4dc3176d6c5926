!> Brings a file to the disk while the program goes on computing (POSIX asynchronous input and
!> output). What is written is safe from the program's own end at once, whatever becomes of it; a
!> sync makes it safe from that of the machine, and takes milliseconds that need not be waited for.
module battery_background_sync
  use, intrinsic :: iso_c_binding, only: c_int, c_size_t, c_ptr, c_char, c_null_char, c_null_ptr, &
    c_loc
  use battery_kinds, only: int64
  use battery_error, only: error_type, fatal_error
  implicit none (type, external)
  private
  public :: sync_type, begin_sync, end_sync

  !> Words of a control block (struct aiocb of the GNU library on 64-bit Linux); its first half word
  !> is the descriptor, the upper half of the sixth says how the end is told.
  integer, parameter :: control_words = 21
  integer(int64), parameter :: tell_nobody = shiftl(1_int64, 32)

  !> What `aio_error` says while the system is at it.
  integer(c_int), parameter :: under_way = 115

  !> A sync that may be under way; one at a time.
  type :: sync_type
    private
    !> Name of the file; not allocated: nothing is under way.
    character(len=:), allocatable :: path
    !> Whether the file was written to since the sync began.
    logical :: again = .false.
    integer(c_int) :: descriptor = -1
    !> Stays where it is as long as the system works on it.
    integer(int64), pointer :: control(:) => null()
  end type sync_type

  interface
    function c_open(path, flags) result(descriptor) bind(c, name='open')
      import :: c_int, c_char
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int), value, intent(in) :: flags
      integer(c_int) :: descriptor
    end function c_open

    function c_close(descriptor) result(status) bind(c, name='close')
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: descriptor
      integer(c_int) :: status
    end function c_close

    function c_aio_fsync(operation, control) result(status) bind(c, name='aio_fsync')
      import :: c_int, c_ptr
      implicit none (type, external)
      integer(c_int), value, intent(in) :: operation
      type(c_ptr), value, intent(in) :: control
      integer(c_int) :: status
    end function c_aio_fsync

    function c_aio_error(control) result(status) bind(c, name='aio_error')
      import :: c_int, c_ptr
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: control
      integer(c_int) :: status
    end function c_aio_error

    function c_aio_return(control) result(status) bind(c, name='aio_return')
      import :: c_size_t, c_ptr
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: control
      integer(c_size_t) :: status
    end function c_aio_return

    function c_aio_suspend(list, number, timeout) result(status) bind(c, name='aio_suspend')
      import :: c_int, c_ptr
      implicit none (type, external)
      type(c_ptr), intent(in) :: list(*)
      integer(c_int), value, intent(in) :: number
      type(c_ptr), value, intent(in) :: timeout
      integer(c_int) :: status
    end function c_aio_suspend
  end interface

contains

  !> Begins to bring a file to the disk, or, where that is under way, takes note to do so again; the
  !> error may be that of the sync before. `path` is the same until `end_sync`.
  recursive subroutine begin_sync(sync, path, error)
    type(sync_type), intent(inout) :: sync
    character(len=*), intent(in) :: path
    type(error_type), allocatable, intent(out) :: error
    integer(c_int), parameter :: read_only = 0, all_of_it = 1052672

    if (allocated(sync%path)) then
      sync%again = c_aio_error(c_loc(sync%control)) == under_way
      if (sync%again) return
      call end_sync(sync, error)
      if (allocated(error)) return
    end if
    sync%descriptor = c_open(path//c_null_char, read_only)
    if (sync%descriptor < 0) then
      call fatal_error(error, path//': cannot be opened to bring it to the disk')
      return
    end if
    sync%path = path
    if (.not. associated(sync%control)) allocate (sync%control(control_words))
    sync%control = 0
    sync%control(1) = sync%descriptor
    sync%control(6) = tell_nobody
    if (c_aio_fsync(all_of_it, c_loc(sync%control)) /= 0) call failed(sync, error)
  end subroutine begin_sync

  !> Waits until all that was begun is over; without anything, does nothing.
  recursive subroutine end_sync(sync, error)
    type(sync_type), intent(inout) :: sync
    type(error_type), allocatable, intent(out) :: error
    integer(c_int) :: status
    character(len=:), allocatable :: path
    logical :: again

    if (.not. allocated(sync%path)) return
    do
      status = c_aio_error(c_loc(sync%control))
      if (status /= under_way) exit
      ! A signal may end the wait; then it begins again.
      status = c_aio_suspend([c_loc(sync%control)], 1_c_int, c_null_ptr)
    end do
    if (status == 0) status = int(c_aio_return(c_loc(sync%control)), c_int)
    if (status /= 0) then
      call failed(sync, error)
      return
    end if
    path = sync%path
    again = sync%again
    call forget(sync)
    if (.not. again) return
    call begin_sync(sync, path, error)
    if (.not. allocated(error)) call end_sync(sync, error)
  end subroutine end_sync

  subroutine failed(sync, error)
    type(sync_type), intent(inout) :: sync
    type(error_type), allocatable, intent(out) :: error

    call fatal_error(error, sync%path//': cannot be brought to the disk')
    call forget(sync)
  end subroutine failed

  !> Nothing is under way any more.
  subroutine forget(sync)
    type(sync_type), intent(inout) :: sync
    integer(c_int) :: status

    status = c_close(sync%descriptor)
    deallocate (sync%control)
    nullify (sync%control)
    deallocate (sync%path)
    sync%again = .false.
  end subroutine forget

end module battery_background_sync
