!> What an ensemble has on disk while it is under way, in the folder `FILE.h5.tasks`:
!>
!> - `plan`: the namelist, and the fingerprint of the initial file;
!> - `rank_N`: results of finished tasks, appended one by one; each rank of each start has its own;
!> - `task_N.a`, `task_N.b`: the state of a long task, two generations, so that one is always whole.
!>
!> All are record files with checksums: what is cut short or damaged is found out and done again.
!> Every record carries what its task is known by (`battery_identity`): what others have left is
!> never taken for this run's. A state says besides what it holds (`battery_stream`): one that is of
!> another format is left alone, and its task begins anew.
module battery_journal
  use battery_kinds, only: dp, int8, int64
  use battery_error, only: error_type, fatal_error
  use battery_text, only: string_type, to_text
  use battery_background_sync, only: sync_type, begin_sync, end_sync
  use battery_files, only: make_folder, sync_file, remove_file, publish_file, file_exists, &
    files_like
  use battery_journal_folder, only: numbers_in, check_journal, remove_journal
  use battery_ownership, only: ownership_type, is_taken_over, taken_over_text
  use battery_record_file, only: record_type, append_record, read_records, &
    write_single, read_single
  use battery_task_result, only: task_result_type, task_complete, to_record, &
    from_record
  use battery_simulation, only: simulation_type, setup_type, pass_simulation
  use battery_stream, only: stream_type, new_stream, stream_of
  implicit none (type, external)
  private
  public :: journal_type, read_plan, begin_journal, join_journal, read_rank_file
  public :: rank_files_in, rank_files_of, kept_in, settle_journal, check_journal
  public :: write_finished, write_state, read_state, remove_states, remove_journal

  type :: journal_type
    character(len=:), allocatable :: folder
    !> Rank files of earlier starts have smaller numbers; this start's ranks have the next ones.
    integer :: first_file = 0, ranks = 0
    !> That of this run; a rank that outlives it writes no more when another has taken over.
    type(ownership_type) :: ownership
    !> This rank's own file, and the length of what is written in it.
    integer :: mine = 0
    integer(int64) :: written = 0
    !> Generation of the state written last.
    integer(int64) :: generation = 0
    !> The rank file may be on its way to the disk.
    type(sync_type) :: sync
  end type journal_type

