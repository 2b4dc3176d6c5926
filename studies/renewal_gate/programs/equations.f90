!> Share of the particles that pass a renewal gate, from equations for the moments of the particles
!> inside.
!>
!> Particles enter as a Poisson process of rate nu, and each is inside for the time
!> (l/2)/cos(theta), with theta from the cosine law. An entry while T particles are inside makes the
!> gate reverse: none is inside then, which ends a cycle. Within a cycle, the distribution of the
!> number inside and of the times of entry, in cells of width 1/cells, obeys linear equations: the
!> time derivative of the probability p_n of n inside depends on the density of one of them over the
!> cells, that of this density on the pair density, and so on. The hierarchy is closed at order 1,
!> 2 (pairs) or 3 (triples): given n, higher joint cumulants are zero, which is exact for T up to
!> the order.
!>
!> No particle leaves before time 1, so the integration starts there, from a Poisson distribution.
!> It uses the fourth-order Runge-Kutta method. Its variable is the square root of the time within a
!> cell, since the rate at which particles leave a cell starts as a square root when the cell
!> reaches age 1. Pairs of old cells are merged. After the given time, the survival probability is
!> extrapolated from the last rate of reversals and its change. Lengths are in units of l/2, so the
!> mean time inside without reversals, tau, is pi/2.
module renewal_equations
  use, intrinsic :: iso_fortran_env, only: real64
  implicit none (type, external)
  private
  public :: wp, solve_gate

  integer, parameter :: wp = real64
  integer, parameter :: max_cells = 400 !< Largest number of cells.
  real(wp), parameter :: least_probability = 1e-250_wp !< States below it are skipped.

