!> Problems of a plan; one that many points of its scan have is reported once.
module battery_problems
  use battery_remarks, only: most_reported
  implicit none (type, external)
  private
  public :: problem_type, point_problems_type, add_point_problems, reported_problems

  !> Greatest number of problems of points that are kept: as many as are reported one by one.
  integer, parameter :: most_kept = most_reported

  !> A problem of a plan: the key, its value, and what is allowed instead.
  type :: problem_type
    character(len=:), allocatable :: key, value, allowed
    !> Whether the value is one of a scan.
    logical :: scanned = .false.
    !> How many points of the scan have it, the first of them and the last; 0: it is not one of
    !> points.
    integer :: points = 0, first_point = 0, last_point = 0
  end type problem_type

  !> The problems of points: those that differ, and those that differ in key or value, whatever is
  !> allowed; of either kind no more than are kept.
  type :: point_problems_type
    type(problem_type), allocatable :: different(:), of_values(:)
    !> How many points have problems, and whether more of either kind were there.
    integer :: points = 0
    logical :: more_different = .false., more_values = .false.
  end type point_problems_type

contains

  !> Adds the problems of one point of the scan.
  pure subroutine add_point_problems(gathered, problems, point)
    !> Problems of the points before.
    type(point_problems_type), intent(inout) :: gathered
    !> Problems of the point.
    type(problem_type), intent(in) :: problems(:)
    !> Number of the point.
    integer, intent(in) :: point
    integer :: at

    if (.not. allocated(gathered%different)) &
      allocate (gathered%different(0), gathered%of_values(0))
    if (size(problems) > 0) gathered%points = gathered%points + 1
    do at = 1, size(problems)
      call count_problem(gathered%different, problems(at), .true., point, gathered%more_different)
      call count_problem(gathered%of_values, problems(at), .false., point, gathered%more_values)
    end do
  end subroutine add_point_problems

  !> Counts one more point of a problem.
  pure subroutine count_problem(kept, problem, exactly, point, more)
    type(problem_type), allocatable, intent(inout) :: kept(:)
    type(problem_type), intent(in) :: problem
    !> Whether what is allowed is to be the same as well.
    logical, intent(in) :: exactly
    integer, intent(in) :: point
    !> Set where there is no place for it.
    logical, intent(inout) :: more
    integer :: k

    do k = 1, size(kept)
      if (kept(k)%key /= problem%key .or. kept(k)%value /= problem%value) cycle
      if (kept(k)%allowed == problem%allowed .or. .not. exactly) exit
    end do
    more = more .or. k > most_kept
    if (k > most_kept) return
    if (k > size(kept)) then
      kept = [kept, problem]
      kept(k)%first_point = point
    end if
    kept(k)%points = kept(k)%points + 1
    kept(k)%last_point = point
  end subroutine count_problem

  !> Problems of points to be reported: all that differ, or where they are too many, those of each
  !> value.
  pure function reported_problems(gathered) result(problems)
    !> Problems of all points, from `add_point_problems`.
    type(point_problems_type), intent(in) :: gathered
    type(problem_type), allocatable :: problems(:)

    if (.not. allocated(gathered%different)) then
      allocate (problems(0))
    else if (gathered%more_different) then
      problems = gathered%of_values
    else
      problems = gathered%different
    end if
  end function reported_problems

end module battery_problems
