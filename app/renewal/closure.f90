!> Share that a renewal gate lets through, without chance: moments of those inside, closed.
!>
!> Poisson entries at rate nu, each inside for (l/2)/cos(theta), cosine law; an entry that finds T
!> inside empties the gate. From empty to the first emptying the number inside and the times at
!> which they came, in cells of a width of 1/cells, obey linear equations: the probability p_n of n
!> inside is changed by those who leave, so by the density of one of them over the cells, that one
!> by pairs, and so on. The chain is cut at pairs (order 2) or triples (order 3): given n, joint
!> cumulants of more are taken as zero. That is exact for T up to the order. Nobody leaves before
!> time 1, so the equations start there, from a Poisson distribution; from then on they are integrated by
!> Runge and Kutta's formula, in the square root of time within a cell, where the rate at which a
!> cell that turns 1 old is left begins as a square root. Old cells are joined two by two. At the
!> end of the time given, the survivors are emptied at the rate reached, with what its change
!> leaves to expect.
!>
!> Reads lines `load threshold order cells time`, writes lines `load threshold share survivors`.
!> Lengths are in units of l/2, so tau = pi/2. Made for `renewal_fit.py`, which fits the results.
module renewal_closure_equations
  use, intrinsic :: iso_fortran_env, only: real64
  implicit none (type, external)
  private
  public :: wp, solve

  integer, parameter :: wp = real64
  integer, parameter :: most = 400 !< cells, at most
  real(wp), parameter :: least_probability = 1e-250_wp !< below it nobody is asked who leaves

