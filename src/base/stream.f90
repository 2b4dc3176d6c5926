!> The stream of a state: what a type must keep to go on to the same last bit.
!>
!> A type passes its components through a stream once, in one procedure for both ways: into a stream
!> that is written they are copied, out of one that is read they are taken. So nobody counts places,
!> and the two ways cannot differ. Every component travels with its name, its kind and its size; at
!> the head stand the number of the format and the precision of the program. On reading, the first
!> that does not fit ends it: `problem` says what was expected, and what follows is left as it is.
!>
!> What reads what: a stream is read by a program that passes the same components in the same order.
!> `format_number` grows when the meaning of a component changes and its name does not.
module battery_stream
  use battery_kinds, only: wp, int8, int16, int32, int64
  use battery_fingerprint, only: fingerprint_of
  implicit none (type, external)
  private
  public :: stream_type, new_stream, measuring_stream, stream_of

  integer(int64), parameter :: format_number = 1_int64

  !> Bytes of a word.
  integer, parameter :: word_bytes = 8

  !> A state as words, on its way to the disk or back.
  type :: stream_type
    !> Whether components are taken out of it, or put into it.
    logical :: reading = .false.
    !> Whether it only counts the words that it would take, so that the next has room for them.
    logical :: measuring = .false.
    !> What has been passed, `word(:length)`.
    integer(int64) :: length = 0
    integer(int64), allocatable :: word(:)
    !> What does not fit; not allocated: nothing.
    character(len=:), allocatable :: problem
  contains
    procedure, private :: pass_logical, pass_int32, pass_int64, pass_real
    procedure, private :: pass_int8s, pass_int16s, pass_int32s, pass_int64s, pass_reals
    procedure, private :: pass_int32_list, pass_real_list
    !> Passes a text of any length.
    procedure :: pass_text
    !> Passes a number, `value`, or an array, `values`, that is as long on reading as it was on
    !> writing. By the `name` a stream of something else is found out. Arrays of real numbers may
    !> stand in a row, up to five with their names.
    generic :: pass => pass_logical, pass_int32, pass_int64, pass_real, pass_int8s, pass_int16s, &
      pass_int32s, pass_int64s, pass_reals
    !> Passes an allocatable array, `values`; on reading it becomes as long as what was written. By
    !> the `name` a stream of something else is found out. Lists of real numbers may stand in a row,
    !> up to four with their names.
    generic :: pass_list => pass_int32_list, pass_real_list
    !> Whether something did not fit.
    procedure :: failed
    !> Whether all that was written has been read.
    procedure :: at_end
    procedure, private :: open_item, pass_words, room_for, pass_size
  end type stream_type

