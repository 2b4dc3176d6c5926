!> Checksum footer of a results file: its last 512 bytes, which come after the end of the HDF5 data,
!> so that readers of HDF5 ignore them.
!>
!> It is plain text with the number and the SHA-256 digest of all bytes before it, so that a file
!> can be checked before HDF5 opens it. It has no other contents: a footer is valid if it is
!> identical to the text made from these bytes. `postproc/reading/seal.py` writes and checks the
!> same text.
!>
!> The alternative is HDF5's user block, before its own header; but readers that identify a file by
!> its first bytes (as `xarray.open_dataset` does) do not recognise such a file as HDF5.
module battery_checksum_footer
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_int8_t, c_int64_t, c_null_char
  use battery_kinds, only: int8, int64
  use battery_error, only: error_type, fatal_error, exit_bad_input, exit_failure
  use battery_files, only: file_exists, write_parts, file_stamp_type, has_stamp
  use battery_foreign_bytes, only: is_results_file
  use battery_file_text, only: read_file
  use battery_paths, only: is_folder, set_system_error
  implicit none (type, external)
  private
  public :: write_with_footer, check_footer, check_discardable, check_unchanged, copy_with_footer

  !> Length of the footer in bytes; hexadecimal digits of a digest.
  integer, parameter :: footer_length = 512, digest_length = 64

  !> First line of the footer, and the line that explains it to a reader.
  character(len=*), parameter :: first_line = 'battery results 1'
  character(len=*), &
    parameter :: explanation = 'Before these 512 bytes is HDF5; head -c -512 FILE | ' &
    //'sha256sum gives the digits above.'

  !> What stands before the digest.
  character(len=*), parameter :: digest_word = new_line('a')//'sha256 '

  !> An attribute that only files of this program have, near their beginning. Programs that write
  !> HDF5 anew may move it.
  character(len=*), parameter :: mark = 'initial_file_fingerprint'

  !> First bytes of a file that are examined; one of fewer than `shortest` is cut off in the first
  !> block of HDF5; bytes of zeros that a crash of the machine leaves at the beginning, if not all.
  integer, parameter :: beginning = 1024**2, shortest = 64, block = 4096

  !> Advice about something else that has the name of the results file.
  character(len=*), parameter :: leave_it = '; name another output file, or move it away'

  interface
    !> SHA-256 digest of bytes, in hexadecimal digits; not 0: it cannot be computed.
    integer(c_int) function c_digest(bytes, count, digits) bind(c, name='battery_digest')
      import :: c_char, c_int, c_int8_t, c_int64_t, digest_length
      implicit none (type, external)
      integer(c_int8_t), intent(in) :: bytes(*)
      integer(c_int64_t), value, intent(in) :: count
      character(kind=c_char), intent(out) :: digits(digest_length)
    end function c_digest

    !> Reads a file once: its first and its last bytes, the digest of all but the last, its length
    !> and its stamp. Returns 0, an error number, or -1 if another program may change it.
    integer(c_int) function c_digest_file(path, behind, first, capacity, last, digits, length, &
        seen) bind(c, name='battery_digest_file')
      import :: c_char, c_int, c_int64_t, digest_length
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int64_t), value, intent(in) :: behind, capacity
      character(kind=c_char), intent(inout) :: first(capacity), last(behind)
      character(kind=c_char), intent(inout) :: digits(digest_length)
      integer(c_int64_t), intent(inout) :: length, seen(5)
    end function c_digest_file
  end interface

