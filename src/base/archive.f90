!> Archive of a state: all that a type must save for the run to continue to the same last bit.
!>
!> A type serialises its components in one procedure for both directions, which saves them or
!> restores them: they are copied to an archive that is written, or from an archive that is read. So
!> there are no offsets, and writing and reading cannot differ. Every component is stored with its
!> name, its kind and its size; the header has the number of the format and the precision of the
!> program. On reading, the first component that does not match ends it: `problem` is the message,
!> and later components do not change.
!>
!> Compatibility: an archive can be read by a program that serialises the same components in the
!> same order. `format_number` increases when the meaning of a component changes under the same
!> name.
module battery_archive
  use battery_kinds, only: wp, int8, int16, int32, int64
  use battery_fingerprint, only: fingerprint_of
  implicit none (type, external)
  private
  public :: archive_type, new_archive, measuring_archive, archive_of

  integer(int64), parameter :: format_number = 1_int64

  !> Bytes of a word.
  integer, parameter :: word_bytes = 8

  !> A state as words, which are written to disk or have been read from it.
  type :: archive_type
    !> Whether components are read from the archive; else they are written to it.
    logical :: reading = .false.
    !> Whether the archive only counts words, so that the one written next can be allocated.
    logical :: measuring = .false.
    !> The words written or read so far are `word(:length)`.
    integer(int64) :: length = 0
    integer(int64), allocatable :: word(:)
    !> The first item that does not match; not allocated: all match.
    character(len=:), allocatable :: problem
  contains
    procedure, private :: serialize_logical, serialize_int32, serialize_int64, serialize_real
    procedure, private :: serialize_int8s, serialize_int16s, serialize_int32s, serialize_int64s, &
      serialize_reals
    !> Saves or restores a text of any length.
    procedure :: serialize_text
    !> Saves or restores a number, `value`, or an array, `values`, that has the same length on
    !> reading as on writing. The `name` is checked on reading. Up to five arrays of reals may be
    !> passed in one call, each after its name.
    generic :: serialize => serialize_logical, serialize_int32, serialize_int64, serialize_real, &
      serialize_int8s, serialize_int16s, serialize_int32s, serialize_int64s, serialize_reals
    !> Saves or restores an allocatable array of reals, `values`, which is allocated on reading. The
    !> `name` is checked on reading. Up to four lists may be passed in one call, each after its
    !> name.
    procedure :: serialize_list
    !> Saves or restores the size of a list; on reading, a size greater than the words of the
    !> archive is a problem.
    procedure :: serialize_size
    !> Begins to read an archive whose words were set.
    procedure :: begin_reading
    !> Whether a component read from the archive differed in name, kind or size from the one asked
    !> for.
    procedure :: failed
    !> Whether all that was written has been read.
    procedure :: at_end
    procedure, private :: open_item, serialize_words, reserve_words
  end type archive_type

