!> Standard errors from block averages of a time series whose length is not known beforehand.
!>
!> **Blocks.** Averages over blocks of equal length are stored. When there are `most_blocks`,
!> adjacent blocks are merged, and blocks become twice as long: at the end there are at least
!> `most_blocks`/2.
!>
!> **Error.** The variance of the mean over a run is the spectral density of the series at
!> frequencies below one over the run. So the standard error is computed from the slowest components
!> of the series, not from the scatter of the blocks, which would have to be longer than the memory
!> of the process. The components are those of the discrete cosine transform of the blocks:
!> orthogonal to each other and to the mean, and of equal variance where the spectrum is flat
!> (Lazarus, Lewis, Stock and Watson, J. Bus. Econ. Stat. 36, 541 (2018)).
!>
!> **Long memory.** If correlations decay slowly, as with particles that circulate, the spectrum
!> still rises below the slowest component, which alone would underestimate the error. So the
!> spectrum is extrapolated: it rises from the slowest two components to frequency 0 by as much as
!> it rose from the faster ones to these two; if it did not rise, the mean of the two is taken. A
!> factor accounts for the scatter of so few components, as in Student's t.
!>
!> **Skewness.** If the mean is dominated by rare events, a run with few of them underestimates both
!> the mean and the components. So the square of the error increases with the squared skewness of
!> the blocks, by a factor of two at most.
!>
!> A run that is no longer than its memory has nearly all of its variance in the slowest two
!> components: then no error is given.
module battery_blocks
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use battery_kinds, only: wp, dp, pi
  use battery_quantities, only: unknown_real
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: blocks_type, most_blocks, add_block, standard_error, error_of_mean, &
    serialize_blocks

  integer, parameter :: most_blocks = 64

  !> Values that differ by at most this fraction of the greatest differ by rounding.
  real(dp), parameter, public :: rounding = 1.0e-12_dp

  !> Averages over the blocks of a run, all of equal length.
  type :: blocks_type
    !> Length of a block in time units; number of complete blocks.
    real(wp) :: length = 1.0_wp
    integer :: count = 0
    real(wp) :: average(most_blocks) = 0.0_wp
  end type blocks_type

contains

  !> Adds the average over a complete block; merges adjacent blocks when there are `most_blocks`.
  pure subroutine add_block(blocks, average)
    type(blocks_type), intent(inout) :: blocks
    !> In the unit of the quantity.
    real(wp), intent(in) :: average
    integer :: half_count

    blocks%count = blocks%count + 1
    blocks%average(blocks%count) = average
    if (blocks%count < most_blocks) return
    half_count = most_blocks/2
    blocks%average(:half_count) = 0.5_wp*(blocks%average(1:most_blocks:2) &
      + blocks%average(2:most_blocks:2))
    blocks%count = half_count
    blocks%length = 2.0_wp*blocks%length
  end subroutine add_block

  !> Standard error of the mean, in the unit of the quantity: half the width of an interval that
  !> covers the mean in 70 % of runs. NaN if there are fewer than `most_blocks`/2 blocks, if they do
  !> not scatter, or if the run is no longer than its memory.
  pure function standard_error(blocks) result(error)
    type(blocks_type), intent(in) :: blocks
    real(dp) :: error
    !> Number of components; the last of the slow and the first of the fast ones.
    integer, parameter :: components = 16, slow = 2, fast = 5
    !> Greatest variance of the slow components relative to the fast ones.
    real(dp), parameter :: steepest = 12.0_dp
    !> Factor with which 70 % of the intervals cover the mean of white noise of 32 to 63 blocks
    !> (1.25: 68.3 %), from 4e5 samples.
    real(dp), parameter :: factor = 1.31_dp
    !> Scatter up to this fraction of the blocks is rounding.
    real(wp), parameter :: rounding = 1024.0_wp*epsilon(1.0_wp)
    !> Square of the skewness that makes the square of the error twice as large.
    real(dp), parameter :: very_skew = 5.0_dp
    real(dp) :: power(components), near, far
    integer :: n

    error = unknown_real()
    n = blocks%count
    if (n < most_blocks/2) return
    if (.not. maxval(blocks%average(:n)) - minval(blocks%average(:n)) &
      > rounding*maxval(abs(blocks%average(:n)))) return
    power = cosine_powers(real(blocks%average(:n), dp), components)
    near = sum(power(:slow))/slow
    far = sum(power(fast:))/(components - fast + 1)
    if (near > steepest*far) return
    error = factor*sqrt((near + max(0.0_dp, near - far)) &
      *(1.0_dp + min(1.0_dp, squared_skewness(real(blocks%average(:n), dp))/very_skew))/n)
  end function standard_error

  !> Square of the skewness of values, not all of which are equal.
  pure function squared_skewness(values) result(square)
    real(dp), intent(in) :: values(:)
    real(dp) :: square
    real(dp), allocatable :: deviations(:), squares(:), cubes(:)
    integer :: n

    n = size(values)
    deviations = values - sum(values)/n
    deviations = deviations/maxval(abs(deviations))
    ! Stored before they are summed, as in `error_of_mean`.
    squares = deviations**2
    cubes = deviations*squares
    square = n*sum(cubes)**2/sum(squares)**3
  end function squared_skewness

  !> Squares of the slowest components of the cosine transform of a series: each estimates its
  !> variance where the spectrum is flat.
  pure function cosine_powers(values, components) result(power)
    real(dp), intent(in) :: values(:)
    !> Number of components.
    integer, intent(in) :: components
    real(dp) :: power(components)
    real(dp), parameter :: digits = 2.0_dp**30
    real(dp), allocatable :: term(:)
    integer :: j, k, n

    n = size(values)
    do j = 1, components
      ! Stored before they are summed, as in `error_of_mean`; the cosine without its last digits, in
      ! which libraries differ.
      term = (values - sum(values)/n)*[(anint(digits*cos(pi*j*(k - 0.5_dp)/n))/digits, k=1, n)]
      power(j) = 2*sum(term)**2/n
    end do
  end function cosine_powers

  !> Standard error of the mean of independent values, from their scatter; 0 where that is rounding,
  !> NaN for fewer than two values.
  pure function error_of_mean(values) result(error)
    !> In the unit of the quantity, as the error.
    real(dp), intent(in) :: values(:)
    real(dp) :: error
    real(dp), allocatable :: squares(:)
    integer :: n

    error = unknown_real()
    n = size(values)
    if (n < 2) return
    ! The squares are stored before they are summed: otherwise the last bit would depend on which
    ! products are fused with sums, and so on the length of the processor's vectors.
    squares = (values - sum(values)/n)**2
    error = sqrt(sum(squares)/(real(n, dp)*real(n - 1, dp)))
    if (ieee_is_nan(error)) return
    if (error < rounding*maxval(abs(values))) error = 0.0_dp
  end function error_of_mean

  !> Saves or restores the block averages.
  pure subroutine serialize_blocks(blocks, archive)
    type(blocks_type), intent(inout) :: blocks
    type(archive_type), intent(inout) :: archive

    call archive%serialize('length', blocks%length)
    call archive%serialize('count', blocks%count)
    call archive%serialize('average', blocks%average)
  end subroutine serialize_blocks

end module battery_blocks
