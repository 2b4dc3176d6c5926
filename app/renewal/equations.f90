!> Share of particles that a renewal gate lets through, from equations for the moments of those
!> inside.
!>
!> Poisson entries at rate nu; each particle is inside for (l/2)/cos(theta), by the cosine law; an
!> entry that finds T inside empties the gate. From empty to the first emptying, the number inside
!> and the times of entry, in cells of the width 1/cells, obey linear equations: the probability p_n
!> of n inside changes with the density of one of them over the cells, that density with the pair
!> density, and so on. The hierarchy is closed at pairs (order 2) or triples (order 3): given n,
!> higher joint cumulants are zero, which is exact for T up to the order. No particle leaves before
!> time 1, so the integration starts there, from a Poisson distribution. It uses the Runge-Kutta
!> formula, with the square root of time within a cell as the variable, since the rate at which a
!> cell empties starts as a square root when the cell reaches age 1. Pairs of old cells are merged.
!> At the end of the given time, the survival probability is extrapolated from the rate reached and
!> its change. Lengths are in units of l/2, so tau = pi/2.
module renewal_equations
  use, intrinsic :: iso_fortran_env, only: real64
  implicit none (type, external)
  private
  public :: wp, solve_gate

  integer, parameter :: wp = real64
  integer, parameter :: most = 400 !< Largest number of cells.
  real(wp), parameter :: least_probability = 1e-250_wp !< States less likely are skipped.

