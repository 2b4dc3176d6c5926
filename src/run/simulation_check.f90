!> Whether a simulation has ended as every one must.
submodule (battery_simulation) battery_simulation_check
  use battery_table, only: chamber_at, outside, half_length
  implicit none (type, external)

contains

  module procedure verify_simulation
    integer, parameter :: chunk = 65536
    real(wp), parameter :: share = 1.0e4_wp*epsilon(1.0_wp)
    type(particles_type) :: particles
    real(wp) :: sharp, ends
    integer :: first, last, i, lost, off_speed, urn1_number, on_line
    character(len=200) :: text

    if (simulation%out_of_room) then
      call fatal_error(error, 'no memory for the series and the event log: given up after ' &
        //to_text(simulation%observer%entries)//' entries and '//to_text(simulation%events%count) &
        //' events; a longer &output series_interval, no event_log or a shorter run takes less')
      return
    end if
    ends = half_length(simulation%setup%table)
    sharp = share*ends
    if (simulation%done .and. .not. simulation%observer%time + simulation%observer%block_time &
      > 0.0_wp) then
      call fatal_error(error, 'nothing is left for the averages: the transient of ' &
        //to_text(simulation%setup%transient_collisions)//' wall collisions ended with the run, ' &
        //'after '//to_text(simulation%collisions)//'; more &run collisions are needed')
      return
    end if
    lost = 0
    off_speed = 0
    urn1_number = 0
    on_line = 0
    do first = 1, simulation%engine%number, chunk
      last = min(first + chunk - 1, simulation%engine%number)
      call simulation%engine%particles(first, last, particles)
      do i = 1, last - first + 1
        if (chamber_at(simulation%setup%table, particles%x(i), particles%y(i), sharp) == outside) &
          lost = lost + 1
        if (.not. abs(hypot(particles%ux(i), particles%uy(i)) - 1.0_wp) <= share) &
          off_speed = off_speed + 1
        if (min(abs(particles%x(i)), ends - abs(particles%x(i))) <= sharp) then
          on_line = on_line + 1
        else if (particles%x(i) < 0.0_wp) then
          urn1_number = urn1_number + 1
        end if
      end do
    end do
    if (simulation%observer%two_halves) then
      ! Of those on a line as many as it takes.
      urn1_number = max(urn1_number, min(urn1_number + on_line, simulation%observer%urn1_number))
    else
      urn1_number = simulation%observer%urn1_number
    end if
    if (lost == 0 .and. off_speed == 0 .and. urn1_number == simulation%observer%urn1_number) return
    write (text, '(a, i0, a, i0, a, i0, a, i0, a)') 'check at the end of the run failed: ', lost, &
      ' particles outside the table, ', off_speed, ' with a speed that is not 1, ', urn1_number, &
      ' in half 1 where the crossings leave ', simulation%observer%urn1_number, &
      '; please report this with the namelist'
    call fatal_error(error, trim(text))
  end procedure verify_simulation

end submodule battery_simulation_check
