!> Problems of a plan; a problem of many points of its scan is reported once.
module battery_problems
  use battery_line_problems, only: most_reported
  implicit none (type, external)
  private
  public :: problem_type, point_problems_type, add_point_problems, reported_problems

  !> Greatest number of problems of points that are stored: as many as are reported one by one.
  integer, parameter :: most_kept = most_reported

  !> A problem of a plan: the key, its value, and what is allowed instead.
  type :: problem_type
    character(len=:), allocatable :: key, value, allowed
    !> Whether the value is one of a scan.
    logical :: scanned = .false.
    !> Number of points of the scan that have the problem, the first of them and the last; 0: it is
    !> no problem of points.
    integer :: points = 0, first_point = 0, last_point = 0
  end type problem_type

  !> Problems of points: those that differ in any component, and those that differ in key or value;
  !> of each kind at most `most_kept`.
  type :: point_problems_type
    type(problem_type), allocatable :: different(:), of_values(:)
    !> Number of points with problems; whether there were more problems of each kind.
    integer :: points = 0
    logical :: more_different = .false., more_values = .false.
  end type point_problems_type

contains

  !> Adds the problems of one point of the scan.
  pure subroutine add_point_problems(gathered, problems, point)
    !> Problems of the points so far.
    type(point_problems_type), intent(inout) :: gathered
    !> Problems of the point.
    type(problem_type), intent(in) :: problems(:)
    !> Index of the point.
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

  !> Increments the number of points of a problem, or adds the problem.
  pure subroutine count_problem(kept, problem, exactly, point, more)
    type(problem_type), allocatable, intent(inout) :: kept(:)
    type(problem_type), intent(in) :: problem
    !> Whether problems that differ only in what is allowed are different.
    logical, intent(in) :: exactly
    integer, intent(in) :: point
    !> Set if there are `most_kept` problems already.
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

  !> Problems of points to be reported: all that differ, or, if there are too many, one for each
  !> value of a key.
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
