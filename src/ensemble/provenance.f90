!> Build and command line of the program: for `--version`, and for results files.
module battery_provenance
  use, intrinsic :: iso_fortran_env, only: compiler_version, compiler_options
  use battery_build_information, only: program_version, git_commit
  use battery_communicator, only: mpi_library
  use battery_gsl, only: gsl_library
  use battery_hdf5_file, only: hdf5_library
  use battery_text, only: new_line_character
  implicit none (type, external)
  private
  public :: build_attributes, build_value, version_text, command_text

  !> Names of the attributes that describe the build.
  character(len=*), parameter :: build_attributes(8) = [character(len=16) :: 'program', 'version', &
    'git_commit', 'compiler', 'compiler_options', 'mpi_library', 'hdf5_library', 'gsl_library']

contains

  !> Value of the attribute number `k` of `build_attributes`.
  function build_value(k) result(text)
    integer, intent(in) :: k
    character(len=:), allocatable :: text

    select case (build_attributes(k))
    case ('program')
      text = 'battery'
    case ('version')
      text = program_version
    case ('git_commit')
      text = git_commit()
    case ('compiler')
      text = compiler_version()
    case ('compiler_options')
      text = compiler_options()
    case ('mpi_library')
      text = mpi_library()
    case ('hdf5_library')
      text = hdf5_library()
    case default
      text = gsl_library()
    end select
  end function build_value

  !> Text of `--version`: name, version and commit, then the attributes of the build, one per line.
  function version_text() result(text)
    character(len=:), allocatable :: text
    integer :: k

    text = 'battery '//program_version//' (commit '//git_commit()//')'
    do k = 4, size(build_attributes)
      text = text//new_line_character//trim(build_attributes(k))//': '//build_value(k)
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
