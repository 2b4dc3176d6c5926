!> The journal: files of an ensemble that is not complete, in the folder `FILE.h5.tasks`:
!>
!> - `plan`: the namelist, and the fingerprint of the initial file;
!> - `rank_N`: results of finished tasks, appended one by one; each rank of each start has its own;
!> - `task_N.a`, `task_N.b`: the state of a long task, two generations, so that one is always whole;
!>   N is the `task_id`, since the number of a task changes as a scan grows.
!>
!> All are record files with checksums: a truncated or damaged record is detected, and its task
!> repeated. Every record has the `task_id` of its task (`battery_identity`): a record of another
!> input is never taken for one of this run. A state also has the names of its components
!> (`battery_archive`): a state of another format is not used, and its task starts again.
module battery_journal
  use battery_kinds, only: dp, int64
  use battery_error, only: error_type, fatal_error
  use battery_paths, only: is_folder
  use battery_fingerprint, only: fingerprint_text
  use battery_text, only: string_type, to_text, is_one_of
  use battery_clocks, only: wall_seconds
  use battery_files, only: make_folder, sync_file, remove_file, publish_file, file_exists, &
    find_files
  use battery_lock_file, only: lock_type, check_lock
  use battery_record_file, only: record_type, append_record, write_single_record, &
    read_single_record
  use battery_task_result, only: task_result_type, to_record
  use battery_setup, only: setup_type
  use battery_simulation, only: simulation_type, serialize_simulation
  use battery_tasks, only: task_type
  use battery_archive, only: archive_type, new_archive, measuring_archive
  implicit none (type, external)
  private
  public :: journal_type, find_journal, begin_journal, join_journal, rank_file, rank_files_of
  public :: states_in, find_task_ids, remove_journal
  public :: write_finished, sync_finished, write_state, read_state

  !> The journal as one rank accesses it.
  type :: journal_type
    character(len=:), allocatable :: folder
    !> Whether there was a plan that can be read, the text of its namelist, and the fingerprint of
    !> the initial file; 0: there was none.
    logical :: has_plan = .false.
    character(len=:), allocatable :: namelist
    integer(int64) :: initial_fingerprint = 0
    !> Files that were there when the folder was listed, on rank 0.
    type(string_type), allocatable, private :: names(:)
    !> Number of the rank file of rank 0: rank files of earlier starts have smaller numbers. Number
    !> of ranks of this start.
    integer :: first_file = 0, ranks = 0
    !> Lock of this run: a rank writes nothing more when another run has taken it over.
    type(lock_type) :: lock
    !> Number of this rank's file, and the length that has been written to it.
    integer :: mine = 0
    integer(int64) :: written = 0
    !> Generation of the state written last.
    integer(int64) :: generation = 0
    !> Whether the rank file has results that are not yet synced to disk; time, in seconds of
    !> `wall_seconds`, from which on the next result causes a sync.
    logical :: is_unsynced = .false.
    real(dp) :: next_sync = 0.0_dp
  end type journal_type

  !> Suffixes of the files of a state, which are written in turn.
  character(len=*), parameter :: generations(2) = ['.a', '.b']

  !> Names of all files of a journal, as a pattern of a shell.
  character(len=*), parameter :: journal_names = &
    '@(rank_@(0|[1-9]*([0-9]))|task_'//repeat('[0-9A-F]', 16)//'.[ab]|plan.new|plan)'

