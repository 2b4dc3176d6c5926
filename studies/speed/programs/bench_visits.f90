!> Speed of `compute_passages` alone, for the speed tables: it computes batches of passages
!> through an urn (called visits here and in the tables), as for the visits in a window of the
!> engine `excursion`.
module battery_bench_visits
  use battery_kinds, only: wp, dp, int64
  use battery_clocks, only: cpu_seconds
  use battery_random, only: hashed_uniform
  use battery_sampling, only: entry_of
  use battery_table, only: table_type
  use battery_urn, only: urn_type, compute_passages
  use battery_visits, only: visits_type, reserve_visits
  implicit none (type, external)
  private
  public :: entrances_type, rate_type, draw_entrances, measure_visits

  !> Rates of one round, per second of processor time: wall collisions, passages through an urn, and
  !> simulated time summed over the particles.
  type :: rate_type
    real(dp) :: collisions = 0.0_dp, visits = 0.0_dp, particle_time = 0.0_dp
  end type rate_type

  !> Number of passages in a batch, and of batches; all of them together fit into the cache.
  integer, parameter :: batch = 1024, batches = 32

  !> Starts of passages: positions uniform on the openings, directions by the cosine law. Arrays are
  !> (visit, batch).
  type :: entrances_type
    private
    type(urn_type) :: urn
    integer(int64), allocatable :: channel(:, :)
    real(wp), allocatable :: x(:, :), y(:, :), u_axial(:, :), u_lateral(:, :)
    !> Work space: the batch that is computed.
    type(visits_type) :: visits
  end type entrances_type

contains

  !> Draws the starts of passages through urn 1.
  subroutine draw_entrances(entrances, table)
    type(entrances_type), intent(out) :: entrances
    type(table_type), intent(in) :: table
    integer :: j, k

    entrances%urn = table%urn(1)
    allocate (entrances%channel(batch, batches), entrances%x(batch, batches), entrances%y(batch, &
      batches), entrances%u_axial(batch, batches), entrances%u_lateral(batch, batches))
    do k = 1, batches
      do j = 1, batch
        call entry_of(table, 1, hashed_uniform(int(j, int64), int(2*k, int64)), &
          hashed_uniform(int(j, int64), int(2*k + 1, int64)), entrances%channel(j, k), &
          entrances%x(j, k), entrances%y(j, k), entrances%u_axial(j, k), entrances%u_lateral(j, k))
      end do
    end do
    call reserve_visits(entrances%visits, batch)
    entrances%visits%urn = 1
    entrances%visits%time = 0.0_wp
    entrances%visits%count = batch
  end subroutine draw_entrances

  !> Computes all batches repeatedly for about `seconds` of processor time.
  subroutine measure_visits(entrances, seconds, rate)
    type(entrances_type), intent(inout) :: entrances
    real(dp), intent(in) :: seconds
    type(rate_type), intent(out) :: rate
    integer(int64) :: hits, visits
    real(dp) :: began, spent, time
    integer :: k

    hits = 0
    visits = 0
    time = 0.0_dp
    began = cpu_seconds()
    do
      do k = 1, batches
        associate (v => entrances%visits)
          v%channel(:batch) = entrances%channel(:, k)
          v%x(:batch) = entrances%x(:, k)
          v%y(:batch) = entrances%y(:, k)
          v%u_axial(:batch) = entrances%u_axial(:, k)
          v%u_lateral(:batch) = entrances%u_lateral(:, k)
          v%hits(:batch) = 0.0_wp
          call compute_passages(entrances%urn, v)
          hits = hits + v%all_hits
          visits = visits + batch
          time = time + sum(real(v%length(:batch), dp))
        end associate
      end do
      spent = cpu_seconds() - began
      if (spent > seconds) exit
    end do
    rate = rate_type(hits/spent, visits/spent, time/spent)
  end subroutine measure_visits

end module battery_bench_visits
