!> Findings on an input: what is wrong in the text of a file, problems of the plan made from it, and
!> remarks on the plan. Problems are collected, and reported in the order of lines; a finding on
!> many points of a scan is reported once.
module battery_findings
  use battery_text, only: to_text, new_line_character
  implicit none (type, external)
  private
  public :: finding_type, findings_type, point_findings_type
  public :: finding_of, add_finding, findings_text, add_point_findings, suggestion, displayable_text

  !> Largest number of problems that are reported one by one, and of problems of points that are
  !> stored; of the others, only the number.
  integer, parameter, public :: most_reported = 50

  !> Largest number of letters of a word of the file that a problem quotes.
  integer, parameter :: most_letters = 80

  !> Kinds, by what `value` is: a sentence on the text; one on a group; the value of the key; a
  !> state of the key; the state that the key is missing; a remark on what is allowed. Of one line
  !> those on the text come first, and then those on groups.
  integer, parameter, public :: of_text = 1, of_group = 2, of_value = 3, of_state = 4, &
    of_missing = 5, of_remark = 6

  !> One finding. Components that it does not need are not allocated.
  type :: finding_type
    !> Line, from 1; 0: it concerns the whole file, or its line is not known yet.
    integer :: line = 0
    !> What was found, and what is allowed instead.
    character(len=:), allocatable :: value, allowed
    character(len=:), allocatable :: group, key
    integer :: kind = of_text
    !> Number of points of the scan that have it, the first of them and the last; 0: it is not about
    !> points.
    integer :: points = 0, first_point = 0, last_point = 0
  end type finding_type

  !> All problems of one file.
  type :: findings_type
    integer :: count = 0
    !> Problems that are reported: the first ones in the order of lines, and the last one.
    type(finding_type), private :: first(most_reported), last
  end type findings_type

  !> Findings on points, at most `most_reported`: all that differ or, if those are more, all that
  !> differ in key or value.
  type :: point_findings_type
    type(finding_type), allocatable :: list(:)
    !> Whether findings that differ only in what is allowed are different.
    logical :: exact = .true.
    !> Number of points with findings; whether there were more of them than are listed.
    integer :: points = 0
    logical :: more = .false.
  end type point_findings_type