contains

  !> Name of the file `kind`_`number`.
  pure function file_of(journal, kind, number) result(name)
    type(journal_type), intent(in) :: journal
    character(len=*), intent(in) :: kind
    integer, intent(in) :: number
    character(len=:), allocatable :: name

    name = journal%folder//'/'//kind//'_'//to_text(number)
  end function file_of

  !> Looks for the journal of an earlier start: its namelist, and the fingerprint of its initial
  !> file. `found` is false where there is none that can be read.
  subroutine read_plan(folder, namelist, initial_fingerprint, found)
    character(len=*), intent(in) :: folder
    character(len=:), allocatable, intent(out) :: namelist
    integer(int64), intent(out) :: initial_fingerprint
    logical, intent(out) :: found
    type(record_type) :: plan
    integer :: k

    call read_single(folder//'/plan', plan, found)
    if (found) found = is_plan(plan)
    initial_fingerprint = 0
    namelist = ''
    if (.not. found) return
    initial_fingerprint = plan%tag
    namelist = repeat(' ', size(plan%bytes))
    do k = 1, size(plan%bytes)
      namelist(k:k) = achar(iand(int(plan%bytes(k)), 255))
    end do
  end subroutine read_plan

  !> Whether a record is a plan, and no result or state.
  pure function is_plan(record) result(yes)
    type(record_type), intent(in) :: record
    logical :: yes

    yes = size(record%reals) == 0 .and. size(record%integers) <= 1
  end function is_plan

  !> The next free number of a rank file: beyond any that is there, and beyond those that earlier
  !> starts had for their ranks, whether they were used or not.
  function rank_files_in(folder) result(rank_files)
    character(len=*), intent(in) :: folder
    integer :: rank_files
    type(record_type) :: plan
    logical :: found

    rank_files = 1 + maxval([-1, numbers_in(folder)])
    call read_single(folder//'/plan', plan, found)
    if (.not. found) return
    if (.not. is_plan(plan) .or. size(plan%integers) == 0) return
    if (plan%integers(1) < huge(rank_files)) rank_files = max(rank_files, int(plan%integers(1)))
  end function rank_files_in

  !> Numbers of the rank files that a journal may have, in any order. Those of this start are not
  !> looked for in the folder: on a network disk a list of it may be old.
  function rank_files_of(journal) result(numbers)
    type(journal_type), intent(in) :: journal
    integer, allocatable :: numbers(:)
    integer :: k

    numbers = numbers_in(journal%folder)
    numbers = [pack(numbers, numbers < journal%first_file), (journal%first_file + k, k=0, &
      journal%ranks - 1)]
  end function rank_files_of

  !> The numbers of tasks, and what they are known by, of the first good record of every file but
  !> the plan, (2, file): what else can tell whose journal this is.
  function kept_in(folder) result(kept)
    character(len=*), intent(in) :: folder
    integer(int64), allocatable :: kept(:, :)
    type(string_type), allocatable :: names(:)
    type(record_type) :: record
    logical :: found
    integer :: k, good

    names = [files_like(folder, 'rank_*'), files_like(folder, 'task_*.a'), &
      files_like(folder, 'task_*.b')]
    allocate (kept(2, size(names)))
    good = 0
    do k = 1, size(names)
      call read_single(folder//'/'//names(k)%text, record, found)
      if (.not. found) cycle
      good = good + 1
      kept(:, good) = [record%tag, record%owner]
    end do
    kept = kept(:, :good)
  end function kept_in

  !> Rank 0 writes the plan before any rank writes anything else.
  subroutine begin_journal(folder, namelist, initial_fingerprint, rank_files, error)
    character(len=*), intent(in) :: folder, namelist
    integer(int64), intent(in) :: initial_fingerprint
    !> Those that this start's ranks may make included.
    integer, intent(in) :: rank_files
    type(error_type), allocatable, intent(out) :: error
    type(record_type) :: plan
    integer :: k

    call make_folder(folder, error)
    if (allocated(error)) return
    plan%tag = initial_fingerprint
    plan%integers = [int(rank_files, int64)]
    allocate (plan%reals(0), plan%bytes(len(namelist)))
    do k = 1, len(namelist)
      plan%bytes(k) = int(merge(iachar(namelist(k:k)) - 256, iachar(namelist(k:k)), &
        iachar(namelist(k:k)) > 127), int8)
    end do
    call write_single(folder//'/plan.new', plan, error)
    if (.not. allocated(error)) call publish_file(folder//'/plan.new', folder//'/plan', error)
  end subroutine begin_journal

  !> Every rank, then: `rank_files` as before this start.
  subroutine join_journal(journal, folder, rank_files, rank, ranks)
    type(journal_type), intent(out) :: journal
    character(len=*), intent(in) :: folder
    integer, intent(in) :: rank_files, rank, ranks

    journal%folder = folder
    journal%first_file = rank_files
    journal%ranks = ranks
    journal%mine = rank_files + rank
  end subroutine join_journal

  !> Good results in the rank file of that number; none if there is no such file.
  subroutine read_rank_file(journal, file, results)
    type(journal_type), intent(in) :: journal
    integer, intent(in) :: file
    type(task_result_type), allocatable, intent(out) :: results(:)
    type(record_type), allocatable :: records(:)
    integer(int64) :: good_size
    logical :: is_one
    integer :: k, good

    call read_records(file_of(journal, 'rank', file), records, good_size)
    allocate (results(size(records)))
    good = 0
    do k = 1, size(records)
      call from_record(records(k), results(good + 1), is_one)
      if (is_one) good = good + 1
    end do
    results = results(:good)
  end subroutine read_rank_file

  !> A task is finished: its result is written at once, so that nothing that happens to the program
  !> can spoil it, and is on its way to the disk. States are of no use any more when it is there.
  subroutine write_finished(journal, found, error)
    type(journal_type), intent(inout) :: journal
    type(task_result_type), intent(in) :: found
    type(error_type), allocatable, intent(out) :: error
    type(record_type) :: record
    character(len=:), allocatable :: name

    call check_ownership(journal, error)
    if (allocated(error)) return
    record = to_record(found)
    name = file_of(journal, 'rank', journal%mine)
    call append_record(name, record, journal%written, error)
    if (allocated(error)) return
    call begin_sync(journal%sync, name, error)
    if (allocated(error)) return
    name = file_of(journal, 'task', found%task)
    if (.not. file_exists(name//'.a')) then
      if (.not. file_exists(name//'.b')) return
    end if
    call end_sync(journal%sync, error)
    if (.not. allocated(error)) call remove_states(journal, found%task, error)
  end subroutine write_finished

  !> A rank whose run has lost the output writes nothing.
  subroutine check_ownership(journal, error)
    type(journal_type), intent(in) :: journal
    type(error_type), allocatable, intent(out) :: error

    if (is_taken_over(journal%ownership)) call fatal_error(error, &
      taken_over_text(journal%ownership))
  end subroutine check_ownership

  !> Waits until all results of this rank are on the disk.
  subroutine settle_journal(journal, error)
    type(journal_type), intent(inout) :: journal
    type(error_type), allocatable, intent(out) :: error

    call end_sync(journal%sync, error)
  end subroutine settle_journal

  subroutine remove_states(journal, task, error)
    type(journal_type), intent(in) :: journal
    integer, intent(in) :: task
    type(error_type), allocatable, intent(out) :: error

    call remove_file(file_of(journal, 'task', task)//'.a', error)
    if (.not. allocated(error)) call remove_file(file_of(journal, 'task', task)//'.b', error)
  end subroutine remove_states

  !> Saves a simulation, over the older of its two generations.
  subroutine write_state(journal, task, kept, simulation, cpu_seconds, error)
    type(journal_type), intent(inout) :: journal
    !> Number of the task, and what it is known by.
    integer, intent(in) :: task
    integer(int64), intent(in) :: kept
    type(simulation_type), intent(inout) :: simulation
    real(dp), intent(in) :: cpu_seconds
    type(error_type), allocatable, intent(out) :: error
    type(stream_type) :: stream
    type(record_type) :: record
    character(len=:), allocatable :: name

    call check_ownership(journal, error)
    if (allocated(error)) return
    stream = new_stream()
    call pass_simulation(simulation, simulation%setup, stream, error)
    if (allocated(error)) return
    record%owner = kept
    record%tag = task
    journal%generation = journal%generation + 1
    record%integers = [journal%generation, stream%word(:stream%length)]
    record%reals = [cpu_seconds]
    allocate (record%bytes(0))
    name = file_of(journal, 'task', task)//merge('.a', '.b', mod(journal%generation, 2_int64) == 1)
    call write_single(name, record, error)
    if (.not. allocated(error)) call sync_file(name, error)
  end subroutine write_state

  !> The newer of the whole states of a task, if there is one.
  subroutine read_state(journal, task, kept, setup, simulation, cpu_seconds, found, error)
    type(journal_type), intent(inout) :: journal
    !> Number of the task, and what it is known by.
    integer, intent(in) :: task
    integer(int64), intent(in) :: kept
    type(setup_type), intent(in) :: setup
    type(simulation_type), intent(out) :: simulation
    real(dp), intent(out) :: cpu_seconds
    logical, intent(out) :: found
    type(error_type), allocatable, intent(out) :: error
    type(record_type) :: record, other
    type(stream_type) :: stream
    logical :: other_found

    journal%generation = 0
    cpu_seconds = 0.0_dp
    call read_own('.a', record, found)
    call read_own('.b', other, other_found)
    if (other_found .and. found) then
      if (other%integers(1) > record%integers(1)) record = other
    else if (other_found) then
      record = other
    end if
    found = found .or. other_found
    if (.not. found) return
    journal%generation = record%integers(1)
    cpu_seconds = record%reals(1)
    stream = stream_of(record%integers(2:))
    call pass_simulation(simulation, setup, stream, error)

  contains

    !> The state in one of the two files, if it is whole and of this task, input and build.
    subroutine read_own(generation, record, found)
      character(len=*), intent(in) :: generation
      type(record_type), intent(out) :: record
      logical, intent(out) :: found

      call read_single(file_of(journal, 'task', task)//generation, record, found)
      if (found) found = record%tag == task .and. record%owner == kept
    end subroutine read_own

  end subroutine read_state

end module battery_journal
