!> Stationary states of one-particle theory, by simulation (`battery_walkers`). Reads lines
!>
!>     number threshold1 threshold2 urn_radius1 urn_radius2 channel1_width channel1_length
!>     channel2_width channel2_length urn2_share copies transient duration seed well_mixed
!>
!> each with all of these values; the fraction `urn2_share` of the walkers starts in urn 2, and
!> `well_mixed` is T or F. Writes for each the line
!>
!>     flow1_12 flow1_21 flow2_12 flow2_21 entries1 entries2 turned1 turned2
!>     half2_number fuller_number polarised_current
!>
!> per copy of the circuit; `turned1` and `turned2` are the particles that gates 1 and 2 reverse.
!> Flows, entries, particles reversed and the current are per unit time.
!> `fuller_number` and `polarised_current` refer to the half that is fuller at the time. Units of
!> length and time are those of the namelist. Called by `walkers.py`.
program one_particle
  use, intrinsic :: iso_fortran_env, only: input_unit, output_unit
  use battery_kinds, only: wp, int64
  use battery_error, only: error_type
  use battery_table, only: table_type, urn_type, channel_type, new_table, shape_circuit
  use battery_engine, only: particles_type
  use battery_initial_state, only: random_particles
  use battery_walkers, only: walkers_type, new_walkers, advance_walkers
  use battery_tally, only: averages
  implicit none (type, external)
  integer :: number, threshold(2), copies, status
  real(wp) :: radius(2), width1, length1, width2, length2, share, transient, duration
  integer(int64) :: seed
  logical :: well_mixed
  !> Walkers of the line that was read last.
  type(walkers_type) :: walkers

  do
    read (input_unit, *, iostat=status) number, threshold, radius, width1, length1, width2, &
      length2, share, copies, transient, duration, seed, well_mixed
    if (status /= 0) exit
    call run_walkers()
    write (output_unit, '(*(es24.16))') averages(walkers%tally, number)
    flush (output_unit)
  end do

contains

  !> Simulates the walkers of one line, from the random initial state to the end.
  subroutine run_walkers()
    type(table_type) :: table
    type(particles_type) :: particles
    type(error_type), allocatable :: error

    table = new_table(shape_circuit, [urn_type(radius=radius(1)), urn_type(radius=radius(2))], &
      [channel_type(width1, length1), channel_type(width2, length2)])
    call random_particles(table, number*copies, number*copies - nint(share*number*copies), seed, &
      particles, error)
    if (allocated(error)) error stop error%message
    call new_walkers(walkers, table, threshold, copies, particles, seed, well_mixed, transient, &
      transient + duration)
    call advance_walkers(walkers, transient + duration)
  end subroutine run_walkers

end program one_particle
