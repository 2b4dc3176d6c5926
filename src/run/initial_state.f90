!> Where the particles start: at random in the urns, or as a file says.
module battery_initial_state
  use, intrinsic :: iso_fortran_env, only: iostat_end
  use battery_kinds, only: wp, int64, pi
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_text, only: string_type, to_text, join, new_line_character
  use battery_table, only: table_type, gated, ungated, chamber_at, outside, x_direction
  use battery_engine, only: particles_type
  use battery_gsl, only: generator_type, new_generator, free_generator, uniform_fine
  implicit none (type, external)
  private
  public :: random_particles, read_particles

  !> Problems of an initial file that are told one by one.
  integer, parameter :: most_problems = 20

  !> Longest line of an initial file.
  integer, parameter :: longest_line = 1024

contains

  !> `number` particles, the first `urn1_number` of them in urn 1: positions uniform in the urns,
  !> directions uniform, speed 1. The same seed gives the same particles everywhere.
  subroutine random_particles(table, number, urn1_number, seed, particles, error)
    type(table_type), intent(in) :: table
    integer, intent(in) :: number, urn1_number
    !> From 0 to 2**32 - 1.
    integer(int64), intent(in) :: seed
    type(particles_type), intent(out) :: particles
    !> No memory, or no generator.
    type(error_type), allocatable, intent(out) :: error
    type(generator_type) :: generator
    integer :: at, status

    allocate (particles%x(number), stat=status)
    if (status == 0) allocate (particles%y(number), stat=status)
    if (status == 0) allocate (particles%ux(number), stat=status)
    if (status == 0) allocate (particles%uy(number), stat=status)
    if (status /= 0) then
      call fatal_error(error, 'no memory for '//to_text(number)//' particles')
      return
    end if
    call new_generator(generator, seed, error)
    if (allocated(error)) return
    do at = 1, number
      call place_in_urn(generator, table, merge(1, 2, at <= urn1_number), particles%x(at), &
        particles%y(at))
      call draw_direction(generator, particles%ux(at), particles%uy(at))
    end do
    call free_generator(generator)
  end subroutine random_particles

  !> A point uniform in an urn: in the disc, on the inner side of both chords.
  subroutine place_in_urn(generator, table, side, x, y)
    type(generator_type), intent(in) :: generator
    type(table_type), intent(in) :: table
    integer, intent(in) :: side
    real(wp), intent(out) :: x, y
    !> Coordinates from the centre; `inward` goes to channel 1.
    real(wp) :: inward

    associate (urn => table%urn(side))
      do
        inward = urn%radius*(2.0_wp*real(uniform_fine(generator), wp) - 1.0_wp)
        y = urn%radius*(2.0_wp*real(uniform_fine(generator), wp) - 1.0_wp)
        if (inward**2 + y**2 >= urn%radius**2) cycle
        if (inward < urn%chord(gated) .and. -inward < urn%chord(ungated)) exit
      end do
      x = x_direction(side)*(urn%centre - inward)
    end associate
  end subroutine place_in_urn

  !> A direction uniform on the circle.
  subroutine draw_direction(generator, ux, uy)
    type(generator_type), intent(in) :: generator
    real(wp), intent(out) :: ux, uy
    real(wp) :: angle

    angle = 2.0_wp*pi*real(uniform_fine(generator), wp)
    ux = cos(angle)
    uy = sin(angle)
  end subroutine draw_direction

  !> `number` particles from a file with a line `x y ux uy` for each; speeds are made 1. Empty lines
  !> and lines that begin with # are passed over. All problems come back in one error.
  subroutine read_particles(file, table, number, particles, error)
    character(len=*), intent(in) :: file
    type(table_type), intent(in) :: table
    integer, intent(in) :: number
    type(particles_type), intent(out) :: particles
    type(error_type), allocatable, intent(out) :: error
    type(string_type), allocatable :: problems(:)
    character(len=longest_line) :: line
    character(len=256) :: message
    character(len=:), allocatable :: problem
    real(wp) :: state(4)
    integer :: unit, status, line_number, count

    allocate (problems(0), particles%x(number), particles%y(number))
    allocate (particles%ux(number), particles%uy(number))
    open (newunit=unit, file=file, status='old', action='read', iostat=status, iomsg=message)
    if (status /= 0) then
      call fatal_error(error, file//': cannot be read: '//trim(message), exit_bad_input)
      return
    end if
    line_number = 0
    count = 0
    do
      read (unit, '(a)', iostat=status, iomsg=message) line
      if (status /= 0) exit
      line_number = line_number + 1
      if (line == '' .or. index(adjustl(line), '#') == 1) cycle
      count = count + 1
      call read_line(line, table, state, problem)
      if (problem /= '') then
        call add(file//', line '//to_text(line_number)//': '//problem)
      else if (count <= number) then
        call keep(state, count, particles)
      end if
    end do
    close (unit)
    if (status /= iostat_end) call add(file//': cannot be read: '//trim(message))
    if (count /= number) call add(file//': has '//to_text(count)//' particles; allowed: ' &
      //to_text(number)//', as &particles number says')
    if (size(problems) > 0) call report(problems, error)

  contains

    subroutine add(text)
      character(len=*), intent(in) :: text
      type(string_type) :: one

      one%text = text
      problems = [problems, one]
    end subroutine add

  end subroutine read_particles

  !> Takes over one particle; its velocity is made 1 long.
  pure subroutine keep(state, at, particles)
    real(wp), intent(in) :: state(4)
    integer, intent(in) :: at
    type(particles_type), intent(inout) :: particles
    real(wp) :: speed

    speed = hypot(state(3), state(4))
    particles%x(at) = state(1)
    particles%y(at) = state(2)
    particles%ux(at) = state(3)/speed
    particles%uy(at) = state(4)/speed
  end subroutine keep

  !> One line of an initial file: its four numbers, and what is wrong with it (empty: nothing).
  subroutine read_line(line, table, state, problem)
    character(len=*), intent(in) :: line
    type(table_type), intent(in) :: table
    real(wp), intent(out) :: state(4)
    character(len=:), allocatable, intent(out) :: problem
    integer :: status, columns

    state = 0.0_wp
    problem = ''
    columns = count_columns(line)
    if (columns /= 4) then
      problem = 'has '//to_text(columns)//' columns; allowed: 4, x y ux uy'
      return
    end if
    if (verify(trim(line), ' +-.0123456789dDeE,'//achar(9)//achar(13)) > 0) then
      problem = 'is not four finite numbers: '//trim(line)
      return
    end if
    read (line, *, iostat=status) state
    if (status /= 0 .or. .not. all(abs(state) <= huge(state))) then
      problem = 'is not four finite numbers: '//trim(line)
    else if (.not. (hypot(state(3), state(4)) > tiny(1.0_wp) .and. &
      hypot(state(3), state(4)) <= huge(1.0_wp))) then
      problem = 'has the speed '//to_text(hypot(state(3), state(4)))//'; allowed: any above 0'
    else if (chamber_at(table, state(1), state(2), 0.0_wp) == outside) then
      problem = 'lies outside the table: x = '//to_text(state(1))//', y = '//to_text(state(2))
    end if
  end subroutine read_line

  !> How many words a line has, set apart by blanks, tabs or commas.
  pure function count_columns(line) result(columns)
    character(len=*), intent(in) :: line
    integer :: columns
    character(len=*), parameter :: apart = ' ,'//achar(9)//achar(13)
    integer :: at

    logical :: in_word, was_in_word

    columns = 0
    was_in_word = .false.
    do at = 1, len(line)
      in_word = scan(line(at:at), apart) == 0
      if (in_word .and. .not. was_in_word) columns = columns + 1
      was_in_word = in_word
    end do
  end function count_columns

  !> One error from a list of problems; beyond `most_problems` only their number.
  subroutine report(problems, error)
    type(string_type), intent(in) :: problems(:)
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: message
    integer :: shown

    shown = min(size(problems), most_problems)
    message = join(problems(:shown), new_line_character)
    if (shown < size(problems)) message = message//new_line_character//'... and ' &
      //to_text(size(problems) - shown)//' more; the last: '//problems(size(problems))%text
    call fatal_error(error, message, exit_bad_input)
  end subroutine report

end module battery_initial_state
