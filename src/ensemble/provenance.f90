!> Build of the program: for `--version`, and for results files.
module battery_provenance
  use, intrinsic :: iso_fortran_env, only: compiler_version, compiler_options
  use battery_build_information, only: program_version, git_commit
  use battery_communicator, only: mpi_library
  use battery_gsl, only: gsl_library
  use battery_hdf5_file, only: hdf5_library
  use battery_text, only: new_line_character
  implicit none (type, external)
  private
  public :: attribute_type, build_attributes, version_text

  !> An attribute of a results file.
  type :: attribute_type
    character(len=16) :: name = ''
    character(len=:), allocatable :: text
  end type attribute_type

contains

  !> The attributes that describe the build. (gfortran 13 takes a wrong length of a text in a
  !> structure constructor.)
  function build_attributes() result(list)
    type(attribute_type) :: list(8)

    list%name = [character(len=16) :: 'program', 'version', 'git_commit', 'compiler', &
      'compiler_options', 'mpi_library', 'hdf5_library', 'gsl_library']
    list(1)%text = 'battery'
    list(2)%text = program_version
    list(3)%text = git_commit()
    list(4)%text = compiler_version()
    list(5)%text = compiler_options()
    list(6)%text = mpi_library()
    list(7)%text = hdf5_library()
    list(8)%text = gsl_library()
  end function build_attributes

  !> Text of `--version`: name, version and commit, then the attributes of the build, one per line.
  function version_text() result(text)
    character(len=:), allocatable :: text
    type(attribute_type) :: build(8)
    integer :: k

    text = 'battery '//program_version//' (commit '//git_commit()//')'
    build = build_attributes()
    do k = 4, size(build)
      text = text//new_line_character//trim(build(k)%name)//': '//build(k)%text
    end do
    if (git_commit() == 'unknown') return
    text = trim(text//new_line_character//'sources: '//merge('changed since the commit', &
      'as in the commit        ', index(git_commit(), '-dirty') > 0))
  end function version_text

end module battery_provenance
