!> Replicas until a precision is reached, in two stages (C. Stein, Ann. Math. Stat. 16, 243 (1945),
!> doi:10.1214/aoms/1177731088): the first replicas of a point alone determine its number of
!> replicas.
!>
!> With s the standard deviation of the n first replicas, N their total number and t of Student's
!> distribution with n - 1 degrees of freedom, the mean over all replicas lies within t s/sqrt(N) of
!> the true mean with probability 68 %: N depends on s and not on the mean. A rule that tested after
!> every replica would stop when s is small by chance.
module battery_precision
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use, intrinsic :: iso_c_binding, only: c_size_t
  use battery_blocks, only: error_of_mean, rounding
  use battery_channel, only: channel2, is_open
  use battery_kinds, only: wp, dp
  use battery_gsl, only: student_quantile, beta_below, sort_order
  use battery_plan, only: plan_type, point_type, point_of, table_of
  use battery_quantities, only: real_quantities, place_of, unknown_real
  use battery_results, only: results_type, task_complete, point_precise, point_not_precise, &
    point_two_states, point_undecided
  use battery_table, only: table_type
  use battery_urn, only: are_mirror_images
  implicit none (type, external)
  private
  public :: decide_replicas, has_two_states, in_two_states, cut_between_groups, signed_chi

  !> Probability that a normal variable is less than one standard deviation above its mean.
  real(dp), parameter :: below_one = 0.841344746068543_dp

  !> Two groups are two states if the variance within them is less than this fraction of the total
  !> variance: groups of equal size are then more than six of their standard deviations apart. A
  !> single normal distribution, cut in two, has 36 % within, a uniform one 25 %.
  real(dp), parameter :: within = 0.1_dp

  !> Of few replicas chance makes groups. For one division of n normal values that fraction has the
  !> beta distribution of (n - 2)/2 and 1/2, and there are 2**(n - 1) - 1 divisions: the probability
  !> of all together must be below `chance`, as it is from `many` replicas on. The chi of two states
  !> differ by more than `jump`. Fewer than four show nothing. The same rule is in
  !> `postproc/reading/points.py`.
  real(dp), parameter :: chance = 1.0e-3_dp, jump = 0.3_dp
  integer, parameter :: many = 20

  !> A chi above this over sqrt(N) is that of a polarised state, not of fluctuations.
  real(dp), parameter :: fluctuation = 4.0_dp

