!> What the tests of the physics share: tables, particles made by formula, an engine's log, and the
!> plain way to move a particle, wall by wall, in more digits than the program has.
module scenes
  use battery_kinds, only: wp, int64
  use battery_urn, only: shape_polygon
  use battery_corners, only: regular_corners
  use battery_table, only: table_type, urn_type, channel_type, new_table, shape_circuit, &
    chamber_at, side_at, outside, in_urn, in_gate, x_direction
  use battery_engine, only: engine_type, particles_type
  use battery_engines, only: new_engine
  use battery_error, only: error_type
  use battery_history, only: history_type, event_entry, event_reversal, event_crossing1, &
    event_crossing2
  use battery_stream, only: stream_type, new_stream, stream_of
  implicit none (type, external)
  private
  public :: qp, table_3_4_5, uneven_table, paper_table, polygon_urn, polygon_table, draw
  public :: scatter, pick, mirrored_x, mirrored_y, reversed, of_particles, one_particle
  public :: count_in_first, same_bits
  public :: begin, log_type, run_for, totals_of, tally
  public :: plain_type, plain_start, plain_run
  public :: save_engine, restore_engine
  public :: bounce_through, facing, channel_of

  !> Polygons: regular, with angles that are no shares of a turn, with parts that reach in and over
  !> a channel.
  integer, parameter, public :: hexagon = 1, decagon = 2, crooked = 3, re_entrant = 4, square = 5

  !> Kind of the reference computations.
  integer, parameter :: qp = selected_real_kind(30)

  !> Events in the order of their happening, with their times since the start.
  type :: log_type
    integer :: events = 0
    real(wp), allocatable :: time(:)
    integer, allocatable :: kind(:), where(:), particle(:)
    !> Time that has passed; windows; sum of what the histories tell.
    real(wp) :: elapsed = 0.0_wp
    integer :: windows = 0
    integer(int64) :: collisions = 0, reversals = 0, bounce_backs = 0
    !> How many crossings of each kind.
    integer :: crossings(4) = 0
    !> Integral of |N1 - N2| over time, and N1 as the crossings tell it.
    real(wp) :: spread = 0.0_wp
    integer :: first = 0
  end type log_type

  !> Rooms of the plain circuit: urns, channels.
  integer, parameter :: in_urn1 = 1, in_urn2 = 2, in_channel1 = 3, in_channel2 = 4

  !> All particles of a circuit, moved together from wall hit to wall hit.
  type :: plain_type
    type(table_type) :: table
    integer :: threshold(2) = 0
    real(qp) :: now = 0.0_qp
    integer(int64) :: hits = 0
    real(qp), allocatable :: x(:), y(:), ux(:), uy(:)
    integer, allocatable :: room(:)
    !> Gate that counts the particle, 0 for none.
    integer, allocatable :: counted(:)
  end type plain_type

  !> The next random number, or the next few.
  interface draw
    procedure draw_one, draw_many
  end interface draw