contains

  !> Probability that a particle is still inside at that age.
  pure elemental function stay_probability(age) result(chance)
    real(wp), intent(in) :: age
    real(wp) :: chance
    chance = 1.0_wp
    if (age > 1.0_wp) chance = 1.0_wp/(age**2 + age*sqrt((age - 1.0_wp)*(age + 1.0_wp)))
  end function stay_probability

  !> Mean time inside up to that age.
  pure elemental function mean_stay(age) result(time)
    real(wp), intent(in) :: age
    real(wp) :: time
    time = age
    if (age > 1.0_wp) time = 1.0_wp/(age + sqrt((age - 1.0_wp)*(age + 1.0_wp))) + acos(1.0_wp/age)
  end function mean_stay

  !> Integrates the equations of a gate with entries at rate `nu` and threshold `top`, with so many
  !> `cells` per unit of time, to the time `longest`; yields the `share` that is let through, and
  !> the probability `left` that the gate lasts longer.
  subroutine solve_gate(nu, top, order, cells, longest, share, left)
    real(wp), intent(in) :: nu, longest
    integer, intent(in) :: top, order, cells
    real(wp), intent(out) :: share, left
    real(wp), allocatable :: state(:)
    real(wp) :: from(most), to(most), h, t, cycle, rate, before, limit
    integer :: k, i

    h = 1.0_wp/cells
    k = cells
    do i = 1, k
      from(i) = (i - 1)*h
      to(i) = i*h
    end do
    call set_initial_state(state, cycle, left, nu, k, top, order)
    t = 1.0_wp
    rate = 1.0_wp
    do while (t < longest .and. left > 1e-10_wp)
      call open_cell(state, from, to, k, top, order, t, h)
      call integrate_cell(state, cycle, left, from, to, t, h, nu, k, top, order)
      before = rate
      rate = nu*state(top*state_length(k, order) + 1)/left
      t = t + h
      call merge_old_cells(state, from, to, k, top, order, t, h)
    end do
    limit = rate + (rate - before)*(t - h)/h
    if (limit > 0.5_wp*rate .and. limit < 2.0_wp*rate) then
      rate = limit + (rate - limit)*t/(t + 1.0_wp/rate)
    end if
    cycle = cycle + left/rate
    share = 1.0_wp - (top + 1)/(nu*cycle)
  end subroutine solve_gate

  !> Sets the state at time 1, before which no particle leaves: Poisson numbers, independent ages.
  !> Also the mean time `cycle` so far, and the probability `left` that the gate has not been
  !> emptied.
  pure subroutine set_initial_state(state, cycle, left, nu, k, top, order)
    real(wp), allocatable, intent(out) :: state(:)
    real(wp), intent(out) :: cycle, left
    real(wp), intent(in) :: nu
    integer, intent(in) :: k, top, order
    real(wp) :: p
    integer :: n

    allocate (state(state_length(k, order)*(top + 1)))
    p = exp(-nu)
    cycle = 0.0_wp
    left = 0.0_wp
    do n = 0, top
      left = left + p
      cycle = cycle + (1.0_wp - left)/nu
      call fill_independent(state(n*state_length(k, order) + 1:(n + 1)*state_length(k, order)), p, &
        n, k, order)
      p = p*nu/(n + 1)
    end do
  end subroutine set_initial_state

  !> Integrates from `t` over the newest cell, of the length `h`, by the Runge-Kutta formula; adds
  !> the mean time that the gate lasts within it to `cycle`, and updates `left`.
  subroutine integrate_cell(state, cycle, left, from, to, t, h, nu, k, top, order)
    real(wp), intent(inout) :: state(:), cycle, left
    real(wp), intent(in) :: from(:), to(:), t, h, nu
    integer, intent(in) :: k, top, order
    real(wp), dimension(size(state)) :: mid, slope, total
    real(wp) :: u, du, s0, d0, d1, w0, w1
    integer :: at, steps

    steps = max(8, ceiling(6.0_wp*h*nu))
    du = 1.0_wp/steps
    do at = 0, steps - 1
      u = at*du
      s0 = survival(state, k, order, top)
      call state_slopes(state, slope, t, h, u, from, to, k, nu, top, order)
      d0 = survival(slope, k, order, top)
      total = slope
      mid = state + 0.5_wp*du*slope
      call state_slopes(mid, slope, t, h, u + 0.5_wp*du, from, to, k, nu, top, order)
      total = total + 2.0_wp*slope
      mid = state + 0.5_wp*du*slope
      call state_slopes(mid, slope, t, h, u + 0.5_wp*du, from, to, k, nu, top, order)
      total = total + 2.0_wp*slope
      mid = state + du*slope
      call state_slopes(mid, slope, t, h, u + du, from, to, k, nu, top, order)
      state = state + du/6.0_wp*(total + slope)
      left = survival(state, k, order, top)
      d1 = -nu*state(top*state_length(k, order) + 1)*2.0_wp*h*(u + du)
      w0 = 2.0_wp*h*u
      w1 = 2.0_wp*h*(u + du)
      ! Simpson's rule, with the middle by Hermite interpolation.
      cycle = cycle + du/6.0_wp*(w0*s0 + w1*left &
        + 2.0_wp*(w0 + w1)*(0.5_wp*(s0 + left) + du/8.0_wp*(d0 - d1)))
    end do
  end subroutine integrate_cell

  !> Numbers stored for each n: probability, density, pairs, triples.
  pure function state_length(k, order) result(count)
    integer, intent(in) :: k, order
    integer :: count
    count = 1 + k
    if (order > 1) count = count + k*k
    if (order > 2) count = count + k*k*k
  end function state_length

  !> Sets the moments of n independent particles, uniform over the cells.
  pure subroutine fill_independent(part, p, n, k, order)
    real(wp), intent(out) :: part(:)
    real(wp), intent(in) :: p
    integer, intent(in) :: n, k, order
    part(1) = p
    part(2:k + 1) = p*n/k
    if (order > 1) part(k + 2:k + 1 + k*k) = p*n*(n - 1)/real(k, wp)**2
    if (order > 2) part(k + 2 + k*k:) = p*n*(n - 1.0_wp)*(n - 2)/real(k, wp)**3
  end subroutine fill_independent

  !> Probability that the gate has not been emptied.
  pure function survival(state, k, order, top) result(total)
    real(wp), intent(in) :: state(:)
    integer, intent(in) :: k, order, top
    real(wp) :: total
    integer :: n
    total = 0.0_wp
    do n = 0, top
      total = total + state(n*state_length(k, order) + 1)
    end do
  end function survival

  !> Adds the cell of the particles that enter now.
  subroutine open_cell(state, from, to, k, top, order, t, h)
    real(wp), allocatable, intent(inout) :: state(:)
    real(wp), intent(inout) :: from(:), to(:)
    integer, intent(inout) :: k
    integer, intent(in) :: top, order
    real(wp), intent(in) :: t, h
    integer :: group(most), i
    do i = 1, k
      group(i) = i
    end do
    from(k + 1) = t
    to(k + 1) = t + h
    call regroup_cells(state, group, k, k + 1, top, order)
    k = k + 1
  end subroutine open_cell

  !> Merges pairs of old cells.
  subroutine merge_old_cells(state, from, to, k, top, order, t, h)
    real(wp), allocatable, intent(inout) :: state(:)
    real(wp), intent(inout) :: from(:), to(:)
    integer, intent(inout) :: k
    integer, intent(in) :: top, order
    real(wp), intent(in) :: t, h
    integer :: group(most), i, made
    real(wp) :: age, allowed, begins(most), ends(most)
    made = 0
    i = 1
    do while (i <= k)
      made = made + 1
      group(i) = made
      begins(made) = from(i)
      ends(made) = to(i)
      if (i < k) then
        age = t - to(i + 1)
        allowed = h
        if (age >= 2.0_wp) allowed = 2.0_wp*h*2.0_wp**floor(log(age)/log(2.0_wp))
        if (to(i + 1) - from(i) <= 1.0001_wp*allowed .and. &
            abs((to(i + 1) - from(i + 1)) - (to(i) - from(i))) < 0.01_wp*h) then
          group(i + 1) = made
          ends(made) = to(i + 1)
          i = i + 1
        end if
      end if
      i = i + 1
    end do
    if (made == k) return
    from(:made) = begins(:made)
    to(:made) = ends(:made)
    call regroup_cells(state, group, k, made, top, order)
    k = made
  end subroutine merge_old_cells

  !> Sums the moments over the cells of each group.
  subroutine regroup_cells(state, group, k, made, top, order)
    real(wp), allocatable, intent(inout) :: state(:)
    integer, intent(in) :: group(:), k, made, top, order
    real(wp), allocatable :: new(:)
    integer :: n, a, b, i, j, l, place
    allocate (new(state_length(made, order)*(top + 1)), source=0.0_wp)
    do n = 0, top
      a = n*state_length(k, order) + 1
      b = n*state_length(made, order) + 1
      new(b) = state(a)
      do i = 1, k
        new(b + group(i)) = new(b + group(i)) + state(a + i)
        if (order < 2) cycle
        do j = 1, k
          place = b + made + group(i) + made*(group(j) - 1)
          new(place) = new(place) + state(a + k + i + k*(j - 1))
          if (order < 3) cycle
          do l = 1, k
            place = b + made + made**2 + group(i) + made*(group(j) - 1) + made**2*(group(l) - 1)
            new(place) = new(place) + state(a + k + k*k + i + k*(j - 1) + k*k*(l - 1))
          end do
        end do
      end do
    end do
    call move_alloc(new, state)
  end subroutine regroup_cells

  !> Time derivative of the state at the position u within the present cell, t = t0 + h u^2.
  subroutine state_slopes(state, slope, t0, h, u, from, to, k, nu, top, order)
    integer, intent(in) :: k, top, order
    real(wp), intent(in) :: state(state_length(k, order), 0:top), t0, h, u, from(:), to(:), nu
    real(wp), intent(out) :: slope(state_length(k, order), 0:top)
    real(wp) :: mu(k), t, out(state_length(k, order)), weight, own
    integer :: i, n
    t = t0 + h*u*u
    weight = 2.0_wp*h*u
    do i = 1, k
      mu(i) = 0.0_wp
      if (t - from(i) > 1.0_wp) then
        own = min(to(i), t)
        mu(i) = (stay_probability(t - own) - stay_probability(t - from(i)))/(mean_stay(t &
          - from(i)) - mean_stay(t - own))
      end if
    end do
    slope = 0.0_wp
    do n = 0, top
      call untagged_rates(state(:, n), out, mu, n, k, order)
      slope(:, n) = slope(:, n) - nu*state(:, n) - out
      if (n > 0) slope(:, n - 1) = slope(:, n - 1) + out
      if (n > 0) slope(:, n) = slope(:, n) + nu*state(:, n - 1)
      call remove_tagged(state(:, n), slope(:, n), mu, k, order)
      if (n > 0) call tag_arrivals(state(:, n - 1), slope(:, n), nu, k, order)
    end do
    slope = slope*weight
  end subroutine state_slopes

  !> Subtracts the tagged particles that leave, at the rates `mu` of their cells.
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

  !> Adds the tagged particles that enter, to a state with one fewer, into the newest cell, `k`.
  pure subroutine tag_arrivals(state, slope, nu, k, order)
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
          call add_to(slope(a + i + k*(j - 1) + k*k*(k - 1)), own)
          call add_to(slope(a + i + k*(k - 1) + k*k*(j - 1)), own)
          call add_to(slope(a + k + k*(i - 1) + k*k*(j - 1)), own)
        end do
      end do
    end if
  end subroutine tag_arrivals

  !> Increases a sum.
  pure subroutine add_to(sum, more)
    real(wp), intent(inout) :: sum
    real(wp), intent(in) :: more

    sum = sum + more
  end subroutine add_to

  !> Rate at which untagged particles leave, with the tagged ones fixed.
  pure subroutine untagged_rates(state, out, mu, n, k, order)
    integer, intent(in) :: n, k, order
    real(wp), intent(in) :: state(:), mu(:)
    real(wp), intent(out) :: out(:)
    real(wp) :: p(k), c(k, k), mc(k), m1, p2(k, k), f, ms(k, k), s(k, k, k)
    integer :: i, j, l
    out = 0.0_wp
    if (n == 0) return
    out(1) = dot_product(mu, state(2:k + 1))
    if (n == 1) return
    if (order == 1) then
      if (state(1) > least_probability) out(2:k + 1) = state(2:k + 1)*out(1)/state(1)*(n - 1.0_wp)/n
      return
    end if
    do j = 1, k
      out(1 + j) = dot_product(mu, state(1 + k + k*(j - 1) + 1:1 + k + k*j))
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
        out(1 + k + k*(j - 1) + 1:1 + k + k*j) = f*(p2(:, j)*m1 + mc*p(j) + p*mc(j))
      end do
      return
    end if
    s = reshape(state(k + 2 + k*k:), [k, k, k])
    do l = 1, k
      do j = 1, k
        out(1 + k + j + k*(l - 1)) = dot_product(mu, s(:, j, l))
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
        out(i + 1:i + k) = f*(m1*s(:, j, l) + mc*p2(j, l) + mc(j)*p2(:, l) + mc(l)*p2(:, j) &
          + ms(:, j)*p(l) + ms(:, l)*p(j) + ms(j, l)*p)
      end do
    end do
  end subroutine untagged_rates
end module renewal_equations