contains

  !> An empty stream, to be written.
  pure type(stream_type) function new_stream(room) result(stream)
    !> Words that it will take, where that is known.
    integer(int64), intent(in), optional :: room

    stream%length = 2
    if (present(room)) then
      allocate (stream%word(room), source=0_int64)
    else
      allocate (stream%word(stream%length))
    end if
    stream%word(:2) = [format_number, int(storage_size(1.0_wp), int64)]
  end function new_stream

  !> A stream that is only to tell, by `length`, how many words it would take.
  pure type(stream_type) function measuring_stream() result(stream)

    stream = new_stream()
    stream%measuring = .true.
  end function measuring_stream

  !> A stream to be read, of words that were written.
  pure type(stream_type) function stream_of(word) result(stream)
    !> `word(:length)` of the stream that was written.
    integer(int64), intent(in) :: word(:)

    stream%reading = .true.
    stream%word = word
    stream%length = 2
    if (size(word) < 2) then
      stream%problem = 'the state is empty'
    else if (word(1) /= format_number) then
      stream%problem = 'the state is of another format'
    else if (word(2) /= storage_size(1.0_wp)) then
      stream%problem = 'the state is of another precision'
    end if
  end function stream_of

  !> Whether something did not fit.
  pure logical function failed(self)
    class(stream_type), intent(in) :: self

    failed = allocated(self%problem)
  end function failed

  !> Whether all that was written has been read.
  pure logical function at_end(self)
    class(stream_type), intent(in) :: self

    at_end = self%length == size(self%word)
  end function at_end

  !> The head of an item. On reading it must be that which was written, and whole.
  pure subroutine open_item(self, name, kind, bytes, items)
    class(stream_type), intent(inout) :: self
    !> Name of the component and of its kind.
    character(len=*), intent(in) :: name, kind
    !> Bytes of one item.
    integer, intent(in) :: bytes
    !> How many.
    integer(int64), intent(in) :: items
    integer(int64) :: mark

    if (self%failed()) return
    mark = fingerprint_of(kind//' '//name)
    if (.not. self%reading) then
      call self%room_for(2 + (items*bytes + word_bytes - 1)/word_bytes)
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

  !> Makes room for so many words more.
  pure subroutine room_for(self, words)
    class(stream_type), intent(inout) :: self
    integer(int64), intent(in) :: words
    integer(int64), allocatable :: more(:)

    if (self%measuring .or. self%length + words <= size(self%word, kind=int64)) return
    allocate (more(max(self%length + words, 2*self%length)), source=0_int64)
    more(:self%length) = self%word(:self%length)
    call move_alloc(more, self%word)
  end subroutine room_for

  !> An item as words, the last of them filled up with zeros: they are put into the stream, or what
  !> is in the stream is put into them.
  pure subroutine pass_words(self, name, kind, bytes, items, words)
    class(stream_type), intent(inout) :: self
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
  end subroutine pass_words

  !> One logical value.
  pure subroutine pass_logical(self, name, value)
    class(stream_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    logical, intent(inout) :: value
    integer(int64) :: word

    word = merge(1_int64, 0_int64, value)
    call self%pass_int64(name, word)
    value = word == 1
  end subroutine pass_logical

  pure subroutine pass_int32(self, name, value)
    class(stream_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int32), intent(inout) :: value
    integer(int32) :: one(1)

    one = value
    call self%pass_int32s(name, one)
    value = one(1)
  end subroutine pass_int32

  pure subroutine pass_int64(self, name, value)
    class(stream_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int64), intent(inout) :: value
    integer(int64) :: one(1)

    one = value
    call self%pass_int64s(name, one)
    value = one(1)
  end subroutine pass_int64

  pure subroutine pass_real(self, name, value)
    class(stream_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    real(wp), intent(inout) :: value
    real(wp) :: one(1)

    one = value
    call self%pass_reals(name, one)
    value = one(1)
  end subroutine pass_real

  !> Small whole numbers, eight in a word.
  pure subroutine pass_int8s(self, name, values)
    class(stream_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int8), intent(inout) :: values(:)
    integer(int64), allocatable :: words(:)

    words = transfer(values, [0_int64])
    call self%pass_words(name, 'int8', 1, size(values), words)
    if (self%reading) values = transfer(words, values, size(values))
  end subroutine pass_int8s

  !> Short whole numbers; none that a state has is beyond those of eight bits.
  pure subroutine pass_int16s(self, name, values)
    class(stream_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int16), intent(inout) :: values(:)
    integer(int8) :: small(size(values))

    small = int(values, int8)
    call self%pass_int8s(name, small)
    values = small
  end subroutine pass_int16s

  pure subroutine pass_int32s(self, name, values)
    class(stream_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int32), intent(inout) :: values(:)
    integer(int64), allocatable :: words(:)

    words = transfer(values, [0_int64])
    call self%pass_words(name, 'int32', 4, size(values), words)
    if (self%reading) values = transfer(words, values, size(values))
  end subroutine pass_int32s

  pure subroutine pass_int64s(self, name, values)
    class(stream_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int64), intent(inout) :: values(:)
    integer(int64), allocatable :: words(:)

    words = transfer(values, [0_int64])
    call self%pass_words(name, 'int64', word_bytes, size(values), words)
    if (self%reading) values = transfer(words, values, size(values))
  end subroutine pass_int64s

  !> Real numbers of the program's precision, to all their bits; then those that follow.
  pure recursive subroutine pass_reals(self, name, values, name2, values2, name3, values3, &
      name4, values4, name5, values5)
    class(stream_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    real(wp), intent(inout) :: values(:)
    !> Those that follow, each with its name.
    character(len=*), intent(in), optional :: name2, name3, name4, name5
    !> Theirs.
    real(wp), intent(inout), optional :: values2(:), values3(:), values4(:), values5(:)
    integer(int64), allocatable :: words(:)

    words = transfer(values, [0_int64])
    call self%pass_words(name, 'real', storage_size(1.0_wp)/8, size(values), words)
    if (self%reading) values = transfer(words, values, size(values))
    if (present(values2)) call self%pass_reals(name2, values2, name3, values3, name4, values4, &
      name5, values5)
  end subroutine pass_reals

  pure subroutine pass_int32_list(self, name, values)
    class(stream_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(int32), allocatable, intent(inout) :: values(:)
    integer :: items

    if (.not. allocated(values)) allocate (values(0))
    items = size(values)
    call self%pass_size(name, items)
    if (self%failed()) return
    if (size(values) /= items) values = spread(0_int32, 1, items)
    call self%pass_int32s(name, values)
  end subroutine pass_int32_list

  pure recursive subroutine pass_real_list(self, name, values, name2, values2, name3, values3, &
      name4, values4)
    class(stream_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    real(wp), allocatable, intent(inout) :: values(:)
    !> Those that follow, each with its name.
    character(len=*), intent(in), optional :: name2, name3, name4
    !> Theirs.
    real(wp), allocatable, intent(inout), optional :: values2(:), values3(:), values4(:)
    integer :: items

    if (.not. allocated(values)) allocate (values(0))
    items = size(values)
    call self%pass_size(name, items)
    if (self%failed()) return
    if (size(values) /= items) values = spread(0.0_wp, 1, items)
    call self%pass_reals(name, values)
    ! Given, and not whether it is allocated: that is what `name2` tells.
    if (present(name2)) call self%pass_real_list(name2, values2, name3, values3, name4, values4)
  end subroutine pass_real_list

  !> A text of any length and of any bytes.
  pure subroutine pass_text(self, name, text)
    class(stream_type), intent(inout) :: self
    !> Of the component: by it a stream of something else is found out.
    character(len=*), intent(in) :: name
    !> On reading it becomes as long as what was written.
    character(len=:), allocatable, intent(inout) :: text
    integer(int8), allocatable :: letters(:)
    integer :: length

    length = 0
    if (allocated(text)) length = len(text)
    call self%pass_size(name, length)
    if (self%failed()) return
    allocate (letters(length), source=0_int8)
    if (.not. self%reading .and. length > 0) letters = transfer(text, letters)
    call self%pass_int8s(name, letters)
    if (self%reading) text = transfer(letters, repeat(' ', length))
  end subroutine pass_text

  !> The size of a list, which no state of so many words can hold if it is greater.
  pure subroutine pass_size(self, name, items)
    class(stream_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, intent(inout) :: items

    call self%pass_int32('size of '//name, items)
    if (self%failed() .or. .not. self%reading) return
    if (items < 0 .or. items > word_bytes*size(self%word, kind=int64)) &
      self%problem = 'the state ends within '''//name//''''
  end subroutine pass_size

end module battery_stream
