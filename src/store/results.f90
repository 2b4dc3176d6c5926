!> All that a scan has measured, in arrays: one entry a point of the scan and a replica.
!>
!> The first index runs fastest, so readers in C or Python see the dimensions reversed.
module battery_results
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  use battery_kinds, only: dp, int32, int64
  implicit none (type, external)
  private
  public :: results_type, new_results, spread_of, unknown_real
  public :: task_complete, task_failed, task_not_done

  !> Values of `task_status`.
  integer(int32), parameter :: task_complete = 0, task_failed = 1, task_not_done = 2

  !> Reals that are not known are NaN, integers -1. Lengths are in units of the namelist, times in
  !> lengths over the speed.
  type :: results_type
    integer :: points = 0, replicas = 0
    !> The points of the scan, (point): N, T, particles in urn 1 at the start, widths.
    integer(int32), allocatable :: number(:), threshold(:), urn1_number(:)
    real(dp), allocatable :: channel1_width(:), channel2_width(:)
    !> From here on (replica, point).
    integer(int64), allocatable :: seed(:, :)
    real(dp), allocatable :: chi(:, :), chi_error(:, :), chi_collision(:, :)
    real(dp), allocatable :: current1(:, :), current1_error(:, :)
    real(dp), allocatable :: current2(:, :), current2_error(:, :)
    real(dp), allocatable :: flow1_12(:, :), flow1_21(:, :), flow2_12(:, :), flow2_21(:, :)
    !> Measured time, time of the transient before it, seconds of the processor.
    real(dp), allocatable :: time(:, :), transient_time(:, :), cpu_seconds(:, :)
    integer(int64), allocatable :: collisions(:, :), bounce_backs(:, :), reversals(:, :), &
      trapped(:, :)
    integer(int32), allocatable :: task_status(:, :)

    !> Series, if asked for: times since the start; N1 as (time, replica, point); crossings per unit
    !> time since the entry before as (time, replica, point, which), which is 1_12, 1_21, 2_12,
    !> 2_21.
    real(dp), allocatable :: series_time(:)
    integer(int32), allocatable :: series_urn1_number(:, :, :)
    real(dp), allocatable :: series_flow(:, :, :, :)
    !> Snapshots, if asked for: times since the start; (particle, snapshot, replica, point).
    real(dp), allocatable :: snapshot_time(:)
    real(dp), allocatable, dimension(:, :, :, :) :: snapshot_x, snapshot_y, snapshot_ux, snapshot_uy
    !> Event log of the only task, if asked for.
    real(dp), allocatable :: event_time(:)
    integer(int32), allocatable :: event_kind(:), event_where(:), event_particle(:)
    !> Final state, if asked for: (particle, replica, point).
    real(dp), allocatable, dimension(:, :, :) :: final_x, final_y, final_ux, final_uy
  end type results_type

contains

  !> Results of which nothing is known yet; what is optional is not allocated.
  subroutine new_results(results, points, replicas)
    type(results_type), intent(out) :: results
    integer, intent(in) :: points, replicas
    real(dp), allocatable :: nothing(:, :)
    integer(int64), allocatable :: no_count(:, :)

    results%points = points
    results%replicas = replicas
    allocate (nothing(replicas, points), source=unknown_real())
    allocate (no_count(replicas, points), source=-1_int64)
    allocate (results%number(points), results%threshold(points), results%urn1_number(points), &
      source=-1_int32)
    allocate (results%channel1_width(points), results%channel2_width(points), source=unknown_real())
    allocate (results%task_status(replicas, points), source=task_not_done)
    allocate (results%seed, results%collisions, results%bounce_backs, results%reversals, &
      results%trapped, source=no_count)
    allocate (results%chi, results%chi_error, results%chi_collision, source=nothing)
    allocate (results%current1, results%current1_error, source=nothing)
    allocate (results%current2, results%current2_error, source=nothing)
    allocate (results%flow1_12, results%flow1_21, results%flow2_12, results%flow2_21, &
      source=nothing)
    allocate (results%time, results%transient_time, results%cpu_seconds, source=nothing)
  end subroutine new_results

  !> Standard error of the mean of the replicas of each point, from their scatter over the complete
  !> tasks; NaN where fewer than two are complete.
  pure function spread_of(values, task_status) result(error)
    real(dp), intent(in) :: values(:, :)
    integer(int32), intent(in) :: task_status(:, :)
    real(dp) :: error(size(values, 2))
    real(dp), allocatable :: known(:)
    integer :: point, n

    error = unknown_real()
    do point = 1, size(values, 2)
      known = pack(values(:, point), task_status(:, point) == task_complete)
      n = size(known)
      if (n < 2) cycle
      known = known - sum(known)/n
      error(point) = sqrt(sum(known**2)/(real(n, dp)*real(n - 1, dp)))
    end do
  end function spread_of

  !> NaN, which stands for a real that is not known.
  pure function unknown_real() result(value)
    real(dp) :: value

    value = ieee_value(value, ieee_quiet_nan)
  end function unknown_real

end module battery_results
