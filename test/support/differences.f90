!> First difference of two objects that should be equal, in words; an empty text if they are equal.
!>
!> Numbers are compared bit by bit, except for the sign of a zero; a NaN equals a NaN.
module differences
  use battery_kinds, only: wp, int64
  use battery_error, only: error_type
  use battery_engine, only: particles_type
  use battery_observer, only: observer_type, serialize_observer
  use battery_simulation, only: simulation_type, serialize_simulation
  use battery_archive, only: archive_type, new_archive
  use battery_text, only: to_text
  use scenes, only: same_bits
  use engine_runs, only: log_type
  implicit none (type, external)
  private
  public :: first_difference

  interface first_difference
    module procedure :: of_numbers, of_planes, of_words, of_particles, of_logs, &
      of_observers, of_simulations
  end interface first_difference

contains

  !> First difference of two arrays of rank 1, bit by bit or to a tolerance.
  pure function of_numbers(a, b, tolerance) result(text)
    real(wp), intent(in) :: a(:), b(:)
    !> Absolute tolerance; absent: bit by bit.
    real(wp), intent(in), optional :: tolerance
    character(len=:), allocatable :: text
    integer :: k

    text = of_sizes(size(a), size(b), 'numbers')
    if (text /= '') return
    do k = 1, size(a)
      if (same_bits(a(k), b(k))) cycle
      if (present(tolerance)) then
        if (abs(a(k) - b(k)) <= tolerance) cycle
      end if
      text = 'number '//to_text(k)//': '//to_text(a(k))//' and '//to_text(b(k))
      return
    end do
  end function of_numbers

  !> First difference of two arrays of rank 2, bit by bit.
  pure function of_planes(a, b) result(text)
    real(wp), intent(in) :: a(:, :), b(:, :)
    character(len=:), allocatable :: text

    text = of_numbers(pack(a, .true.), pack(b, .true.))
  end function of_planes

  !> Difference of two counts.
  pure function of_sizes(a, b, what) result(text)
    integer, intent(in) :: a, b
    character(len=*), intent(in) :: what
    character(len=:), allocatable :: text

    text = ''
    if (a /= b) text = to_text(a)//' and '//to_text(b)//' '//what
  end function of_sizes

  !> First difference of two sets of particles.
  pure function of_particles(a, b, tolerance) result(text)
    type(particles_type), intent(in) :: a, b
    !> Absolute tolerance of x, y, ux and uy; absent: bit by bit.
    real(wp), intent(in), optional :: tolerance
    character(len=:), allocatable :: text

    text = named('x', of_numbers(a%x, b%x, tolerance))
    if (text == '') text = named('y', of_numbers(a%y, b%y, tolerance))
    if (text == '') text = named('ux', of_numbers(a%ux, b%ux, tolerance))
    if (text == '') text = named('uy', of_numbers(a%uy, b%uy, tolerance))
  end function of_particles

  !> Puts the name of the compared quantity before a difference, if there is one.
  pure function named(name, difference) result(text)
    character(len=*), intent(in) :: name, difference
    character(len=:), allocatable :: text

    text = difference
    if (text /= '') text = name//', '//difference
  end function named

  !> First difference of two logs, which should have the same events in the same order, at times t
  !> that differ by at most `tolerance` times exp(rate t).
  pure function of_logs(a, b, tolerance, rate) result(text)
    type(log_type), intent(in) :: a, b
    real(wp), intent(in) :: tolerance, rate
    character(len=:), allocatable :: text
    integer :: k

    text = ''
    do k = 1, min(a%events, b%events)
      if (all([a%kind(k), a%where(k), a%particle(k)] == [b%kind(k), b%where(k), b%particle(k)]) &
        .and. abs(a%time(k) - b%time(k)) <= tolerance*exp(rate*a%time(k))) cycle
      text = 'event '//to_text(k)//': '//event_text(a, k)//'; and '//event_text(b, k)
      return
    end do
    text = of_sizes(a%events, b%events, 'events')
  end function of_logs

  !> Text that describes event k of a log.
  pure function event_text(log, k) result(text)
    type(log_type), intent(in) :: log
    integer, intent(in) :: k
    character(len=:), allocatable :: text

    text = 'kind '//to_text(log%kind(k))//' where '//to_text(log%where(k))//' particle ' &
      //to_text(log%particle(k))//' at '//to_text(log%time(k))
  end function event_text

  !> First difference of two observers, in all their components.
  pure function of_observers(a, b) result(text)
    type(observer_type), intent(in) :: a, b
    character(len=:), allocatable :: text
    type(observer_type) :: one, other
    type(archive_type) :: first, second

    one = a
    other = b
    first = new_archive()
    second = new_archive()
    call serialize_observer(one, first)
    call serialize_observer(other, second)
    text = of_words(first%word(:first%length), second%word(:second%length))
    if (text /= '') text = 'observers, '//text//', times '//to_text(a%time)//' and ' &
      //to_text(b%time)//', entries '//to_text(a%entries)//' and '//to_text(b%entries)
  end function of_observers

  !> First difference of the words of two states or records.
  pure function of_words(a, b) result(text)
    integer(int64), intent(in) :: a(:), b(:)
    character(len=:), allocatable :: text
    integer :: k

    text = ''
    do k = 1, min(size(a), size(b))
      if (a(k) == b(k)) cycle
      text = 'word '//to_text(k)//': '//to_text(a(k))//' and '//to_text(b(k))
      return
    end do
    text = of_sizes(size(a), size(b), 'words')
  end function of_words

  !> First difference of two simulations: particles, counts, and all components of their states.
  function of_simulations(a, b) result(text)
    type(simulation_type), intent(inout) :: a, b
    character(len=:), allocatable :: text
    type(particles_type) :: here, there
    type(archive_type) :: first, second
    type(error_type), allocatable :: error
    integer(int64) :: hits(2)

    text = of_observers(a%observer, b%observer)
    if (text == '') text = named('clocks', of_numbers([a%engine%clock()], [b%engine%clock()]))
    hits = [a%engine%collisions(), b%engine%collisions()]
    if (text == '' .and. hits(1) /= hits(2)) text = to_text(hits(1))//' and '//to_text(hits(2)) &
      //' collisions'
    if (text /= '') return
    first = new_archive()
    second = new_archive()
    call serialize_simulation(a, a%setup, first, error)
    if (.not. allocated(error)) call serialize_simulation(b, b%setup, second, error)
    if (allocated(error)) then
      text = error%message
      return
    end if
    call a%engine%get_particles(1, a%engine%number, here)
    call b%engine%get_particles(1, b%engine%number, there)
    text = of_particles(here, there)
    if (text == '') text = of_words(first%word(:first%length), second%word(:second%length))
  end function of_simulations

end module differences
