!> Archive of a state: what a type must save for the run to continue to the same last bit.
!>
!> A type passes its components through an archive once, in one procedure for both ways: into an
!> archive that is written they are copied, out of one that is read they are taken. So no offsets
!> are numbered, and the two ways cannot differ. Every component travels with its name, its kind and
!> its size; at the head stand the number of the format and the precision of the program. On
!> reading, the first that does not fit ends it: `problem` says what was expected, and what follows
!> is left as it is.
!>
!> What reads what: an archive is read by a program that passes the same components in the same
!> order. `format_number` grows when the meaning of a component changes and its name does not.
module battery_archive
  use battery_kinds, only: wp, int8, int16, int32, int64
  use battery_fingerprint, only: fingerprint_of
  implicit none (type, external)
  private
  public :: archive_type, new_archive, measuring_archive, archive_of

  integer(int64), parameter :: format_number = 1_int64

  !> Bytes of a word.
  integer, parameter :: word_bytes = 8

  !> A state as words, on its way to the disk or back.
  type :: archive_type
    !> Whether components are read from it, or written to it.
    logical :: reading = .false.
    !> Whether it only counts words, so that the archive written next can be allocated.
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
    procedure, private :: serialize_int32_list, serialize_real_list
    !> Passes a text of any length.
    procedure :: serialize_text
    !> Passes a number, `value`, or an array, `values`, that is as long on reading as it was on
    !> writing. By the `name` an archive of something else is found out. Arrays of real numbers may
    !> stand in a row, up to five with their names.
    generic :: serialize => serialize_logical, serialize_int32, serialize_int64, serialize_real, &
      serialize_int8s, serialize_int16s, serialize_int32s, serialize_int64s, serialize_reals
    !> Passes an allocatable array, `values`; on reading it becomes as long as what was written. By
    !> the `name` an archive of something else is found out. Lists of real numbers may stand in a
    !> row, up to four with their names.
    generic :: serialize_list => serialize_int32_list, serialize_real_list
    !> Whether an item did not match what was expected.
    procedure :: failed
    !> Whether all that was written has been read.
    procedure :: at_end
    procedure, private :: open_item, serialize_words, reserve_words, serialize_size
  end type archive_type

contains

  !> An empty archive, to be written.
  pure type(archive_type) function new_archive(room) result(archive)
    !> Number of words to allocate, where that is known.
    integer(int64), intent(in), optional :: room

    archive%length = 2
    if (present(room)) then
      allocate (archive%word(room), source=0_int64)
    else
      allocate (archive%word(archive%length))
    end if
    archive%word(:2) = [format_number, int(storage_size(1.0_wp), int64)]
  end function new_archive

  !> An archive that stores nothing: its `length` counts the words of the state.
  pure type(archive_type) function measuring_archive() result(archive)

    archive = new_archive()
    archive%measuring = .true.
  end function measuring_archive

  !> An archive to be read, from words that were written.
  pure type(archive_type) function archive_of(word) result(archive)
    !> `word(:length)` of the archive that was written.
    integer(int64), intent(in) :: word(:)

    archive%reading = .true.
    archive%word = word
    archive%length = 2
    if (size(word) < 2) then
      archive%problem = 'the state is empty'
    else if (word(1) /= format_number) then
      archive%problem = 'the state is of another format'
    else if (word(2) /= storage_size(1.0_wp)) then
      archive%problem = 'the state is of another precision'
    end if
  end function archive_of

  !> Whether something did not fit.
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

  !> An item as words, the last of them filled up with zeros: they are put into the archive, or what
  !> is in the archive is put into them.
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

  !> Passes one logical value.
  pure subroutine serialize_logical(self, name, value)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    logical, intent(inout) :: value
    integer(int64) :: word

    word = merge(1_int64, 0_int64, value)
    call self%serialize_int64(name, word)
    value = word == 1
  end subroutine serialize_logical

  pure subroutine serialize_int32(self, name, value)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int32), intent(inout) :: value
    integer(int32) :: one(1)

    one = value
    call self%serialize_int32s(name, one)
    value = one(1)
  end subroutine serialize_int32

  pure subroutine serialize_int64(self, name, value)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int64), intent(inout) :: value
    integer(int64) :: one(1)

    one = value
    call self%serialize_int64s(name, one)
    value = one(1)
  end subroutine serialize_int64

  pure subroutine serialize_real(self, name, value)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    real(wp), intent(inout) :: value
    real(wp) :: one(1)

    one = value
    call self%serialize_reals(name, one)
    value = one(1)
  end subroutine serialize_real

  !> Small whole numbers, eight in a word.
  pure subroutine serialize_int8s(self, name, values)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int8), intent(inout) :: values(:)
    integer(int64), allocatable :: words(:)

    words = transfer(values, [0_int64])
    call self%serialize_words(name, 'int8', 1, size(values), words)
    if (self%reading) values = transfer(words, values, size(values))
  end subroutine serialize_int8s

  !> Short whole numbers; none that a state has is beyond those of eight bits.
  pure subroutine serialize_int16s(self, name, values)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int16), intent(inout) :: values(:)
    integer(int8) :: small(size(values))

    small = int(values, int8)
    call self%serialize_int8s(name, small)
    values = small
  end subroutine serialize_int16s

  pure subroutine serialize_int32s(self, name, values)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int32), intent(inout) :: values(:)
    integer(int64), allocatable :: words(:)

    words = transfer(values, [0_int64])
    call self%serialize_words(name, 'int32', 4, size(values), words)
    if (self%reading) values = transfer(words, values, size(values))
  end subroutine serialize_int32s

  pure subroutine serialize_int64s(self, name, values)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int64), intent(inout) :: values(:)
    integer(int64), allocatable :: words(:)

    words = transfer(values, [0_int64])
    call self%serialize_words(name, 'int64', word_bytes, size(values), words)
    if (self%reading) values = transfer(words, values, size(values))
  end subroutine serialize_int64s

  !> Real numbers of the program's precision, to all their bits; then those that follow.
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

  pure subroutine serialize_int32_list(self, name, values)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int32), allocatable, intent(inout) :: values(:)
    integer :: items

    if (.not. allocated(values)) allocate (values(0))
    items = size(values)
    call self%serialize_size(name, items)
    if (self%failed()) return
    if (size(values) /= items) values = spread(0_int32, 1, items)
    call self%serialize_int32s(name, values)
  end subroutine serialize_int32_list

  pure recursive subroutine serialize_real_list(self, name, values, name2, values2, name3, &
    values3, name4, values4)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
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
    ! Passed whether or not it is allocated; `name2` says whether it counts.
    if (present(name2)) call self%serialize_real_list(name2, values2, name3, values3, name4, &
      values4)
  end subroutine serialize_real_list

  !> A text of any length and of any bytes.
  pure subroutine serialize_text(self, name, text)
    class(archive_type), intent(inout) :: self
    !> Name of the component: by it an archive of something else is found out.
    character(len=*), intent(in) :: name
    !> Text, which on reading becomes as long as what was written.
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

  !> The size of a list, which no state of so many words can hold if it is greater.
  pure subroutine serialize_size(self, name, items)
    class(archive_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, intent(inout) :: items

    call self%serialize_int32('size of '//name, items)
    if (self%failed() .or. .not. self%reading) return
    if (items < 0 .or. items > word_bytes*size(self%word, kind=int64)) &
      self%problem = 'the state ends within '''//name//''''
  end subroutine serialize_size

end module battery_archive
