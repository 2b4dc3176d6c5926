!> Reference simulation of the billiard: all particles are moved from wall hit to wall hit, with
!> more digits than the program has. Urns are discs. It shares only the table with the program.
module reference_billiard
  use battery_kinds, only: wp, dp, int64
  use battery_table, only: table_type, chamber_at, urn_at, in_urn, in_gate, x_direction
  use battery_engine, only: particles_type
  use battery_event_record, only: event_entry, event_reversal, event_crossing1, event_crossing2
  use engine_runs, only: log_type, extend_log, append_event
  implicit none (type, external)
  private
  public :: qp, billiard_type, start_billiard, run_billiard, bounce_through

  !> Kind of the reference computations: 33 digits, or those of `dp` where a compiler has no more.
  !> (Flang 22 has reals of 80 bits on x86, but Debian's has no library of their functions.)
  integer, parameter :: qp = merge(selected_real_kind(30), dp, selected_real_kind(30) > 0)

  !> Regions of the circuit: the urns and the channels.
  integer, parameter :: in_urn1 = 1, in_urn2 = 2, in_channel1 = 3, in_channel2 = 4

  !> All particles of a circuit, with the region in which each of them is.
  type :: billiard_type
    type(table_type) :: table
    integer :: threshold(2) = 0
    real(qp) :: now = 0.0_qp
    integer(int64) :: hits = 0
    real(qp), allocatable :: x(:), y(:), ux(:), uy(:)
    integer, allocatable :: region(:)
    !> Gate that counts the particle, 0 for none.
    integer, allocatable :: counted(:)
  end type billiard_type

contains

  !> Loads particles, with their velocities normalised to speed 1. Those inside a gate that move
  !> towards the other gate are counted.
  subroutine start_billiard(billiard, table, threshold, particles)
    type(billiard_type), intent(out) :: billiard
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold(2)
    type(particles_type), intent(in) :: particles
    real(qp) :: speed
    integer :: i

    billiard%table = table
    billiard%threshold = threshold
    billiard%x = real(particles%x, qp)
    billiard%y = real(particles%y, qp)
    billiard%ux = real(particles%ux, qp)
    billiard%uy = real(particles%uy, qp)
    billiard%region = [(0, i=1, size(billiard%x))]
    billiard%counted = billiard%region
    do i = 1, size(billiard%x)
      speed = sqrt(billiard%ux(i)**2 + billiard%uy(i)**2)
      billiard%ux(i) = billiard%ux(i)/speed
      billiard%uy(i) = billiard%uy(i)/speed
      select case (chamber_at(table, particles%x(i), particles%y(i), 1.0_wp))
      case (in_urn)
        billiard%region(i) = merge(in_urn1, in_urn2, urn_at(table, particles%x(i)) == 1)
      case (in_gate)
        billiard%region(i) = in_channel1
        associate (urn => urn_at(table, particles%x(i)))
          billiard%counted(i) = merge(urn, 0, x_direction(urn)*billiard%ux(i) < 0.0_qp)
        end associate
      case default
        billiard%region(i) = in_channel2
      end select
    end do
  end subroutine start_billiard

  !> Advances all particles to the time `until`, and logs the events that an engine logs.
  subroutine run_billiard(billiard, until, log)
    type(billiard_type), intent(inout) :: billiard
    real(wp), intent(in) :: until
    type(log_type), intent(inout) :: log
    real(qp) :: delay, soonest
    integer :: i, next, event, first_event

    call extend_log(log, 0)
    do
      soonest = real(until, qp) - billiard%now
      next = 0
      first_event = 0
      do i = 1, size(billiard%x)
        call next_event(billiard, i, delay, event)
        if (delay >= soonest) cycle
        soonest = delay
        next = i
        first_event = event
      end do
      billiard%x = billiard%x + billiard%ux*soonest
      billiard%y = billiard%y + billiard%uy*soonest
      billiard%now = billiard%now + soonest
      if (next == 0) exit
      call process_event(billiard, next, first_event, log)
    end do
    log%elapsed = until
    log%collisions = billiard%hits
  end subroutine run_billiard

  !> Next event of particle i and the time until then: a wall hit (event = 0), the crossing of the
  !> chord of channel 1 or 2 (1, 2), or of the middle or the periodic line (3).
  pure subroutine next_event(billiard, i, delay, event)
    type(billiard_type), intent(in) :: billiard
    integer, intent(in) :: i
    real(qp), intent(out) :: delay
    integer, intent(out) :: event
    real(qp) :: x, ux, y, uy, across, middle, chord
    integer :: urn

    x = billiard%x(i)
    y = billiard%y(i)
    ux = billiard%ux(i)
    uy = billiard%uy(i)
    associate (table => billiard%table)
      urn = merge(1, 2, x < 0.0_qp)
      if (billiard%region(i) == in_urn1 .or. billiard%region(i) == in_urn2) then
        urn = merge(1, 2, billiard%region(i) == in_urn1)
        if (urn == 2) then
          x = -x
          ux = -ux
        end if
        call next_in_urn(table, urn, x + real(table%urn(urn)%centre, qp), y, ux, uy, delay, event)
        return
      end if
      if (billiard%region(i) == in_channel1) then
        middle = 0.0_qp
        chord = 0.5_qp*real(table%channel(1)%length, qp)
        across = 0.5_qp*real(table%channel(1)%width, qp)
        if (x*ux < 0.0_qp) then
          delay = -x/ux
          event = 3
        else
          delay = (chord - abs(x))/max(abs(ux), tiny(ux))
          event = 1
        end if
      else
        middle = real(table%urn(urn)%periodic_line, qp)
        chord = real(table%urn(urn)%centre, qp) + real(table%urn(urn)%chord(2), qp)
        across = 0.5_qp*real(table%channel(2)%width, qp)
        if (x*ux > 0.0_qp) then
          delay = (middle - abs(x))/max(abs(ux), tiny(ux))
          event = 3
        else
          delay = (abs(x) - chord)/max(abs(ux), tiny(ux))
          event = 2
        end if
      end if
    end associate
    if (abs(uy) > 0.0_qp) then
      across = (across - sign(1.0_qp, uy)*y)/abs(uy)
      if (across < delay) then
        delay = across
        event = 0
      end if
    end if
    if (billiard%region(i) == in_channel2) then
      call next_scatterer(billiard%table, x, y, ux, uy, delay, event)
    end if
  end subroutine next_event

  !> Replaces the event by the hit of scatterer k, event = -k, if that comes sooner.
  pure subroutine next_scatterer(table, x, y, ux, uy, delay, event)
    type(table_type), intent(in) :: table
    real(qp), intent(in) :: x, y, ux, uy
    real(qp), intent(inout) :: delay
    integer, intent(inout) :: event
    real(qp) :: dx, dy, b, discriminant
    integer :: k

    do k = 1, size(table%scatterers, 2)
      call from_scatterer(table, k, x, y, dx, dy)
      b = dx*ux + dy*uy
      discriminant = b**2 - (dx**2 + dy**2 - real(table%scatterers(3, k), qp)**2)
      if (b >= 0.0_qp .or. discriminant <= 0.0_qp) cycle
      if (-b - sqrt(discriminant) >= delay) cycle
      delay = -b - sqrt(discriminant)
      event = -k
    end do
  end subroutine next_scatterer

  !> Vector from the centre of a scatterer to the point (x, y).
  pure subroutine from_scatterer(table, k, x, y, dx, dy)
    type(table_type), intent(in) :: table
    integer, intent(in) :: k
    real(qp), intent(in) :: x, y
    real(qp), intent(out) :: dx, dy

    dx = x - sign(real(table%urn(merge(1, 2, x < 0.0_qp))%periodic_line, qp), x) &
      - real(table%scatterers(1, k), qp)
    dy = y - real(table%scatterers(2, k), qp)
  end subroutine from_scatterer

  !> Next event inside an urn, in the urn's own frame with channel 1 at +x.
  pure subroutine next_in_urn(table, urn, x, y, ux, uy, delay, event)
    type(table_type), intent(in) :: table
    integer, intent(in) :: urn
    real(qp), intent(in) :: x, y, ux, uy
    real(qp), intent(out) :: delay
    integer, intent(out) :: event
    real(qp) :: b, radius, hit_x, hit_y

    radius = real(table%urn(urn)%radius, qp)
    b = x*ux + y*uy
    delay = -b + sqrt(max(b**2 + (radius - hypot(x, y))*(radius + hypot(x, y)), 0.0_qp))
    hit_x = x + ux*delay
    hit_y = y + uy*delay
    event = 0
    if (hit_x > 0.0_qp .and. abs(hit_y) < 0.5_qp*real(table%channel(1)%width, qp)) then
      event = 1
      delay = (real(table%urn(urn)%chord(1), qp) - x)/ux
    else if (hit_x < 0.0_qp .and. abs(hit_y) < 0.5_qp*real(table%channel(2)%width, qp)) then
      event = 2
      delay = -(real(table%urn(urn)%chord(2), qp) + x)/ux
    end if
  end subroutine next_in_urn

  !> Changes the state of particle i, and of its gate, at the event that `next_event` has found.
  subroutine process_event(billiard, i, event, log)
    type(billiard_type), intent(inout) :: billiard
    integer, intent(in) :: i, event
    type(log_type), intent(inout) :: log
    integer :: gate

    select case (event)
    case (:0)
      call bounce(billiard, i, -event)
    case (1, 2)
      gate = merge(1, 2, billiard%x(i) < 0.0_qp)
      if (billiard%region(i) == in_channel1 .or. billiard%region(i) == in_channel2) then
        billiard%region(i) = merge(in_urn1, in_urn2, gate == 1)
      else if (event == 2) then
        billiard%region(i) = in_channel2
      else
        billiard%region(i) = in_channel1
        billiard%counted(i) = gate
        call append_event(log, real(billiard%now, wp), event_entry, gate, i)
        if (count(billiard%counted == gate) > billiard%threshold(gate)) then
          call append_event(log, real(billiard%now, wp), event_reversal, gate, &
            count(billiard%counted == gate))
          log%reversals = log%reversals + 1
          log%bounce_backs = log%bounce_backs + count(billiard%counted == gate)
          where (billiard%counted == gate)
            billiard%ux = -billiard%ux
            billiard%counted = 0
          end where
        end if
      end if
    case default
      gate = merge(12, 21, billiard%ux(i) > 0.0_qp)
      if (billiard%region(i) == in_channel1) then
        billiard%counted(i) = 0
        billiard%x(i) = 0.0_qp
        call append_event(log, real(billiard%now, wp), event_crossing1, gate, i)
        if (billiard%table%urn_count == 1) then
          billiard%ux(i) = -billiard%ux(i)
          billiard%hits = billiard%hits + 1
        end if
      else
        billiard%x(i) = -sign(real(billiard%table%urn(merge(2, 1, billiard%x(i) < 0.0_qp)) &
          %periodic_line, qp), billiard%x(i))
        call append_event(log, real(billiard%now, wp), event_crossing2, 33 - gate, i)
      end if
    end select
  end subroutine process_event

  !> Reflects particle i at a wall.
  subroutine bounce(billiard, i, scatterer)
    type(billiard_type), intent(inout) :: billiard
    integer, intent(in) :: i
    !> Index of the scatterer that is hit; 0: another wall.
    integer, intent(in) :: scatterer
    real(qp) :: nx, ny, along
    integer :: urn

    billiard%hits = billiard%hits + 1
    if (scatterer > 0) then
      call from_scatterer(billiard%table, scatterer, billiard%x(i), billiard%y(i), nx, ny)
    else if (billiard%region(i) == in_channel1 .or. billiard%region(i) == in_channel2) then
      billiard%uy(i) = -billiard%uy(i)
      return
    else
      urn = merge(1, 2, billiard%region(i) == in_urn1)
      nx = billiard%x(i) - x_direction(urn)*real(billiard%table%urn(urn)%centre, qp)
      ny = billiard%y(i)
    end if
    along = 2.0_qp*(nx*billiard%ux(i) + ny*billiard%uy(i))/(nx**2 + ny**2)
    billiard%ux(i) = billiard%ux(i) - along*nx
    billiard%uy(i) = billiard%uy(i) - along*ny
  end subroutine bounce

  !> Follows a particle from the point (x, y) of an urn's own frame until it reaches a chord, has
  !> hit `most` walls, or its path has the length `longest`. Returns the opening (1 or -1, 0 if
  !> none), position, velocity, length of the path and number of hits.
  pure subroutine bounce_through(table, x, y, ux, uy, longest, most, opening, length, hits)
    type(table_type), intent(in) :: table
    real(qp), intent(inout) :: x, y, ux, uy
    real(qp), intent(in) :: longest
    integer, intent(in) :: most
    integer, intent(out) :: opening, hits
    real(qp), intent(out) :: length
    real(qp) :: delay, along
    integer :: event

    along = hypot(ux, uy)
    ux = ux/along
    uy = uy/along
    length = 0.0_qp
    hits = 0
    opening = 0
    do
      call next_in_urn(table, 1, x, y, ux, uy, delay, event)
      if (length + delay >= longest) event = 3
      if (event == 3) delay = longest - length
      x = x + delay*ux
      y = y + delay*uy
      length = length + delay
      if (event == 1) opening = 1
      if (event == 2) opening = -1
      if (event > 0) exit
      along = 2.0_qp*(x*ux + y*uy)/(x**2 + y**2)
      ux = ux - along*x
      uy = uy - along*y
      hits = hits + 1
      if (hits >= most) exit
    end do
  end subroutine bounce_through

end module reference_billiard
