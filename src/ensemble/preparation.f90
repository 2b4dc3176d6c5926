!> The start of an ensemble: what is there already, and which tasks are still to be done.
module battery_preparation
  use battery_kinds, only: int64
  use battery_communicator, only: communicator_type, share_error, share_words
  use battery_error, only: error_type, fatal_error, exit_failure, exit_bad_input
  use battery_files, only: file_exists, remove_file
  use battery_fingerprint, only: fingerprint_text
  use battery_journal, only: journal_type, read_plan, kept_in, begin_journal, join_journal, &
    read_rank_file, rank_files_of, rank_files_in
  use battery_journal_folder, only: check_journal, remove_journal
  use battery_metadata, only: read_metadata
  use battery_namelist_input, only: differing_keys
  use battery_plan, only: plan_type
  use battery_results, only: task_complete
  use battery_task_result, only: task_result_type
  use battery_tasks, only: task_count, is_task_of, put_longest_first
  use battery_terminal, only: say
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: prepare

contains

  !> Rank 0 looks at what is there: results that are complete, a journal to go on with, or neither.
  subroutine prepare(plan, communicator, overwrite, quiet, journal, pending, complete, error)
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    !> Whether to discard what is there; whether rank 0 says nothing.
    logical, intent(in) :: overwrite, quiet
    type(journal_type), intent(out) :: journal
    !> On rank 0 the tasks that are to be done, longest first; empty on the others.
    integer, allocatable, intent(out) :: pending(:)
    !> Whether nothing is left to be done.
    logical, intent(out) :: complete
    !> The same on all ranks; code `exit_bad_input` where something else is in the way.
    type(error_type), allocatable, intent(out) :: error
    integer(int64), allocatable :: shared(:)
    integer :: rank_files

    allocate (pending(0))
    if (communicator%rank == 0) then
      call look_at_output(plan, communicator%size, overwrite, quiet, complete, rank_files, &
        pending, error)
      shared = [merge(1, 0, complete), rank_files]
    end if
    call share_error(communicator, error)
    if (allocated(error)) return
    call share_words(communicator, shared)
    complete = shared(1) == 1
    call join_journal(journal, journal_folder(plan), int(shared(2)), communicator%rank, &
      communicator%size)
  end subroutine prepare

  !> Which tasks are pending, and how many rank files earlier starts have; begins the journal of a
  !> start with so many ranks if there is something to do.
  subroutine look_at_output(plan, ranks, overwrite, quiet, complete, rank_files, pending, error)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: ranks
    logical, intent(in) :: overwrite, quiet
    logical, intent(out) :: complete
    integer, intent(out) :: rank_files
    integer, allocatable, intent(inout) :: pending(:)
    type(error_type), allocatable, intent(out) :: error
    type(error_type), allocatable :: damage
    logical, allocatable :: finished(:)
    logical :: found
    integer :: k

    complete = .false.
    rank_files = 0
    call check_journal(journal_folder(plan), error)
    if (.not. allocated(error) .and. overwrite) call remove_file(plan%file, error)
    if (.not. allocated(error) .and. overwrite) call remove_journal(journal_folder(plan), error)
    if (.not. allocated(error)) call look_at_results_file(plan, complete, damage, error)
    if (allocated(error)) return
    if (complete) then
      if (.not. quiet) call say(plan%file//' is complete; --overwrite runs it again')
      call remove_journal(journal_folder(plan), error)
      return
    end if
    call look_at_journal(plan, found, error)
    if (allocated(error)) return
    rank_files = rank_files_in(journal_folder(plan))
    finished = finished_tasks(plan, rank_files)
    found = found .or. any(finished)
    if (allocated(damage)) then
      if (.not. found) then
        call move_alloc(damage, error)
        return
      end if
      if (.not. quiet) call say(plan%file//' is damaged, and is written anew from ' &
        //journal_folder(plan))
    end if
    call open_journal(plan, ranks, rank_files, error)
    if (allocated(error)) return
    pending = pack([(k, k=1, size(finished))], .not. finished)
    call put_longest_first(plan, pending)
    if (found .and. .not. quiet) call say('going on: ' &
      //to_text(count(finished))//' of '//to_text(size(finished))//' tasks are finished')
  end subroutine look_at_output

  !> Notes in the journal that so many ranks start, after so many rank files of earlier ones.
  subroutine open_journal(plan, ranks, rank_files, error)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: ranks, rank_files
    type(error_type), allocatable, intent(out) :: error

    if (rank_files > huge(rank_files) - ranks) then
      call fatal_error(error, journal_folder(plan)//'/rank_'//to_text(rank_files - 1) &
        //': leaves no number for another file; remove it')
    else
      call begin_journal(journal_folder(plan), plan%text, plan%initial_fingerprint, &
        rank_files + ranks, error)
    end if
  end subroutine open_journal

  !> Which of the tasks of a plan its journal has as complete; failed ones are tried again.
  function finished_tasks(plan, rank_files) result(finished)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: rank_files
    logical, allocatable :: finished(:)
    type(journal_type) :: journal
    type(task_result_type), allocatable :: results(:)
    integer, allocatable :: files(:)
    integer :: file, k

    allocate (finished(task_count(plan)), source=.false.)
    call join_journal(journal, journal_folder(plan), rank_files, 0, 0)
    files = rank_files_of(journal)
    do file = 1, size(files)
      call read_rank_file(journal, files(file), results)
      do k = 1, size(results)
        if (results(k)%status /= task_complete) cycle
        if (is_task_of(plan, int(results(k)%task, int64), results(k)%kept)) &
          finished(results(k)%task) = .true.
      end do
    end do
  end function finished_tasks

  !> Folder of the journal of a plan.
  pure function journal_folder(plan) result(folder)
    type(plan_type), intent(in) :: plan
    character(len=:), allocatable :: folder

    folder = plan%file//'.tasks'
  end function journal_folder

  !> Results that are there must be of this input.
  subroutine look_at_results_file(plan, complete, damage, error)
    type(plan_type), intent(in) :: plan
    !> Whether nothing is left to be done.
    logical, intent(out) :: complete
    !> What a results file cannot be read for.
    type(error_type), allocatable, intent(out) :: damage
    !> Code `exit_bad_input`: they are of another input, or what is there is no results file.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: before, status, initial_fingerprint

    complete = .false.
    if (.not. file_exists(plan%file)) return
    call read_metadata(plan%file, before, status, initial_fingerprint, error)
    if (.not. allocated(error)) then
      complete = status == 'complete'
      call compare(plan, before, initial_fingerprint, error)
    else if (error%code == exit_failure) then
      error%message = error%message//'; there is no journal to write it anew from: ' &
        //'remove the file, or compute it again with --overwrite'
      call move_alloc(error, damage)
    else
      error%message = error%message//', but is there already; name another output file, ' &
        //'move it away, or discard it with --overwrite'
    end if
  end subroutine look_at_results_file

  !> A journal must be of this input; if its plan is damaged, its other files must not say that
  !> they are of another.
  subroutine look_at_journal(plan, found, error)
    type(plan_type), intent(in) :: plan
    !> Whether there is a journal with a plan.
    logical, intent(out) :: found
    !> Code `exit_bad_input`: it is of another input.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: before
    integer(int64) :: initial_fingerprint

    call read_plan(journal_folder(plan), before, initial_fingerprint, found)
    if (found) then
      call compare(plan, before, fingerprint_text(initial_fingerprint), error)
    else if (belongs_to_another(plan)) then
      call fatal_error(error, journal_folder(plan)//' holds parts of another input, and the ' &
        //'plan in it is damaged; name another output file, or discard it with --overwrite', &
        exit_bad_input)
    end if
  end subroutine look_at_journal

  !> Whether the journal has anything that is of another input, where its plan cannot tell.
  function belongs_to_another(plan) result(another)
    type(plan_type), intent(in) :: plan
    logical :: another
    integer(int64), allocatable :: kept(:, :)
    integer :: k

    kept = kept_in(journal_folder(plan))
    another = .not. all([(is_task_of(plan, kept(1, k), kept(2, k)), k=1, size(kept, 2))])
  end function belongs_to_another

  !> Results of another input are not gone on with, nor those of an initial file that has changed.
  subroutine compare(plan, before, initial_fingerprint, error)
    type(plan_type), intent(in) :: plan
    character(len=*), intent(in) :: before, initial_fingerprint
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: keys

    keys = differing_keys(before, plan%text)
    if (keys == '' .and. plan%initial_file /= '' &
      .and. initial_fingerprint /= fingerprint_text(plan%initial_fingerprint)) &
      keys = '&particles initial_file: '''//plan%initial_file//''' has other contents now'
    if (keys /= '') call fatal_error(error, plan%file &
      //' was made from another input; these differ:' &
      //new_line('a')//keys//new_line('a') &
      //'name another output file, or discard it with --overwrite', exit_bad_input)
  end subroutine compare

end module battery_preparation
