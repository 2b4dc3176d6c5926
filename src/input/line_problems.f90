!> Problems of an input file with their lines; collected, and reported in the order of lines.
module battery_line_problems
  use battery_text, only: to_text, new_line_character
  implicit none (type, external)
  private
  public :: line_problems_type, add_line_problem, line_problems_text, displayable_text

  !> Largest number of problems that are reported one by one; of the others, only the number.
  integer, parameter, public :: most_reported = 50

  !> Largest number of letters of a word of the file that a problem quotes.
  integer, parameter :: most_letters = 80

  !> One problem and its line; 0: it concerns the whole file.
  type :: line_problem_type
    integer :: line = 0
    character(len=:), allocatable :: text
  end type line_problem_type

  !> All problems of one file.
  type :: line_problems_type
    integer :: count = 0
    !> Problems that are reported: the first ones in the order of lines, and the last one.
    type(line_problem_type), private :: first(most_reported), last
  end type line_problems_type

contains

  !> Adds a problem of a line, or of the whole file if `line` is 0.
  pure subroutine add_line_problem(problems, line, text)
    !> Problems of the file so far.
    type(line_problems_type), intent(inout) :: problems
    !> Line of the namelist, from 1.
    integer, intent(in) :: line
    !> Problem, with its place in the line and the allowed values.
    character(len=*), intent(in) :: text
    type(line_problem_type) :: problem
    integer :: place, reported

    problem%line = line
    problem%text = text
    reported = min(problems%count, most_reported)
    place = 1 + count(problems%first(:reported)%line <= line)
    if (place <= most_reported) then
      reported = min(reported + 1, most_reported)
      problems%first(place + 1:reported) = problems%first(place:reported - 1)
      problems%first(place) = problem
    end if
    if (line >= problems%last%line) problems%last = problem
    problems%count = problems%count + 1
  end subroutine add_line_problem

  !> All problems of the file `name`, one per line, in the order of its lines, those without a line
  !> first; if there are many, the first ones, the last one and the number of all. Empty: none.
  pure function line_problems_text(problems, name) result(text)
    !> Problems of the file.
    type(line_problems_type), intent(in) :: problems
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: text
    integer :: at

    text = ''
    do at = 1, min(problems%count, most_reported)
      if (at > 1) text = text//new_line_character
      text = text//one_text(problems%first(at), name)
    end do
    if (problems%count > most_reported) text = text//new_line_character//'... and ' &
      //to_text(problems%count - most_reported)//' more; the last: '//one_text(problems%last, name)
  end function line_problems_text

  !> Text of one problem.
  pure function one_text(problem, name) result(text)
    type(line_problem_type), intent(in) :: problem
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: text

    text = name
    if (problem%line > 0) text = text//', line '//to_text(problem%line)
    text = text//': '//problem%text
  end function one_text

  !> A word of a file made safe to print: shortened, control characters replaced by `?`.
  pure function displayable_text(word) result(shown)
    !> Word of the file.
    character(len=*), intent(in) :: word
    character(len=:), allocatable :: shown
    integer :: at

    shown = word(:min(len(word), most_letters))
    do at = 1, len(shown)
      if (iachar(shown(at:at)) < 32 .or. iachar(shown(at:at)) == 127) shown(at:at) = '?'
    end do
    if (len(word) > most_letters) shown = shown//' ...'
  end function displayable_text

end module battery_line_problems
