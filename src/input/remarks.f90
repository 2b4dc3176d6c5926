!> What is wrong with an input file, with its lines; collected, and told in their order.
module battery_remarks
  use battery_text, only: to_text, new_line_character
  implicit none (type, external)
  private
  public :: remarks_type, add_remark, remarks_text, shown_text

  !> So many are told one by one, beyond that only how many there are.
  integer, parameter, public :: most_reported = 50

  !> Most letters of a word of the file that a remark repeats.
  integer, parameter :: most_letters = 80

  !> One thing that is wrong, and its line; 0: it has none.
  type :: remark_type
    integer :: line = 0
    character(len=:), allocatable :: text
  end type remark_type

  !> All that is wrong.
  type :: remarks_type
    integer :: count = 0
    !> Those that are told: the first of all, in the order of their lines, and the last.
    type(remark_type), private :: first(most_reported), last
  end type remarks_type

contains

  !> Adds what is wrong with a line, or with the whole file if the line is 0.
  pure subroutine add_remark(remarks, line, text)
    type(remarks_type), intent(inout) :: remarks
    !> From 1.
    integer, intent(in) :: line
    !> What, where in the line, and what is allowed.
    character(len=*), intent(in) :: text
    type(remark_type) :: remark
    integer :: place, told

    remark%line = line
    remark%text = text
    told = min(remarks%count, most_reported)
    place = 1 + count(remarks%first(:told)%line <= line)
    if (place <= most_reported) then
      told = min(told + 1, most_reported)
      remarks%first(place + 1:told) = remarks%first(place:told - 1)
      remarks%first(place) = remark
    end if
    if (line >= remarks%last%line) remarks%last = remark
    remarks%count = remarks%count + 1
  end subroutine add_remark

  !> All remarks about the file `name`, one a line in the order of its lines, those without a line
  !> first; of many, the first ones, the last one and how many there are. Empty: none.
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

  pure function one_text(remark, name) result(text)
    type(remark_type), intent(in) :: remark
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: text

    text = name
    if (remark%line > 0) text = text//', line '//to_text(remark%line)
    text = text//': '//remark%text
  end function one_text

  !> A word of a file as it may be shown: shortened, and without signs that steer a terminal.
  pure function shown_text(word) result(shown)
    !> As it stands there.
    character(len=*), intent(in) :: word
    character(len=:), allocatable :: shown
    integer :: at

    shown = word(:min(len(word), most_letters))
    do at = 1, len(shown)
      if (iachar(shown(at:at)) < 32 .or. iachar(shown(at:at)) == 127) shown(at:at) = '?'
    end do
    if (len(word) > most_letters) shown = shown//' ...'
  end function shown_text

end module battery_remarks
