!> Initial positions and velocities: at random in the urns, or from a file.
module battery_initial_state
  use battery_kinds, only: wp, int64, pi
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_foreign_bytes, only: text_start, foreign_byte_text
  use battery_numbers, only: read_decimal
  use battery_findings, only: finding_type, findings_type, finding_of, add_finding, findings_text, &
    displayable_text
  use battery_text, only: to_text, lower_case, string_type, new_line_character
  use battery_table, only: table_type, passage_type, passage_at, channel1, chamber_at, &
    moves_along_arc, outside, half_length, try_random_point
  use battery_engine, only: particles_type
  use battery_signals, only: stop_requested, set_stop_error
  use battery_gsl, only: seed_generator, uniform
  implicit none (type, external)
  private
  public :: random_particles, parse_particles, are_inside, before_crossing

  !> Characters that separate the numbers of a line, besides commas.
  character(len=*), parameter :: blanks = ' '//achar(9)

  !> Faults of a line: not four columns, a comma without a number, no number, no speed, outside the
  !> table, along an arc.
  integer, parameter :: of_columns = 1, of_commas = 2, of_numbers = 3, of_speed = 4, of_place = 5, &
    of_arc = 6
  !> Number of further lines with the same fault whose numbers are given.
  integer, parameter :: most_named = 20

  !> Number of particles or lines between two checks for a stop request.
  integer, parameter :: particles_between_stop_checks = 65536

