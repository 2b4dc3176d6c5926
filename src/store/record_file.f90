!> Files of records that survive a crash of the program: results of finished tasks, saved states.
!>
!> A record is a header, the words of an archive (`battery_archive`) and a checksum over both.
!> Records are appended and synced to disk one by one. On reading, a record that does not match its
!> checksum is passed over; the first that is truncated, or whose header is damaged, ends the file.
module battery_record_file
  use battery_kinds, only: int64
  use battery_archive, only: archive_type
  use battery_error, only: error_type, fatal_error
  use battery_files, only: write_parts, file_exists
  use battery_fingerprint, only: fingerprint_start, mix_word
  use battery_paths, only: is_pipe_or_device
  implicit none (type, external)
  private
  public :: record_type, append_record, write_single_record, read_single_record
  public :: record_reader_type, open_records, next_record, close_records

  !> One record: an archive of an owner.
  type, extends(archive_type) :: record_type
    !> What the record belongs to: for a result or a state of a task, its `task_id`.
    integer(int64) :: owner = 0
    !> Of records with the same owner, that with the greatest generation is the newest.
    integer(int64) :: generation = 0
  end type record_type

  !> A file that is read record by record: at most one record is in memory.
  type :: record_reader_type
    !> Offset of the next record in bytes; may be set to that of any record.
    integer(int64) :: at = 0
    !> The file is there, but the system cannot open or read it: what it has is not known.
    type(error_type), allocatable :: error
    character(len=:), allocatable, private :: name
    integer, private :: unit = 0
    logical, private :: is_open = .false.
  end type record_reader_type

  !> First word of every record.
  integer(int64), parameter :: mark = int(z'6261747465727932', int64)

  !> Longest message of the system.
  integer, parameter :: message_length = 200

  !> Words of a header (mark, owner, 0, generation, number of words), and bytes of a word. The third
  !> had a meaning once.
  integer, parameter :: head_size = 5, word_bytes = 8

contains

  !> Appends a record to the file `name`; `good_size` is the length of its valid part in bytes,
  !> after which anything is overwritten; if it is 0, a new file is made.
  subroutine append_record(name, record, good_size, error)
    character(len=*), intent(in) :: name
    type(record_type), intent(in) :: record
    integer(int64), intent(inout) :: good_size
    type(error_type), allocatable, intent(out) :: error
    integer(int64) :: head(head_size), sum

    head = [mark, record%owner, 0_int64, record%generation, size(record%word, kind=int64)]
    sum = fingerprint_start
    call mix_words(sum, head)
    call mix_words(sum, record%word)
    call write_parts(name, good_size, head, record%word, [sum], error)
    if (.not. allocated(error)) good_size = good_size + word_bytes*(head_size + head(head_size) + 1)
  end subroutine append_record

  !> Opens a file to be read from its beginning, unless the reader has it open already; a missing
  !> file has no records.
  subroutine open_records(reader, name)
    !> Reader, open; to be closed with `close_records`.
    type(record_reader_type), intent(inout) :: reader
    !> Path of the file.
    character(len=*), intent(in) :: name
    integer :: status
    character(len=message_length) :: message

    if (reader%is_open .or. .not. file_exists(name) .or. is_pipe_or_device(name)) return
    reader%name = name
    open (newunit=reader%unit, file=name, access='stream', form='unformatted', action='read', &
      status='old', iostat=status, iomsg=message)
    reader%is_open = status == 0
    ! A run that ends may have removed it.
    if (status /= 0 .and. file_exists(name)) call set_error(reader, message)
  end subroutine open_records

  !> Reads the first valid record from `reader%at` on, and moves `reader%at` to its end.
  subroutine next_record(reader, record, found, at)
    !> Reader, open, or of a missing file.
    type(record_reader_type), intent(inout) :: reader
    !> Record, to be read from its first component on.
    type(record_type), intent(out) :: record
    !> Whether there is one; if not, `reader%at` does not change.
    logical, intent(out) :: found
    !> Its offset in bytes.
    integer(int64), intent(out) :: at
    integer(int64) :: head(head_size), bytes, left, sum, sum_stored
    integer :: status
    character(len=message_length) :: message

    found = .false.
    at = reader%at
    if (.not. reader%is_open) return
    inquire (reader%unit, size=bytes)
    do
      left = (bytes - at)/word_bytes - head_size - 1
      if (left < 0) return
      read (reader%unit, pos=at + 1, iostat=status, iomsg=message) head
      if (status == 0) then
        if (head(1) /= mark .or. head(head_size) < 0 .or. head(head_size) > left) return
        if (allocated(record%word)) deallocate (record%word)
        allocate (record%word(head(head_size)))
        read (reader%unit, iostat=status, iomsg=message) record%word, sum_stored
      end if
      if (status > 0) call set_error(reader, message)
      if (status /= 0) return
      sum = fingerprint_start
      call mix_words(sum, head)
      call mix_words(sum, record%word)
      found = sum_stored == sum
      if (found) exit
      at = at + word_bytes*(head_size + head(head_size) + 1)
    end do
    reader%at = at + word_bytes*(head_size + head(head_size) + 1)
    record%owner = head(2)
    record%generation = head(4)
    call record%begin_reading()
  end subroutine next_record

  !> Sets the error of a reader.
  subroutine set_error(reader, message)
    type(record_reader_type), intent(inout) :: reader
    !> Message of the system.
    character(len=*), intent(in) :: message

    call fatal_error(reader%error, reader%name//': cannot be read, and is kept ('//trim(message) &
      //')')
  end subroutine set_error

  !> Closes a file of records; a reader that is not open is no error.
  subroutine close_records(reader)
    !> Reader, which is not open afterwards.
    type(record_reader_type), intent(inout) :: reader

    if (reader%is_open) close (reader%unit)
    reader = record_reader_type()
  end subroutine close_records

  !> Adds words to a checksum.
  pure subroutine mix_words(sum, words)
    integer(int64), intent(inout) :: sum
    integer(int64), intent(in) :: words(:)
    integer(int64) :: k

    do k = 1, size(words, kind=int64)
      call mix_word(sum, words(k))
    end do
  end subroutine mix_words

  !> Writes a new file with a single record.
  subroutine write_single_record(name, record, error)
    !> Path of the file, which is replaced.
    character(len=*), intent(in) :: name
    type(record_type), intent(in) :: record
    type(error_type), allocatable, intent(out) :: error
    integer(int64) :: size_before

    size_before = 0
    call append_record(name, record, size_before, error)
  end subroutine write_single_record

  !> Reads the first valid record of a file; `found` is false if there is none.
  subroutine read_single_record(name, record, found, error)
    !> Path of the file.
    character(len=*), intent(in) :: name
    type(record_type), intent(out) :: record
    logical, intent(out) :: found
    !> The file is there and cannot be read.
    type(error_type), allocatable, intent(out) :: error
    type(record_reader_type) :: reader
    integer(int64) :: at

    call open_records(reader, name)
    call next_record(reader, record, found, at)
    call move_alloc(reader%error, error)
    call close_records(reader)
  end subroutine read_single_record

end module battery_record_file