contains

  !> Probability that a particle is still inside at a time `age` after its entry.
  pure elemental function time_in_gate_probability(age) result(chance)
    real(wp), intent(in) :: age
    real(wp) :: chance
    chance = 1.0_wp
    if (age > 1.0_wp) chance = 1.0_wp/(age**2 + age*sqrt((age - 1.0_wp)*(age + 1.0_wp)))
  end function time_in_gate_probability

  !> Mean time that a particle spends inside until a time `age` after its entry.
  pure elemental function mean_time_in_gate(age) result(time)
    real(wp), intent(in) :: age
    real(wp) :: time
    time = age
    if (age > 1.0_wp) time = 1.0_wp/(age + sqrt((age - 1.0_wp)*(age + 1.0_wp))) + acos(1.0_wp/age)
  end function mean_time_in_gate

  !> Integrates the equations of a gate, and computes the share of particles that pass it.
  subroutine solve_gate(nu, threshold, order, cells, max_time, share, survivors)
    !> Rate of entries; time until which the equations are integrated.
    real(wp), intent(in) :: nu, max_time
    !> Threshold; order of the closure, 1 to 3; cells per unit time.
    integer, intent(in) :: threshold, order, cells
    !> Share of the particles that pass; probability that the gate has not reversed at the end of
    !> the integration.
    real(wp), intent(out) :: share, survivors
    real(wp), allocatable :: state(:)
    real(wp) :: from(max_cells), to(max_cells), h, t, cycle_time, rate, previous_rate, limit
    integer :: k, i

    h = 1.0_wp/cells
    k = cells
    do i = 1, k
      from(i) = (i - 1)*h
      to(i) = i*h
    end do
    call set_initial_state(state, cycle_time, survivors, nu, k, threshold, order)
    t = 1.0_wp
    rate = 1.0_wp
    do while (t < max_time .and. survivors > 1e-10_wp)
      call open_cell(state, from, to, k, threshold, order, t, h)
      call integrate_cell(state, cycle_time, survivors, from, to, t, h, nu, k, threshold, order)
      previous_rate = rate
      rate = nu*state(threshold*state_length(k, order) + 1)/survivors
      t = t + h
      call merge_old_cells(state, from, to, k, threshold, order, t, h)
    end do
    limit = rate + (rate - previous_rate)*(t - h)/h
    if (limit > 0.5_wp*rate .and. limit < 2.0_wp*rate) then
      rate = limit + (rate - limit)*t/(t + 1.0_wp/rate)
    end if
    cycle_time = cycle_time + survivors/rate
    share = 1.0_wp - (threshold + 1)/(nu*cycle_time)
  end subroutine solve_gate

  !> Sets the state at time 1, before which no particle leaves: a Poisson distribution of the
  !> number, and independent times of entry.
  pure subroutine set_initial_state(state, cycle_time, survivors, nu, k, threshold, order)
    !> Moments for n = 0 ... threshold, `state_length` numbers for each.
    real(wp), allocatable, intent(out) :: state(:)
    !> Mean duration of the cycle up to time 1; probability that the gate has not reversed.
    real(wp), intent(out) :: cycle_time, survivors
    real(wp), intent(in) :: nu
    integer, intent(in) :: k, threshold, order
    real(wp) :: p
    integer :: n

    allocate (state(state_length(k, order)*(threshold + 1)))
    p = exp(-nu)
    cycle_time = 0.0_wp
    survivors = 0.0_wp
    do n = 0, threshold
      survivors = survivors + p
      cycle_time = cycle_time + (1.0_wp - survivors)/nu
      call fill_independent(state(n*state_length(k, order) + 1:(n + 1)*state_length(k, order)), p, &
        n, k, order)
      p = p*nu/(n + 1)
    end do
  end subroutine set_initial_state

  !> Integrates from `t` to `t + h`, over the newest cell; adds the mean duration of the cycle
  !> within this interval to `cycle_time`, and updates `survivors`.
  subroutine integrate_cell(state, cycle_time, survivors, from, to, t, h, nu, k, threshold, order)
    real(wp), intent(inout) :: state(:), cycle_time, survivors
    real(wp), intent(in) :: from(:), to(:), t, h, nu
    integer, intent(in) :: k, threshold, order
    real(wp), dimension(size(state)) :: mid, slope, total
    real(wp) :: u, du, s0, d0, d1, w0, w1
    integer :: at, steps

    steps = max(8, ceiling(6.0_wp*h*nu))
    du = 1.0_wp/steps
    do at = 0, steps - 1
      u = at*du
      s0 = survival(state, k, order, threshold)
      call state_slopes(state, slope, t, h, u, from, to, k, nu, threshold, order)
      d0 = survival(slope, k, order, threshold)
      total = slope
      mid = state + 0.5_wp*du*slope
      call state_slopes(mid, slope, t, h, u + 0.5_wp*du, from, to, k, nu, threshold, order)
      total = total + 2.0_wp*slope
      mid = state + 0.5_wp*du*slope
      call state_slopes(mid, slope, t, h, u + 0.5_wp*du, from, to, k, nu, threshold, order)
      total = total + 2.0_wp*slope
      mid = state + du*slope
      call state_slopes(mid, slope, t, h, u + du, from, to, k, nu, threshold, order)
      state = state + du/6.0_wp*(total + slope)
      survivors = survival(state, k, order, threshold)
      d1 = -nu*state(threshold*state_length(k, order) + 1)*2.0_wp*h*(u + du)
      w0 = 2.0_wp*h*u
      w1 = 2.0_wp*h*(u + du)
      ! Simpson's rule; the value at the midpoint is from Hermite interpolation.
      cycle_time = cycle_time + du/6.0_wp*(w0*s0 + w1*survivors &
        + 2.0_wp*(w0 + w1)*(0.5_wp*(s0 + survivors) + du/8.0_wp*(d0 - d1)))
    end do
  end subroutine integrate_cell

  !> Number of moments that are stored for each n: probability, densities of single particles, of
  !> pairs and of triples over `k` cells.
  pure function state_length(k, order) result(count)
    integer, intent(in) :: k, order
    integer :: count
    count = 1 + k
    if (order > 1) count = count + k*k
    if (order > 2) count = count + k*k*k
  end function state_length

  !> Moments of n independent particles, uniform over the cells; `p` is the probability of n.
  pure subroutine fill_independent(moments, p, n, k, order)
    real(wp), intent(out) :: moments(:)
    real(wp), intent(in) :: p
    integer, intent(in) :: n, k, order
    moments(1) = p
    moments(2:k + 1) = p*n/k
    if (order > 1) moments(k + 2:k + 1 + k*k) = p*n*(n - 1)/real(k, wp)**2
    if (order > 2) moments(k + 2 + k*k:) = p*n*(n - 1.0_wp)*(n - 2)/real(k, wp)**3
  end subroutine fill_independent

  !> Probability that the gate has not reversed.
  pure function survival(state, k, order, threshold) result(total)
    real(wp), intent(in) :: state(:)
    integer, intent(in) :: k, order, threshold
    real(wp) :: total
    integer :: n
    total = 0.0_wp
    do n = 0, threshold
      total = total + state(n*state_length(k, order) + 1)
    end do
  end function survival

  !> Adds a cell for the particles that enter from `t` to `t + h`.
  subroutine open_cell(state, from, to, k, threshold, order, t, h)
    real(wp), allocatable, intent(inout) :: state(:)
    real(wp), intent(inout) :: from(:), to(:)
    integer, intent(inout) :: k
    integer, intent(in) :: threshold, order
    real(wp), intent(in) :: t, h
    integer :: group(max_cells), i
    do i = 1, k
      group(i) = i
    end do
    from(k + 1) = t
    to(k + 1) = t + h
    call regroup_cells(state, group, k, k + 1, threshold, order)
    k = k + 1
  end subroutine open_cell

  !> Merges pairs of adjacent cells of equal width, if the result is narrow relative to their age.
  subroutine merge_old_cells(state, from, to, k, threshold, order, t, h)
    real(wp), allocatable, intent(inout) :: state(:)
    real(wp), intent(inout) :: from(:), to(:)
    integer, intent(inout) :: k
    integer, intent(in) :: threshold, order
    real(wp), intent(in) :: t, h
    integer :: group(max_cells), i, groups
    real(wp) :: age, allowed, begins(max_cells), ends(max_cells)
    groups = 0
    i = 1
    do while (i <= k)
      groups = groups + 1
      group(i) = groups
      begins(groups) = from(i)
      ends(groups) = to(i)
      if (i < k) then
        age = t - to(i + 1)
        allowed = h
        if (age >= 2.0_wp) allowed = 2.0_wp*h*2.0_wp**floor(log(age)/log(2.0_wp))
        if (to(i + 1) - from(i) <= 1.0001_wp*allowed .and. &
            abs((to(i + 1) - from(i + 1)) - (to(i) - from(i))) < 0.01_wp*h) then
          group(i + 1) = groups
          ends(groups) = to(i + 1)
          i = i + 1
        end if
      end if
      i = i + 1
    end do
    if (groups == k) return
    from(:groups) = begins(:groups)
    to(:groups) = ends(:groups)
    call regroup_cells(state, group, k, groups, threshold, order)
    k = groups
  end subroutine merge_old_cells

  !> Replaces `k` cells by `groups` cells: sums the moments over the cells of each group.
  subroutine regroup_cells(state, group, k, groups, threshold, order)
    real(wp), allocatable, intent(inout) :: state(:)
    integer, intent(in) :: group(:), k, groups, threshold, order
    real(wp), allocatable :: new(:)
    integer :: n, a, b, i, j, l, place
    allocate (new(state_length(groups, order)*(threshold + 1)), source=0.0_wp)
    do n = 0, threshold
      a = n*state_length(k, order) + 1
      b = n*state_length(groups, order) + 1
      new(b) = state(a)
      do i = 1, k
        new(b + group(i)) = new(b + group(i)) + state(a + i)
        if (order < 2) cycle
        do j = 1, k
          place = b + groups + group(i) + groups*(group(j) - 1)
          new(place) = new(place) + state(a + k + i + k*(j - 1))
          if (order < 3) cycle
          do l = 1, k
            place = b + groups + groups**2 + group(i) + groups*(group(j) - 1) &
              + groups**2*(group(l) - 1)
            new(place) = new(place) + state(a + k + k*k + i + k*(j - 1) + k*k*(l - 1))
          end do
        end do
      end do
    end do
    call move_alloc(new, state)
  end subroutine regroup_cells

  !> Derivative of the state with respect to u within the newest cell, where t = t0 + h u**2.
  subroutine state_slopes(state, slope, t0, h, u, from, to, k, nu, threshold, order)
    integer, intent(in) :: k, threshold, order
    real(wp), intent(in) :: state(state_length(k, order), 0:threshold), t0, h, u, from(:), to(:), nu
    real(wp), intent(out) :: slope(state_length(k, order), 0:threshold)
    real(wp) :: mu(k), t, outflow(state_length(k, order)), weight, own
    integer :: i, n
    t = t0 + h*u*u
    weight = 2.0_wp*h*u
    do i = 1, k
      mu(i) = 0.0_wp
      if (t - from(i) > 1.0_wp) then
        own = min(to(i), t)
        mu(i) = (time_in_gate_probability(t - own) - time_in_gate_probability(t - from(i))) &
          /(mean_time_in_gate(t - from(i)) - mean_time_in_gate(t - own))
      end if
    end do
    slope = 0.0_wp
    do n = 0, threshold
      call untagged_rates(state(:, n), outflow, mu, n, k, order)
      slope(:, n) = slope(:, n) - nu*state(:, n) - outflow
      if (n > 0) slope(:, n - 1) = slope(:, n - 1) + outflow
      if (n > 0) slope(:, n) = slope(:, n) + nu*state(:, n - 1)
      call remove_tagged(state(:, n), slope(:, n), mu, k, order)
      if (n > 0) call tag_arrivals(state(:, n - 1), slope(:, n), nu, k, order)
    end do
    slope = slope*weight
  end subroutine state_slopes

  !> Subtracts the loss of tagged particles, those whose cells a moment specifies, at the rates `mu`
  !> of their cells.
  pure subroutine remove_tagged(state, slope, mu, k, order)
    real(wp), intent(in) :: state(:), mu(:)
    real(wp), intent(inout) :: slope(:)
    integer, intent(in) :: k, order
    integer :: i, j, l, a

    do i = 1, k
      slope(1 + i) = slope(1 + i) - mu(i)*state(1 + i)
    end do
    if (order > 1) then
      do j = 1, k
        a = 1 + k + k*(j - 1)
        slope(a + 1:a + k) = slope(a + 1:a + k) - (mu(:k) + mu(j))*state(a + 1:a + k)
      end do
    end if
    if (order > 2) then
      do l = 1, k
        do j = 1, k
          a = 1 + k + k*k + k*(j - 1) + k*k*(l - 1)
          slope(a + 1:a + k) = slope(a + 1:a + k) &
            - (mu(:k) + mu(j) + mu(l))*state(a + 1:a + k)
        end do
      end do
    end if
  end subroutine remove_tagged

  !> Adds the gain of tagged particles by entries into the newest cell, `k`.
  pure subroutine tag_arrivals(state, slope, nu, k, order)
    !> Moments for one particle fewer; rate of entries.
    real(wp), intent(in) :: state(:), nu
    real(wp), intent(inout) :: slope(:)
    integer, intent(in) :: k, order
    real(wp) :: own
    integer :: i, j, a

    slope(1 + k) = slope(1 + k) + nu*state(1)
    if (order > 1) then
      do j = 1, k
        a = 1 + k
        slope(a + k + k*(j - 1)) = slope(a + k + k*(j - 1)) + nu*state(1 + j)
        slope(a + j + k*(k - 1)) = slope(a + j + k*(k - 1)) + nu*state(1 + j)
      end do
    end if
    if (order > 2) then
      do j = 1, k
        do i = 1, k
          own = nu*state(1 + k + i + k*(j - 1))
          a = 1 + k + k*k
          call increment(slope(a + i + k*(j - 1) + k*k*(k - 1)), own)
          call increment(slope(a + i + k*(k - 1) + k*k*(j - 1)), own)
          call increment(slope(a + k + k*(i - 1) + k*k*(j - 1)), own)
        end do
      end do
    end if
  end subroutine tag_arrivals

  !> Adds `term` to `sum`.
  pure subroutine increment(sum, term)
    real(wp), intent(inout) :: sum
    real(wp), intent(in) :: term

    sum = sum + term
  end subroutine increment

  !> Loss rate of each moment for `n` particles by the untagged ones, those whose cells the moment
  !> does not specify.
  pure subroutine untagged_rates(state, outflow, mu, n, k, order)
    integer, intent(in) :: n, k, order
    real(wp), intent(in) :: state(:), mu(:)
    real(wp), intent(out) :: outflow(:)
    real(wp) :: p(k), c(k, k), mc(k), m1, p2(k, k), f, ms(k, k), s(k, k, k)
    integer :: i, j, l
    outflow = 0.0_wp
    if (n == 0) return
    outflow(1) = dot_product(mu, state(2:k + 1))
    if (n == 1) return
    if (order == 1) then
      if (state(1) > least_probability) outflow(2:k + 1) = state(2:k + 1)*outflow(1)/state(1) &
        *(n - 1.0_wp)/n
      return
    end if
    do j = 1, k
      outflow(1 + j) = dot_product(mu, state(1 + k + k*(j - 1) + 1:1 + k + k*j))
    end do
    if (n == 2) return
    if (state(1) < least_probability) return
    p = state(2:k + 1)/(n*state(1))
    p2 = reshape(state(k + 2:k + 1 + k*k), [k, k])/(n*(n - 1.0_wp)*state(1))
    do j = 1, k
      c(:, j) = p2(:, j) - p*p(j)
    end do
    m1 = dot_product(mu, p)
    mc = matmul(mu, c)
    if (order == 2) then
      f = n*(n - 1.0_wp)*(n - 2)*state(1)
      do j = 1, k
        outflow(1 + k + k*(j - 1) + 1:1 + k + k*j) = f*(p2(:, j)*m1 + mc*p(j) + p*mc(j))
      end do
      return
    end if
    s = reshape(state(k + 2 + k*k:), [k, k, k])
    do l = 1, k
      do j = 1, k
        outflow(1 + k + j + k*(l - 1)) = dot_product(mu, s(:, j, l))
      end do
    end do
    if (n == 3) return
    s = s/(n*(n - 1.0_wp)*(n - 2)*state(1))
    f = n*(n - 1.0_wp)*(n - 2)*(n - 3)*state(1)
    do l = 1, k
      do j = 1, k
        ms(j, l) = sum(mu*(s(:, j, l) - p*p(j)*p(l) - c(:, j)*p(l) - c(:, l)*p(j) - c(j, l)*p))
      end do
    end do
    do l = 1, k
      do j = 1, k
        i = 1 + k + k*k + k*(j - 1) + k*k*(l - 1)
        outflow(i + 1:i + k) = f*(m1*s(:, j, l) + mc*p2(j, l) + mc(j)*p2(:, l) + mc(l)*p2(:, j) &
          + ms(:, j)*p(l) + ms(:, l)*p(j) + ms(j, l)*p)
      end do
    end do
  end subroutine untagged_rates
end module renewal_equations
