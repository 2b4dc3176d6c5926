!> Problems of an input file with their lines; collected, and reported in the order of lines.
module battery_remarks
  use battery_text, only: to_text, new_line_character
  implicit none (type, external)
  private
  public :: remarks_type, add_remark, remarks_text, displayable_text

  !> Largest number of problems that are reported one by one; of the others, only the number.
  integer, parameter, public :: most_reported = 50

  !> Largest number of letters of a word of the file in a remark.
  integer, parameter :: most_letters = 80

  !> One problem and its line; 0: it concerns the whole file.
  type :: remark_type
    integer :: line = 0
    character(len=:), allocatable :: text
  end type remark_type

  !> All problems of one file.
  type :: remarks_type
    integer :: count = 0
    !> Problems that are reported: the first ones in the order of lines, and the last one.
    type(remark_type), private :: first(most_reported), last
  end type remarks_type

contains

  !> Adds a problem of a line, or of the whole file if `line` is 0.
  pure subroutine add_remark(remarks, line, text)
    type(remarks_type), intent(inout) :: remarks
    !> Line of the namelist, from 1.
    integer, intent(in) :: line
    !> Problem, with its place in the line and the allowed values.
    character(len=*), intent(in) :: text
    type(remark_type) :: remark
    integer :: place, reported

    remark%line = line
    remark%text = text
    reported = min(remarks%count, most_reported)
    place = 1 + count(remarks%first(:reported)%line <= line)
    if (place <= most_reported) then
      reported = min(reported + 1, most_reported)
      remarks%first(place + 1:reported) = remarks%first(place:reported - 1)
      remarks%first(place) = remark
    end if
    if (line >= remarks%last%line) remarks%last = remark
    remarks%count = remarks%count + 1
  end subroutine add_remark

  !> All problems of the file `name`, one per line, in the order of its lines, those without a line
  !> first; if there are many, the first ones, the last one and the number of all. Empty: none.
  pure function remarks_text(remarks, name) result(text)
    type(remarks_type), intent(in) :: remarks
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: text
    integer :: at

    text = ''
    do at = 1, min(remarks%count, most_reported)
      if (at > 1) text = text//new_line_character
      text = text//one_text(remarks%first(at), name)
    end do
    if (remarks%count > most_reported) text = text//new_line_character//'... and ' &
      //to_text(remarks%count - most_reported)//' more; the last: '//one_text(remarks%last, name)
  end function remarks_text

  !> Text of one remark.
  pure function one_text(remark, name) result(text)
    type(remark_type), intent(in) :: remark
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: text

    text = name
    if (remark%line > 0) text = text//', line '//to_text(remark%line)
    text = text//': '//remark%text
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

end module battery_remarks