contains

  !> Makes an empty archive to be written.
  pure type(archive_type) function new_archive(capacity) result(archive)
    !> Number of words to allocate, if known.
    integer(int64), intent(in), optional :: capacity

    archive%length = 2
    if (present(capacity)) then
      allocate (archive%word(capacity), source=0_int64)
    else
      allocate (archive%word(archive%length))
    end if
    archive%word(:2) = [format_number, int(storage_size(1.0_wp), int64)]
  end function new_archive

  !> Makes an archive that stores nothing: its `length` counts the words of the state.
  pure type(archive_type) function measuring_archive() result(archive)

    archive = new_archive()
    archive%measuring = .true.
  end function measuring_archive

  !> Makes an archive to be read from its words.
  pure type(archive_type) function archive_of(word) result(archive)
    !> `word(:length)` of the archive that was written.
    integer(int64), intent(in) :: word(:)

    archive%word = word
    call archive%begin_reading()
  end function archive_of

  !> Begins to read an archive whose words were set.
  pure subroutine begin_reading(self)
    class(archive_type), intent(inout) :: self

    self%reading = .true.
    self%length = 2
    if (size(self%word) < 2) then
      self%problem = 'the state is empty'
    else if (self%word(1) /= format_number) then
      self%problem = 'the state is of another format'
    else if (self%word(2) /= storage_size(1.0_wp)) then
      self%problem = 'the state is of another precision'
    end if
  end subroutine begin_reading

  !> Whether a component read from the archive differed in name, kind or size from the one asked
  !> for.
  pure logical function failed(self)
    class(archive_type), intent(in) :: self

    failed = allocated(self%problem)
  end function failed

  !> Whether all that was written has been read.
  pure logical function at_end(self)
    class(archive_type), intent(in) :: self

    at_end = self%length == size(self%word)
  end function at_end

  !> Writes or checks the head of an item: on reading, name, kind and size must be those written.
  pure subroutine open_item(self, name, kind, bytes, items)
    class(archive_type), intent(inout) :: self
    !> Name of the component and of its kind.
    character(len=*), intent(in) :: name, kind
    !> Bytes of one item.
    integer, intent(in) :: bytes
    !> Number of items.
    integer(int64), intent(in) :: items
    integer(int64) :: mark

    if (self%failed()) return
    mark = fingerprint_of(kind//' '//name)
    if (.not. self%reading) then
      call self%reserve_words(2 + (items*bytes + word_bytes - 1)/word_bytes)
      if (.not. self%measuring) self%word(self%length + 1:self%length + 2) = [mark, items]
      self%length = self%length + 2
      return
    end if
    if (self%length + 2 > size(self%word)) then
      self%problem = 'the state ends before '''//name//''''
    else if (self%word(self%length + 1) /= mark) then
      self%problem = 'the state has something else in place of '''//name//''''
    else if (self%word(self%length + 2) /= items) then
      self%problem = 'the state has another number of '''//name//''''
    else
      self%length = self%length + 2
      if (items > word_bytes*(size(self%word, kind=int64) - self%length)/bytes) &
        self%problem = 'the state ends within '''//name//''''
    end if
  end subroutine open_item

  !> Ensures that `words` more words fit into the array.
  pure subroutine reserve_words(self, words)
    class(archive_type), intent(inout) :: self
    integer(int64), intent(in) :: words
    integer(int64), allocatable :: more(:)

    if (self%measuring .or. self%length + words <= size(self%word, kind=int64)) return
    allocate (more(max(self%length + words, 2*self%length)), source=0_int64)
    more(:self%length) = self%word(:self%length)
    call move_alloc(more, self%word)
  end subroutine reserve_words

  !> Copies an item, as words of which the last is padded with zeros, to the archive or from it.
  pure subroutine serialize_words(self, name, kind, bytes, items, words)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name, kind
    integer, intent(in) :: bytes, items
    integer(int64), intent(inout) :: words(:)
    integer(int64) :: last
    integer :: bits

    call self%open_item(name, kind, bytes, int(items, int64))
    if (self%failed()) return
    last = self%length + size(words)
    if (self%reading) then
      words = self%word(self%length + 1:last)
    else if (.not. self%measuring) then
      self%word(self%length + 1:last) = words
      bits = int(8*mod(int(items, int64)*bytes, int(word_bytes, int64)))
      if (bits > 0) self%word(last) = ibits(self%word(last), 0, bits)
    end if
    self%length = last
  end subroutine serialize_words

  !> Saves or restores one logical value.
  pure subroutine serialize_logical(self, name, value)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    logical, intent(inout) :: value
    integer(int64) :: word

    word = merge(1_int64, 0_int64, value)
    call self%serialize_int64(name, word)
    value = word == 1
  end subroutine serialize_logical

  !> Saves or restores one integer of 32 bits.
  pure subroutine serialize_int32(self, name, value)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int32), intent(inout) :: value
    integer(int32) :: one(1)

    one = value
    call self%serialize_int32s(name, one)
    value = one(1)
  end subroutine serialize_int32

  !> Saves or restores one integer of 64 bits.
  pure subroutine serialize_int64(self, name, value)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int64), intent(inout) :: value
    integer(int64) :: one(1)

    one = value
    call self%serialize_int64s(name, one)
    value = one(1)
  end subroutine serialize_int64

  !> Saves or restores one real.
  pure subroutine serialize_real(self, name, value)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    real(wp), intent(inout) :: value
    real(wp) :: one(1)

    one = value
    call self%serialize_reals(name, one)
    value = one(1)
  end subroutine serialize_real

  !> Saves or restores integers of 8 bits, eight in a word.
  pure subroutine serialize_int8s(self, name, values)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int8), intent(inout) :: values(:)
    integer(int64), allocatable :: words(:)

    words = transfer(values, [0_int64])
    call self%serialize_words(name, 'int8', 1, size(values), words)
    if (self%reading) values = transfer(words, values, size(values))
  end subroutine serialize_int8s

  !> Saves or restores integers of 16 bits, stored with 8 bits: no state has greater values.
  pure subroutine serialize_int16s(self, name, values)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int16), intent(inout) :: values(:)
    integer(int8) :: small(size(values))

    small = int(values, int8)
    call self%serialize_int8s(name, small)
    values = small
  end subroutine serialize_int16s

  !> Saves or restores integers of 32 bits.
  pure subroutine serialize_int32s(self, name, values)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int32), intent(inout) :: values(:)
    integer(int64), allocatable :: words(:)

    words = transfer(values, [0_int64])
    call self%serialize_words(name, 'int32', 4, size(values), words)
    if (self%reading) values = transfer(words, values, size(values))
  end subroutine serialize_int32s

  !> Saves or restores integers of 64 bits.
  pure subroutine serialize_int64s(self, name, values)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int64), intent(inout) :: values(:)
    integer(int64), allocatable :: words(:)

    words = transfer(values, [0_int64])
    call self%serialize_words(name, 'int64', word_bytes, size(values), words)
    if (self%reading) values = transfer(words, values, size(values))
  end subroutine serialize_int64s

  !> Saves or restores reals of the program's precision with all their bits; then the arrays that
  !> follow.
  pure recursive subroutine serialize_reals(self, name, values, name2, values2, name3, values3, &
      name4, values4, name5, values5)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    real(wp), intent(inout) :: values(:)
    !> Names of the arrays that follow.
    character(len=*), intent(in), optional :: name2, name3, name4, name5
    !> The arrays that follow, in the order of their names.
    real(wp), intent(inout), optional :: values2(:), values3(:), values4(:), values5(:)
    integer(int64), allocatable :: words(:)

    words = transfer(values, [0_int64])
    call self%serialize_words(name, 'real', storage_size(1.0_wp)/8, size(values), words)
    if (self%reading) values = transfer(words, values, size(values))
    if (present(values2)) call self%serialize_reals(name2, values2, name3, values3, name4, &
      values4, name5, values5)
  end subroutine serialize_reals

  !> Saves or restores a list of reals; then the lists that follow.
  pure recursive subroutine serialize_list(self, name, values, name2, values2, name3, values3, &
    name4, values4)
    class(archive_type), intent(inout) :: self
    !> Name of the list, which is checked on reading.
    character(len=*), intent(in) :: name
    !> Reals, which are allocated on reading.
    real(wp), allocatable, intent(inout) :: values(:)
    !> Names of the arrays that follow.
    character(len=*), intent(in), optional :: name2, name3, name4
    !> The arrays that follow, in the order of their names.
    real(wp), allocatable, intent(inout), optional :: values2(:), values3(:), values4(:)
    integer :: items

    if (.not. allocated(values)) allocate (values(0))
    items = size(values)
    call self%serialize_size(name, items)
    if (self%failed()) return
    if (size(values) /= items) values = spread(0.0_wp, 1, items)
    call self%serialize_reals(name, values)
    ! `values2` may be present and not allocated; `name2` shows whether there is a second list.
    if (present(name2)) call self%serialize_list(name2, values2, name3, values3, name4, values4)
  end subroutine serialize_list

  !> Saves or restores a text of any length and of any bytes.
  pure subroutine serialize_text(self, name, text)
    class(archive_type), intent(inout) :: self
    !> Name of the component, which is checked on reading.
    character(len=*), intent(in) :: name
    !> Text, which is allocated on reading.
    character(len=:), allocatable, intent(inout) :: text
    integer(int8), allocatable :: letters(:)
    integer :: length

    length = 0
    if (allocated(text)) length = len(text)
    call self%serialize_size(name, length)
    if (self%failed()) return
    allocate (letters(length), source=0_int8)
    if (.not. self%reading .and. length > 0) letters = transfer(text, letters)
    call self%serialize_int8s(name, letters)
    if (self%reading) text = transfer(letters, repeat(' ', length))
  end subroutine serialize_text

  !> Saves or restores the size of a list; on reading, a size greater than the words of the archive
  !> is a problem.
  pure subroutine serialize_size(self, name, items)
    class(archive_type), intent(inout) :: self
    !> Name of the list, which is checked on reading.
    character(len=*), intent(in) :: name
    !> Number of its items.
    integer, intent(inout) :: items

    call self%serialize_int32('size of '//name, items)
    if (self%failed() .or. .not. self%reading) return
    if (items < 0 .or. items > word_bytes*size(self%word, kind=int64)) &
      self%problem = 'the state ends within '''//name//''''
  end subroutine serialize_size

end module battery_archive
