!> The numbers that a scan has measured, as arrays with an entry for each point and replica. Series,
!> states and events, which are large, are in `task_output_type` of `battery_results_file`.
!>
!> The first index runs fastest, so readers in C or Python see the dimensions reversed.
module battery_results
  use battery_kinds, only: dp, int32, int64
  use battery_blocks, only: error_of_mean
  use battery_plan, only: plan_type, point_type, point_of, table_of
  use battery_table, only: table_type
  use battery_text, only: string_type
  use battery_quantities, only: real_quantities, integer_quantities, unknown_real, unknown_count
  implicit none (type, external)
  private
  public :: results_type, new_results, set_points, scatter_of
  public :: task_complete, task_failed, task_not_done, task_not_asked, all_tasks_complete
  public :: point_precise, point_not_precise, point_two_states, point_undecided

  !> Values of `task_status`; `task_not_asked`: replicas beyond those that a precision needs.
  integer(int32), parameter :: task_complete = 0, task_failed = 1, task_not_done = 2, &
    task_not_asked = 3

  !> Values of `point_status`.
  integer(int32), parameter :: point_precise = 0, point_not_precise = 1, point_two_states = 2, &
    point_undecided = 3

  !> Results of all tasks. Unknown reals are NaN, unknown integers -1. Lengths are in the unit of
  !> the namelist, times in lengths over the speed.
  type :: results_type
    !> The points of the scan.
    type(point_type), allocatable :: point(:)
    integer(int64), allocatable :: seed(:, :)
    !> The arrays from here on are (replica, point, place of the quantity in its list).
    real(dp), allocatable :: average(:, :, :), error(:, :, :)
    integer(int64), allocatable :: counted(:, :, :)
    !> Machines that tasks ran on; `provenance/host` counts them from 0.
    type(string_type), allocatable :: host(:)
    integer(int32), allocatable :: task_status(:, :)
    !> If a precision is required: status of each point, and standard errors over its replicas, as
    !> (point, 1 for chi or 2 for polarised_current).
    integer(int32), allocatable :: point_status(:)
    real(dp), allocatable :: replica_error(:, :)
    !> Number of replicas required at each point.
    integer, allocatable :: replicas_needed(:)
    !> Reason for which each task failed, in the order of the tasks; not allocated for the others.
    type(string_type), allocatable :: failure(:)
    !> Number of complete tasks that ended before the last snapshot.
    integer :: short_tasks = 0
  end type results_type

contains

  !> Makes results with unknown values; optional arrays are not allocated.
  subroutine new_results(results, points, replicas)
    type(results_type), intent(out) :: results
    !> Number of points, and of replicas of each.
    integer, intent(in) :: points, replicas

    allocate (results%point(points), results%host(0))
    allocate (results%failure(points*replicas))
    allocate (results%task_status(replicas, points), source=task_not_done)
    allocate (results%seed(replicas, points), source=unknown_count)
    allocate (results%average(replicas, points, size(real_quantities())), &
      source=unknown_real())
    results%error = results%average
    allocate (results%counted(replicas, points, size(integer_quantities())), source=unknown_count)
  end subroutine new_results

  !> Sets the points of the scan, with the radii of the table, which are those of polygons too.
  subroutine set_points(results, plan)
    type(results_type), intent(inout) :: results
    type(plan_type), intent(in) :: plan
    type(table_type) :: table
    integer :: p

    do p = 1, plan%point_count
      results%point(p) = point_of(plan, p)
      table = table_of(plan, results%point(p))
      results%point(p)%urn_radius = table%urn%radius
    end do
  end subroutine set_points

  !> Whether all tasks are complete, except those that a precision does not need.
  pure logical function all_tasks_complete(results) result(yes)
    type(results_type), intent(in) :: results

    yes = all(results%task_status == task_complete .or. results%task_status == task_not_asked)
  end function all_tasks_complete

  !> Standard error of the mean over the replicas of each point, from the scatter of the complete
  !> tasks; NaN if fewer than two are complete.
  pure function scatter_of(values, task_status) result(error)
    !> (replica, point).
    real(dp), intent(in) :: values(:, :)
    !> (replica, point).
    integer(int32), intent(in) :: task_status(:, :)
    !> (point).
    real(dp) :: error(size(values, 2))
    integer :: point

    do point = 1, size(values, 2)
      error(point) = error_of_mean(pack(values(:, point), task_status(:, point) == task_complete))
    end do
  end function scatter_of

end module battery_results
