!> Lyapunov exponent of the billiard without gates, from its tangent map.
!>
!> A tangent vector is (J, D): the perpendicular distance of a neighbouring path, and the difference
!> of its direction. In a flight of duration t, J increases by t D. A reflection from a straight
!> wall changes the sign of both; one from the inside of a circle of radius r, where c is the cosine
!> of the incidence, replaces J by -J and D by -(D - 2 J/(r c)). The exponent is the growth of
!> log |(J, D)| per unit time. N. Chernov, R. Markarian, "Chaotic billiards", AMS 2006, chapter 3.
module battery_probe_lyapunov
  use battery_kinds, only: wp, dp, int64
  use battery_text, only: to_text
  use battery_table, only: table_type
  use battery_motion, only: motion_type, move_straight, meets_channel_wall, meets_nothing
  use battery_wall_motion, only: find_first_wall, hit_wall, pass_line, motion_at
  use battery_engine, only: particles_type
  use battery_error, only: error_type
  use battery_initial_state, only: random_particles
  use battery_probe, only: argument, real_argument, integer_argument, precision_name, paper_table, &
    print_json_line, stop_with_message, read_particles
  implicit none (type, external)
  private
  public :: lyapunov_main, tangent_type, advance_tangent, reflect_tangent

  !> Tangent vector (J, D) = (`offset`, `deflection`), normalised at each reflection, and the
  !> logarithm of its growth until then.
  type :: tangent_type
    real(wp) :: offset = 1.0_wp, deflection = 0.0_wp
    real(wp) :: log_growth = 0.0_wp
  end type tangent_type

contains

  !> `lyapunov WIDTH1 WIDTH2 NUMBER TIME [FILE]`: prints the mean exponent of NUMBER paths of
  !> duration TIME, its standard error, and the mean over the second half of the time. Initial
  !> states are random in the urns, or from FILE.
  subroutine lyapunov_main()
    type(table_type) :: table
    type(motion_type) :: flight
    type(particles_type) :: particles
    type(error_type), allocatable :: error
    real(wp) :: duration, rate, sums(2), late_rate
    integer :: number, i

    table = paper_table(real_argument(2), real_argument(3))
    number = int(integer_argument(4))
    duration = real_argument(5)
    sums = 0.0_wp
    late_rate = 0.0_wp
    if (argument(6) /= '') then
      call read_particles(argument(6), table, number, particles, error)
    else
      call random_particles(table, number, number/2, 1_int64, particles, error)
    end if
    if (allocated(error)) call stop_with_message(error%message)
    do i = 1, number
      flight = motion_at(table, particles%x(i), particles%y(i), &
        particles%ux(i), particles%uy(i))
      call follow_path(table, flight, duration, rate, late_rate)
      sums = sums + [rate, rate**2]
    end do
    sums = sums/number
    call print_json_line('{"precision": "'//precision_name()//'", "number": '//to_text(number) &
      //', "time": '//to_text(real(duration, dp))//', "lyapunov": '//to_text(real(sums(1), dp)) &
      //', "error": '//to_text(real(sqrt((sums(2) - sums(1)**2)/max(number - 1, 1)), dp)) &
      //', "second_half": '//to_text(real(late_rate/number, dp))//'}')
  end subroutine lyapunov_main

  !> Follows one path, and measures its growth rate.
  subroutine follow_path(table, flight, duration, rate, late_rate)
    type(table_type), intent(in) :: table
    type(motion_type), intent(inout) :: flight
    real(wp), intent(in) :: duration
    !> Growth rate, per unit time.
    real(wp), intent(out) :: rate
    !> The growth rate in the second half of the time is added to this sum.
    real(wp), intent(inout) :: late_rate
    type(tangent_type) :: tangent
    real(wp) :: wait, time, first_half_growth, first_half_time

    call find_first_wall(table, flight, wait)
    time = 0.0_wp
    first_half_growth = 0.0_wp
    first_half_time = 0.0_wp
    do while (time < duration)
      if (flight%next == meets_nothing) exit
      call move_straight(flight, wait)
      call advance_tangent(tangent, wait)
      time = time + wait
      call process_event(table, flight, tangent, wait)
      if (time < 0.5_wp*duration) then
        first_half_growth = tangent%log_growth
        first_half_time = time
      end if
    end do
    rate = tangent%log_growth/time
    late_rate = late_rate + (tangent%log_growth - first_half_growth)/(time - first_half_time)
  end subroutine follow_path

  !> Processes the next event of a particle, a wall hit or the crossing of a line, and its tangent
  !> vector.
  subroutine process_event(table, flight, tangent, wait)
    type(table_type), intent(in) :: table
    type(motion_type), intent(inout) :: flight
    type(tangent_type), intent(inout) :: tangent
    !> Time until the event after it.
    real(wp), intent(out) :: wait

    associate (urn => table%urn(flight%urn))
      if (flight%next < meets_channel_wall) then
        call pass_line(table, flight, wait)
      else
        if (flight%next == meets_channel_wall) then
          call reflect_tangent(tangent)
        else
          call reflect_tangent(tangent, abs((urn%centre &
            + urn%axis_sign*flight%x)*urn%axis_sign*flight%ux + flight%y*flight%uy))
        end if
        call hit_wall(table, flight, wait)
      end if
    end associate
  end subroutine process_event

  !> Advances the tangent vector over a straight flight of this time.
  pure subroutine advance_tangent(tangent, time)
    type(tangent_type), intent(inout) :: tangent
    real(wp), intent(in) :: time

    tangent%offset = tangent%offset + time*tangent%deflection
  end subroutine advance_tangent

  !> Applies a reflection to the tangent vector, and normalises it.
  pure subroutine reflect_tangent(tangent, depth)
    type(tangent_type), intent(inout) :: tangent
    !> At the inside of a circle: r c. Absent at a straight wall.
    real(wp), intent(in), optional :: depth
    real(wp) :: length

    if (present(depth)) tangent%deflection = tangent%deflection - 2.0_wp*tangent%offset/depth
    tangent%offset = -tangent%offset
    tangent%deflection = -tangent%deflection
    length = hypot(tangent%offset, tangent%deflection)
    tangent%log_growth = tangent%log_growth + log(length)
    tangent%offset = tangent%offset/length
    tangent%deflection = tangent%deflection/length
  end subroutine reflect_tangent

end module battery_probe_lyapunov
