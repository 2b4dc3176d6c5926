!> Build and command line of the program: for `--version`, and for results files.
module battery_provenance
  use, intrinsic :: iso_fortran_env, only: compiler_version, compiler_options
  use battery_build_information, only: program_version, git_commit
  use battery_communicator, only: mpi_library
  use battery_gsl, only: gsl_library
  use battery_hdf5_file, only: hdf5_library
  use battery_metadata, only: metadata_type, add_text_metadata
  use battery_text, only: new_line_character
  implicit none (type, external)
  private
  public :: add_build_metadata, version_text, command_text

contains

  !> Adds attributes that describe the build: version, commit, compiler, libraries.
  subroutine add_build_metadata(metadata)
    type(metadata_type), intent(inout) :: metadata

    call add_text_metadata(metadata, 'program', 'battery')
    call add_text_metadata(metadata, 'version', program_version)
    call add_text_metadata(metadata, 'git_commit', git_commit())
    call add_text_metadata(metadata, 'compiler', compiler_version())
    call add_text_metadata(metadata, 'compiler_options', compiler_options())
    call add_text_metadata(metadata, 'mpi_library', mpi_library())
    call add_text_metadata(metadata, 'hdf5_library', hdf5_library())
    call add_text_metadata(metadata, 'gsl_library', gsl_library())
  end subroutine add_build_metadata

  !> Text of `--version`: name, version and commit, then the attributes of the build, one per line.
  function version_text() result(text)
    character(len=:), allocatable :: text
    type(metadata_type) :: metadata
    integer :: k

    text = 'battery '//program_version//' (commit '//git_commit()//')'
    call add_build_metadata(metadata)
    do k = 4, size(metadata%texts)
      text = text//new_line_character//metadata%texts(k)%name//': '//metadata%texts(k)%text
    end do
    if (git_commit() == 'unknown') return
    text = trim(text//new_line_character//'sources: '//merge('changed since the commit', &
      'as in the commit        ', index(git_commit(), '-dirty') > 0))
  end function version_text

  !> The command line of this process.
  function command_text() result(text)
    character(len=:), allocatable :: text
    integer :: length

    call get_command(length=length)
    allocate (character(len=length) :: text)
    call get_command(text)
  end function command_text

end module battery_provenance
