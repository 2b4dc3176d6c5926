!> The start of an ensemble: finds existing results, and the tasks that are pending.
module battery_startup
  use battery_kinds, only: wp, dp, int64
  use battery_build_information, only: program_version
  use battery_clocks, only: utc_now
  use battery_communicator, only: communicator_type, share_error, share_words
  use battery_checksum_footer, only: check_discardable
  use battery_error, only: error_type, fatal_error, exit_failure, exit_bad_input
  use battery_files, only: file_exists, make_folder, remove_file, publish_file, file_stamp_type
  use battery_findings, only: findings_type, findings_text
  use battery_input_files, only: reason_unwritable
  use battery_journal, only: journal_type, find_journal, find_task_ids, begin_journal, &
    join_journal, states_in, remove_journal
  use battery_lock_file, only: lock_type, acquire_lock, release_lock
  use battery_merge, only: collect_results, sources_type, open_sources, close_sources, &
    write_results_of
  use battery_namelist_input, only: differing_keys, parse_namelist
  use battery_plan, only: plan_type
  use battery_plan_remarks, only: remarks_of
  use battery_results, only: results_type, task_complete, point_undecided
  use battery_process, only: process_number, host_name
  use battery_results_file, only: results_file_type, open_results, read_results, close_results, &
    accept_results
  use battery_tasks, only: task_type, task_count, task_of, order_tasks, task_index_type, &
    task_index_of, task_number_of
  use battery_terminal, only: print_line
  use battery_text, only: to_text, count_text, new_line_character
  implicit none (type, external)
  private
  public :: find_pending_tasks, find_further_tasks, progress_type, inspect_output, set_pending
  public :: further_text, accept_output, clear_error_if_complete, check_writable
  public :: write_partial_results

  character(len=*), parameter :: discard_text = &
    'name another output file, or discard it with --overwrite'

  !> Progress of an ensemble.
  type :: progress_type
    !> Whether the results file is complete.
    logical :: complete = .false.
    !> Whether there is one that is damaged.
    logical :: is_damaged = .false.
    !> Number of finished tasks.
    integer :: finished = 0
    !> Number of tasks that have a saved state, from which they go on.
    integer :: begun = 0
    !> Numbers of the tasks that are known to be needed and are not finished.
    integer, allocatable :: pending(:)
    !> Largest number of tasks that may be needed besides, if a precision is required.
    integer :: further = 0
    !> Expected number of these, if undecided points get as many replicas as the others on average;
    !> below 0 if no point is decided.
    real(dp) :: expected = -1.0_dp
  end type progress_type