contains

  !> Name of the rank file with a number, of which `next_result` reads the records.
  pure function rank_file(journal, number) result(name)
    type(journal_type), intent(in) :: journal
    !> As in `rank_files_of`.
    integer, intent(in) :: number
    character(len=:), allocatable :: name

    name = journal%folder//'/rank_'//to_text(number)
  end function rank_file

  !> Name of the state files of a task, without the suffix of the generation.
  pure function state_file(journal, task_id) result(name)
    type(journal_type), intent(in) :: journal
    !> `task_type%task_id`.
    integer(int64), intent(in) :: task_id
    character(len=:), allocatable :: name

    name = journal%folder//'/task_'//fingerprint_text(task_id)
  end function state_file

  !> Finds the files of earlier starts, and reads their plan. The folder is listed here only;
  !> `first_file` becomes the next free number of a rank file: greater than those of all files, and
  !> than those that earlier starts reserved for their ranks, used or not.
  subroutine find_journal(journal, folder, error)
    type(journal_type), intent(out) :: journal
    !> Folder of the journal, which need not be there.
    character(len=*), intent(in) :: folder
    !> What is there cannot be read.
    type(error_type), allocatable, intent(out) :: error
    type(record_type) :: record
    integer :: files

    journal%folder = folder
    call list_files(folder, journal%names, error)
    if (.not. allocated(error)) call read_single_record(folder//'/plan', record, &
      journal%has_plan, error)
    files = 0
    if (journal%has_plan) then
      call serialize_plan(journal, files, record%archive_type)
      journal%has_plan = .not. record%failed()
    end if
    journal%first_file = max(files, 1 + maxval([-1, numbers_in(journal%names)]))
  end subroutine find_journal

  !> Saves or restores the contents of the file `plan`.
  pure subroutine serialize_plan(journal, rank_files, archive)
    type(journal_type), intent(inout) :: journal
    !> Number of rank files, including those that the ranks of the start may make.
    integer, intent(inout) :: rank_files
    type(archive_type), intent(inout) :: archive

    call archive%serialize_text('namelist', journal%namelist)
    call archive%serialize('initial_fingerprint', journal%initial_fingerprint)
    call archive%serialize('rank_files', rank_files)
  end subroutine serialize_plan

  !> Numbers of the rank files that a journal may have, in any order.
  function rank_files_of(journal) result(numbers)
    !> From `find_journal`.
    type(journal_type), intent(in) :: journal
    integer, allocatable :: numbers(:)
    integer :: k

    numbers = numbers_in(journal%names)
    numbers = [pack(numbers, numbers < journal%first_file), (journal%first_file + k, k=0, &
      journal%ranks - 1)]
  end function rank_files_of

  !> `task_id` of the first valid record of every file but the plan: without a plan they show
  !> to which input the journal belongs.
  subroutine find_task_ids(journal, task_id, error)
    !> From `find_journal`.
    type(journal_type), intent(in) :: journal
    integer(int64), allocatable, intent(out) :: task_id(:)
    !> A file cannot be read.
    type(error_type), allocatable, intent(out) :: error
    type(record_type) :: record
    logical :: found
    integer :: k

    allocate (task_id(0))
    do k = 1, size(journal%names)
      if (index(journal%names(k)%text, 'plan') == 1) cycle
      call read_single_record(journal%folder//'/'//journal%names(k)%text, record, found, error)
      if (allocated(error)) return
      if (found) task_id = [task_id, record%owner]
    end do
  end subroutine find_task_ids

  !> Begins the journal: writes the plan, on rank 0, before any rank writes anything else.
  subroutine begin_journal(journal, namelist, initial_fingerprint, ranks, error)
    !> From `find_journal`.
    type(journal_type), intent(inout) :: journal
    !> Text of the namelist.
    character(len=*), intent(in) :: namelist
    !> Fingerprint of the initial file; 0 if there is none.
    integer(int64), intent(in) :: initial_fingerprint
    !> Number of ranks of this start.
    integer, intent(in) :: ranks
    type(error_type), allocatable, intent(out) :: error
    type(record_type) :: record
    integer :: files

    if (journal%first_file > huge(ranks) - ranks) then
      call fatal_error(error, rank_file(journal, journal%first_file - 1) &
        //': leaves no number for another file; remove it')
      return
    end if
    call make_folder(journal%folder, error)
    if (allocated(error)) return
    journal%namelist = namelist
    journal%initial_fingerprint = initial_fingerprint
    files = journal%first_file + ranks
    record%archive_type = new_archive()
    call serialize_plan(journal, files, record%archive_type)
    record%word = record%word(:record%length)
    associate (plan => journal%folder//'/plan')
      call write_single_record(plan//'.new', record, error)
      if (.not. allocated(error)) call publish_file(plan//'.new', plan, error)
    end associate
  end subroutine begin_journal

  !> Sets up the journal on a rank, after `begin_journal`; `rank_files` is the number before this
  !> start.
  subroutine join_journal(journal, folder, rank_files, rank, ranks)
    !> On rank 0, from `find_journal`.
    type(journal_type), intent(inout) :: journal
    !> Folder of the journal.
    character(len=*), intent(in) :: folder
    !> Number of rank files of earlier starts; this rank, from 0; number of ranks.
    integer, intent(in) :: rank_files, rank, ranks

    journal%folder = folder
    journal%first_file = rank_files
    journal%ranks = ranks
    journal%mine = rank_files + rank
  end subroutine join_journal

  !> Writes the result of a finished task at once, so that it survives the end of the program. The
  !> file is synced to disk, so that it survives a crash of the machine, unless that was done
  !> shortly before: a crash then loses only results computed since. The states of the task are
  !> removed.
  subroutine write_finished(journal, found, error)
    type(journal_type), intent(inout) :: journal
    !> The result of the task; not changed.
    type(task_result_type), intent(inout) :: found
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: state
    logical :: has_state
    integer :: k

    call check_lock(journal%lock, error)
    if (allocated(error)) return
    call append_record(rank_file(journal, journal%mine), to_record(found), journal%written, error)
    if (allocated(error)) return
    journal%is_unsynced = .true.
    state = state_file(journal, found%task_id)
    has_state = file_exists(state//generations(1)) .or. file_exists(state//generations(2))
    if (has_state .or. wall_seconds() >= journal%next_sync) call sync_finished(journal, error)
    do k = 1, merge(2, 0, has_state)
      if (.not. allocated(error)) call remove_file(state//generations(k), error)
    end do
  end subroutine write_finished

  !> Syncs all results of this rank to disk, always; `write_finished` decides when to call it.
  subroutine sync_finished(journal, error)
    type(journal_type), intent(inout) :: journal
    !> Results could not be written to disk.
    type(error_type), allocatable, intent(out) :: error
    !> Least number of seconds between two syncs, and the fraction of the time that they may take.
    real(dp), parameter :: interval = 0.1_dp, share = 0.02_dp
    real(dp) :: began, ended

    if (.not. journal%is_unsynced) return
    began = wall_seconds()
    call sync_file(rank_file(journal, journal%mine), error)
    ended = wall_seconds()
    journal%is_unsynced = allocated(error)
    journal%next_sync = ended + max(interval, (ended - began)/share)
  end subroutine sync_finished

  !> Saves the state of a simulation over the older of its two generations.
  subroutine write_state(journal, task, simulation, cpu_seconds, error)
    type(journal_type), intent(inout) :: journal
    type(task_type), intent(in) :: task
    type(simulation_type), intent(inout) :: simulation
    !> Processor time spent on the task so far.
    real(dp), intent(in) :: cpu_seconds
    type(error_type), allocatable, intent(out) :: error
    type(record_type) :: record
    real(dp) :: seconds
    character(len=:), allocatable :: name

    call check_lock(journal%lock, error)
    if (allocated(error)) return
    seconds = cpu_seconds
    ! The length is measured first: there is only one copy of a large state.
    record%archive_type = measuring_archive()
    call serialize_state(simulation, simulation%setup, seconds, record%archive_type, error)
    if (allocated(error)) return
    record%archive_type = new_archive(record%length)
    call serialize_state(simulation, simulation%setup, seconds, record%archive_type, error)
    if (allocated(error)) return
    record%owner = task%task_id
    journal%generation = journal%generation + 1
    record%generation = journal%generation
    name = state_file(journal, task%task_id)//generations(2 - mod(journal%generation, 2_int64))
    call write_single_record(name, record, error)
    if (.not. allocated(error)) call sync_file(name, error)
  end subroutine write_state

  !> Saves or restores the contents of a state file.
  subroutine serialize_state(simulation, setup, cpu_seconds, archive, error)
    type(simulation_type), intent(inout) :: simulation
    type(setup_type), intent(in) :: setup
    real(dp), intent(inout) :: cpu_seconds
    type(archive_type), intent(inout) :: archive
    type(error_type), allocatable, intent(out) :: error

    call archive%serialize('cpu_seconds', cpu_seconds)
    call serialize_simulation(simulation, setup, archive, error)
  end subroutine serialize_state

  !> Reads the newest valid state of a task, if it has the format of this program.
  subroutine read_state(journal, task, simulation, cpu_seconds, found, failure, error)
    type(journal_type), intent(inout) :: journal
    type(task_type), intent(in) :: task
    type(simulation_type), intent(out) :: simulation
    !> Processor time spent on the task before.
    real(dp), intent(out) :: cpu_seconds
    !> Whether there is a valid state of the task.
    logical, intent(out) :: found
    !> The simulation cannot go on from it; a file cannot be read.
    type(error_type), allocatable, intent(out) :: failure, error
    type(record_type) :: state(2)
    integer :: k, newer

    cpu_seconds = 0.0_dp
    do k = 1, 2
      call read_single_record(state_file(journal, task%task_id)//generations(k), state(k), found, &
        error)
      if (allocated(error)) return
      if (state(k)%owner /= task%task_id) state(k) = record_type()
    end do
    ! The generation is 0 if a file is missing or holds the result of a task.
    newer = maxloc(state%generation, 1)
    journal%generation = state(newer)%generation
    found = journal%generation > 0
    if (.not. found) return
    state(3 - newer) = record_type()
    call serialize_state(simulation, task%setup, cpu_seconds, state(newer)%archive_type, failure)
    if (.not. state(newer)%failed()) return
    ! A state of another format stays until this task saves a state.
    deallocate (failure)
    found = .false.
    cpu_seconds = 0.0_dp
  end subroutine read_state

  !> Numbers of the rank files in a list of names, in its order. Names whose suffix is not the
  !> number of a rank file are ignored.
  pure function numbers_in(names) result(numbers)
    type(string_type), intent(in) :: names(:)
    integer, allocatable :: numbers(:)
    integer :: k, number, status

    allocate (numbers(0))
    do k = 1, size(names)
      if (index(names(k)%text, 'rank_') /= 1) cycle
      read (names(k)%text(6:), *, iostat=status) number
      if (status /= 0) cycle
      if (names(k)%text /= 'rank_'//to_text(number)) cycle
      if (number >= 0 .and. number < huge(1)) numbers = [numbers, number]
    end do
  end function numbers_in

  !> Number of tasks that have a saved state.
  pure integer function states_in(journal) result(states)
    !> From `find_journal`.
    type(journal_type), intent(in) :: journal
    integer :: k

    states = 0
    do k = 1, size(journal%names)
      associate (name => journal%names(k)%text)
        if (index(name, 'task_') /= 1) cycle
        ! A task with both generations counts once.
        if (name(len(name):) == 'a' .or. .not. is_one_of(name(:len(name) - 1)//'a', &
          journal%names)) states = states + 1
      end associate
    end do
  end function states_in

  !> Lists all journal files in the folder, in any order.
  subroutine list_files(folder, names, error)
    !> Folder of the journal, which need not be there.
    character(len=*), intent(in) :: folder
    type(string_type), allocatable, intent(out) :: names(:)
    !> It cannot be read, or a folder has the name of a file.
    type(error_type), allocatable, intent(out) :: error
    integer :: k

    call find_files(folder, journal_names, names, error)
    do k = 1, size(names)
      if (is_folder(folder//'/'//names(k)%text)) call fatal_error(error, folder//'/' &
        //names(k)%text//': is a folder where a file should be; remove it')
      if (allocated(error)) return
    end do
  end subroutine list_files

  !> Removes the journal with all its files, the plan last. A folder with any other file stays.
  subroutine remove_journal(folder, error)
    !> Folder of a journal, which need not be there.
    character(len=*), intent(in) :: folder
    type(error_type), allocatable, intent(out) :: error
    type(string_type), allocatable :: names(:)
    integer :: k

    if (.not. is_folder(folder)) then
      if (file_exists(folder)) call fatal_error(error, folder &
        //': is not a folder, or cannot be read, and is kept')
      return
    end if
    call list_files(folder, names, error)
    if (allocated(error)) return
    do k = 1, size(names)
      if (names(k)%text /= 'plan') call remove_file(folder//'/'//names(k)%text, error)
      if (allocated(error)) return
    end do
    call remove_file(folder//'/plan', error)
    if (.not. allocated(error)) call remove_file(folder, error)
  end subroutine remove_journal

end module battery_journal
