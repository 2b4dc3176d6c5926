!> Plans for tests, from the text of a namelist.
module plans
  use battery_kinds, only: int64
  use battery_error, only: error_type
  use battery_namelist_input, only: parse_namelist
  use battery_plan, only: plan_type
  use battery_tasks, only: task_type, task_of
  implicit none (type, external)
  private
  public :: plan_of, task_from

contains

  !> Plan that a valid namelist describes.
  function plan_of(text) result(plan)
    character(len=*), intent(in) :: text
    type(plan_type) :: plan
    type(error_type), allocatable :: error

    call parse_namelist(text, 'case.nml', plan, error)
    if (allocated(error)) error stop error%message
  end function plan_of

  !> One task of the plan that a valid namelist describes.
  function task_from(text, number, initial_fingerprint) result(task)
    character(len=*), intent(in) :: text
    !> Number of the task, from 1; absent: 1.
    integer, intent(in), optional :: number
    !> Fingerprint of the initial file; absent: there is no such file.
    integer(int64), intent(in), optional :: initial_fingerprint
    type(task_type) :: task
    type(plan_type) :: plan
    integer :: at

    plan = plan_of(text)
    if (present(initial_fingerprint)) plan%initial_fingerprint = initial_fingerprint
    at = 1
    if (present(number)) at = number
    task = task_of(plan, at)
  end function task_from

end module plans