contains

  !> Adds a problem of a line, or of the whole file if its line is 0.
  pure subroutine add_finding(findings, finding)
    !> Problems of the file so far.
    type(findings_type), intent(inout) :: findings
    type(finding_type), intent(in) :: finding
    integer :: place, reported

    reported = min(findings%count, most_reported)
    place = 1 + count(rank_of(findings%first(:reported)) <= rank_of(finding))
    if (place <= most_reported) then
      reported = min(reported + 1, most_reported)
      findings%first(place + 1:reported) = findings%first(place:reported - 1)
      findings%first(place) = finding
    end if
    if (rank_of(finding) >= rank_of(findings%last)) findings%last = finding
    findings%count = findings%count + 1
  end subroutine add_finding

  !> Rank of a finding among those of its file.
  elemental integer function rank_of(finding)
    type(finding_type), intent(in) :: finding

    rank_of = of_value*finding%line + min(finding%kind, of_value)
  end function rank_of

  !> A finding from its components.
  pure type(finding_type) function finding_of(line, value, allowed, group, key, kind) &
      result(finding)
    !> Line, from 1; 0: it concerns the whole file, or its line is not known yet.
    integer, intent(in) :: line
    !> What was found.
    character(len=*), intent(in) :: value
    !> What is allowed instead; group and key.
    character(len=*), intent(in), optional :: allowed, group, key
    !> Kind, if not `of_value` with a key and `of_text` without.
    integer, intent(in), optional :: kind

    finding%line = line
    finding%value = value
    if (present(allowed)) finding%allowed = allowed
    if (present(group)) finding%group = group
    if (present(key)) finding%key = key
    finding%kind = merge(of_value, of_text, present(key))
    if (present(kind)) finding%kind = kind
  end function finding_of

  !> All problems of the file `name`, or all remarks, one per line, in the order of its lines, those
  !> without a line first; if there are many, the first ones, the last one and the number of all.
  !> Empty: none.
  pure function findings_text(findings, name, column) result(text)
    !> Problems of the file.
    type(findings_type), intent(in) :: findings
    character(len=*), intent(in) :: name
    !> Number of columns before what is told; absent: as many as it needs.
    integer, intent(in), optional :: column
    character(len=:), allocatable :: text
    integer :: at

    text = ''
    do at = 1, min(findings%count, most_reported)
      if (at > 1) text = text//new_line_character
      text = text//one_text(findings%first(at), name, column)
    end do
    if (findings%count > most_reported) text = text//new_line_character//'... and ' &
      //to_text(findings%count - most_reported)//' more; the last: '//one_text(findings%last, name)
  end function findings_text

  !> Text of one problem.
  pure function one_text(finding, name, column) result(text)
    type(finding_type), intent(in) :: finding
    character(len=*), intent(in) :: name
    integer, intent(in), optional :: column
    character(len=:), allocatable :: text

    text = name
    if (finding%line > 0) text = text//', line '//to_text(finding%line)
    text = text//': '
    if (present(column)) text = text//repeat(' ', column - len(text))
    if (allocated(finding%group)) text = text//'&'//displayable_text(finding%group)
    if (allocated(finding%key)) then
      text = text//' '//displayable_text(finding%key)//trim(merge(' =', '  ', finding%kind &
        == of_value))//' '
    else if (allocated(finding%group)) then
      text = text//': '
    end if
    text = text//finding%value
    if (allocated(finding%allowed)) text = text//'; allowed: '//finding%allowed
  end function one_text

  !> Adds the findings on one point of the scan.
  pure subroutine add_point_findings(gathered, findings, point)
    !> Findings on the points so far; its list is allocated.
    type(point_findings_type), intent(inout) :: gathered
    !> Findings on the point.
    type(finding_type), intent(in) :: findings(:)
    !> Index of the point.
    integer, intent(in) :: point
    type(finding_type) :: found
    integer :: at

    if (size(findings) > 0) gathered%points = gathered%points + 1
    do at = 1, size(findings)
      found = findings(at)
      found%points = 1
      found%first_point = point
      found%last_point = point
      call count_finding(gathered, found)
    end do
  end subroutine add_point_findings

  !> Adds the points of a finding to those of one that is listed, or lists it.
  pure recursive subroutine count_finding(gathered, finding)
    type(point_findings_type), intent(inout) :: gathered
    type(finding_type), intent(in) :: finding
    type(finding_type), allocatable :: before(:)
    integer :: k

    do k = 1, size(gathered%list)
      associate (listed => gathered%list(k))
        if (listed%key /= finding%key .or. listed%value /= finding%value .or. &
          (listed%allowed /= finding%allowed .and. gathered%exact)) cycle
        listed%points = listed%points + finding%points
        listed%last_point = finding%last_point
        return
      end associate
    end do
    if (k <= most_reported) then
      gathered%list = [gathered%list, finding]
    else if (gathered%exact) then
      ! Too many: from now on they need only differ in key or value.
      gathered%exact = .false.
      before = [gathered%list, finding]
      gathered%list = before(:0)
      do k = 1, size(before)
        call count_finding(gathered, before(k))
      end do
    else
      gathered%more = .true.
    end if
  end subroutine count_finding

  !> Question whether a name, after its sign (such as `&`), was meant; empty if there is no name.
  pure function suggestion(sign, name) result(text)
    !> Sign, and name that exists; empty: none is similar.
    character(len=*), intent(in) :: sign, name
    character(len=:), allocatable :: text

    text = ''
    if (name /= '') text = ' (did you mean '//sign//name//'?)'
  end function suggestion

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

end module battery_findings
