!> Probe of scatterers: problem 2 of the SIAM 100-Digit Challenge. Circular mirrors of radius 1/3
!> have their centres at the integer points of the plane, and a photon of speed 1 starts at
!> (1/2, 1/10) in the direction of x: its distance from the origin at time 10.
module battery_probe_photon
  use battery_kinds, only: wp
  use battery_table, only: table_type, urn_type, channel_type, new_table, shape_circuit, &
    has_scatterers
  use battery_engine, only: engine_type, particles_type
  use battery_event_record, only: event_record_type
  use battery_probe, only: argument, precision_name, start_engine, advance_for
  implicit none (type, external)
  private
  public :: photon_main

contains

  !> `photon ENGINE`: prints the precision, the number of hits, the distance and its error.
  subroutine photon_main()
    real(wp), parameter :: published = 0.99526291944335416089031180942672_wp
    class(engine_type), allocatable :: engine
    type(particles_type) :: photon
    type(event_record_type) :: event_record
    type(table_type) :: table
    real(wp) :: distance

    table = table_of_mirrors()
    if (.not. has_scatterers(table)) error stop 'no mirrors'
    photon%x = [0.5_wp - table%urn(1)%periodic_line]
    photon%y = [0.1_wp]
    photon%ux = [1.0_wp]
    photon%uy = [0.0_wp]
    call start_engine(argument(2), table, 1, photon, 0.0_wp, engine)
    call advance_for(engine, 10.0_wp, event_record)
    call engine%get_particles(1, 1, photon)
    distance = hypot(photon%x(1) - sign(table%urn(1)%periodic_line, photon%x(1)), photon%y(1))
    print '(a, 1x, i0, 1x, f0.32, 1x, es9.1)', precision_name(), engine%collisions(), distance, &
      abs(distance - published)
  end subroutine photon_main

  !> Table with the mirrors that the photon can reach as scatterers in channel 2; lengths are
  !> integers.
  function table_of_mirrors() result(table)
    type(table_type) :: table
    real(wp) :: stand(3, 25)
    integer :: i

    do i = 1, 25
      stand(:, i) = [real(modulo(i - 1, 5) - 2, wp), real((i - 1)/5 - 2, wp), 1.0_wp/3.0_wp]
    end do
    table = new_table(shape_circuit, [urn_type(radius=5.0_wp), urn_type(radius=5.0_wp)], &
      [channel_type(6.0_wp, 2.0_wp), channel_type(6.0_wp, 8.0_wp)], stand)
  end function table_of_mirrors

end module battery_probe_photon