contains

  !> Allocates arrays for `number` particles; an error if there is no memory.
  subroutine allocate_particle_arrays(particles, number, error)
    type(particles_type), intent(inout) :: particles
    integer, intent(in) :: number
    type(error_type), allocatable, intent(out) :: error
    integer :: status

    allocate (particles%x(number), stat=status)
    if (status == 0) allocate (particles%y(number), stat=status)
    if (status == 0) allocate (particles%ux(number), stat=status)
    if (status == 0) allocate (particles%uy(number), stat=status)
    if (status /= 0) call fatal_error(error, 'no memory for '//to_text(number)//' particles')
  end subroutine allocate_particle_arrays

  !> Draws `number` particles, the first `urn1_number` of them in urn 1: positions uniform in the
  !> urns, directions uniform, speed 1. The same seed gives the same random numbers on all machines,
  !> and the same particles where `cos` and `sin` round alike: without FMA instructions, 681 of 1e6
  !> directions differ in the last bit.
  subroutine random_particles(table, number, urn1_number, seed, particles, error)
    type(table_type), intent(in) :: table
    integer, intent(in) :: number, urn1_number
    !> Seed, any number of 64 bits: the identity of a task. (The base seed of a namelist, one of the
    !> values that the identity follows from, is from 0 to 18 digits.)
    integer(int64), intent(in) :: seed
    type(particles_type), intent(out) :: particles
    !> No memory, no random generator, or a stop request.
    type(error_type), allocatable, intent(out) :: error
    real(wp) :: angle
    integer :: at

    call allocate_particle_arrays(particles, number, error)
    if (allocated(error)) return
    call seed_generator(seed, error)
    if (allocated(error)) return
    do at = 1, number
      if (mod(at, particles_between_stop_checks) == 0) then
        if (stop_requested()) exit
      end if
      call place_in_urn(table, merge(1, 2, at <= urn1_number), particles%x(at), particles%y(at))
      angle = 2.0_wp*pi*real(uniform(), wp)
      particles%ux(at) = cos(angle)
      particles%uy(at) = sin(angle)
    end do
    if (stop_requested()) call set_stop_error(error)
  end subroutine random_particles

  !> Draws a point uniform in an urn.
  subroutine place_in_urn(table, urn, x, y)
    type(table_type), intent(in) :: table
    integer, intent(in) :: urn
    real(wp), intent(out) :: x, y
    real(wp) :: across, up
    logical :: inside

    do
      across = real(uniform(), wp)
      up = real(uniform(), wp)
      call try_random_point(table%urn(urn), across, up, x, y, inside)
      if (inside) exit
    end do
  end subroutine place_in_urn

  !> Parses `number` particles from a text with a line `x y ux uy` for each; velocities are
  !> normalised to speed 1. Empty lines and lines that begin with # are ignored. All problems are
  !> reported in one error, with `name` for the file.
  subroutine parse_particles(text, name, table, number, particles, error)
    !> Text of the whole file, and its name.
    character(len=*), intent(in) :: text, name
    type(table_type), intent(in) :: table
    integer, intent(in) :: number
    type(particles_type), intent(out) :: particles
    type(error_type), allocatable, intent(out) :: error
    type(findings_type) :: findings
    !> The first line with each fault, the number of further ones, and numbers of some of these.
    type(finding_type) :: first_of(of_arc)
    integer :: further(of_arc)
    type(string_type) :: further_lines(of_arc)
    character(len=:), allocatable :: problem, foreign
    real(wp) :: state(4)
    integer(int64) :: first, line_start, last, next
    integer :: line, count, head, fault

    call allocate_particle_arrays(particles, number, error)
    if (allocated(error)) return
    next = text_start(text)
    line = 0
    count = 0
    head = 0
    further = 0
    foreign = ''
    do while (next <= len(text, int64))
      first = next
      line_start = next
      last = index(text(first:), new_line_character, kind=int64) + first - 1
      if (last < first) last = len(text, int64) + 1
      next = last + 1
      line = line + 1
      if (mod(line, particles_between_stop_checks) == 0) then
        if (stop_requested()) then
          call set_stop_error(error)
          return
        end if
      end if
      ! Line ends of Windows have a carriage return.
      if (last > first) last = merge(last - 1, last, text(last - 1:last - 1) == achar(13))
      first = first + verify(text(first:last - 1)//'.', blanks, kind=int64) - 1
      if (first >= last) cycle
      if (text(first:first) == '#') cycle
      count = count + 1
      call read_line(text(first:last - 1), table, state, fault, problem)
      if (problem /= '') then
        foreign = foreign_byte_text(text(line_start:min(last, len(text, int64))))
        if (foreign /= '') problem = foreign
        ! The first line may be the names of columns; all others may have the same fault.
        if (count == 1) head = merge(1, 0, scan(text(first:first), '+-.0123456789') == 0 .and. &
          scan(lower_case(text(first:last - 1)), 'abcfghijklmnopqrstuvwxyz') > 0)
        if (foreign /= '' .or. count == head) then
          call add_finding(findings, finding_of(line, problem))
        else if (first_of(fault)%line == 0) then
          first_of(fault) = finding_of(line, problem)
          further_lines(fault)%text = ''
        else
          further(fault) = further(fault) + 1
          if (further(fault) <= most_named) &
            further_lines(fault)%text = further_lines(fault)%text//', '//to_text(line)
        end if
        if (foreign /= '') exit
      else if (count <= number) then
        state(3:) = state(3:)/hypot(state(3), state(4))
        particles%x(count) = state(1)
        particles%y(count) = state(2)
        particles%ux(count) = state(3)
        particles%uy(count) = state(4)
      end if
    end do
    do fault = 1, size(first_of)
      if (first_of(fault)%line == 0) cycle
      if (further(fault) > 0) first_of(fault)%value = first_of(fault)%value &
        //'; further such lines: '//to_text(further(fault))//' ('//further_lines(fault)%text(3:) &
        //trim(merge(', ...', '     ', further(fault) > most_named))//')'
      call add_finding(findings, first_of(fault))
    end do
    if (foreign == '' .and. count /= number .and. count - head /= number) &
      call add_finding(findings, finding_of(0, 'has '//to_text(count)//' particles', &
      to_text(number)//', as &particles number says'))
    if (findings%count > 0) call fatal_error(error, findings_text(findings, name), exit_bad_input)
  end subroutine parse_particles

  !> Whether all particles are inside a table.
  pure logical function are_inside(table, particles) result(inside)
    type(table_type), intent(in) :: table
    type(particles_type), intent(in) :: particles
    integer :: at

    inside = .false.
    do at = 1, size(particles%x)
      if (chamber_at(table, particles%x(at), particles%y(at), 0.0_wp) == outside) return
    end do
    inside = .true.
  end function are_inside

  !> x of a particle at the start. In a run that goes on, with a `start_time` above 0, it is just
  !> before the line if it is exactly on the chord of a gate or on the middle line, and moves over
  !> it, since a run ends before the events of its last instant.
  elemental real(wp) function before_crossing(table, start_time, x, y, ux, uy) result(before)
    type(table_type), intent(in) :: table
    !> Clock time at the start, in time units.
    real(wp), intent(in) :: start_time
    !> Position in the frame of the table, lengths; velocity, of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    type(passage_type) :: passage

    before = x
    if (.not. start_time > 0.0_wp) return
    passage = passage_at(table, x, y, ux, uy)
    if (passage%trapped .or. passage%channel /= channel1) return
    if (.not. (abs(x) > 0.0_wp .or. ux < 0.0_wp .or. table%urn_count == 1)) before = -tiny(x)
    if (abs(x) >= table%urn(passage%urn)%channel_start(channel1) .and. x*ux < 0.0_wp) &
      before = nearest(x, x)
  end function before_crossing

  !> Parses one line of an initial file: its four numbers, and its problem (empty: none).
  subroutine read_line(line, table, state, fault, problem)
    character(len=*), intent(in) :: line
    type(table_type), intent(in) :: table
    real(wp), intent(out) :: state(4)
    !> Which fault a problem is.
    integer, intent(out) :: fault
    character(len=:), allocatable, intent(out) :: problem
    !> Numbers up to this have finite squares.
    real(wp), parameter :: far = 0.25_wp*sqrt(huge(1.0_wp))
    !> Bound on rounding errors of a place, in units of the table.
    real(wp), parameter :: rounding = 64.0_wp*epsilon(1.0_wp)
    integer :: first(4), last(4), k
    logical :: lost

    state = 0.0_wp
    call find_columns(line, first, last, fault, problem)
    if (problem /= '') return
    fault = of_numbers
    do k = 1, 4
      call read_decimal(line(first(k):last(k)), state(k), problem)
      if (problem == '') cycle
      problem = 'is not four finite numbers: '//displayable_text(line(first(k):last(k)))//' ' &
        //problem
      return
    end do
    fault = of_speed
    if (maxval(abs(state(3:))) > 0.5_wp*huge(1.0_wp)) then
      problem = 'has a speed that is not finite; allowed: any above 0'
    else if (.not. hypot(state(3), state(4)) > tiny(1.0_wp)) then
      problem = 'has the speed '//to_text(hypot(state(3), state(4)))//'; allowed: any above ' &
        //to_text(tiny(1.0_wp))
    else
      lost = maxval(abs(state(:2))) > far
      ! A final state on a wall may be beyond it by rounding, in a polygon by its `tolerance`, which
      ! is less than this.
      if (.not. lost) lost = chamber_at(table, state(1), state(2), 2.0_wp*rounding &
        *half_length(table)) == outside
      if (lost) then
        fault = of_place
        problem = 'lies outside the table: x = '//to_text(state(1))//', y = '//to_text(state(2))
      else if (moves_along_arc(table, state(1), state(2), state(3)/hypot(state(3), state(4)), &
        state(4)/hypot(state(3), state(4)))) then
        fault = of_arc
        problem = 'moves along the arc of its urn, which it would hit without end; allowed: ' &
          //'another direction, or a place farther from the arc'
      end if
    end if
  end subroutine read_line

  !> Finds the four columns of a line, which are separated by blanks or by one comma with or without
  !> blanks: the positions in the line at which they start (`first`) and end (`last`); `problem` is
  !> empty if there are four.
  pure subroutine find_columns(line, first, last, fault, problem)
    character(len=*), intent(in) :: line
    integer, intent(out) :: first(4), last(4)
    !> Which fault a problem is.
    integer, intent(out) :: fault
    character(len=:), allocatable, intent(out) :: problem
    integer :: at, length, columns
    logical :: after_comma

    problem = ''
    first = 1
    last = 0
    columns = 0
    after_comma = .true.
    at = 1
    do while (at <= len(line))
      if (scan(line(at:at), blanks) == 1) then
        at = at + 1
      else if (line(at:at) == ',') then
        if (after_comma) problem = 'has a comma without a number before it'
        after_comma = .true.
        at = at + 1
      else
        length = scan(line(at:), blanks//',') - 1
        if (length < 0) length = len(line) - at + 1
        columns = columns + 1
        if (columns <= 4) then
          first(columns) = at
          last(columns) = at + length - 1
        end if
        after_comma = .false.
        at = at + length
      end if
    end do
    if (after_comma .and. problem == '') problem = 'has a comma without a number behind it'
    fault = merge(of_columns, of_commas, problem == '')
    if (problem == '' .and. columns /= 4) problem = 'has '//to_text(columns) &
      //trim(merge(' column ', ' columns', columns == 1))//'; allowed: 4, x y ux uy, ' &
      //'between blanks or commas, with decimal points'
  end subroutine find_columns

end module battery_initial_state