contains

  !> Chord 1 is the long side of a triangle with whole numbers: distances are exact in binary.
  pure function table_3_4_5() result(table)
    type(table_type) :: table

    table = new_table(shape_circuit, 1.25_wp, 1.5_wp, 1.0_wp, 0.0_wp, 1.0_wp)
  end function table_3_4_5

  !> A table with all five lengths different.
  pure function uneven_table() result(table)
    type(table_type) :: table

    table = new_table(shape_circuit, 1.25_wp, 0.7_wp, 1.5_wp, 0.4_wp, 0.75_wp)
  end function uneven_table

  !> The table of the paper's figures with w = 0.3, w' = 0.01.
  pure function paper_table() result(table)
    type(table_type) :: table

    table = new_table(shape_circuit, 1.0_wp, 0.3_wp, 1.0_wp, 0.01_wp, 1.0_wp)
  end function paper_table

  !> One of the polygons, as an urn that has no openings yet.
  pure function polygon_urn(kind) result(urn)
    !> `hexagon` and so on.
    integer, intent(in) :: kind
    type(urn_type) :: urn

    urn%shape = shape_polygon
    select case (kind)
    case (hexagon)
      urn%corner = regular_corners(6, 1.25_wp)
    case (decagon)
      urn%corner = regular_corners(10, 1.5_wp)
    case (square)
      urn%corner = regular_corners(4, sqrt(2.0_wp))
    case (crooked)
      urn%corner = reshape([0.9_wp, -0.5_wp, 0.9_wp, 0.6_wp, 0.1_wp, 1.1_wp, -0.95_wp, 0.55_wp, &
        -0.95_wp, -0.45_wp, -0.2_wp, -1.2_wp], [2, 6])
    case default
      urn%corner = reshape([1.0_wp, -0.6_wp, 1.0_wp, 0.6_wp, 1.4_wp, 0.7_wp, 1.3_wp, 1.2_wp, &
        -0.5_wp, 1.1_wp, -0.6_wp, 0.3_wp, -1.0_wp, 0.9_wp, -1.2_wp, 0.5_wp, -1.2_wp, -0.5_wp, &
        -0.3_wp, -1.0_wp, 0.2_wp, -0.4_wp, 0.7_wp, -1.1_wp], [2, 12])
    end select
  end function polygon_urn

  !> Polygons as urns of the uneven table.
  pure function polygon_table(first, second) result(table)
    integer, intent(in) :: first, second
    type(table_type) :: table

    table = new_table(shape_circuit, [polygon_urn(first), polygon_urn(second)], &
      [channel_type(0.7_wp, 1.5_wp), channel_type(0.4_wp, 0.75_wp)])
  end function polygon_table

  !> Next number in (0, 1): two steps of the multiplicative generator of Park and Miller with the
  !> multiplier 48271 make 53 bits. Start from any whole number from 1 to 2147483646.
  subroutine draw_one(state, number)
    integer(int64), intent(inout) :: state
    real(wp), intent(out) :: number
    integer(int64), parameter :: modulus = 2147483647_int64
    integer(int64) :: high

    high = modulo(48271_int64*state, modulus)
    state = modulo(48271_int64*high, modulus)
    number = (real(high - 1, wp) + real(state, wp)/real(modulus, wp))/real(modulus - 1, wp)
  end subroutine draw_one

  subroutine draw_many(state, numbers)
    integer(int64), intent(inout) :: state
    real(wp), intent(out) :: numbers(:)
    integer :: i

    do i = 1, size(numbers)
      call draw_one(state, numbers(i))
    end do
  end subroutine draw_many

  !> `number` particles, uniform in the table (`everywhere`) or in its urns, of all directions.
  subroutine scatter(table, number, seed, everywhere, particles)
    type(table_type), intent(in) :: table
    integer, intent(in) :: number, seed
    logical, intent(in) :: everywhere
    type(particles_type), intent(out) :: particles
    integer(int64) :: state
    integer :: i, chamber
    real(wp) :: a, b, height

    state = 1 + modulo(7919_int64*int(seed, int64), 2147483646_int64)
    particles = of_particles(spread(0.0_wp, 1, number))
    height = maxval(table%urn%reach)
    do i = 1, number
      do
        call draw(state, a)
        call draw(state, b)
        particles%x(i) = (2.0_wp*a - 1.0_wp)*maxval(table%urn%periodic_line)
        particles%y(i) = (2.0_wp*b - 1.0_wp)*height
        chamber = chamber_at(table, particles%x(i), particles%y(i), 0.0_wp)
        if (everywhere .and. chamber /= outside) exit
        if (chamber == in_urn) exit
      end do
      call draw(state, a)
      a = 8.0_wp*atan(1.0_wp)*a
      particles%ux(i) = cos(a)
      particles%uy(i) = sin(a)
    end do
  end subroutine scatter

  !> Particles at the places x on the axis that fly to the right; the other numbers are to be set.
  pure function of_particles(x) result(particles)
    real(wp), intent(in) :: x(:)
    type(particles_type) :: particles
    integer :: i

    particles%x = x
    particles%y = [(0.0_wp, i=1, size(x))]
    particles%ux = [(1.0_wp, i=1, size(x))]
    particles%uy = particles%y
  end function of_particles

  pure function one_particle(x, y, ux, uy) result(particles)
    real(wp), intent(in) :: x, y, ux, uy
    type(particles_type) :: particles

    particles%x = [x]
    particles%y = [y]
    particles%ux = [ux]
    particles%uy = [uy]
  end function one_particle

  !> The particles with the numbers `order`, in that order.
  pure function pick(particles, order) result(picked)
    type(particles_type), intent(in) :: particles
    integer, intent(in) :: order(:)
    type(particles_type) :: picked

    picked%x = particles%x(order)
    picked%y = particles%y(order)
    picked%ux = particles%ux(order)
    picked%uy = particles%uy(order)
  end function pick

  pure function mirrored_x(particles) result(mirrored)
    type(particles_type), intent(in) :: particles
    type(particles_type) :: mirrored

    mirrored = particles
    mirrored%x = -particles%x
    mirrored%ux = -particles%ux
  end function mirrored_x

  pure function mirrored_y(particles) result(mirrored)
    type(particles_type), intent(in) :: particles
    type(particles_type) :: mirrored

    mirrored = particles
    mirrored%y = -particles%y
    mirrored%uy = -particles%uy
  end function mirrored_y

  !> The same places, all velocities turned round.
  pure function reversed(particles) result(back)
    type(particles_type), intent(in) :: particles
    type(particles_type) :: back

    back = particles
    back%ux = -particles%ux
    back%uy = -particles%uy
  end function reversed

  !> N1: how many particles are in the left half of the table.
  pure integer function count_in_first(particles)
    type(particles_type), intent(in) :: particles

    count_in_first = count(particles%x < 0.0_wp)
  end function count_in_first

  !> Whether two numbers are the same to the last bit, but for the sign of a zero.
  elemental logical function same_bits(a, b)
    real(wp), intent(in) :: a, b

    same_bits = a <= b .and. a >= b
  end function same_bits

  !> An engine by its name, at the time 0; the particles are left as they are.
  subroutine begin(name, table, threshold, particles, engine)
    character(len=*), intent(in) :: name
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold(2)
    type(particles_type), intent(in) :: particles
    class(engine_type), allocatable, intent(out) :: engine
    type(error_type), allocatable :: error
    type(particles_type) :: given

    call new_engine(trim(name), engine, error)
    engine%time_step = 1.0e-4_wp
    engine%seed = 5_int64
    given = particles
    call engine%start(table, threshold, given, 0.0_wp)
  end subroutine begin

  !> Lets the engine go on for `duration`, in windows not longer than `step`, and adds to the log.
  subroutine run_for(engine, duration, log, step)
    class(engine_type), intent(inout) :: engine
    real(wp), intent(in) :: duration
    type(log_type), intent(inout) :: log
    real(wp), intent(in), optional :: step
    type(history_type) :: history
    real(wp) :: rest, began

    if (.not. allocated(log%time)) then
      allocate (log%time(0), log%kind(0), log%where(0), log%particle(0))
    end if
    history%logging = .true.
    began = log%elapsed
    rest = duration
    do while (rest > 16.0_wp*epsilon(1.0_wp)*(began + duration))
      if (present(step)) rest = min(rest, step)
      call engine%advance(rest, history)
      call tally(history, engine%number, log)
      rest = duration - (log%elapsed - began)
    end do
  end subroutine run_for

  !> Adds one window to the log.
  subroutine tally(history, number, log)
    type(history_type), intent(in) :: history
    integer, intent(in) :: number
    type(log_type), intent(inout) :: log
    integer :: i, n
    real(wp) :: before

    n = history%events
    if (n > 0) call append_events()
    before = 0.0_wp
    do i = 1, history%crossings
      log%spread = log%spread + (history%crossing_time(i) - before)*abs(2*log%first - number)
      before = history%crossing_time(i)
      log%first = log%first + merge(1, -1, modulo(int(history%crossing(i)), 2) == 0)
      log%crossings(history%crossing(i)) = log%crossings(history%crossing(i)) + 1
    end do
    log%spread = log%spread + (history%duration - before)*abs(2*log%first - number)
    log%elapsed = log%elapsed + history%duration
    log%windows = log%windows + 1
    log%collisions = log%collisions + history%collisions
    log%reversals = log%reversals + history%reversals
    log%bounce_backs = log%bounce_backs + history%bounce_backs

  contains

    subroutine append_events()
      call make_room(log, log%events + n)
      log%time(log%events + 1:log%events + n) = log%elapsed + history%event_time(:n)
      log%kind(log%events + 1:log%events + n) = history%event_kind(:n)
      log%where(log%events + 1:log%events + n) = history%event_where(:n)
      log%particle(log%events + 1:log%events + n) = history%event_particle(:n)
      log%events = log%events + n
    end subroutine append_events

  end subroutine tally

  subroutine make_room(log, events)
    type(log_type), intent(inout) :: log
    integer, intent(in) :: events
    integer :: more

    if (.not. allocated(log%time)) then
      allocate (log%time(0), log%kind(0), log%where(0), log%particle(0))
    end if
    more = max(events, 2*size(log%time), 64) - size(log%time)
    if (events <= size(log%time)) return
    log%time = [log%time, spread(0.0_wp, 1, more)]
    log%kind = [log%kind, spread(0, 1, more)]
    log%where = [log%where, spread(0, 1, more)]
    log%particle = [log%particle, spread(0, 1, more)]
  end subroutine make_room

  !> What a run adds up to: wall collisions, reversals, turned back, crossings of each kind.
  pure function totals_of(log, collisions) result(totals)
    type(log_type), intent(in) :: log
    !> As the engine counts them; the log tells of some before they happen.
    integer(int64), intent(in) :: collisions
    real(wp) :: totals(7)

    totals = real([collisions, log%reversals, log%bounce_backs, int(log%crossings, int64)], wp)
  end function totals_of

  !> The state of an engine, written and ready to be read.
  subroutine save_engine(engine, state)
    class(engine_type), intent(inout) :: engine
    type(stream_type), intent(out) :: state

    state = new_stream()
    call engine%pass_state(engine%table, engine%gate%threshold, state)
    state = stream_of(state%word(:state%length))
  end subroutine save_engine

  !> An engine that goes on from a state; step and seed are set already.
  subroutine restore_engine(engine, table, threshold, state)
    class(engine_type), intent(inout) :: engine
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold
    type(stream_type), intent(in) :: state
    type(stream_type) :: stream

    stream = state
    call engine%pass_state(table, [threshold, threshold], stream)
    if (stream%failed()) error stop 'a state was not restored'
  end subroutine restore_engine

  ! ---- The plain way: wall by wall.

  !> Takes over particles; those in a gate that head for the other one are counted.
  subroutine plain_start(plain, table, threshold, particles)
    type(plain_type), intent(out) :: plain
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold(2)
    type(particles_type), intent(in) :: particles
    real(qp) :: speed
    integer :: i

    plain%table = table
    plain%threshold = threshold
    plain%x = real(particles%x, qp)
    plain%y = real(particles%y, qp)
    plain%ux = real(particles%ux, qp)
    plain%uy = real(particles%uy, qp)
    plain%room = [(0, i=1, size(plain%x))]
    plain%counted = plain%room
    do i = 1, size(plain%x)
      speed = sqrt(plain%ux(i)**2 + plain%uy(i)**2)
      plain%ux(i) = plain%ux(i)/speed
      plain%uy(i) = plain%uy(i)/speed
      select case (chamber_at(table, particles%x(i), particles%y(i), 1.0_wp))
      case (in_urn)
        plain%room(i) = merge(in_urn1, in_urn2, side_at(table, particles%x(i)) == 1)
      case (in_gate)
        plain%room(i) = in_channel1
        associate (side => side_at(table, particles%x(i)))
          plain%counted(i) = merge(side, 0, x_direction(side)*plain%ux(i) < 0.0_qp)
        end associate
      case default
        plain%room(i) = in_channel2
      end select
    end do
  end subroutine plain_start

  !> Moves all particles until `until`, and logs what the engine would log.
  subroutine plain_run(plain, until, log)
    type(plain_type), intent(inout) :: plain
    real(wp), intent(in) :: until
    type(log_type), intent(inout) :: log
    real(qp) :: wait, soonest
    integer :: i, next, what, now_what

    call make_room(log, 0)
    do
      soonest = real(until, qp) - plain%now
      next = 0
      now_what = 0
      do i = 1, size(plain%x)
        call next_event(plain, i, wait, what)
        if (wait >= soonest) cycle
        soonest = wait
        next = i
        now_what = what
      end do
      plain%x = plain%x + plain%ux*soonest
      plain%y = plain%y + plain%uy*soonest
      plain%now = plain%now + soonest
      if (next == 0) exit
      call happen(plain, next, now_what, log)
    end do
    log%elapsed = until
    log%collisions = plain%hits
  end subroutine plain_run

  !> When particle i next hits a wall (what = 0) or crosses a line: the chord of channel 1 or 2 (1,
  !> 2), the middle or the periodic line (3).
  pure subroutine next_event(plain, i, wait, what)
    type(plain_type), intent(in) :: plain
    integer, intent(in) :: i
    real(qp), intent(out) :: wait
    integer, intent(out) :: what
    real(qp) :: x, ux, y, uy, across, middle, chord
    integer :: side

    x = plain%x(i)
    y = plain%y(i)
    ux = plain%ux(i)
    uy = plain%uy(i)
    associate (table => plain%table)
      side = merge(1, 2, x < 0.0_qp)
      if (plain%room(i) == in_urn1 .or. plain%room(i) == in_urn2) then
        side = merge(1, 2, plain%room(i) == in_urn1)
        if (side == 2) then
          x = -x
          ux = -ux
        end if
        call next_in_urn(table, side, x + real(table%urn(side)%centre, qp), y, ux, uy, wait, what)
        return
      end if
      if (plain%room(i) == in_channel1) then
        middle = 0.0_qp
        chord = 0.5_qp*real(table%channel(1)%length, qp)
        across = 0.5_qp*real(table%channel(1)%width, qp)
        if (x*ux < 0.0_qp) then
          wait = -x/ux
          what = 3
        else
          wait = (chord - abs(x))/max(abs(ux), tiny(ux))
          what = 1
        end if
      else
        middle = real(table%urn(side)%periodic_line, qp)
        chord = real(table%urn(side)%centre, qp) + real(table%urn(side)%chord(2), qp)
        across = 0.5_qp*real(table%channel(2)%width, qp)
        if (x*ux > 0.0_qp) then
          wait = (middle - abs(x))/max(abs(ux), tiny(ux))
          what = 3
        else
          wait = (abs(x) - chord)/max(abs(ux), tiny(ux))
          what = 2
        end if
      end if
    end associate
    if (abs(uy) > 0.0_qp) then
      across = (across - sign(1.0_qp, uy)*y)/abs(uy)
      if (across < wait) then
        wait = across
        what = 0
      end if
    end if
    if (plain%room(i) == in_channel2) call next_scatterer(plain%table, x, y, ux, uy, wait, what)
  end subroutine next_event

  !> Scatterer k instead, as what = -k, if that is met sooner.
  pure subroutine next_scatterer(table, x, y, ux, uy, wait, what)
    type(table_type), intent(in) :: table
    real(qp), intent(in) :: x, y, ux, uy
    real(qp), intent(inout) :: wait
    integer, intent(inout) :: what
    real(qp) :: dx, dy, b, room
    integer :: k

    do k = 1, size(table%scatterers, 2)
      call from_scatterer(table, k, x, y, dx, dy)
      b = dx*ux + dy*uy
      room = b**2 - (dx**2 + dy**2 - real(table%scatterers(3, k), qp)**2)
      if (b >= 0.0_qp .or. room <= 0.0_qp) cycle
      if (-b - sqrt(room) >= wait) cycle
      wait = -b - sqrt(room)
      what = -k
    end do
  end subroutine next_scatterer

  !> The way from the middle of a scatterer.
  pure subroutine from_scatterer(table, k, x, y, dx, dy)
    type(table_type), intent(in) :: table
    integer, intent(in) :: k
    real(qp), intent(in) :: x, y
    real(qp), intent(out) :: dx, dy

    dx = x - sign(real(table%urn(merge(1, 2, x < 0.0_qp))%periodic_line, qp), x) &
      - real(table%scatterers(1, k), qp)
    dy = y - real(table%scatterers(2, k), qp)
  end subroutine from_scatterer

  !> The same in an urn's own frame, channel 1 at +x.
  pure subroutine next_in_urn(table, side, x, y, ux, uy, wait, what)
    type(table_type), intent(in) :: table
    integer, intent(in) :: side
    real(qp), intent(in) :: x, y, ux, uy
    real(qp), intent(out) :: wait
    integer, intent(out) :: what
    real(qp) :: b, radius, hit_x, hit_y

    radius = real(table%urn(side)%radius, qp)
    b = x*ux + y*uy
    wait = -b + sqrt(max(b**2 + (radius - hypot(x, y))*(radius + hypot(x, y)), 0.0_qp))
    hit_x = x + ux*wait
    hit_y = y + uy*wait
    what = 0
    if (hit_x > 0.0_qp .and. abs(hit_y) < 0.5_qp*real(table%channel(1)%width, qp)) then
      what = 1
      wait = (real(table%urn(side)%chord(1), qp) - x)/ux
    else if (hit_x < 0.0_qp .and. abs(hit_y) < 0.5_qp*real(table%channel(2)%width, qp)) then
      what = 2
      wait = -(real(table%urn(side)%chord(2), qp) + x)/ux
    end if
  end subroutine next_in_urn

  !> Particle i has come to what `next_event` told.
  subroutine happen(plain, i, what, log)
    type(plain_type), intent(inout) :: plain
    integer, intent(in) :: i, what
    type(log_type), intent(inout) :: log
    integer :: gate

    select case (what)
    case (:0)
      call bounce(plain, i, -what)
    case (1, 2)
      gate = merge(1, 2, plain%x(i) < 0.0_qp)
      if (plain%room(i) == in_channel1 .or. plain%room(i) == in_channel2) then
        plain%room(i) = merge(in_urn1, in_urn2, gate == 1)
      else if (what == 2) then
        plain%room(i) = in_channel2
      else
        plain%room(i) = in_channel1
        plain%counted(i) = gate
        call note(log, plain%now, event_entry, gate, i)
        if (count(plain%counted == gate) > plain%threshold(gate)) then
          call note(log, plain%now, event_reversal, gate, count(plain%counted == gate))
          log%reversals = log%reversals + 1
          log%bounce_backs = log%bounce_backs + count(plain%counted == gate)
          where (plain%counted == gate)
            plain%ux = -plain%ux
            plain%counted = 0
          end where
        end if
      end if
    case default
      gate = merge(12, 21, plain%ux(i) > 0.0_qp)
      if (plain%room(i) == in_channel1) then
        plain%counted(i) = 0
        plain%x(i) = 0.0_qp
        call note(log, plain%now, event_crossing1, gate, i)
        if (plain%table%sides == 1) then
          plain%ux(i) = -plain%ux(i)
          plain%hits = plain%hits + 1
        end if
      else
        plain%x(i) = -sign(real(plain%table%urn(merge(2, 1, plain%x(i) < 0.0_qp))%periodic_line, &
          qp), plain%x(i))
        call note(log, plain%now, event_crossing2, 33 - gate, i)
      end if
    end select
  end subroutine happen

  subroutine bounce(plain, i, scatterer)
    type(plain_type), intent(inout) :: plain
    integer, intent(in) :: i
    !> Which, or 0: another wall.
    integer, intent(in) :: scatterer
    real(qp) :: nx, ny, along
    integer :: side

    plain%hits = plain%hits + 1
    if (scatterer > 0) then
      call from_scatterer(plain%table, scatterer, plain%x(i), plain%y(i), nx, ny)
    else if (plain%room(i) == in_channel1 .or. plain%room(i) == in_channel2) then
      plain%uy(i) = -plain%uy(i)
      return
    else
      side = merge(1, 2, plain%room(i) == in_urn1)
      nx = plain%x(i) - x_direction(side)*real(plain%table%urn(side)%centre, qp)
      ny = plain%y(i)
    end if
    along = 2.0_qp*(nx*plain%ux(i) + ny*plain%uy(i))/(nx**2 + ny**2)
    plain%ux(i) = plain%ux(i) - along*nx
    plain%uy(i) = plain%uy(i) - along*ny
  end subroutine bounce

  subroutine note(log, time, kind, where, particle)
    type(log_type), intent(inout) :: log
    real(qp), intent(in) :: time
    integer, intent(in) :: kind, where, particle

    call make_room(log, log%events + 1)
    log%events = log%events + 1
    log%time(log%events) = real(time, wp)
    log%kind(log%events) = kind
    log%where(log%events) = where
    log%particle(log%events) = particle
  end subroutine note

  !> From the point (x, y) of an urn's own frame until a chord is reached or `most` walls are hit or
  !> the way is `longest`: opening (1, -1, 0 if none), place, velocity, length and hits.
  pure subroutine bounce_through(table, x, y, ux, uy, longest, most, opening, length, hits)
    type(table_type), intent(in) :: table
    real(qp), intent(inout) :: x, y, ux, uy
    real(qp), intent(in) :: longest
    integer, intent(in) :: most
    integer, intent(out) :: opening, hits
    real(qp), intent(out) :: length
    real(qp) :: wait, along
    integer :: what

    along = hypot(ux, uy)
    ux = ux/along
    uy = uy/along
    length = 0.0_qp
    hits = 0
    opening = 0
    do
      call next_in_urn(table, 1, x, y, ux, uy, wait, what)
      if (length + wait >= longest) what = 3
      if (what == 3) wait = longest - length
      x = x + wait*ux
      y = y + wait*uy
      length = length + wait
      if (what == 1) opening = 1
      if (what == 2) opening = -1
      if (what > 0) exit
      along = 2.0_qp*(x*ux + y*uy)/(x**2 + y**2)
      ux = ux - along*x
      uy = uy - along*y
      hits = hits + 1
      if (hits >= most) exit
    end do
  end subroutine bounce_through

  !> The way along x, in the frame of an urn, to a channel; 0 for none.
  elemental function facing(channel) result(way)
    integer(int64), intent(in) :: channel
    real(wp) :: way

    way = merge(1.0_wp, merge(-1.0_wp, 0.0_wp, channel == 2), channel == 1)
  end function facing

  !> The channel that lies this way, 1 or -1.
  elemental function channel_of(way) result(channel)
    real(wp), intent(in) :: way
    integer(int64) :: channel

    channel = merge(1_int64, 2_int64, way > 0.0_wp)
  end function channel_of

end module scenes
