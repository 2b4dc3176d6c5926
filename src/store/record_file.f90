!> Files of records that survive a program's sudden end: results of finished tasks, saved states.
!>
!> A record is an owner, a tag, three arrays (integers, reals, bytes) and a checksum over all of
!> them. Records are appended and brought to the disk one by one. On reading, the first record that
!> is cut short or does not match its checksum ends the file: what stands before it is good.
module battery_record_file
  use battery_kinds, only: dp, int8, int64
  use battery_error, only: error_type, fatal_error
  use battery_files, only: create_new_file
  use battery_fingerprint, only: fingerprint_start, mix_word
  use battery_paths, only: is_file
  implicit none (type, external)
  private
  public :: record_type, append_record, read_records, write_single, read_single, move_record, &
    free_record

  !> What is kept in one piece.
  type :: record_type
    !> Fingerprint of the input that the record was made from.
    integer(int64) :: owner = 0
    !> What the record is about, for instance the number of a task.
    integer(int64) :: tag = 0
    integer(int64), allocatable :: integers(:)
    real(dp), allocatable :: reals(:)
    integer(int8), allocatable :: bytes(:)
  end type record_type

  !> First word of every record.
  integer(int64), parameter :: mark = int(z'62617474657279', int64)

contains

  !> Appends a record to the file `name`; `good_size` is the length of its good part in bytes,
  !> beyond which anything is overwritten; where that is 0 the file is made anew. The record is read
  !> back: on a full disk gfortran reports neither the write nor the close as failed.
  subroutine append_record(name, record, good_size, error)
    character(len=*), intent(in) :: name
    type(record_type), intent(in) :: record
    integer(int64), intent(inout) :: good_size
    type(error_type), allocatable, intent(out) :: error
    integer :: unit, status
    integer(int64) :: head(6), sum
    character(len=256) :: reason
    logical :: good

    if (good_size == 0) call create_new_file(name, error)
    if (allocated(error)) return
    reason = 'the disk may be full'
    good = .false.
    head = [mark, record%owner, record%tag, size(record%integers, kind=int64), &
      size(record%reals, kind=int64), size(record%bytes, kind=int64)]
    sum = checksum(record)
    open (newunit=unit, file=name, access='stream', form='unformatted', action='readwrite', &
      iostat=status, iomsg=reason)
    if (status == 0) then
      write (unit, pos=good_size + 1, iostat=status, iomsg=reason) head, record%integers, &
        record%reals, record%bytes, sum
      ! What was longer must not be taken for the next record.
      if (status == 0) endfile (unit, iostat=status, iomsg=reason)
      close (unit)
    end if
    if (status == 0) then
      open (newunit=unit, file=name, access='stream', form='unformatted', action='read', &
        status='old', iostat=status, iomsg=reason)
      if (status == 0) then
        call compare_written(unit, good_size, head, sum, good)
        close (unit)
      end if
    end if
    if (good) then
      good_size = good_size + 56 + 8*head(4) + 8*head(5) + head(6)
    else
      call fatal_error(error, 'cannot write '''//name//''': '//trim(reason))
    end if
  end subroutine append_record

  !> Whether the record with that head and checksum stands behind `at` bytes. It is read in pieces:
  !> a large state once more as a whole may be more than there is memory for.
  subroutine compare_written(unit, at, head, sum, good)
    integer, intent(in) :: unit
    integer(int64), intent(in) :: at, head(6), sum
    logical, intent(out) :: good
    integer(int64) :: head_found(6), sum_found, sum_stored, word(4096), left
    integer(int8) :: byte(4096)
    integer :: status, n, k

    good = .false.
    read (unit, pos=at + 1, iostat=status) head_found
    if (status /= 0 .or. any(head_found /= head)) return
    sum_found = fingerprint_start
    do k = 2, 6
      call mix_word(sum_found, head(k))
    end do
    left = head(4) + head(5)
    do while (left > 0 .and. status == 0)
      n = int(min(left, size(word, kind=int64)))
      read (unit, iostat=status) word(:n)
      do k = 1, n
        call mix_word(sum_found, word(k))
      end do
      left = left - n
    end do
    left = head(6)
    do while (left > 0 .and. status == 0)
      n = int(min(left, size(byte, kind=int64)))
      read (unit, iostat=status) byte(:n)
      do k = 1, n
        call mix_word(sum_found, int(byte(k), int64))
      end do
      left = left - n
    end do
    if (status == 0) read (unit, iostat=status) sum_stored
    if (status == 0) good = sum_found == sum .and. sum_stored == sum
  end subroutine compare_written

  !> All good records of a file, in their order, and the length of its good part in bytes; none if
  !> there is no such file.
  subroutine read_records(name, records, good_size)
    !> Path of the file.
    character(len=*), intent(in) :: name
    !> From the beginning of the file.
    type(record_type), allocatable, intent(out) :: records(:)
    !> 0 if there is nothing good.
    integer(int64), intent(out) :: good_size
    type(record_type), allocatable :: more(:)
    type(record_type) :: record
    integer :: unit, status, count, k
    integer(int64) :: bytes
    logical :: good

    allocate (records(0))
    good_size = 0
    if (.not. is_file(name)) return
    open (newunit=unit, file=name, access='stream', form='unformatted', action='read', &
      status='old', iostat=status)
    if (status /= 0) return
    inquire (unit, size=bytes)
    count = 0
    do
      call read_record(unit, good_size, bytes, record, good)
      if (.not. good) exit
      if (count == size(records)) then
        allocate (more(max(16, 2*count)))
        do k = 1, count
          more(k) = records(k)
        end do
        call move_alloc(more, records)
      end if
      count = count + 1
      records(count) = record
    end do
    close (unit)
    records = records(:count)
  end subroutine read_records

  !> The record that begins after `at` bytes; moves `at` behind it.
  subroutine read_record(unit, at, bytes, record, good)
    integer, intent(in) :: unit
    integer(int64), intent(inout) :: at
    integer(int64), intent(in) :: bytes
    type(record_type), intent(out) :: record
    logical, intent(out) :: good
    integer(int64) :: head(6), sum, left
    integer :: status

    good = .false.
    left = bytes - at - 56
    if (left < 0) return
    read (unit, pos=at + 1, iostat=status) head
    if (status /= 0 .or. head(1) /= mark) return
    if (any(head(4:6) < 0) .or. any(head(4:6) > left)) return
    if (8*head(4) + 8*head(5) + head(6) > left) return
    record%owner = head(2)
    record%tag = head(3)
    allocate (record%integers(head(4)))
    allocate (record%reals(head(5)))
    allocate (record%bytes(head(6)))
    read (unit, iostat=status) record%integers, record%reals, record%bytes, sum
    if (status /= 0) return
    good = sum == checksum(record)
    if (good) at = at + 56 + 8*head(4) + 8*head(5) + head(6)
  end subroutine read_record

  !> The fingerprint of a record: its words and their numbers.
  pure function checksum(record) result(sum)
    type(record_type), intent(in) :: record
    integer(int64) :: sum
    integer(int64) :: k

    sum = fingerprint_start
    call mix_word(sum, record%owner)
    call mix_word(sum, record%tag)
    call mix_word(sum, size(record%integers, kind=int64))
    call mix_word(sum, size(record%reals, kind=int64))
    call mix_word(sum, size(record%bytes, kind=int64))
    do k = 1, size(record%integers, kind=int64)
      call mix_word(sum, record%integers(k))
    end do
    do k = 1, size(record%reals, kind=int64)
      call mix_word(sum, transfer(record%reals(k), 1_int64))
    end do
    do k = 1, size(record%bytes, kind=int64)
      call mix_word(sum, int(record%bytes(k), int64))
    end do
  end function checksum

  !> Writes a file that holds just this record.
  subroutine write_single(name, record, error)
    !> Path of the file, which is made anew.
    character(len=*), intent(in) :: name
    type(record_type), intent(in) :: record
    type(error_type), allocatable, intent(out) :: error
    integer(int64) :: size_before

    size_before = 0
    call append_record(name, record, size_before, error)
  end subroutine write_single

  !> The record of a file that holds just one; `found` is false if there is no good one.
  subroutine read_single(name, record, found)
    !> Path of the file.
    character(len=*), intent(in) :: name
    type(record_type), intent(out) :: record
    logical, intent(out) :: found
    integer :: unit, status
    integer(int64) :: at, bytes

    found = .false.
    if (.not. is_file(name)) return
    open (newunit=unit, file=name, access='stream', form='unformatted', action='read', &
      status='old', iostat=status)
    if (status /= 0) return
    inquire (unit, size=bytes)
    at = 0
    call read_record(unit, at, bytes, record, found)
    close (unit)
  end subroutine read_single

  !> Moves a record to `to` without a copy; `from` is empty then.
  pure subroutine move_record(from, to)
    type(record_type), intent(inout) :: from
    type(record_type), intent(out) :: to

    to%owner = from%owner
    to%tag = from%tag
    call move_alloc(from%integers, to%integers)
    call move_alloc(from%reals, to%reals)
    call move_alloc(from%bytes, to%bytes)
  end subroutine move_record

  !> Gives the memory of a record back; it may be empty already.
  pure subroutine free_record(record)
    type(record_type), intent(inout) :: record

    if (allocated(record%integers)) deallocate (record%integers)
    if (allocated(record%reals)) deallocate (record%reals)
    if (allocated(record%bytes)) deallocate (record%bytes)
  end subroutine free_record

end module battery_record_file