contains

  !> Writes bytes and their footer to a new file.
  subroutine write_with_footer(name, bytes, error)
    !> Path of the file, which is replaced.
    character(len=*), intent(in) :: name
    !> All bytes before the footer.
    integer(int8), intent(in), contiguous :: bytes(:)
    !> The digest could not be computed, or not all bytes could be written.
    type(error_type), allocatable, intent(out) :: error
    character(len=digest_length) :: digits

    if (c_digest(bytes, size(bytes, kind=int64), digits) /= 0) then
      call fatal_error(error, 'the digest cannot be computed')
    else
      call write_parts(name, 0_int64, bytes, transfer(footer_text(size(bytes, kind=int64), &
        digits), bytes), bytes(:0), error)
    end if
  end subroutine write_with_footer

  !> Text of the footer for `count` bytes with a digest.
  pure function footer_text(count, digits) result(footer)
    integer(int64), intent(in) :: count
    character(len=*), intent(in) :: digits
    character(len=footer_length) :: footer
    character(len=*), parameter :: lf = new_line('a')
    character(len=20) :: number

    write (number, '(i0)') count
    footer = first_line//lf//'bytes '//trim(number)//digest_word//digits//lf//explanation//lf
    footer(footer_length:) = lf
  end function footer_text

  !> Reads a whole file and checks its footer. The error has the code `exit_failure` if the file is
  !> a damaged results file, `exit_bad_input` if it is another file, or one without a footer: HDF5
  !> cuts off what is behind its data when a program opens the file for writing, and versions before
  !> 0.2.0 wrote none. A file that is empty, or whose first bytes are zero, may result from a crash
  !> of the machine, and counts as damaged.
  subroutine check_footer(name, error, lacks_footer, stamp)
    !> Path of the file.
    character(len=*), intent(in) :: name
    !> The file cannot be read, is open in another program, is damaged, or has no footer.
    type(error_type), allocatable, intent(out) :: error
    !> Whether the error is that a file of this program, at least as long as HDF5 says, has no
    !> footer.
    logical, intent(out), optional :: lacks_footer
    !> Stamp of the file that was read, also after an error.
    type(file_stamp_type), intent(out), optional :: stamp
    character(len=footer_length) :: footer
    character(len=:), allocatable :: first
    type(file_stamp_type) :: seen
    integer(int64) :: bytes, content
    integer :: status

    if (present(lacks_footer)) lacks_footer = .false.
    if (is_folder(name)) call fatal_error(error, name//' is a folder'//leave_it, exit_bad_input)
    if (allocated(error)) return
    allocate (character(len=beginning) :: first)
    bytes = 0
    footer = ''
    status = c_digest_file(name//c_null_char, int(footer_length, c_int64_t), first, int( &
      beginning, c_int64_t), footer, seen%digest, bytes, seen%mark)
    if (present(stamp)) stamp = seen
    content = merge(bytes - footer_length, bytes, bytes > footer_length)
    if (content < beginning) first = first(:content)
    if (status < 0) then
      call fatal_error(error, name//' is open in another program, which may change it; ' &
        //'close it there', exit_bad_input)
    else if (status > 0) then
      call set_system_error(status, name//' cannot be read to its end', error)
      error%code = exit_bad_input
    else if (footer == footer_text(content, seen%digest)) then
      return
    else if (index(footer, first_line) == 1 .and. (digest_in(footer) /= seen%digest .or. &
      end_in_hdf5(first) /= content)) then
      call fatal_error(error, name//' is damaged: its digest is wrong', exit_failure)
    else if (end_in_hdf5(first) > 0 .and. end_in_hdf5(first) <= bytes .and. has_mark(name, &
      first)) then
      ! Its footer was cut off, in part or as a whole, or something is behind it. A digest that is
      ! left must be that of the HDF5 before it.
      call check_what_is_left(name, bytes - end_in_hdf5(first), error)
      if (allocated(error)) return
      if (present(lacks_footer)) lacks_footer = .true.
      call fatal_error(error, name//' was changed by another program, or is of a version before ' &
        //'0.2.0: it has no digest at its end, which HDF5 cuts off when it opens a file for ' &
        //'writing; if the contents are still as they were, battery --accept FILE.nml takes them ' &
        //'as they are', exit_bad_input)
    else if (may_be_results(name, first, bytes) .or. digest_in(footer) /= '') then
      call fatal_error(error, name//' is damaged: it has no digest at its end', exit_failure)
    else
      call fatal_error(error, name//' is not a results file of this program'//leave_it, &
        exit_bad_input)
    end if
  end subroutine check_footer

  !> Whether a file has the mark. One of HDF5 is read on if its first bytes do not have it.
  logical function has_mark(name, first) result(yes)
    !> Path of the file; its first bytes.
    character(len=*), intent(in) :: name, first
    character(len=:), allocatable :: piece
    integer(int64) :: bytes, at
    integer :: unit, status

    yes = index(first, mark) > 0
    if (yes .or. .not. is_results_file(first)) return
    open (newunit=unit, file=name, access='stream', form='unformatted', action='read', &
      status='old', iostat=status)
    if (status /= 0) return
    inquire (unit, size=bytes)
    ! Pieces overlap, since the mark may lie across the end of one.
    do at = 1, bytes, beginning - len(mark)
      piece = repeat(' ', int(min(bytes - at + 1, int(beginning, int64))))
      read (unit, pos=at, iostat=status) piece
      yes = status == 0 .and. index(piece, mark) > 0
      if (yes .or. status /= 0) exit
    end do
    close (unit)
  end function has_mark

  !> Checks what is left of the footer of a results file behind its HDF5: if it has a digest, that
  !> must be right.
  subroutine check_what_is_left(name, behind, error)
    !> Path of the file; number of bytes behind its HDF5.
    character(len=*), intent(in) :: name
    integer(int64), intent(in) :: behind
    !> The file is damaged, code `exit_failure`, or cannot be read.
    type(error_type), allocatable, intent(out) :: error
    character(len=digest_length) :: digits
    character(len=shortest) :: first
    character(len=:), allocatable :: tail
    integer(int64) :: bytes, seen(5)

    allocate (character(len=behind) :: tail)
    if (c_digest_file(name//c_null_char, behind, first, int(shortest, c_int64_t), tail, digits, &
      bytes, seen) /= 0) then
      call fatal_error(error, name//' cannot be read to its end', exit_bad_input)
      return
    end if
    if (digest_in(tail) /= '' .and. digest_in(tail) /= digits) call fatal_error(error, name &
      //' is damaged: its digest is wrong', exit_failure)
  end subroutine check_what_is_left

  !> The first digest in what is left of a footer; blank if there is none.
  pure function digest_in(text) result(digits)
    character(len=*), intent(in) :: text
    character(len=digest_length) :: digits
    integer(int64) :: at, next

    at = 1
    do
      next = index(text(at:), digest_word, kind=int64)
      at = at + next - 1 + len(digest_word)
      digits = ''
      if (next == 0 .or. at + digest_length > len(text, int64)) return
      digits = text(at:at + digest_length - 1)
      if (verify(digits, '0123456789abcdef') == 0 .and. text(at + digest_length:at &
        + digest_length) == new_line('a')) return
    end do
  end function digest_in

  !> Checks that a results file is what it was when it was read. If another program has touched it,
  !> or copied it back, it has the same digest, and its stamp is renewed.
  subroutine check_unchanged(name, stamp, error)
    !> Path of the file.
    character(len=*), intent(in) :: name
    type(file_stamp_type), intent(inout) :: stamp
    !> It is another file, or there is none any more.
    type(error_type), allocatable, intent(out) :: error
    type(file_stamp_type) :: now

    if (has_stamp(name, stamp)) return
    call check_footer(name, error, stamp=now)
    if (.not. allocated(error) .and. now%digest /= stamp%digest) &
      call fatal_error(error, name//' is another file now')
    if (.not. allocated(error)) stamp = now
  end subroutine check_unchanged

  !> Checks that a file may be removed: a results file, whole or not. A namelist, or an HDF5 file of
  !> another program, stays.
  subroutine check_discardable(name, error)
    !> Path of the file, which need not exist.
    character(len=*), intent(in) :: name
    !> It is something else; code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: first
    character(len=footer_length) :: last
    integer(int64) :: bytes
    integer :: unit, status

    if (.not. file_exists(name)) return
    open (newunit=unit, file=name, access='stream', form='unformatted', action='read', &
      status='old', iostat=status)
    if (status /= 0) then
      call fatal_error(error, name//' cannot be read, and is not discarded'//leave_it, &
        exit_bad_input)
      return
    end if
    inquire (unit, size=bytes)
    allocate (character(len=min(bytes, int(beginning, int64))) :: first)
    last = ''
    if (bytes > 0) read (unit, iostat=status) first
    if (status == 0 .and. bytes > footer_length) &
      read (unit, pos=bytes - footer_length + 1, iostat=status) last
    close (unit)
    if (status == 0 .and. (may_be_results(name, first, bytes) .or. index(last, first_line) == 1)) &
      return
    call fatal_error(error, name//trim(merge(' is not a results file', ' cannot be read       ', &
      status == 0))//', and is not discarded'//leave_it, exit_bad_input)
  end subroutine check_discardable

  !> Whether a file without a footer may be what is left of a results file: an HDF5 file that is cut
  !> off or has the mark; it may begin with zeros, as a crash of the machine leaves it.
  logical function may_be_results(name, first, bytes) result(yes)
    !> Path of the file; its first bytes, or all; its length.
    character(len=*), intent(in) :: name, first
    integer(int64), intent(in) :: bytes

    yes = is_results_file(first) .or. verify(first(:min(block, len(first))), achar(0)) == 0
    if (yes) yes = len(first) < shortest .or. bytes < end_in_hdf5(first) .or. &
      verify(first, achar(0)) == 0 .or. has_mark(name, first)
  end function may_be_results

  !> Length of a file according to HDF5's superblock.
  pure integer(int64) function end_in_hdf5(first) result(bytes)
    !> First bytes of the file.
    character(len=*), intent(in) :: first
    !> Offset of the length, which is little-endian, in superblocks of versions 0 (that of files of
    !> this program), 1, 2 and 3 (of programs that write HDF5 anew).
    integer, parameter :: places(0:3) = [40, 44, 28, 28]
    integer :: k, place

    bytes = 0
    if (len(first) < maxval(places) + 8) return
    if (ichar(first(9:9)) > ubound(places, 1)) return
    place = places(ichar(first(9:9)))
    do k = 8, 1, -1
      bytes = ior(shiftl(bytes, 8), int(ichar(first(place + k:place + k)), int64))
    end do
  end function end_in_hdf5

  !> Copies the HDF5 of a file without a footer, and adds one. All of it is in memory, as when it
  !> was made.
  subroutine copy_with_footer(name, copy, error)
    !> Paths of the file and of its copy, which is made anew.
    character(len=*), intent(in) :: name, copy
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: text

    call read_file(name, text, error)
    if (.not. allocated(error)) call write_with_footer(copy, transfer(text(:end_in_hdf5(text)), &
      [0_int8]), error)
  end subroutine copy_with_footer

end module battery_checksum_footer
