!> What is wrong with a plan; what is wrong with many points of its scan is told once.
module battery_problems
  use battery_remarks, only: most_reported
  implicit none (type, external)
  private
  public :: problem_type, gathered_type, add_point_problems, reported_problems

  !> So many problems of points are kept: what can be told one by one.
  integer, parameter :: most_kept = most_reported

  !> Something wrong with a plan: the key, its value, and what is allowed instead.
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
  type :: gathered_type
    type(problem_type), allocatable :: different(:), of_values(:)
    !> How many points have problems, and whether more of either kind were there.
    integer :: points = 0
    logical :: more_different = .false., more_values = .false.
  end type gathered_type

contains

  !> Puts the problems of one point to those of the points before.
  pure subroutine add_point_problems(gathered, problems, point)
    type(gathered_type), intent(inout) :: gathered
    !> Of the point.
    type(problem_type), intent(in) :: problems(:)
    !> Its number.
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

  !> What is told of points: all problems that differ, or where they are too many, those of each
  !> value.
  pure function reported_problems(gathered) result(problems)
    type(gathered_type), intent(in) :: gathered
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