contains

  !> Finds the pending tasks: rank 0 inspects the results file and the journal, if they exist.
  subroutine find_pending_tasks(plan, communicator, overwrite, quiet, sources, pending, complete, &
    error)
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    !> Whether to discard existing results; whether rank 0 prints nothing.
    logical, intent(in) :: overwrite, quiet
    !> The journal, and the old results file on rank 0, open if it is there.
    type(sources_type), intent(out) :: sources
    !> Numbers of the pending tasks, in the order to be taken, on rank 0; empty on the others.
    integer, allocatable, intent(out) :: pending(:)
    !> Whether no task is pending.
    logical, intent(out) :: complete
    !> The same error on all ranks; code `exit_bad_input` if existing files are of another input.
    type(error_type), allocatable, intent(out) :: error
    integer(int64), allocatable :: shared(:)

    allocate (pending(0))
    complete = .false.
    if (communicator%rank == 0) then
      call begin_on_rank0()
      shared = [merge(1, 0, complete), sources%first_file]
    end if
    call share_error(communicator, error)
    if (allocated(error)) return
    call share_words(communicator, shared)
    complete = shared(1) == 1
    call join_journal(sources%journal_type, journal_folder(plan), int(shared(2)), &
      communicator%rank, communicator%size)

  contains

    !> Finds the pending tasks, and the journal of earlier starts; if there are pending tasks,
    !> begins the journal of this start.
    subroutine begin_on_rank0()
      type(progress_type) :: progress
      character(len=:), allocatable :: message
      type(findings_type) :: remarks

      if (overwrite) call discard_output(plan, error)
      if (.not. allocated(error)) call inspect_output(plan, sources, progress, message, error)
      if (allocated(error)) return
      complete = progress%complete
      pending = progress%pending
      if (message /= '' .and. .not. quiet) call print_line(message)
      if (complete) then
        call remove_journal(sources%folder, error)
      else
        remarks = remarks_of(plan, 0.0_dp)
        if (remarks%count > 0 .and. .not. quiet) call print_line(findings_text(remarks, 'remark'))
        ! Somebody may want to save what the journal lacks.
        if (progress%is_damaged) call publish_file(plan%file, damaged_file(plan), error)
        if (progress%is_damaged) sources%old%stamp = file_stamp_type()
        if (.not. allocated(error)) call begin_journal(sources%journal_type, plan%text, &
          plan%initial_fingerprint, communicator%size, error)
        call order_tasks(plan, communicator%size, pending)
      end if
    end subroutine begin_on_rank0

  end subroutine find_pending_tasks

  !> Finds the tasks that a precision needs besides, after those of a first pass are finished.
  subroutine find_further_tasks(plan, communicator, sources, pending, error)
    type(plan_type), intent(in) :: plan
    type(communicator_type), intent(in) :: communicator
    type(sources_type), intent(inout) :: sources
    !> On rank 0: the tasks of the last pass; then those of the next, in the order to be taken; none
    !> if results of the last cannot be read back.
    integer, allocatable, intent(inout) :: pending(:)
    !> The same error on all ranks.
    type(error_type), allocatable, intent(out) :: error
    type(results_type) :: results
    logical :: were_read

    if (communicator%rank == 0) call collect_results(plan, sources, results, error)
    call share_error(communicator, error)
    if (communicator%rank > 0 .or. allocated(error)) return
    associate (status => reshape(results%task_status, [task_count(plan)]))
      were_read = all(status(pending) == task_complete)
    end associate
    pending = pending_tasks(plan, results)
    if (.not. were_read) pending = pending(:0)
    call order_tasks(plan, communicator%size, pending)
  end subroutine find_further_tasks

  !> Numbers of the tasks that are known to be needed and are not complete.
  pure function pending_tasks(plan, results) result(pending)
    type(plan_type), intent(in) :: plan
    type(results_type), intent(in) :: results
    integer, allocatable :: pending(:)
    integer :: k

    associate (needed => results%replicas_needed)
      pending = pack([(k, k=1, task_count(plan))], [(results%task_status(:needed(k), k) &
        /= task_complete, spread(.false., 1, plan%replicas - needed(k)), k=1, plan%point_count)])
    end associate
  end function pending_tasks

  !> Removes the results file, and the journal whether or not it can be read. A folder for the next
  !> journal is made before: where that is not possible the results stay.
  subroutine discard_output(plan, error)
    type(plan_type), intent(in) :: plan
    !> They are something else, or cannot be removed.
    type(error_type), allocatable, intent(out) :: error

    call check_discardable(plan%file, error)
    if (.not. allocated(error)) call check_discardable(plan%file//'.part', error)
    if (.not. allocated(error)) call remove_journal(journal_folder(plan), error)
    if (.not. allocated(error)) call make_folder(journal_folder(plan), error)
    if (.not. allocated(error)) call remove_file(plan%file, error)
  end subroutine discard_output

  !> Determines the progress of an ensemble from its results file and its journal; writes nothing.
  subroutine inspect_output(plan, sources, progress, message, error)
    type(plan_type), intent(in) :: plan
    !> Journal of earlier starts; the results file, to be closed with `close_sources`.
    type(sources_type), intent(out) :: sources
    type(progress_type), intent(out) :: progress
    !> Message for the user; may be empty.
    character(len=:), allocatable, intent(out) :: message
    !> Existing files are of another input; code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error
    type(error_type), allocatable :: damage
    type(results_type) :: results
    logical :: found

    allocate (progress%pending(0))
    message = ''
    call inspect_results_file(plan, .false., sources%old, progress%complete, damage, error)
    if (.not. allocated(error)) call inspect_journal(plan, progress%complete, &
      sources%journal_type, error)
    if (.not. allocated(error)) call collect_results(plan, sources, results, error)
    if (allocated(error)) return
    progress%finished = count(results%task_status == task_complete)
    progress%begun = states_in(sources%journal_type)
    if (progress%complete) then
      message = plan%file//' is complete; --overwrite runs it again'
      return
    end if
    call check_writable(plan, error)
    if (allocated(error)) return
    ! The results are written under this name first.
    call check_discardable(plan%file//'.part', error)
    if (allocated(error)) return
    found = sources%has_plan .or. progress%finished > 0
    if (allocated(damage)) then
      if (.not. found) call fatal_error(error, damage%message//'; there is no journal to write ' &
        //'it anew from: remove the file, or compute it again with --overwrite')
      if (found .and. file_exists(damaged_file(plan))) call fatal_error(error, &
        damaged_file(plan)//': is there already; move it away', exit_bad_input)
      if (allocated(error)) return
      message = plan%file//' is damaged: the run keeps it as '//damaged_file(plan) &
        //', and writes it anew from '//journal_folder(plan)//new_line_character
    end if
    progress%is_damaged = allocated(damage)
    call set_pending(plan, results, progress)
    if (found) message = message//'going on: '//to_text(progress%finished)//' of ' &
      //to_text(progress%finished + size(progress%pending))//' tasks are finished' &
      //further_text(progress)
  end subroutine inspect_output

  !> Clears the error that an output or its lock file cannot be written, if the output is complete,
  !> as protected results are: then nothing is to be done.
  subroutine clear_error_if_complete(plan, quiet, complete, error)
    type(plan_type), intent(in) :: plan
    !> Whether to print nothing.
    logical, intent(in) :: quiet
    logical, intent(out) :: complete
    !> Why it cannot be written; deallocated if it is complete. That of existing files comes first.
    type(error_type), allocatable, intent(inout) :: error
    type(sources_type) :: sources
    type(progress_type) :: progress
    character(len=:), allocatable :: message
    type(error_type), allocatable :: other

    call inspect_output(plan, sources, progress, message, other)
    call close_sources(sources)
    complete = progress%complete .and. .not. allocated(other)
    if (complete) then
      deallocate (error)
      if (.not. quiet) call print_line(message)
    else if (allocated(other)) then
      call move_alloc(other, error)
    end if
  end subroutine clear_error_if_complete

  !> An error if the results file of a plan cannot be written.
  subroutine check_writable(plan, error)
    type(plan_type), intent(in) :: plan
    !> Code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: reason

    reason = reason_unwritable(plan%file, .true.)
    if (reason /= '') call fatal_error(error, plan%file//': '//reason, exit_bad_input)
  end subroutine check_writable

  !> Text for the tasks that go on from a saved state, and for the number that may be needed besides
  !> those known to be needed; empty: none.
  function further_text(progress) result(text)
    type(progress_type), intent(in) :: progress
    character(len=:), allocatable :: text

    text = ''
    if (progress%begun > 0) text = ', '//to_text(progress%begun)//' begun and saved'
    if (progress%further > 0) text = text//', and up to '//to_text(progress%further) &
      //' more as the first replicas tell'
  end function further_text

  !> Sets the pending tasks, and estimates the number of tasks of points whose first replicas are
  !> not complete.
  pure subroutine set_pending(plan, results, progress)
    type(plan_type), intent(in) :: plan
    !> Results, for which `decide_replicas` was called.
    type(results_type), intent(in) :: results
    type(progress_type), intent(inout) :: progress
    logical :: decided(plan%point_count)
    integer :: others

    progress%pending = pending_tasks(plan, results)
    if (.not. allocated(results%point_status)) return
    decided = results%point_status /= point_undecided
    others = count(.not. decided)
    progress%further = others*(plan%replicas - plan%first_replicas)
    if (any(decided)) progress%expected = others*(real(sum(results%replicas_needed, decided), dp) &
      /count(decided) - plan%first_replicas)
  end subroutine set_pending

  !> Path under which a damaged results file of a plan is kept.
  pure function damaged_file(plan) result(path)
    type(plan_type), intent(in) :: plan
    character(len=:), allocatable :: path

    path = plan%file//'.damaged'
  end function damaged_file

  !> Folder of the journal of a plan.
  pure function journal_folder(plan) result(folder)
    type(plan_type), intent(in) :: plan
    character(len=:), allocatable :: folder

    folder = plan%file//'.tasks'
  end function journal_folder

  !> Inspects the results file, which must be of this input, or of one that this input extends.
  subroutine inspect_results_file(plan, is_read, file, complete, damage, error)
    type(plan_type), intent(in) :: plan
    !> Whether its numbers are needed if it is complete, too.
    logical, intent(in) :: is_read
    !> The file, open if it is there and undamaged.
    type(results_file_type), intent(inout) :: file
    !> Whether no task is pending.
    logical, intent(out) :: complete
    !> Reason for which the results file cannot be read.
    type(error_type), allocatable, intent(out) :: damage
    !> The file is of another input, or no results file; code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error

    complete = .false.
    if (.not. file_exists(plan%file)) return
    call open_results(plan%file, file, error)
    if (.not. allocated(error)) then
      call check_input_of(file, plan, is_read, complete, error)
    else if (error%code == exit_failure) then
      call move_alloc(error, damage)
    end if
  end subroutine inspect_results_file

  !> An error if a results file is of an input that a plan does not extend, or of another version:
  !> its datasets cannot be read.
  subroutine check_input_of(file, plan, is_read, complete, error)
    !> The file, open; its plan is set here. One of another version that need not be read is closed.
    type(results_file_type), intent(inout) :: file
    type(plan_type), intent(in) :: plan
    !> Whether its numbers are needed if it is complete, too.
    logical, intent(in) :: is_read
    !> Whether it has all tasks of the plan.
    logical, intent(out) :: complete
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: remedy
    logical :: same

    remedy = discard_text
    if (file_exists(journal_folder(plan))) remedy = 'name another output file, or move it away, ' &
      //'with '//journal_folder(plan)//' if that is of the same input; --overwrite would ' &
      //'discard both'
    if (is_read) remedy = 'use the namelist and the version that it was made with'
    call compare_inputs(plan, plan%file, remedy, file%namelist, file%initial_fingerprint, &
      file%plan, same, error)
    complete = same .and. file%status == 'complete'
    if (allocated(error) .or. file%version == program_version) return
    if (complete .and. .not. is_read) then
      call close_results(file)
    else
      call fatal_error(error, plan%file//' was made by version '//file%version//', and this is ' &
        //program_version//'; '//remedy, exit_bad_input)
    end if
  end subroutine check_input_of

  !> Gives the results file of a plan a new footer, if it was cut off, and the contents are results
  !> of this input, or of one that this input extends.
  subroutine accept_output(plan, message, error)
    type(plan_type), intent(in) :: plan
    !> Message for the user.
    character(len=:), allocatable, intent(out) :: message
    !> The file is not accepted, and unchanged; code `exit_bad_input` if it is of another input.
    type(error_type), allocatable, intent(out) :: error
    type(results_file_type) :: file
    type(results_type) :: results
    type(lock_type) :: lock
    logical :: lacks_footer, complete

    message = ''
    if (.not. file_exists(plan%file)) then
      call fatal_error(error, plan%file//': there is no results file to accept', exit_bad_input)
      return
    end if
    call acquire_lock(lock, plan%file, error)
    if (allocated(error)) return
    call open_results(plan%file, file, error, lacks_footer)
    if (.not. allocated(error) .and. lacks_footer) then
      call check_input_of(file, plan, .true., complete, error)
      if (.not. allocated(error)) call check_writable(plan, error)
      if (.not. allocated(error)) call check_discardable(plan%file//'.part', error)
      if (.not. allocated(error)) call accept_results(plan%file, file, results, error)
      if (.not. allocated(error)) message = plan%file//': accepted as it is, with a new digest: ' &
        //'its structure and its seeds are those of its namelist; ' &
        //count_text(count(results%task_status == task_complete), 'complete task')
    else if (.not. allocated(error)) then
      message = plan%file//': has its digest; there is nothing to accept'
    end if
    call close_results(file)
    call release_lock(lock)
  end subroutine accept_output

  !> Writes what is finished of an ensemble, which may be going on or have died, to the file
  !> `FILE.h5.partial.h5`. It takes no lock and changes nothing else. All rank files are opened
  !> before the results file: a run that ends meanwhile publishes that before it removes them.
  subroutine write_partial_results(plan, message, error)
    type(plan_type), intent(in) :: plan
    !> Message for the user.
    character(len=:), allocatable, intent(out) :: message
    !> No task is finished, existing files are of another input, or the file cannot be written.
    type(error_type), allocatable, intent(out) :: error
    type(plan_type) :: partial
    type(sources_type) :: sources
    type(results_type) :: results
    type(error_type), allocatable :: damage, ignored
    character(len=:), allocatable :: unique
    logical :: complete
    !> Number of finished tasks in the partial file of before.
    integer :: finished_before

    message = ''
    partial = plan
    partial%file = plan%file//'.partial.h5'
    call check_writable(partial, error)
    if (.not. allocated(error)) call check_replaceable()
    if (allocated(error)) return
    call inspect_journal(plan, .true., sources%journal_type, error)
    if (.not. allocated(error)) call open_sources(sources, .true., error)
    if (.not. allocated(error)) call inspect_results_file(plan, .true., sources%old, complete, &
      damage, error)
    if (.not. allocated(error)) call collect_results(plan, sources, results, error)
    if (.not. allocated(error)) then
      if (all(results%task_status /= task_complete)) call fatal_error(error, plan%file &
        //': no task is finished yet'//damage_text(), exit_bad_input)
      ! Of a run before `--overwrite`, whose results are nowhere else.
      if (finished_before > count(results%task_status == task_complete)) call fatal_error(error, &
        partial%file//': has more finished tasks than there are now, and is not replaced; move ' &
        //'it away', exit_bad_input)
    end if
    if (.not. allocated(error)) then
      ! Another process may write the same file at the same time.
      unique = partial%file//'.'//host_name()//'.'//to_text(process_number())
      call remove_file(unique, error)
      if (.not. allocated(error)) call write_results_of(plan, sources, unique, file_stamp_type(), &
        utc_now(), results, error)
      if (.not. allocated(error)) call check_replaceable()
      if (.not. allocated(error)) call publish_file(unique, partial%file, error)
      if (allocated(error)) then
        call remove_file(unique, ignored)
        call remove_file(unique//'.part', ignored)
      end if
      message = partial%file//': has '//to_text(count(results%task_status == task_complete)) &
        //' of '//to_text(task_count(plan))//' tasks'//damage_text()
    end if
    call close_sources(sources)

  contains

    !> An error if what has the name of the partial file is no partial file of this input.
    subroutine check_replaceable()
      type(results_file_type) :: file
      type(results_type) :: before
      type(error_type), allocatable :: reason

      finished_before = 0
      call inspect_results_file(partial, .true., file, complete, reason, error)
      if (file_exists(partial%file) .and. .not. (allocated(reason) .or. allocated(error))) then
        call read_results(file, before, error)
        if (.not. allocated(error)) finished_before = count(before%task_status == task_complete)
      end if
      call close_results(file)
      if (.not. allocated(error)) call move_alloc(reason, error)
      if (.not. allocated(error)) return
      ! What is advised behind the reason is about a results file.
      if (index(error%message, '; ') > 0) error%message = error%message(:index(error%message, &
        '; ') - 1)
      error%message = partial%file//': is not a partial file of this input, and is not ' &
        //'replaced; move it away ('//error%message//')'
      error%code = exit_bad_input
    end subroutine check_replaceable

    !> Text for a results file that is damaged, whose tasks are not known.
    pure function damage_text() result(text)
      character(len=:), allocatable :: text

      text = ''
      if (allocated(damage)) text = ' ('//damage%message//')'
    end function damage_text

  end subroutine write_partial_results

  !> Inspects the journal, which must be of this input, or of one that this input extends; if its
  !> plan is damaged, its records must not belong to another input.
  subroutine inspect_journal(plan, complete, journal, error)
    type(plan_type), intent(in) :: plan
    !> Whether the results file is complete, so that the journal is not needed any more.
    logical, intent(in) :: complete
    type(journal_type), intent(out) :: journal
    !> The journal is of another input; code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error
    integer(int64), allocatable :: task_id(:)
    type(task_index_type) :: task_index
    type(plan_type) :: before
    character(len=:), allocatable :: remedy
    logical :: same
    integer :: k

    call find_journal(journal, journal_folder(plan), error)
    if (allocated(error)) return
    remedy = discard_text
    if (file_exists(plan%file)) remedy = 'go on with that input, or remove this folder; ' &
      //plan%file//' stays as it is'
    if (journal%has_plan) then
      call compare_inputs(plan, journal_folder(plan), remedy, journal%namelist, &
        journal%initial_fingerprint, before, same, error)
    else if (.not. complete) then
      call find_task_ids(journal, task_id, error)
      if (allocated(error) .or. size(task_id) == 0) return
      task_index = task_index_of(plan)
      if (any([(task_number_of(task_index, task_id(k)) == 0, k=1, size(task_id))])) call &
        fatal_error(error, journal_folder(plan) &
        //' holds parts of another input, and the plan in it is damaged; '//remedy, exit_bad_input)
    end if
  end subroutine inspect_journal

  !> An error unless the plan has all tasks of an earlier input, so that their results can be used;
  !> the initial file must be the same, too.
  subroutine compare_inputs(plan, path, remedy, text, initial_fingerprint, before, same, error)
    type(plan_type), intent(in) :: plan
    !> The results file or the journal of the earlier input; what may be done; the earlier namelist.
    character(len=*), intent(in) :: path, remedy, text
    integer(int64), intent(in) :: initial_fingerprint
    !> Its plan.
    type(plan_type), intent(out) :: before
    !> Whether the plan has no other tasks than the earlier input.
    logical, intent(out) :: same
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: keys, longer
    type(error_type), allocatable :: wrong

    call parse_namelist(text, plan%file, before, wrong)
    before%initial_fingerprint = initial_fingerprint
    keys = differing_keys(before%settings, plan%settings)
    same = keys == '' .and. initial_fingerprint == plan%initial_fingerprint
    if (same) return
    if (initial_fingerprint /= plan%initial_fingerprint .and. index(keys, '&particles ' &
      //'initial_file') == 0) then
      if (keys /= '') keys = keys//new_line_character
      keys = keys//'&particles initial_file: '''//plan%initial_file//''' has other contents now'
    else if (allocated(wrong)) then
      keys = keys//new_line_character//wrong%message
    else
      if (has_all_of(plan, before)) return
    end if
    longer = ''
    if (index(keys, '&run collisions') > 0 .or. index(keys, '&run duration') > 0) longer = &
      new_line_character//'(to go on from a finished run, write its &output final_state as a ' &
      //'text, and give that as &particles initial_file)'
    call fatal_error(error, path//' was made from another input; these differ:' &
      //new_line_character//keys//new_line_character//remedy//longer, exit_bad_input)
  end subroutine compare_inputs

  !> Whether a plan has all tasks of an earlier one.
  logical function has_all_of(plan, old) result(yes)
    type(plan_type), intent(in) :: plan, old
    type(task_index_type) :: task_index
    type(task_type) :: task
    integer :: k

    ! Without a precision (0) all replicas are needed; else each error that was required before must
    ! be required still, and be at most that.
    associate (now => plan%precision, before => old%precision)
      yes = task_count(old) <= task_count(plan) .and. plan%first_replicas >= old%first_replicas &
        .and. (all(.not. before > 0.0_wp .or. (now > 0.0_wp .and. now <= before)) &
        .or. .not. any(now > 0.0_wp))
    end associate
    if (.not. yes) return
    task_index = task_index_of(plan)
    do k = 1, task_count(old)
      task = task_of(old, k)
      yes = task_number_of(task_index, task%task_id) > 0
      if (.not. yes) return
    end do
  end function has_all_of

end module battery_startup
