!> Probe of numerical stability: cases in which event-driven methods tend to fail, for one engine.
!> It prints a line for each case.
!>
!> `value` is a number specific to the case; `stability.py` documents its meaning
!> and its reference. The other numbers are the same for all cases: how the run ended (`done`, or
!> `stopped` by the time limit), the time `reached`, the number of particles outside the table or
!> not a number, the greatest | |u| - 1 |, and the numbers of trapped particles and of wall hits.
module battery_probe_stability
  use battery_kinds, only: wp, dp, int64
  use battery_table, only: table_type
  use battery_event_record, only: event_record_type, event_entry
  use battery_engine, only: particles_type
  use battery_clocks, only: wall_seconds
  use battery_probe, only: argument, real_argument, integer_argument, paper_table, start_engine
  use battery_probe_case, only: case_type, run_case, print_case, crossings, one_particle_at, &
    first_event_time, random_in_urns, engine_name, step, time_limit
  implicit none (type, external)
  private
  public :: stability_main

contains

  !> `stability ENGINE COLLISIONS SECONDS`: runs all cases. SECONDS is the time limit of each case
  !> but the long run, which ends after COLLISIONS wall hits.
  subroutine stability_main()
    engine_name = argument(2)
    time_limit = real(real_argument(4), dp)
    call probe_whispering()
    call probe_corners()
    call probe_along_the_axis()
    call probe_across_a_channel()
    call probe_diameter()
    call probe_ties()
    call probe_extremes()
    call probe_late_clock()
    call probe_long_run(integer_argument(3))
  end subroutine stability_main

  !> A particle starts at the top of urn 2 towards channel 1, at a small angle to the wall. `value`:
  !> time of its entry into the gate.
  subroutine probe_whispering()
    type(case_type) :: one
    type(table_type) :: table
    real(wp) :: centre
    real(wp) :: angle
    integer :: k

    if (engine_name == 'reservoir') return
    table = paper_table(0.3_wp, 0.01_wp)
    centre = table%urn(1)%centre
    do k = 3, 12
      angle = 10.0_wp**(-k)
      call run_case(one, 'whispering', angle, table, 10, one_particle_at(centre, 1.0_wp, &
        -cos(angle), -sin(angle)), 3.0_wp, 0.5_wp/angle)
      call print_case(one, first_event_time(one))
    end do
  end subroutine probe_whispering

  !> A particle starts inside urn 2 towards the corner of gate 2, or towards a point 2**-k above or
  !> below it. `value`: number of starts for which it passes the corner on the wrong side; greatest
  !> distance of the point from the corner among these. A particle that starts exactly towards the
  !> corner may pass it on either side, but must not be lost.
  subroutine probe_corners()
    type(case_type) :: one
    type(table_type) :: table
    real(wp) :: corner(2), start(2), offset, worst
    integer :: k, shot, direction, wrong
    logical :: entered

    if (engine_name == 'reservoir') return
    table = paper_table(0.3_wp, 0.01_wp)
    corner = [0.5_wp, 0.5_wp*table%channel(1)%width]
    wrong = 0
    worst = 0.0_wp
    do shot = 1, 10
      start = [1.0_wp + 0.05_wp*shot, 0.6_wp - 0.1_wp*shot]
      do k = 4, 60
        offset = 0.5_wp**k
        if (k == 60) offset = 0.0_wp
        do direction = -1, 1, 2
          call run_case(one, 'corner', offset, table, 10, one_particle_at(start(1), start(2), &
            corner(1) - start(1), corner(2) + direction*offset - start(2)), 1.5_wp, 10.0_wp)
          entered = any(one%log%kind(:min(1, size(one%log%kind))) == event_entry)
          if (k < 60 .and. (entered .neqv. direction < 0)) then
            wrong = wrong + 1
            worst = max(worst, offset)
          end if
          if (k == 60 .and. shot == 10 .and. direction == 1) then
            one%name = 'corner exactly'
            call print_case(one, merge(1.0_wp, 0.0_wp, entered))
          end if
        end do
      end do
    end do
    one%name = 'corner shots on the wrong side'
    call print_case(one, real(wrong, wp))
    one%name = 'corner farthest wrong shot'
    call print_case(one, worst)
  end subroutine probe_corners

  !> A particle moves nearly along the axis, through both channels in turn. `value`: its height
  !> after 100 time units.
  subroutine probe_along_the_axis()
    type(case_type) :: one
    type(table_type) :: table
    real(wp) :: centre
    real(wp) :: slope
    integer :: k

    if (engine_name == 'reservoir') return
    table = paper_table(0.3_wp, 0.01_wp)
    centre = table%urn(1)%centre
    do k = 3, 16
      slope = 10.0_wp**(-k)
      if (k == 16) slope = 0.0_wp
      call run_case(one, 'along the axis', slope, table, 10, one_particle_at(centre, 0.0_wp, &
        1.0_wp, slope), 100.0_wp, 10.0_wp)
      call print_case(one, one%particles%y(1))
    end do
  end subroutine probe_along_the_axis

  !> A particle moves across channel 1, with a small velocity towards the middle line. `value`:
  !> relative error of the time of its crossing.
  subroutine probe_across_a_channel()
    type(case_type) :: one
    type(table_type) :: table
    real(wp) :: drift, exact
    integer :: k

    table = paper_table(0.3_wp, 0.01_wp)
    do k = 3, 16
      drift = 10.0_wp**(-k)
      if (k == 16) drift = 0.0_wp
      exact = 100.0_wp
      if (drift > 0.0_wp) exact = 0.25_wp*sqrt(1.0_wp + drift**2)/drift
      call run_case(one, 'across a channel', drift, table, 10, one_particle_at(-0.25_wp, 0.0_wp, &
        drift, 1.0_wp), 1.001_wp*exact, 4.0_wp)
      call print_case(one, first_event_time(one)/exact - 1.0_wp)
    end do
  end subroutine probe_across_a_channel

  !> A particle moves on a diameter of urn 2 that meets no opening. `value`: its distance from the
  !> diameter at time 2000.
  subroutine probe_diameter()
    type(case_type) :: one
    type(table_type) :: table
    real(wp) :: centre

    if (engine_name == 'reservoir') return
    table = paper_table(0.3_wp, 0.01_wp)
    centre = table%urn(1)%centre
    call run_case(one, 'upright diameter', 0.0_wp, table, 10, one_particle_at(centre, 0.0_wp, &
      0.0_wp, 1.0_wp), 2000.0_wp, 10.0_wp)
    call print_case(one, abs(one%particles%x(1) - centre))
    call run_case(one, 'slanted diameter', 1.0_wp, table, 10, one_particle_at(centre, 0.0_wp, &
      0.6_wp, 0.8_wp), 2000.0_wp, 10.0_wp)
    call print_case(one, abs(0.8_wp*(one%particles%x(1) - centre) - 0.6_wp*one%particles%y(1)))
  end subroutine probe_diameter

  !> Four particles enter gate 2 at exactly the same time; T = 0, 1, 2 and 3. `value`: number of the
  !> 24 orders in memory for which the motion of any particle differs from that in the first order.
  subroutine probe_ties()
    type(case_type) :: one, first
    type(table_type) :: table
    type(particles_type) :: particles
    real(wp), parameter :: heights(4) = [0.125_wp, -0.125_wp, 0.0625_wp, 0.0_wp]
    integer :: order(4), first_order(4), threshold, code, differing
    logical :: is_first

    if (engine_name == 'reservoir') return
    table = paper_table(0.3_wp, 0.01_wp)
    do threshold = 0, 3
      differing = 0
      is_first = .true.
      do code = 0, 255
        order = 1 + modulo(code/[1, 4, 16, 64], 4)
        if (any([count(order == 1), count(order == 2), count(order == 3)] /= 1)) cycle
        if (count(order == 4) /= 1) cycle
        particles = particles_type(spread(1.0_wp, 1, 4), heights(order), spread(-1.0_wp, 1, 4), &
          spread(0.0_wp, 1, 4))
        call run_case(one, 'ties', real(threshold, wp), table, threshold, particles, 1.75_wp, &
          10.0_wp)
        if (is_first) then
          first = one
          first_order = order
        end if
        is_first = .false.
        if (.not. same_motion(one, order, first, first_order)) differing = differing + 1
      end do
      call print_case(one, real(differing, wp))
    end do
  end subroutine probe_ties

  !> Whether each particle has, in both orders, entries at the same times and the same final
  !> position.
  pure function same_motion(one, order, other, other_order) result(same)
    type(case_type), intent(in) :: one, other
    integer, intent(in) :: order(4), other_order(4)
    logical :: same
    integer :: particle, i, j

    same = size(one%log%time) == size(other%log%time)
    do particle = 1, 4
      if (.not. same) return
      i = findloc(order, particle, 1)
      j = findloc(other_order, particle, 1)
      associate (mine => one%log, theirs => other%log)
        associate (entries => mine%particle == i .and. mine%kind == event_entry, &
          other_entries => theirs%particle == j .and. theirs%kind == event_entry)
          same = count(entries) == count(other_entries)
          if (same) same = all(abs(pack(mine%time, entries) - pack(theirs%time, other_entries)) &
            <= 0.0_wp)
        end associate
      end associate
      same = same .and. abs(one%particles%x(i) - other%particles%x(j)) <= 0.0_wp &
        .and. abs(one%particles%y(i) - other%particles%y(j)) <= 0.0_wp
    end do
  end function same_motion

  !> Random initial states, with parameters at the limits of what is allowed.
  subroutine probe_extremes()
    call probe_extreme('N = 1', 1, 7, 0.3_wp, 0.01_wp)
    call probe_extreme('T = 0', 100, 0, 0.3_wp, 0.01_wp)
    call probe_extreme('w'' = 0', 100, 3, 0.3_wp, 0.0_wp)
    call probe_extreme('w near 2r', 100, 3, nearest(2.0_wp, -1.0_wp), 0.01_wp)
    call probe_extreme('w and w'' near 2r', 100, 3, 1.9999_wp, 1.9999_wp)
    call probe_extreme('openings of 1e-9', 100, 3, 1.0e-9_wp, 1.0e-9_wp)
  end subroutine probe_extremes

  !> Runs one of these. `value`: change of the number of particles in half 1 plus the net number of
  !> crossings from half 1 to half 2.
  subroutine probe_extreme(name, number, threshold, width1, width2)
    character(len=*), intent(in) :: name
    integer, intent(in) :: number, threshold
    real(wp), intent(in) :: width1, width2
    type(case_type) :: one
    type(table_type) :: table
    type(particles_type) :: particles
    integer :: first

    table = paper_table(width1, width2)
    particles = random_in_urns(table, number)
    first = count(particles%x < 0.0_wp)
    call run_case(one, name, 0.0_wp, table, threshold, particles, 300.0_wp, 2.0_wp*number)
    call print_case(one, real(count(one%particles%x < 0.0_wp) - first + int(one%crossings(1) &
      - one%crossings(2)), wp))
  end subroutine probe_extreme

  !> The same run starts at time 0 and at time 1e12. `value`: greatest difference of the times of
  !> events since the start; -1 if the numbers of events differ.
  subroutine probe_late_clock()
    type(case_type) :: early, late
    type(table_type) :: table
    type(particles_type) :: particles
    real(wp) :: difference

    table = paper_table(0.3_wp, 0.01_wp)
    particles = random_in_urns(table, 50)
    ! The comparison needs both runs to their end, so the time limit is longer.
    time_limit = 60.0_dp*time_limit
    call run_case(early, 'clock at 1e12', 0.0_wp, table, 3, particles, 50.0_wp, 100.0_wp)
    call run_case(late, 'clock at 1e12', 1.0e12_wp, table, 3, particles, 50.0_wp, 100.0_wp, &
      1.0e12_wp)
    difference = -1.0_wp
    if (size(early%log%time) == size(late%log%time)) &
      difference = maxval(abs(early%log%time - late%log%time))
    call print_case(late, difference)
    time_limit = time_limit/60.0_dp
  end subroutine probe_late_clock

  !> One long run, N = 1000, T = 7. `value`: greatest final distance of a particle beyond a wall; in
  !> a second line, as in `probe_extreme`.
  subroutine probe_long_run(collisions)
    integer(int64), intent(in) :: collisions
    type(case_type) :: one
    type(table_type) :: table
    type(particles_type) :: particles
    type(event_record_type) :: event_record
    integer(int64) :: collisions_so_far
    real(dp) :: began
    integer :: first

    table = paper_table(0.3_wp, 0.01_wp)
    particles = random_in_urns(table, 1000)
    first = count(particles%x < 0.0_wp)
    one%name = 'long run'
    one%parameter = real(collisions, wp)
    one%table = table
    one%number = 1000
    call start_engine(engine_name, table, 7, particles, step, one%engine)
    collisions_so_far = 0
    began = wall_seconds()
    do while (collisions_so_far < collisions)
      call one%engine%advance(huge(1.0_wp), event_record)
      collisions_so_far = collisions_so_far + event_record%collisions
      one%reached = one%reached + event_record%duration
      one%crossings = one%crossings + [crossings(event_record, 1), crossings(event_record, 0)]
    end do
    one%seconds = wall_seconds() - began
    call one%engine%get_particles(1, 1000, one%particles)
    call print_case(one, farthest_beyond_walls(table, one%particles))
    one%name = 'long run, count of half 1'
    call print_case(one, real(count(one%particles%x < 0.0_wp) - first + int(one%crossings(1) &
      - one%crossings(2)), wp))
  end subroutine probe_long_run

  !> Greatest distance of a particle beyond the walls of its chamber; 0 if there is none.
  pure function farthest_beyond_walls(table, particles) result(distance)
    type(table_type), intent(in) :: table
    type(particles_type), intent(in) :: particles
    real(wp) :: distance
    real(wp) :: qx
    integer :: i

    distance = 0.0_wp
    do i = 1, size(particles%x)
      qx = abs(particles%x(i)) - table%urn(1)%centre
      if (qx <= -table%urn(1)%chord(1)) then
        distance = max(distance, abs(particles%y(i)) - 0.5_wp*table%channel(1)%width)
      else if (qx >= table%urn(1)%chord(2)) then
        distance = max(distance, abs(particles%y(i)) - 0.5_wp*table%channel(2)%width)
      else
        distance = max(distance, hypot(qx, particles%y(i)) - table%urn(1)%radius)
      end if
    end do
  end function farthest_beyond_walls

end module battery_probe_stability
