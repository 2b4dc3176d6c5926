!> Reads and checks the input on one rank, and shares the plan with the others.
module battery_plan_sharing
  use battery_communicator, only: communicator_type, share_error, share_words
  use battery_error, only: error_type
  use battery_input_files, only: read_namelist
  use battery_keys, only: all_keys
  use battery_namelist_input, only: fill_plan
  use battery_plan, only: plan_type
  use battery_settings, only: read_settings, serialize_settings
  use battery_signals, only: stop_requested, set_stop_error
  use battery_archive, only: archive_type, new_archive, archive_of
  implicit none (type, external)
  private
  public :: read_plan_once

contains

  !> Reads the plan of a namelist file, for all ranks. Only rank 0 accesses files and parses the
  !> text: a namelist from a pipe can be read only once. The others get the values of all keys, and
  !> what rank 0 has read from other files.
  subroutine read_plan_once(file, communicator, plan, error)
    !> Path of the namelist.
    character(len=*), intent(in) :: file
    type(communicator_type), intent(in) :: communicator
    type(plan_type), intent(out) :: plan
    !> The input is invalid (code `exit_bad_input`), or a signal has stopped the run; the same error
    !> on all ranks.
    type(error_type), allocatable, intent(out) :: error
    type(archive_type) :: archive

    if (communicator%rank == 0) then
      call read_namelist(file, plan, error)
      if (stop_requested()) call set_stop_error(error)
    end if
    call share_error(communicator, error)
    if (allocated(error) .or. communicator%size == 1) return
    if (communicator%rank == 0) then
      archive = new_archive()
      call serialize_input(plan, archive)
    end if
    call share_words(communicator, archive%word)
    if (communicator%rank == 0) return
    archive = archive_of(archive%word)
    call read_settings('', all_keys(), plan%settings)
    call serialize_input(plan, archive)
  end subroutine read_plan_once

  !> Saves or restores what rank 0 has read: values of the keys, initial particles, and their
  !> fingerprint.
  subroutine serialize_input(plan, archive)
    type(plan_type), intent(inout) :: plan
    type(archive_type), intent(inout) :: archive

    call serialize_settings(plan%settings, archive)
    if (archive%reading) call fill_plan(plan)
    call archive%serialize_text('text', plan%text)
    call archive%serialize_text('input_file', plan%input_file)
    call archive%serialize_text('file', plan%file)
    call archive%serialize('urn1_number', plan%base%urn1_number)
    call archive%serialize('initial_fingerprint', plan%initial_fingerprint)
    if (plan%initial_fingerprint == 0) return
    call archive%serialize_list('x', plan%file_particles%x, 'y', plan%file_particles%y, 'ux', &
      plan%file_particles%ux, 'uy', plan%file_particles%uy)
  end subroutine serialize_input

end module battery_plan_sharing
