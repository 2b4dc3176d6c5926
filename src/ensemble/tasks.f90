!> The tasks of a plan: every parameter point of the scan, each with all its replicas.
!>
!> Tasks are numbered from 1; the replica varies fastest. What a task is depends on the plan and its
!> number alone, so any rank can make it at any time, and no list of tasks is kept.
module battery_tasks
  use battery_plan, only: plan_type, point_type, task_seed, setup_of
  use battery_task, only: task_type
  implicit none (type, external)
  private
  public :: task_count, task_of, put_longest_first

contains

  pure function task_count(plan) result(count)
    type(plan_type), intent(in) :: plan
    integer :: count

    count = size(plan%points)*plan%replicas
  end function task_count

  !> Task `number` of the plan.
  function task_of(plan, number) result(task)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: number
    type(task_type) :: task
    type(point_type) :: point

    task%task = number
    task%point = (number - 1)/plan%replicas + 1
    task%replica = number - (task%point - 1)*plan%replicas
    point = plan%points(task%point)
    task%number = point%number
    task%urn1_number = point%urn1_number
    task%seed = task_seed(plan%seed, task%point, task%replica)
    task%initial_file = plan%initial_file
    task%final_state = plan%final_state
    task%setup = setup_of(plan, task%point, task%replica)
  end function task_of

  !> Orders tasks by their expected cost, the dearest first, else as they are. The cost of a run of
  !> given duration goes with its number of particles; of given collisions, all cost about the same,
  !> but large systems leave the cache.
  pure subroutine put_longest_first(plan, tasks)
    type(plan_type), intent(in) :: plan
    integer, intent(inout) :: tasks(:)
    integer :: number(size(tasks)), k

    do k = 1, size(tasks)
      number(k) = plan%points((tasks(k) - 1)/plan%replicas + 1)%number
    end do
    if (size(tasks) == 0) return
    if (minval(number) == maxval(number)) return
    call sort(tasks, number)
  end subroutine put_longest_first

  !> Stable merge sort of `tasks` by falling `number`.
  pure recursive subroutine sort(tasks, number)
    integer, intent(inout) :: tasks(:), number(:)
    integer :: left(size(tasks)/2), left_number(size(tasks)/2)
    integer :: half, i, j, k

    if (size(tasks) < 2) return
    half = size(tasks)/2
    call sort(tasks(:half), number(:half))
    call sort(tasks(half + 1:), number(half + 1:))
    left = tasks(:half)
    left_number = number(:half)
    i = 1
    j = half + 1
    do k = 1, size(tasks)
      if (i > half) exit
      if (j <= size(tasks)) then
        if (number(j) > left_number(i)) then
          tasks(k) = tasks(j)
          number(k) = number(j)
          j = j + 1
          cycle
        end if
      end if
      tasks(k) = left(i)
      number(k) = left_number(i)
      i = i + 1
    end do
  end subroutine sort

end module battery_tasks
