!> Version and commit that this program was built from.
module battery_build_information
  use, intrinsic :: iso_c_binding, only: c_char, c_null_char
  implicit none (type, external)
  private
  public :: program_version, git_commit

  !> Version of the program, the same as in fpm.toml (test/test_fpm.py).
  character(len=*), parameter :: program_version = '0.4.0'

  !> Git commit, compiled into `commit.c`.
  character(kind=c_char), bind(c, name='battery_commit'), protected :: commit(48)

contains

  !> Git commit: 40 digits, with `-dirty` if sources were changed; `unknown` if the program was not
  !> built by `make`.
  pure function git_commit() result(text)
    character(len=:), allocatable :: text

    text = transfer(commit, repeat(' ', size(commit)))
    text = text(:index(text//c_null_char, c_null_char) - 1)
  end function git_commit

end module battery_build_information