contains

  !> Decides the number of replicas of each point whose first replicas are complete.
  subroutine decide_replicas(plan, results)
    type(plan_type), intent(in) :: plan
    !> Results, in which the number of replicas, the status and the errors of each point are set.
    type(results_type), intent(inout) :: results
    real(dp) :: factor, scatter(2), needed
    integer :: place(2), n, p, k
    logical :: asked(2), known(2)

    n = plan%first_replicas
    allocate (results%replicas_needed(plan%point_count), source=n)
    asked = plan%precision > 0.0_wp
    if (.not. any(asked)) return
    allocate (results%point_status(plan%point_count), source=point_undecided)
    allocate (results%replica_error(plan%point_count, 2), source=unknown_real())
    place = [place_of('chi', real_quantities()), place_of('polarised_current', real_quantities())]
    factor = student_quantile(below_one, real(n - 1, dp))
    do p = 1, plan%point_count
      if (any(results%task_status(:n, p) /= task_complete)) cycle
      results%point_status(p) = point_two_states
      if (has_two_states(signed_chi(plan, results, [(k, k=1, n)], p))) cycle
      do k = 1, 2
        associate (values => results%average(:n, p, place(k)))
          scatter(k) = factor*sqrt(sum((values - sum(values)/n)**2)/(n - 1))
        end associate
      end do
      results%point_status(p) = point_not_precise
      ! Without channel 2 its current is NaN, and has no error to be reached.
      known = asked .and. [.true., is_open(results%point(p)%channel(channel2))]
      if (.not. any(known .and. ieee_is_nan(scatter))) then
        needed = max(0.0_dp, maxval((scatter/merge(real(plan%precision, dp), 1.0_dp, known))**2, &
          known))
        if (needed <= plan%replicas) results%point_status(p) = point_precise
        results%replicas_needed(p) = max(n, ceiling(min(needed, real(plan%replicas, dp))))
      end if
      associate (replicas => results%replicas_needed(p))
        if (any(results%task_status(:replicas, p) /= task_complete)) cycle
        if (has_two_states(signed_chi(plan, results, [(k, k=1, replicas)], p))) then
          results%point_status(p) = point_two_states
        else
          results%replica_error(p, :) = [(error_of_mean(results%average(:replicas, p, place(k))), &
            k=1, 2)]
        end if
      end associate
    end do
  end subroutine decide_replicas

  !> Whether the replicas of each point are in two states: as found when their number was decided,
  !> or by the chi of those that are complete.
  function in_two_states(plan, results) result(yes)
    type(plan_type), intent(in) :: plan
    type(results_type), intent(in) :: results
    logical :: yes(size(results%point))
    integer :: p, k

    yes = .false.
    if (allocated(results%point_status)) yes = results%point_status == point_two_states
    do p = 1, size(yes)
      yes(p) = yes(p) .or. has_two_states(signed_chi(plan, results, pack([(k, k=1, &
        size(results%task_status, 1))], results%task_status(:, p) == task_complete), p))
    end do
  end function in_two_states

  !> chi of replicas of a point. If its urns or gates are unequal, polarised states of opposite sign
  !> are no mirror images: then it has the sign of N1 - N2, if each replica was in one such state.
  !> The fuller urn never changed if the current through channel 2 is that along the polarity, or
  !> its negative; the sign tells which it was.
  function signed_chi(plan, results, replicas, p) result(chi)
    type(plan_type), intent(in) :: plan
    type(results_type), intent(in) :: results
    !> Replicas, and the point.
    integer, intent(in) :: replicas(:), p
    real(dp) :: chi(size(replicas)), current(size(replicas)), polarised(size(replicas))
    type(point_type) :: point
    type(table_type) :: table

    chi = results%average(replicas, p, place_of('chi', real_quantities()))
    point = point_of(plan, p)
    table = table_of(plan, point)
    if (table%urn_count == 1) return
    if (are_mirror_images(table%urn) .and. point%threshold(1) == point%threshold(2)) return
    current = results%average(replicas, p, place_of('current2', real_quantities()))
    polarised = results%average(replicas, p, place_of('polarised_current', real_quantities()))
    if (all(chi > max(jump, fluctuation/sqrt(real(point%number, dp))) &
      .and. abs(polarised) > 0.0_dp &
      .and. abs(abs(current) - abs(polarised)) <= rounding*abs(polarised))) &
      chi = sign(chi, current*polarised)
  end function signed_chi

  !> Whether values of chi form two separate groups, each of one value or more.
  logical function has_two_states(values) result(yes)
    !> Values, finite.
    real(dp), intent(in) :: values(:)
    real(dp) :: fraction
    integer :: n

    yes = .false.
    if (size(values) <= 3) return
    n = min(size(values), many)
    fraction = fraction_within(values)
    yes = fraction < within .and. maxval(values) - minval(values) > jump
    if (yes) yes = 2.0_dp**(n - 1)*beta_below(fraction, 0.5_dp*n - 1.0_dp, 0.5_dp) < chance
  end function has_two_states

  !> Fraction of the variance that is within the groups of the best division into two; 1 if values
  !> are equal.
  real(dp) function fraction_within(values) result(fraction)
    !> Values, finite, one or more.
    real(dp), intent(in) :: values(:)
    real(dp) :: cut, total

    fraction = 1.0_dp
    total = squared_deviations(values)
    if (.not. total > size(values)*(rounding*maxval(abs(values)))**2) return
    cut = cut_between_groups(values)
    fraction = (squared_deviations(pack(values, values <= cut)) &
      + squared_deviations(pack(values, values > cut)))/total
  end function fraction_within

  !> The greatest value of the lower group in the best division into two groups. A division reduces
  !> the sum of squares by n d**2/(k (n - k)), with d the sum of the deviations of the lowest k
  !> values.
  function cut_between_groups(values) result(cut)
    !> Values, finite, one or more.
    real(dp), intent(in) :: values(:)
    real(dp) :: cut
    integer(c_size_t) :: order(size(values))
    real(dp) :: distance(size(values)), lowest, taken, most
    integer :: n, k

    n = size(values)
    distance = values - sum(values)/n
    call sort_order(order, distance, 1_c_size_t, int(n, c_size_t))
    cut = maxval(values)
    lowest = 0.0_dp
    most = 0.0_dp
    do k = 1, n - 1
      lowest = lowest + distance(order(k) + 1)
      taken = lowest**2*(real(n, dp)/(real(k, dp)*real(n - k, dp)))
      if (.not. taken > most) cycle
      most = taken
      cut = values(order(k) + 1)
    end do
  end function cut_between_groups

  !> Sum of the squared distances from the mean.
  pure real(dp) function squared_deviations(values)
    real(dp), intent(in) :: values(:)

    squared_deviations = sum((values - sum(values)/max(size(values), 1))**2)
  end function squared_deviations

end module battery_precision
