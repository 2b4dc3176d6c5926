!> The ranks of a run, and the task queue that they share. This module alone calls MPI.
!>
!> The queue consists of a few counters in the memory of rank 0 that every rank changes by one-sided
!> atomic operations: the next task, tasks finished, collisions done, and whether to stop; after
!> them comes the list of the tasks to be done, of which a rank reads one entry at a time. So no
!> rank waits for a master, no other rank stores a list of tasks, the length of no message depends
!> on the number of ranks or tasks, and rank 0 computes too; it only calls MPI at intervals
!> (`drive_mpi_progress`), since some networks complete one-sided operations only inside a call of
!> rank 0.
module battery_communicator
  use, intrinsic :: ieee_exceptions, only: ieee_all, ieee_status_type, ieee_get_status, &
    ieee_set_status, ieee_set_halting_mode
  use, intrinsic :: iso_c_binding, only: c_ptr, c_f_pointer
  ! A compiler without the switches of fpm.rsp shows the next line, and stops.
  use mpi_f08, only: & ! type "fpm @release": "fpm build" alone has no switches (docs/install.md)
    MPI_Comm, MPI_Win, MPI_Request, MPI_COMM_WORLD, MPI_INFO_NULL, MPI_INTEGER8, MPI_INTEGER, &
    MPI_CHARACTER, MPI_DOUBLE_PRECISION, MPI_SUM, MPI_MIN, &
    MPI_ADDRESS_KIND, MPI_MAX_LIBRARY_VERSION_STRING, MPI_Init, MPI_Initialized, MPI_Finalize, &
    MPI_Comm_rank, MPI_Comm_size, MPI_Comm_dup, MPI_Comm_free, MPI_Bcast, MPI_Barrier, &
    MPI_Ibarrier, MPI_Test, MPI_Allreduce, MPI_Win_allocate, MPI_Win_free, MPI_Win_lock_all, &
    MPI_Win_unlock_all, MPI_Win_flush, MPI_Win_sync, MPI_Fetch_and_op, MPI_Get, MPI_Iprobe, &
    MPI_Get_library_version, MPI_STATUS_IGNORE, MPI_ANY_SOURCE, MPI_ANY_TAG, MPI_Comm_split_type, &
    MPI_COMM_TYPE_SHARED, MPI_Comm_set_errhandler, MPI_ERRORS_RETURN, MPI_ERRORS_ARE_FATAL, &
    MPI_SUCCESS
  use battery_kinds, only: dp, int64
  use battery_clocks, only: sleep_for
  use battery_error, only: error_type, fatal_error
  use battery_process, only: set_home
  use battery_signals, only: signals_watch
  implicit none (type, external)
  private
  public :: communicator_type, open_communicator, close_communicator, share_error, share_text
  public :: ranks_on_node
  public :: share_words, wait_for_all, sleep_until_all, mean_over_ranks, mpi_library
  public :: task_queue_type, open_task_queue, close_task_queue, add_to_counter, read_counter
  public :: fetch_task, drive_mpi_progress, mpi_progress_interval
  public :: next_task, tasks_finished, tasks_failed, collisions_done, stop_wanted

  !> Seconds between two calls of MPI by rank 0 while it computes, so that one-sided requests
  !> proceed (`drive_mpi_progress`).
  real(dp), parameter :: mpi_progress_interval = 2.5e-4_dp

  !> Counters of the queue.
  integer, parameter :: next_task = 1, tasks_finished = 2, tasks_failed = 3, collisions_done = 4, &
    stop_wanted = 5, counter_count = 5

  !> The ranks of a run, and the index of this rank.
  type :: communicator_type
    type(MPI_Comm) :: ranks
    integer :: rank = 0, size = 1
    !> Whether this program called MPI_Init, and so has to call MPI_Finalize.
    logical :: mine = .false.
  end type communicator_type

  !> The task queue as one rank accesses it.
  type :: task_queue_type
    type(MPI_Win) :: shared_memory
    !> Number of tasks in the list.
    integer :: tasks = 0
    !> Ranks that access the queue, which is in the memory of rank 0.
    type(communicator_type) :: communicator
  end type task_queue_type

