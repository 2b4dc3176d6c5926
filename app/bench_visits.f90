!> Whole visits to an urn, and nothing else, for the speed tables: batch after batch is given to
!> `compute_visits`, as the engine `excursion` does with the visits of a window.
module battery_bench_visits
  use battery_kinds, only: wp, dp, int64
  use battery_bench_rows, only: rate_type
  use battery_clocks, only: cpu_seconds
  use battery_random, only: hashed_uniform
  use battery_table, only: table_type, gated, ungated
  use battery_urn, only: urn_type, compute_visits
  use battery_visits, only: visits_type, reserve_visits
  implicit none (type, external)
  private
  public :: visitors_type, invite, receive

  !> Visits of a batch, and batches that are drawn: together they fit into the cache.
  integer, parameter :: batch = 1024, batches = 32

  !> Ways into an urn, uniform on its openings, by the law of cosines: (visit, batch).
  type :: visitors_type
    private
    type(urn_type) :: urn
    integer(int64), allocatable :: channel(:, :)
    real(wp), allocatable :: x(:, :), y(:, :), u_axial(:, :), u_lateral(:, :)
    type(visits_type) :: visits
  end type visitors_type

contains

  !> Draws ways into urn 1.
  subroutine invite(visitors, table)
    type(visitors_type), intent(out) :: visitors
    type(table_type), intent(in) :: table
    real(wp) :: place, sine, width(2)
    integer :: j, k

    visitors%urn = table%urn(1)
    width = table%channel%width
    allocate (visitors%channel(batch, batches), visitors%x(batch, batches), visitors%y(batch, &
      batches), visitors%u_axial(batch, batches), visitors%u_lateral(batch, batches))
    do k = 1, batches
      do j = 1, batch
        place = sum(width)*hashed_uniform(int(j, int64), int(2*k, int64))
        sine = 2.0_wp*hashed_uniform(int(j, int64), int(2*k + 1, int64)) - 1.0_wp
        visitors%u_lateral(j, k) = sine
        visitors%u_axial(j, k) = sqrt((1.0_wp - sine)*(1.0_wp + sine))
        if (place < width(gated)) then
          visitors%channel(j, k) = gated
          visitors%x(j, k) = table%urn(1)%chord(gated)
          visitors%y(j, k) = place - 0.5_wp*width(gated)
          visitors%u_axial(j, k) = -visitors%u_axial(j, k)
        else
          visitors%channel(j, k) = ungated
          visitors%x(j, k) = -table%urn(1)%chord(ungated)
          visitors%y(j, k) = place - width(gated) - 0.5_wp*width(ungated)
        end if
      end do
    end do
    call reserve_visits(visitors%visits, batch)
    visitors%visits%urn = 1
    visitors%visits%time = 0.0_wp
    visitors%visits%count = batch
  end subroutine invite

  !> Lets them visit for about so many seconds.
  subroutine receive(visitors, seconds, rate)
    type(visitors_type), intent(inout) :: visitors
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
        associate (v => visitors%visits)
          v%channel(:batch) = visitors%channel(:, k)
          v%x(:batch) = visitors%x(:, k)
          v%y(:batch) = visitors%y(:, k)
          v%u_axial(:batch) = visitors%u_axial(:, k)
          v%u_lateral(:batch) = visitors%u_lateral(:, k)
          v%hits(:batch) = 0.0_wp
          call compute_visits(visitors%urn, v)
          hits = hits + v%all_hits
          visits = visits + batch
          time = time + sum(real(v%length(:batch), dp))
        end associate
      end do
      spent = cpu_seconds() - began
      if (spent > seconds) exit
    end do
    rate = rate_type(hits/spent, visits/spent, time/spent)
  end subroutine receive

end module battery_bench_visits
