!> Deficit of the current through channel 2 in a run that has not lasted long enough.
!>
!> Particles that circulate through both channels carry a part of that current. In the course of a
!> run, orbits of more and more rounds are populated, until the gate of the sparse urn reverses the
!> particles on them. With L the length of a round, R the fraction of entries that this gate
!> reverses, and tau = L/R, the current at an age s lacks about this part of its stationary value:
!>
!>     2.14 (w'/L) (L + l')/(L - l') exp(-s/tau) log(1 + tau/s)                       (1)
!>
!> The number of particles in the sparse urn follows from the balance of flows through both
!> channels, with the load of the dense gate times 0.85 (the paper's theory has 1). R is that of a
!> gate with exponentially distributed passage times, in closed form. The factors 2.14 and 0.85 are
!> fitted to the theory of the currents and to runs of many ages; docs/validation.md links to
!> the page with the deviations of (1) from both.
!>
!> The fit, and so the use of (1), is for equal discs with equal gates, channels without scatterers,
!> exact engines, T up to 20, w up to 0.9 r, w' up to w/12, l up to 3 r, l' up to 6 r**2/w, and runs
!> without an initial file: with a wider channel, or a longer channel 2, (1) is several times too
!> large, with a longer channel 1 too small. Otherwise, and if the balance has no polarised state,
!> as near the transition of T, no remark is made.
module battery_current_age
  use battery_kinds, only: wp, dp, int64, pi
  use battery_plan, only: plan_type, point_type, point_of, point_text, table_of
  use battery_table, only: table_type, area, perimeter, channel1, channel2
  use battery_text, only: to_text, duration_text
  implicit none (type, external)
  private
  public :: circulation_type, circulation_at, lacking_share, transient_for, current_remark

  !> Circulation at a parameter point.
  type :: circulation_type
    !> The factor before the exponential of (1); 0: the current is negligible, or (1) is not used.
    real(dp) :: growth = 0.0_dp
    !> The time tau after which a circulating particle is reversed.
    real(dp) :: lifetime = 1.0_dp
  end type circulation_type

  !> Fitted numbers: the factor of (1), and the factor of the dense gate's load.
  real(dp), parameter :: steepness = 2.14_dp, dense_load = 0.85_dp

  !> Relative deficit that is allowed: a quarter of a tolerance of 1 %, as in postproc.advise.
  real(dp), parameter :: allowed = 0.0025_dp

  !> Ratio of measured time to transient in the recommended run.
  real(dp), parameter :: measured = 2.0_dp

  !> Cost of the recommended run over that of this one from which it is not worth having.
  real(dp), parameter :: most_times = 100.0_dp

  !> The least chi of a state that counts as polarised.
  real(dp), parameter :: polarised = 0.3_dp

  !> The largest w'/w, w/r, l/r and w l'/r**2 at which (1) holds.
  real(dp), parameter :: largest_widths = 1.0_dp/12.0_dp, largest_width = 0.9_dp
  real(dp), parameter :: largest_length = 3.0_dp, largest_product = 6.0_dp

  !> The largest threshold at which (1) was compared with theory; largest number of points examined.
  integer, parameter :: largest_threshold = 20, most_points = 1000

contains

  !> Remark on the point of a plan with the largest deficit, and the transient that its currents
  !> would need for one per cent; empty if all deficits are allowed, or if (1) does not apply.
  function current_remark(plan, seconds) result(text)
    type(plan_type), intent(in) :: plan
    !> Expected duration of the run in seconds; 0: not known.
    real(dp), intent(in) :: seconds
    character(len=:), allocatable :: text, key
    !> First and last age of the averages, in time units or in collisions.
    real(dp) :: ages(2)
    real(dp), allocatable :: lacks(:)
    real(dp) :: transient, times, two_digits
    character(len=16) :: percent, times_text
    integer :: step, worst, at

    text = ''
    if (plan%shape == 'urn' .or. plan%urn_shape == 'polygon' .or. size(plan%scatterers) > 0 .or. &
      plan%initial_file /= '' .or. any(plan%engine == [character(len=9) :: 'timestep', &
      'reservoir'])) return
    key = trim(merge('duration  ', 'collisions', plan%duration > 0.0_dp))
    ages = real([plan%transient_collisions, plan%collisions], dp)
    if (plan%duration > 0.0_dp) ages = real([plan%transient_duration, plan%duration], dp)
    step = 1 + (plan%point_count - 1)/most_points
    lacks = [(lacking_share(circulation_at(point_of(plan, at)), ages*time_unit(plan, &
      point_of(plan, at))), at=1, plan%point_count, step)]
    if (maxval(lacks) <= allowed) return
    worst = 1 + step*(maxloc(lacks, dim=1) - 1)
    ! Two decimals below 1 %, else one.
    write (percent, merge('(f4.2)', '(f0.1)', 100.0_dp*maxval(lacks) < 0.995_dp)) &
      100.0_dp*maxval(lacks)
    text = 'currents lack about '//trim(percent)//' %'
    if (point_text(plan, worst, '') /= '') text = text//', most at '//point_text(plan, worst, '')
    text = text//': circulations still build up'
    transient = transient_for(circulation_at(point_of(plan, worst)), allowed)/time_unit(plan, &
      point_of(plan, worst))
    times = (1.0_dp + measured)*transient/ages(2)
    if (times > most_times) then
      text = text//', and a run that is old enough would cost more than ' &
        //to_text(nint(most_times))//' times this one; compare with theory at the age of the run'
    else
      ! The least number of two digits that is not below.
      two_digits = 10.0_dp**(floor(log10(transient)) - 1)
      transient = two_digits*ceiling(transient/two_digits)
      text = text//'; &run transient_'//key//' = '//to_text(nint(transient, int64))//', '//key &
        //' = '//to_text(nint((1.0_dp + measured)*transient, int64))//' would lack 0.25 % ('
      if (seconds > 0.0_dp) then
        text = text//'about '//duration_text(times*seconds)//')'
      else
        write (times_text, '(f16.1)') times
        text = text//trim(adjustl(times_text))//' times the cost)'
      end if
    end if
  end function current_remark

  !> Time for each unit of the length of runs: 1, or if it is in collisions the mean time between
  !> them, taken as the mean free path of the empty table over the number of particles.
  pure real(dp) function time_unit(plan, point) result(time)
    type(plan_type), intent(in) :: plan
    type(point_type), intent(in) :: point
    type(table_type) :: table

    time = 1.0_dp
    if (plan%duration > 0.0_dp) return
    table = table_of(plan, point)
    time = real(pi*area(table)/perimeter(table), dp)/real(point%number, dp)
  end function time_unit

  !> Circulation at a parameter point whose urns are discs.
  pure type(circulation_type) function circulation_at(point) result(found)
    type(point_type), intent(in) :: point
    !> It converges within some tens of steps, except near the largest load without polarisation.
    integer, parameter :: most_steps = 10000
    !> No u_n is above this, so that their sum is finite.
    real(dp), parameter :: enough = 1.0e100_dp
    real(dp) :: width(2), radius(2), load, widths, sparse, before, round_length, back, u, total
    integer :: step

    width = real(point%channel%width, dp)
    radius = real(point%urn_radius, dp)
    associate (threshold => point%threshold(1), number => real(point%number, dp))
      if (any(point%threshold /= threshold) .or. threshold < 1 .or. threshold > largest_threshold &
        .or. any(radius < maxval(radius)) .or. .not. width(channel2) > 0.0_dp) return
      ! Mean number in a gate over number in its urn: w/(pi A) entries per unit of time, each for pi
      ! l/4.
      load = width(channel1)*real(point%channel(channel1)%length/(4.0_wp*pi), dp)/radius(1)**2
      ! Number of particles in the sparse urn for which the current through channel 2 equals that of
      ! channel 1 in the other direction, by iteration from an empty urn; at most half of all.
      widths = width(channel2)/width(channel1)
      if (max(widths/largest_widths, width(channel1)/radius(1)/largest_width, &
        real(point%channel(channel1)%length, dp)/radius(1)/largest_length, &
        width(channel1)*real(point%channel(channel2)%length, dp)/radius(1)**2/largest_product) &
        > 1.0_dp + 1.0e-12_dp) return
      sparse = 0.0_dp
      do step = 1, most_steps
        before = sparse
        ! What flows into the sparse urn over the flow out of it of each of its particles.
        sparse = min(0.5_dp*number, (number - sparse)*(widths + chance_below(threshold, &
          dense_load*load*(number - sparse)))/(widths + chance_below(threshold, load*sparse)))
        if (abs(sparse - before) <= epsilon(number)*number) exit
      end do
      if (sparse > 0.5_dp*(1.0_dp - polarised)*number) return
      round_length = sum(sqrt(4.0_dp*radius**2 - width**2) + real(point%channel%length, dp))
      back = real(point%channel(channel2)%length, dp)
      found%growth = steepness*width(channel2)/round_length*(round_length + back) &
        /(round_length - back)
      ! A gate with exponentially distributed passage times reverses of its entries the fraction
      ! (T + 1) over the sum of u_n, u_0 = 1, u_n = 1 + n u_(n-1)/load.
      u = 1.0_dp
      total = 1.0_dp
      do step = 1, threshold
        u = min(enough, 1.0_dp + real(step, dp)*u/(load*sparse))
        total = total + u
      end do
      found%lifetime = round_length*total/real(threshold + 1, dp)
    end associate
  end function circulation_at

  !> Probability that a Poisson variable with this mean is below `threshold`.
  pure real(dp) function chance_below(threshold, mean) result(chance)
    integer, intent(in) :: threshold
    real(dp), intent(in) :: mean
    integer :: k

    ! By logarithms, since powers of a large mean overflow.
    chance = sum([(exp(k*log(max(mean, tiny(mean))) - mean - log_gamma(real(k + 1, dp))), k=0, &
      threshold - 1)])
  end function chance_below

  !> Relative deficit of a current: (1) averaged over ages.
  pure real(dp) function lacking_share(circulation, ages)
    type(circulation_type), intent(in) :: circulation
    !> First and last age of the average, in time units.
    real(dp), intent(in) :: ages(2)
    integer, parameter :: parts = 16
    real(dp) :: age(parts)
    integer :: k

    age = max(tiny(1.0_dp), (ages(1) + (ages(2) - ages(1))*([(k, k=1, parts)] - 0.5_dp)/parts) &
      /circulation%lifetime)
    lacking_share = circulation%growth*sum(exp(-age)*log(1.0_dp + 1.0_dp/age))/parts
  end function lacking_share

  !> Transient, the least in steps of 1 %, after which the current of a run that measures twice as
  !> long has a relative deficit of at most `part`.
  pure real(dp) function transient_for(circulation, part) result(transient)
    type(circulation_type), intent(in) :: circulation
    !> Greatest relative deficit allowed, above 0.
    real(dp), intent(in) :: part

    ! A transient of no length lacks most.
    transient = 1.0e-13_dp*circulation%lifetime
    do while (lacking_share(circulation, [1.0_dp, 1.0_dp + measured]*transient) > part)
      transient = 1.01_dp*transient
    end do
  end function transient_for

end module battery_current_age