contains

  !> Makes a communicator of all ranks of the program, or of those of `parent` if MPI is already
  !> initialised (as in tests). Without mpirun there is one rank.
  subroutine open_communicator(communicator, parent)
    type(communicator_type), intent(out) :: communicator
    type(MPI_Comm), intent(in), optional :: parent
    type(MPI_Comm) :: from
    logical :: running

    call MPI_Initialized(running)
    communicator%mine = .not. running
    if (communicator%mine) then
      call initialize_mpi()
      ! MPICH takes SIGUSR1 for the report of a failed rank, asks mpiexec which one, and hangs if
      ! there is no mpiexec.
      call signals_watch()
    end if
    from = MPI_COMM_WORLD
    if (present(parent)) from = parent
    call MPI_Comm_dup(from, communicator%ranks)
    call MPI_Comm_rank(communicator%ranks, communicator%rank)
    call MPI_Comm_size(communicator%ranks, communicator%size)
  end subroutine open_communicator

  !> Calls MPI_Init without traps of floating-point exceptions: Open MPI 5 loads a library that
  !> makes a NaN on purpose. Restores traps and flags afterwards.
  subroutine initialize_mpi()
    type(ieee_status_type) :: status

    call ieee_get_status(status)
    call ieee_set_halting_mode(ieee_all, .false.)
    call set_home()
    call MPI_Init()
    call ieee_set_status(status)
  end subroutine initialize_mpi

  !> Calls MPI_Finalize if `open_communicator` called MPI_Init. Collective.
  subroutine close_communicator(communicator)
    type(communicator_type), intent(inout) :: communicator

    call MPI_Comm_free(communicator%ranks)
    if (communicator%mine) call MPI_Finalize()
  end subroutine close_communicator

  !> Gives every rank the error of the lowest rank that has one. Collective.
  subroutine share_error(communicator, error)
    type(communicator_type), intent(in) :: communicator
    type(error_type), allocatable, intent(inout) :: error
    integer :: mine, first

    mine = merge(communicator%rank, communicator%size, allocated(error))
    call MPI_Allreduce(mine, first, 1, MPI_INTEGER, MPI_MIN, communicator%ranks)
    if (first == communicator%size) return
    if (.not. allocated(error)) allocate (error)
    call MPI_Bcast(error%code, 1, MPI_INTEGER, first, communicator%ranks)
    call share_text(communicator, error%message, first)
  end subroutine share_error

  !> Gives every rank the text of rank `root`. Collective.
  subroutine share_text(communicator, text, root)
    type(communicator_type), intent(in) :: communicator
    !> Given on rank `root`.
    character(len=:), allocatable, intent(inout) :: text
    integer, intent(in) :: root
    integer :: length

    if (communicator%rank == root) length = len(text)
    call MPI_Bcast(length, 1, MPI_INTEGER, root, communicator%ranks)
    if (communicator%rank /= root) text = repeat(' ', length)
    call MPI_Bcast(text, length, MPI_CHARACTER, root, communicator%ranks)
  end subroutine share_text

  !> Gives every rank the words of rank 0; on the other ranks the array is allocated again.
  !> Collective.
  subroutine share_words(communicator, words)
    type(communicator_type), intent(in) :: communicator
    !> Given on rank 0.
    integer(int64), allocatable, intent(inout) :: words(:)
    integer :: length

    if (communicator%rank == 0) length = size(words)
    call MPI_Bcast(length, 1, MPI_INTEGER, 0, communicator%ranks)
    if (communicator%rank /= 0) words = spread(0_int64, 1, length)
    call MPI_Bcast(words, length, MPI_INTEGER8, 0, communicator%ranks)
  end subroutine share_words

  !> Barrier: returns when all ranks have called it. Collective.
  subroutine wait_for_all(communicator)
    type(communicator_type), intent(in) :: communicator

    call MPI_Barrier(communicator%ranks)
  end subroutine wait_for_all

  !> Barrier for ranks one of which may be seconds late: the others sleep meanwhile, where
  !> `wait_for_all` keeps their processors busy, but returns sooner. Collective.
  subroutine sleep_until_all(communicator)
    type(communicator_type), intent(in) :: communicator
    real(dp), parameter :: pause = 1.0e-3_dp
    type(MPI_Request) :: request
    logical :: reached

    call MPI_Ibarrier(communicator%ranks, request)
    do
      call MPI_Test(request, reached, MPI_STATUS_IGNORE)
      if (reached) exit
      call sleep_for(pause)
    end do
  end subroutine sleep_until_all

  !> Number of ranks on the machine of this rank. Collective.
  function ranks_on_node(communicator) result(ranks)
    type(communicator_type), intent(in) :: communicator
    integer :: ranks
    type(MPI_Comm) :: node

    call MPI_Comm_split_type(communicator%ranks, MPI_COMM_TYPE_SHARED, 0, MPI_INFO_NULL, node)
    call MPI_Comm_size(node, ranks)
    call MPI_Comm_free(node)
  end function ranks_on_node

  !> Mean of one value per rank. Collective.
  real(dp) function mean_over_ranks(communicator, value) result(mean)
    type(communicator_type), intent(in) :: communicator
    !> Value of this rank.
    real(dp), intent(in) :: value

    call MPI_Allreduce(value, mean, 1, MPI_DOUBLE_PRECISION, MPI_SUM, communicator%ranks)
    mean = mean/real(communicator%size, dp)
  end function mean_over_ranks

  !> Name and version of the MPI library: its description up to the first comma or line end, with
  !> blanks in place of tabs.
  function mpi_library() result(name)
    character(len=:), allocatable :: name
    character(len=MPI_MAX_LIBRARY_VERSION_STRING) :: text
    integer :: length, tab

    call MPI_Get_library_version(text, length)
    name = text(:scan(text(:length)//new_line('a'), ','//new_line('a')) - 1)
    tab = index(name, achar(9))
    if (tab > 0) name(tab:tab) = ' '
  end function mpi_library

  !> Creates the queue, all counters 0, with the list of tasks of rank 0. Collective.
  subroutine open_task_queue(task_queue, communicator, tasks, error)
    type(task_queue_type), intent(out) :: task_queue
    type(communicator_type), intent(in) :: communicator
    !> Tasks to be done; used on rank 0 only.
    integer, intent(in) :: tasks(:)
    !> This MPI has no one-sided operations between the nodes; the same error on all ranks.
    type(error_type), allocatable, intent(out) :: error
    integer(MPI_ADDRESS_KIND) :: bytes
    integer :: status
    type(c_ptr) :: base
    integer(int64), pointer :: entries(:)

    task_queue%communicator = communicator
    task_queue%tasks = size(tasks)
    call MPI_Bcast(task_queue%tasks, 1, MPI_INTEGER, 0, communicator%ranks)
    bytes = 0
    if (communicator%rank == 0) bytes = (counter_count + int(task_queue%tasks, MPI_ADDRESS_KIND)) &
      *storage_size(1_int64)/8
    call MPI_Comm_set_errhandler(communicator%ranks, MPI_ERRORS_RETURN)
    call MPI_Win_allocate(bytes, storage_size(1_int64)/8, MPI_INFO_NULL, communicator%ranks, base, &
      task_queue%shared_memory, status)
    call MPI_Comm_set_errhandler(communicator%ranks, MPI_ERRORS_ARE_FATAL)
    if (status /= MPI_SUCCESS) call fatal_error(error, 'battery: '//mpi_library()//' refuses ' &
      //'one-sided operations between these ranks; Open MPI 4 has them with OMPI_MCA_osc=^ucx ' &
      //'in the environment of all ranks (one rank: without OMPI_MCA_osc)')
    call share_error(communicator, error)
    if (allocated(error)) return
    call MPI_Win_lock_all(0, task_queue%shared_memory)
    if (communicator%rank == 0) then
      call c_f_pointer(base, entries, [counter_count + task_queue%tasks])
      entries(:counter_count) = 0
      entries(counter_count + 1:) = tasks
      call MPI_Win_sync(task_queue%shared_memory)
    end if
    call MPI_Barrier(communicator%ranks)
  end subroutine open_task_queue

  !> Takes the next task of the list; 0 if there is none left.
  subroutine fetch_task(task_queue, task)
    type(task_queue_type), intent(in) :: task_queue
    !> Number of the task in the plan, from 1.
    integer, intent(out) :: task
    integer(int64) :: place
    integer(int64), asynchronous :: entry

    task = 0
    call add_to_counter(task_queue, next_task, 1_int64, place)
    if (place >= task_queue%tasks) return
    call MPI_Get(entry, 1, MPI_INTEGER8, 0, int(counter_count + place, MPI_ADDRESS_KIND), 1, &
      MPI_INTEGER8, task_queue%shared_memory)
    call MPI_Win_flush(0, task_queue%shared_memory)
    task = int(entry)
  end subroutine fetch_task

  !> Calls MPI on rank 0: without remote direct memory access, one-sided operations of the other
  !> ranks wait until rank 0 is inside an MPI call.
  subroutine drive_mpi_progress(task_queue)
    type(task_queue_type), intent(in) :: task_queue
    logical :: waiting

    if (task_queue%communicator%rank == 0 .and. task_queue%communicator%size > 1) call MPI_Iprobe( &
      MPI_ANY_SOURCE, MPI_ANY_TAG, task_queue%communicator%ranks, waiting, MPI_STATUS_IGNORE)
  end subroutine drive_mpi_progress

  !> Frees the queue. Collective.
  subroutine close_task_queue(task_queue)
    type(task_queue_type), intent(inout) :: task_queue

    call MPI_Win_unlock_all(task_queue%shared_memory)
    call MPI_Win_free(task_queue%shared_memory)
  end subroutine close_task_queue

  !> Adds to a counter atomically and returns its value before.
  subroutine add_to_counter(task_queue, entry, amount, before)
    type(task_queue_type), intent(in) :: task_queue
    !> Entry of the task queue: one of the constants above, such as `next_task`.
    integer, intent(in) :: entry
    !> Amount to add, of either sign.
    integer(int64), intent(in) :: amount
    !> Value of the entry before the addition.
    integer(int64), intent(out), optional :: before
    integer(int64), asynchronous :: found

    call MPI_Fetch_and_op(amount, found, MPI_INTEGER8, 0, int(entry - 1, MPI_ADDRESS_KIND), &
      MPI_SUM, task_queue%shared_memory)
    call MPI_Win_flush(0, task_queue%shared_memory)
    if (present(before)) before = found
  end subroutine add_to_counter

  !> Present value of a counter.
  function read_counter(task_queue, entry) result(value)
    type(task_queue_type), intent(in) :: task_queue
    !> Entry of the task queue: one of the constants above, such as `next_task`.
    integer, intent(in) :: entry
    integer(int64) :: value

    call add_to_counter(task_queue, entry, 0_int64, value)
  end function read_counter

end module battery_communicator
