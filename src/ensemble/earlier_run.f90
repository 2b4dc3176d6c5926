!> What earlier runs have left under the name of an output, and whether it is of the same input.
module battery_earlier_run
  use battery_kinds, only: int64
  use battery_error, only: error_type, fatal_error, exit_failure, exit_bad_input
  use battery_files, only: file_exists, remove_file
  use battery_fingerprint, only: fingerprint_text
  use battery_journal, only: read_plan, kept_in
  use battery_journal_folder, only: remove_journal
  use battery_metadata, only: read_metadata
  use battery_namelist_input, only: differing_keys
  use battery_plan, only: plan_type
  use battery_tasks, only: is_task_of
  implicit none (type, external)
  private
  public :: look_at_results_file, look_at_journal, discard, journal_folder

contains

  !> Folder of the journal of a plan.
  pure function journal_folder(plan) result(folder)
    type(plan_type), intent(in) :: plan
    character(len=:), allocatable :: folder

    folder = plan%file//'.tasks'
  end function journal_folder

  !> Removes results and journal of whatever run used the same output file.
  subroutine discard(plan, error)
    type(plan_type), intent(in) :: plan
    type(error_type), allocatable, intent(out) :: error

    call remove_file(plan%file, error)
    if (.not. allocated(error)) call remove_journal(journal_folder(plan), error)
  end subroutine discard

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

end module battery_earlier_run
