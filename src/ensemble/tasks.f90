!> The tasks of a plan: every parameter point of the scan, each with all its replicas.
!>
!> Tasks are numbered from 1; the replica varies fastest. A task follows from the plan and its
!> number alone, so any rank can make it at any time, and no list of tasks is stored.
module battery_tasks
  use, intrinsic :: iso_c_binding, only: c_size_t
  use battery_kinds, only: wp, dp, int64, pi
  use battery_engine, only: particles_type
  use battery_error, only: error_type
  use battery_gsl, only: sort_order
  use battery_identity, only: task_id_with
  use battery_initial_state, only: random_particles, before_crossing
  use battery_plan, only: plan_type, point_type, point_of, table_of, setup_of
  use battery_setup, only: setup_type
  use battery_simulation, only: simulation_type, begin_simulation
  use battery_table, only: table_type
  implicit none (type, external)
  private
  public :: task_type, task_count, task_of, order_tasks, begin_task
  public :: task_index_type, task_index_of, task_number_of

  !> One task: a replica of a point of the scan.
  type :: task_type
    !> Its point and replica, from 1.
    integer :: point = 0, replica = 0
    type(setup_type) :: setup
    !> Hash of the task and its output: names its records of result and saved state.
    integer(int64) :: task_id = 0
  end type task_type

  !> Numbers of the tasks of a plan by their `task_id`: a hash table that is never full.
  type :: task_index_type
    private
    integer(int64), allocatable :: task_id(:)
    !> Number of the task in each slot; 0 if the slot is empty.
    integer, allocatable :: number(:)
  end type task_index_type

contains

  !> Number of tasks of a plan: points times replicas.
  pure function task_count(plan) result(count)
    type(plan_type), intent(in) :: plan
    integer :: count

    count = plan%point_count*plan%replicas
  end function task_count

  !> Task `number` of the plan.
  function task_of(plan, number) result(task)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: number
    type(task_type) :: task

    task%point = (number - 1)/plan%replicas + 1
    task%replica = number - (task%point - 1)*plan%replicas
    task%setup = setup_of(plan, task%point, task%replica)
    task%task_id = task_id_with(task%setup%seed, task%setup)
  end function task_of

  !> Makes the index of all tasks of a plan.
  function task_index_of(plan) result(task_index)
    type(plan_type), intent(in) :: plan
    type(task_index_type) :: task_index
    type(task_type) :: task
    integer :: k, at

    allocate (task_index%number(0:2**(bit_size(k) - leadz(task_count(plan)) + 1) - 1), source=0)
    allocate (task_index%task_id(0:ubound(task_index%number, 1)))
    do k = 1, task_count(plan)
      task = task_of(plan, k)
      at = slot_of(task_index, task%task_id)
      task_index%task_id(at) = task%task_id
      task_index%number(at) = k
    end do
  end function task_index_of

  !> Number of the task with a given `task_id`; 0 if the plan has no such task.
  pure integer function task_number_of(task_index, task_id) result(number)
    type(task_index_type), intent(in) :: task_index
    !> As in `task_type`.
    integer(int64), intent(in) :: task_id

    number = task_index%number(slot_of(task_index, task_id))
  end function task_number_of

  !> Slot of a task in the hash table: its slot if it is there, else the empty slot for it.
  pure integer function slot_of(task_index, task_id) result(at)
    type(task_index_type), intent(in) :: task_index
    integer(int64), intent(in) :: task_id
    integer :: last

    last = ubound(task_index%number, 1)
    at = int(iand(task_id, int(last, int64)))
    do while (task_index%number(at) > 0)
      if (task_index%task_id(at) == task_id) exit
      at = iand(at + 1, last)
    end do
  end function slot_of

  !> Expected cost of a task, in units of a wall collision. A passage through an urn has a fixed
  !> cost of many collisions besides its own (measured: 70 ns against 2 ns); the number of passages
  !> follows from the widths. Systems that exceed the cache cost more.
  pure function cost_of(plan, task) result(cost)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: task
    real(wp) :: cost
    real(wp), parameter :: visit_cost = 35.0_wp
    type(point_type) :: point
    type(table_type) :: table
    real(wp) :: openings

    point = point_of(plan, (task - 1)/plan%replicas + 1)
    table = table_of(plan, point)
    openings = sum(table%channel%width)
    if (plan%duration > 0.0_wp) then
      cost = plan%duration*point%number*(table%urn(1)%perimeter + visit_cost*openings) &
        /(pi*table%urn(1)%area)
    else
      cost = real(plan%collisions, wp)*(1.0_wp + visit_cost*openings/table%urn(1)%perimeter)
    end if
    cost = cost*(1.0_wp + 0.1_wp*log(real(point%number, wp)))
  end function cost_of

  !> Puts tasks in the order in which ranks take them: replica by replica, so that a run that is
  !> stopped has the whole scan; in a replica by classes of cost (a factor of two), the longest
  !> first; in a class spread over the scan. The last tasks of each rank come longest first: then
  !> the run ends at most 2 % later than if all did (maps, and N from 200 to 6400, 2 to 1000 ranks).
  subroutine order_tasks(plan, ranks, tasks)
    type(plan_type), intent(in) :: plan
    !> Number of ranks that share the tasks.
    integer, intent(in) :: ranks
    !> Numbers of the tasks.
    integer, intent(inout) :: tasks(:)
    integer, parameter :: last_tasks = 8, classes = 2048
    real(dp) :: cost(size(tasks)), place(size(tasks)), longest
    integer(c_size_t) :: order(size(tasks)), count
    integer :: k, bits, bit

    count = size(tasks)
    bits = bit_size(bits) - leadz(plan%point_count)
    cost = [(real(cost_of(plan, tasks(k)), dp), k=1, size(tasks))]
    longest = maxval(cost)
    do k = 1, size(tasks)
      associate (point => (tasks(k) - 1)/plan%replicas, replica => mod(tasks(k) - 1, &
        plan%replicas), class => min(classes - 1, floor(log(longest/cost(k))/log(2.0_dp))))
        ! The bits of the point in the opposite order.
        place(k) = (real(replica, dp)*classes + class)*2.0_dp**bits + sum([(merge(2**(bits - 1 &
          - bit), 0, btest(point, bit)), bit=0, bits - 1)])
      end associate
    end do
    if (count > 0) call sort_order(order, place, 1_c_size_t, count)
    tasks = tasks(order + 1)
    cost = cost(order + 1)
    count = min(count, int(last_tasks, c_size_t)*ranks)
    associate (last => tasks(size(tasks) - count + 1:))
      if (count > 0) call sort_order(order, -cost(size(tasks) - count + 1:), 1_c_size_t, count)
      last = last(order(:count) + 1)
    end associate
  end subroutine order_tasks

  !> Begins the simulation of a task.
  subroutine begin_task(task, start, simulation, error)
    type(task_type), intent(in) :: task
    !> Particles of the initial file; if the arrays are not allocated, particles are drawn at
    !> random.
    type(particles_type), intent(in) :: start
    type(simulation_type), intent(out) :: simulation
    type(error_type), allocatable, intent(out) :: error
    type(particles_type) :: particles

    associate (setup => task%setup)
      if (allocated(start%x)) then
        particles = start
        particles%x = before_crossing(setup%table, setup%start_time, start%x, start%y, start%ux, &
          start%uy)
      else
        call random_particles(setup%table, setup%number, setup%urn1_number, setup%seed, &
          particles, error)
      end if
      if (.not. allocated(error)) call begin_simulation(simulation, setup, particles, error)
    end associate
  end subroutine begin_task

end module battery_tasks