contains

  !> Chance to be inside at that age
  pure elemental function stays(age) result(chance)
    real(wp), intent(in) :: age
    real(wp) :: chance
    chance = 1.0_wp
    if (age > 1.0_wp) chance = 1.0_wp/(age**2 + age*sqrt((age - 1.0_wp)*(age + 1.0_wp)))
  end function stays

  !> Mean time inside up to that age
  pure elemental function stayed(age) result(time)
    real(wp), intent(in) :: age
    real(wp) :: time
    time = age
    if (age > 1.0_wp) time = 1.0_wp/(age + sqrt((age - 1.0_wp)*(age + 1.0_wp))) + acos(1.0_wp/age)
  end function stayed

  !> Integrates to the time `longest`; `left` is the chance to last longer
  subroutine solve(nu, top, order, cells, longest, share, left)
    real(wp), intent(in) :: nu, longest
    integer, intent(in) :: top, order, cells
    real(wp), intent(out) :: share, left
    real(wp), allocatable :: old(:), mid(:), slope(:), total(:)
    real(wp) :: from(most), to(most), h, t, u, du, cycle, s0, s1, d0, d1, w0, w1, p
    real(wp) :: rate, before, limit
    integer :: k, n, steps, at, size1, i
    h = 1.0_wp/cells
    k = cells
    do i = 1, k
      from(i) = (i - 1)*h
      to(i) = i*h
    end do
    size1 = length(k, order)*(top + 1)
    allocate (old(size1))
    ! no one leaves before time 1: Poisson numbers, each at a place of its own
    p = exp(-nu)
    cycle = 0.0_wp
    s1 = 0.0_wp
    do n = 0, top
      s1 = s1 + p
      cycle = cycle + (1.0_wp - s1)/nu
      call fill(old(n*length(k, order) + 1:(n + 1)*length(k, order)), p, n, k, order)
      p = p*nu/(n + 1)
    end do
    steps = max(8, ceiling(6.0_wp*h*nu))
    du = 1.0_wp/steps
    t = 1.0_wp
    rate = 1.0_wp
    do while (t < longest .and. s1 > 1e-10_wp)
      call append(old, from, to, k, top, order, t, h)
      size1 = size(old)
      allocate (mid(size1), slope(size1), total(size1))
      do at = 0, steps - 1
        u = at*du
        s0 = survival(old, k, order, top)
        call rates(old, slope, t, h, u, from, to, k, nu, top, order)
        d0 = survival(slope, k, order, top)
        total = slope
        mid = old + 0.5_wp*du*slope
        call rates(mid, slope, t, h, u + 0.5_wp*du, from, to, k, nu, top, order)
        total = total + 2.0_wp*slope
        mid = old + 0.5_wp*du*slope
        call rates(mid, slope, t, h, u + 0.5_wp*du, from, to, k, nu, top, order)
        total = total + 2.0_wp*slope
        mid = old + du*slope
        call rates(mid, slope, t, h, u + du, from, to, k, nu, top, order)
        old = old + du/6.0_wp*(total + slope)
        s1 = survival(old, k, order, top)
        d1 = -nu*old(top*length(k, order) + 1)*2.0_wp*h*(u + du)
        w0 = 2.0_wp*h*u
        w1 = 2.0_wp*h*(u + du)
        ! Simpson's rule, the middle by Hermite's interpolation
        cycle = cycle + du/6.0_wp*(w0*s0 + w1*s1 &
          + 2.0_wp*(w0 + w1)*(0.5_wp*(s0 + s1) + du/8.0_wp*(d0 - d1)))
      end do
      before = rate
      rate = nu*old(top*length(k, order) + 1)/s1
      deallocate (mid, slope, total)
      t = t + h
      call merge_old(old, from, to, k, top, order, t, h)
    end do
    left = s1
    limit = rate + (rate - before)*(t - h)/h
    if (limit > 0.5_wp*rate .and. limit < 2.0_wp*rate) then
      rate = limit + (rate - limit)*t/(t + 1.0_wp/rate)
    end if
    cycle = cycle + s1/rate
    share = 1.0_wp - (top + 1)/(nu*cycle)
  end subroutine solve

  !> Numbers kept for each n: probability, density, pairs, triples
  pure function length(k, order) result(count)
    integer, intent(in) :: k, order
    integer :: count
    count = 1 + k
    if (order > 1) count = count + k*k
    if (order > 2) count = count + k*k*k
  end function length

  !> n independent ones, spread evenly
  subroutine fill(part, p, n, k, order)
    real(wp), intent(out) :: part(:)
    real(wp), intent(in) :: p
    integer, intent(in) :: n, k, order
    part(1) = p
    part(2:k + 1) = p*n/k
    if (order > 1) part(k + 2:k + 1 + k*k) = p*n*(n - 1)/real(k, wp)**2
    if (order > 2) part(k + 2 + k*k:) = p*n*(n - 1.0_wp)*(n - 2)/real(k, wp)**3
  end subroutine fill

  !> Chance that the gate was not emptied yet
  pure function survival(state, k, order, top) result(total)
    real(wp), intent(in) :: state(:)
    integer, intent(in) :: k, order, top
    real(wp) :: total
    integer :: n
    total = 0.0_wp
    do n = 0, top
      total = total + state(n*length(k, order) + 1)
    end do
  end function survival

  !> Opens the cell of those who come now
  subroutine append(state, from, to, k, top, order, t, h)
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
    call regroup(state, group, k, k + 1, top, order)
    k = k + 1
  end subroutine append

  !> Joins pairs of old cells
  subroutine merge_old(state, from, to, k, top, order, t, h)
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
    call regroup(state, group, k, made, top, order)
    k = made
  end subroutine merge_old

  !> Sums what is in cells of one group
  subroutine regroup(state, group, k, made, top, order)
    real(wp), allocatable, intent(inout) :: state(:)
    integer, intent(in) :: group(:), k, made, top, order
    real(wp), allocatable :: new(:)
    integer :: n, a, b, i, j, l, place
    allocate (new(length(made, order)*(top + 1)), source=0.0_wp)
    do n = 0, top
      a = n*length(k, order) + 1
      b = n*length(made, order) + 1
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
  end subroutine regroup

  !> Slopes at a place u within the current cell, t = t0 + h u^2
  subroutine rates(state, slope, t0, h, u, from, to, k, nu, top, order)
    integer, intent(in) :: k, top, order
    real(wp), intent(in) :: state(length(k, order), 0:top), t0, h, u, from(:), to(:), nu
    real(wp), intent(out) :: slope(length(k, order), 0:top)
    real(wp) :: mu(k), t, out(length(k, order)), weight, own
    integer :: i, j, l, n, a
    t = t0 + h*u*u
    weight = 2.0_wp*h*u
    do i = 1, k
      mu(i) = 0.0_wp
      if (t - from(i) > 1.0_wp) then
        own = min(to(i), t)
        mu(i) = (stays(t - own) - stays(t - from(i)))/(stayed(t - from(i)) - stayed(t - own))
      end if
    end do
    slope = 0.0_wp
    do n = 0, top
      call leaving(state(:, n), out, mu, n, k, order)
      slope(:, n) = slope(:, n) - nu*state(:, n) - out
      if (n > 0) slope(:, n - 1) = slope(:, n - 1) + out
      if (n > 0) slope(:, n) = slope(:, n) + nu*state(:, n - 1)
      ! those tagged leave themselves
      do i = 1, k
        slope(1 + i, n) = slope(1 + i, n) - mu(i)*state(1 + i, n)
      end do
      if (order > 1) then
        do j = 1, k
          a = 1 + k + k*(j - 1)
          slope(a + 1:a + k, n) = slope(a + 1:a + k, n) - (mu(:k) + mu(j))*state(a + 1:a + k, n)
        end do
      end if
      if (order > 2) then
        do l = 1, k
          do j = 1, k
            a = 1 + k + k*k + k*(j - 1) + k*k*(l - 1)
            slope(a + 1:a + k, n) = slope(a + 1:a + k, n) &
              - (mu(:k) + mu(j) + mu(l))*state(a + 1:a + k, n)
          end do
        end do
      end if
      if (n == 0) cycle
      ! those who come are tagged
      slope(1 + k, n) = slope(1 + k, n) + nu*state(1, n - 1)
      if (order > 1) then
        do j = 1, k
          a = 1 + k
          slope(a + k + k*(j - 1), n) = slope(a + k + k*(j - 1), n) + nu*state(1 + j, n - 1)
          slope(a + j + k*(k - 1), n) = slope(a + j + k*(k - 1), n) + nu*state(1 + j, n - 1)
        end do
      end if
      if (order > 2) then
        do j = 1, k
          do i = 1, k
            own = nu*state(1 + k + i + k*(j - 1), n - 1)
            a = 1 + k + k*k
            call add(slope(a + i + k*(j - 1) + k*k*(k - 1), n), own)
            call add(slope(a + i + k*(k - 1) + k*k*(j - 1), n), own)
            call add(slope(a + k + k*(i - 1) + k*k*(j - 1), n), own)
          end do
        end do
      end if
    end do
    slope = slope*weight
  end subroutine rates

  pure subroutine add(sum, more)
    real(wp), intent(inout) :: sum
    real(wp), intent(in) :: more

    sum = sum + more
  end subroutine add

  !> Rate at which untagged ones leave, tagged places kept
  pure subroutine leaving(state, out, mu, n, k, order)
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
  end subroutine leaving
end module renewal_closure_equations

program renewal_closure
  use renewal_closure_equations, only: wp, solve
  use, intrinsic :: iso_fortran_env, only: input_unit, output_unit
  implicit none (type, external)
  real(wp), parameter :: half_pi = 1.57079632679489661923_wp
  integer :: threshold, order, cells, status
  real(wp) :: load, longest, share, left
  do
    read (input_unit, *, iostat=status) load, threshold, order, cells, longest
    if (status /= 0) exit
    call solve(load/half_pi, threshold, order, cells, longest, share, left)
    write (output_unit, '(es24.16,1x,i0,2(1x,es24.16))') load, threshold, share, left
    flush (output_unit)
  end do
end program renewal_closure
