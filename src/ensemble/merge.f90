!> From the journal of an ensemble to its results file.
module battery_merge
  use, intrinsic :: iso_fortran_env, only: compiler_version, compiler_options
  use battery_kinds, only: dp
  use battery_build_information, only: program_version, git_commit
  use battery_collection, only: collect_results
  use battery_communicator, only: mpi_library
  use battery_error, only: error_type
  use battery_fingerprint, only: fingerprint_text
  use battery_journal, only: journal_type
  use battery_metadata, only: metadata_type
  use battery_plan, only: plan_type
  use battery_results, only: results_type, task_complete
  use battery_results_file, only: write_results
  use battery_text, only: string_type
  implicit none (type, external)
  private
  public :: merge_results

contains

  !> Writes the results file from all that the journal has, which comes back in `results`.
  subroutine merge_results(plan, journal, ranks, results, failures, error)
    type(plan_type), intent(in) :: plan
    type(journal_type), intent(in) :: journal
    !> How many ran.
    integer, intent(in) :: ranks
    type(results_type), intent(out) :: results
    !> Why a task failed; not allocated where it did not.
    type(string_type), allocatable, intent(out) :: failures(:)
    type(error_type), allocatable, intent(out) :: error
    type(metadata_type) :: metadata

    call collect_results(plan, journal, results, failures)
    metadata%program = 'battery'
    metadata%version = program_version
    metadata%git_commit = git_commit()
    metadata%compiler = compiler_version()
    metadata%compiler_options = compiler_options()
    metadata%mpi_library = mpi_library()
    metadata%mpi_ranks = ranks
    metadata%namelist = plan%text
    metadata%initial_file_fingerprint = ''
    if (plan%initial_file /= '') &
      metadata%initial_file_fingerprint = fingerprint_text(plan%initial_fingerprint)
    metadata%status = merge('complete', 'partial ', all(results%task_status == task_complete))
    metadata%status = trim(metadata%status)
    metadata%shape = plan%shape
    metadata%engine = plan%engine
    metadata%start_time = real(plan%start_time, dp)
    call write_results(plan%file, results, metadata, error)
  end subroutine merge_results

end module battery_merge
