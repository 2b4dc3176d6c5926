!> What this program was built from; `make build` writes the values.
module battery_build_information
  implicit none (type, external)
  private
  public :: program_version, git_commit

  ! program_version: as in fpm.toml; git_commit: 40 digits, `-dirty` where sources were changed.
  include 'build_information.inc'

end module battery_build_information
