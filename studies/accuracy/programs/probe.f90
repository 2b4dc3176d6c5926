!> Procedures that the probes of the program `accuracy` have in common: command line, JSON, start of
!> an engine.
module battery_probe
  use, intrinsic :: iso_fortran_env, only: output_unit, real32
  use battery_kinds, only: wp, dp, int64
  use battery_error, only: error_type
  use battery_file_text, only: read_file
  use battery_initial_state, only: parse_particles
  use battery_text, only: to_text
  use battery_table, only: table_type, new_table, shape_circuit
  use battery_engine, only: engine_type, particles_type
  use battery_event_record, only: event_record_type
  use battery_engines, only: new_engine
  implicit none (type, external)
  private
  public :: argument, real_argument, integer_argument, rounded_to_bits, precision_name, &
    paper_table, start_engine, read_particles
  public :: advance_for, json_list, print_json_line, stop_with_message

contains

  !> Word `k` of the command line.
  function argument(k) result(word)
    integer, intent(in) :: k
    character(len=:), allocatable :: word
    integer :: length

    call get_command_argument(k, length=length)
    allocate (character(len=length) :: word)
    call get_command_argument(k, word)
  end function argument

  !> Word `k` of the command line as a real number.
  function real_argument(k) result(number)
    integer, intent(in) :: k
    real(wp) :: number
    character(len=64) :: word
    integer :: status

    word = argument(k)
    read (word, *, iostat=status) number
    if (status /= 0) call stop_with_message('argument '//to_text(k)//' is not a number')
  end function real_argument

  !> Word `k` of the command line as a whole number.
  function integer_argument(k) result(number)
    integer, intent(in) :: k
    integer(int64) :: number
    character(len=64) :: word
    integer :: status

    word = argument(k)
    read (word, *, iostat=status) number
    if (status /= 0) call stop_with_message('argument '//to_text(k)//' is not a whole number')
  end function integer_argument

  !> A length rounded such that it is the same in all precisions with more than `bits` bits.
  elemental function rounded_to_bits(length, bits) result(rounded)
    real(wp), intent(in) :: length
    !> Below 24: rounded to real32; else to real64.
    integer, intent(in) :: bits
    real(wp) :: rounded

    rounded = real(real(length, dp), wp)
    if (bits < 24) rounded = real(real(length, real32), wp)
  end function rounded_to_bits

  !> Name of the precision that the program was built with: real32, real64 or real128.
  function precision_name() result(name)
    character(len=:), allocatable :: name

    name = 'real'//to_text(storage_size(1.0_wp))
  end function precision_name

  !> Table of the paper: urns of radius 1, channels of length 1.
  function paper_table(width1, width2) result(table)
    !> Widths of the channels, rounded to the precision.
    real(wp), intent(in) :: width1, width2
    type(table_type) :: table

    table = new_table(shape_circuit, 1.0_wp, width1, 1.0_wp, width2, 1.0_wp)
  end function paper_table

  !> Creates an engine, and starts it from a copy of the particles; its seed is 1.
  subroutine start_engine(name, table, threshold, particles, step, engine, clock)
    character(len=*), intent(in) :: name
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold
    type(particles_type), intent(in) :: particles
    !> Time step of the engine `timestep`.
    real(wp), intent(in) :: step
    class(engine_type), allocatable, intent(out) :: engine
    !> Time at the start; default 0.
    real(wp), intent(in), optional :: clock
    type(error_type), allocatable :: error
    type(particles_type) :: initial
    real(wp) :: began

    call new_engine(name, engine, error)
    if (allocated(error)) call stop_with_message(error%message)
    engine%time_step = step
    engine%seed = 1
    initial = particles
    began = 0.0_wp
    if (present(clock)) began = clock
    call engine%start(table, [threshold, threshold], initial, began)
  end subroutine start_engine

  !> Advances an engine by `duration`; `event_record` is that of the last window.
  subroutine advance_for(engine, duration, event_record)
    class(engine_type), intent(inout) :: engine
    real(wp), intent(in) :: duration
    type(event_record_type), intent(inout) :: event_record
    real(wp) :: elapsed

    elapsed = 0.0_wp
    do while (duration - elapsed > 4.0_wp*epsilon(1.0_wp)*duration)
      call engine%advance(duration - elapsed, event_record)
      elapsed = elapsed + event_record%duration
    end do
  end subroutine advance_for

  !> Numbers as a JSON list, with all digits; null for NaN and infinity.
  function json_list(numbers) result(text)
    real(wp), intent(in) :: numbers(:)
    character(len=:), allocatable :: text, buffer
    character(len=48) :: word
    character(len=16) :: layout
    integer :: k, digits, at

    digits = precision(1.0_wp) + 3
    write (layout, '(a, i0, a, i0, a)') '(es', digits + 9, '.', digits - 1, 'e4)'
    allocate (character(len=size(numbers)*len(word) + 2) :: buffer)
    buffer(1:1) = '['
    at = 1
    do k = 1, size(numbers)
      write (word, layout) numbers(k)
      if (.not. abs(numbers(k)) <= huge(1.0_wp)) word = 'null'
      if (k > 1) call append_text(',')
      call append_text(trim(adjustl(word)))
    end do
    call append_text(']')
    text = buffer(:at)

  contains

    !> Appends `part` to the buffer.
    subroutine append_text(part)
      character(len=*), intent(in) :: part

      buffer(at + 1:at + len(part)) = part
      at = at + len(part)
    end subroutine append_text

  end function json_list

  !> Reads the states of `number` particles from a file.
  subroutine read_particles(file, table, number, particles, error)
    character(len=*), intent(in) :: file
    type(table_type), intent(in) :: table
    integer, intent(in) :: number
    type(particles_type), intent(out) :: particles
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: text

    call read_file(file, text, error)
    if (.not. allocated(error)) call parse_particles(text, file, table, number, particles, error)
  end subroutine read_particles

  !> Prints a line of JSON, and flushes the output.
  subroutine print_json_line(text)
    character(len=*), intent(in) :: text

    write (output_unit, '(a)') text
    flush (output_unit)
  end subroutine print_json_line

  !> Stops the program with an error message.
  subroutine stop_with_message(message)
    character(len=*), intent(in) :: message

    error stop 'accuracy: '//message
  end subroutine stop_with_message

end module battery_probe
