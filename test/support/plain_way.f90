!> The plain way to move particles, wall by wall, in more digits than the program has.
module plain_way
  use battery_kinds, only: wp, dp, int64
  use battery_table, only: table_type, chamber_at, urn_at, in_urn, in_gate, x_direction
  use battery_engine, only: particles_type
  use battery_event_record, only: event_entry, event_reversal, event_crossing1, event_crossing2
  use engine_runs, only: log_type, make_room, note
  implicit none (type, external)
  private
  public :: qp, plain_type, plain_start, plain_run, bounce_through

  !> Kind of the reference computations: 33 digits, or those of `dp` where a compiler has no more.
  !> (Flang 22 has reals of 80 bits on x86, but Debian's has no library of their functions.)
  integer, parameter :: qp = merge(selected_real_kind(30), dp, selected_real_kind(30) > 0)

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

contains

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
        plain%room(i) = merge(in_urn1, in_urn2, urn_at(table, particles%x(i)) == 1)
      case (in_gate)
        plain%room(i) = in_channel1
        associate (side => urn_at(table, particles%x(i)))
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
        call note(log, real(plain%now, wp), event_entry, gate, i)
        if (count(plain%counted == gate) > plain%threshold(gate)) then
          call note(log, real(plain%now, wp), event_reversal, gate, count(plain%counted == gate))
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
        call note(log, real(plain%now, wp), event_crossing1, gate, i)
        if (plain%table%urn_count == 1) then
          plain%ux(i) = -plain%ux(i)
          plain%hits = plain%hits + 1
        end if
      else
        plain%x(i) = -sign(real(plain%table%urn(merge(2, 1, plain%x(i) < 0.0_qp))%periodic_line, &
          qp), plain%x(i))
        call note(log, real(plain%now, wp), event_crossing2, 33 - gate, i)
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

end module plain_way
