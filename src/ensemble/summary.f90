!> The summary at the end of a run: averages, errors, failed tasks, and the load of the ranks.
module battery_summary
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use battery_blocks, only: error_of_mean
  use battery_kinds, only: dp, int64
  use battery_plan, only: plan_type
  use battery_table, only: channel1, channel2
  use battery_tasks, only: task_count
  use battery_precision, only: cut_between_groups
  use battery_quantities, only: averaged_quantities, counted_quantities, place_of
  use battery_results, only: results_type, task_complete, task_not_asked, &
    point_two_states, point_not_precise
  use battery_columns, only: whole_text, number_text, duration_text, rate_text
  use battery_terminal, only: print_line
  use battery_command_line, only: ways_to_stop
  use battery_text, only: to_text, count_text
  implicit none (type, external)
  private
  public :: print_summary, print_stop

  !> Up to this many tasks are printed one by one; up to this many points, with averages over their
  !> replicas.
  integer, parameter :: most_rows = 12

  !> What the tables may show, and their heads there, with that of the error: the currents of both
  !> channels where they have an error. Their sign is that of the polarity, which must have changed
  !> some times for it.
  character(len=*), parameter :: names(4) = [character(len=17) :: 'chi', 'polarised_current', &
    'current1', 'current2']
  character(len=*), parameter :: heads(4) = [character(len=22) :: '          chi  +-error', &
    '    polarised  +-error', '    current 1  +-error', '    current 2  +-error']

contains

  !> Prints the averages, and the tasks that failed, with reasons; `busy` is the least, mean and
  !> greatest fraction of the time that a rank spent in tasks.
  subroutine print_summary(plan, results, ranks, busy, seconds, collisions, all_done, &
      quiet)
    type(plan_type), intent(in) :: plan
    type(results_type), intent(in) :: results
    !> Number of ranks.
    integer, intent(in) :: ranks
    !> Least, mean and greatest fraction of time in tasks; duration of the run in seconds.
    real(dp), intent(in) :: busy(3), seconds
    !> Wall collisions of this start, on all ranks.
    integer(int64), intent(in) :: collisions
    !> Whether no task is pending; whether to print errors only.
    logical, intent(in) :: all_done, quiet
    integer :: point, replica, done, task
    logical :: shown(size(names)), lacking

    done = count(results%task_status == task_complete)
    do task = 1, size(results%failure)
      if (allocated(results%failure(task)%text)) call print_line('task '//to_text(task) &
        //' failed: '//results%failure(task)%text)
    end do
    if (quiet) return
    shown = shown_quantities(results)
    lacking = .false.
    if (task_count(plan) <= most_rows .and. done > 0) then
      call print_line(table_head('   replica', shown))
      do point = 1, size(results%point)
        do replica = 1, plan%replicas
          if (results%task_status(replica, point) == task_complete) call print_task_row(results, &
            point, replica, shown, lacking)
        end do
      end do
    end if
    if (plan%replicas > 1 .and. plan%point_count <= most_rows) call print_points(results, shown)
    if (lacking) call print_line('-: the run is too short for an error of its own; replicas give ' &
      //'one (&scan replicas)')
    if (task_count(plan) > most_rows) call print_line('all points: battery-postproc table ' &
      //plan%file)
    call print_line(to_text(done)//' of '//to_text(count(results%task_status /= task_not_asked)) &
      //' tasks are complete')
    call list_points(results, point_two_states, 'replicas fall into two states')
    call list_points(results, point_not_precise, 'the precision was not reached')
    call print_line(rate_text(real(collisions, dp)/max(seconds, 1.0e-9_dp))//' collisions/s in ' &
      //duration_text(seconds)//' on '//count_text(ranks, 'rank')//', busy for '&
      //to_text(nint(100.0_dp*busy(2)))//' % of the time')
    if (done > 0) call print_slowest(results)
    if (any(results%counted(:, :, place_of('trapped', counted_quantities())) > 0)) &
      call print_line('some particles are on orbits that never leave: see the dataset trapped')
    if (results%short_tasks > 0) call print_line(to_text(results%short_tasks)//' of the complete ' &
      //'tasks ended before the last of snapshot_times: the later snapshots are NaN')
    if (all_done) then
      call print_line('results: '//plan%file)
    else
      call print_stop(ranks, 'results: '//plan%file)
    end if
  end subroutine print_summary

  !> Prints the last lines of a run that was stopped early.
  subroutine print_stop(ranks, where_results_are)
    !> Number of ranks.
    integer, intent(in) :: ranks
    !> The last line.
    character(len=*), intent(in) :: where_results_are

    call print_line('stopped early, the state is saved: the same command goes on')
    if (ranks > 1) call print_line(ways_to_stop)
    call print_line(where_results_are)
  end subroutine print_stop

  !> Which of `names` the tables show: chi and the polarised current where they are known, the
  !> currents of the channels where a task has an error of them, or nothing else is known.
  pure function shown_quantities(results) result(shown)
    type(results_type), intent(in) :: results
    logical :: shown(size(names))
    integer :: at(size(names)), k

    at = places()
    shown = [(is_known(results%average(:, :, at(k))), k=1, size(names))]
    if (any(shown(:2))) shown(3:) = [(is_known(results%error(:, :, at(k))), k=3, size(names))]

  contains

    !> Whether a complete task has a value; (replica, point).
    pure logical function is_known(values)
      real(dp), intent(in) :: values(:, :)

      is_known = any(results%task_status == task_complete .and. .not. ieee_is_nan(values))
    end function is_known

  end function shown_quantities

  !> Place of each of `names` among the averages.
  pure function places()
    integer :: places(size(names)), k

    places = [(place_of(trim(names(k)), averaged_quantities()), k=1, size(names))]
  end function places

  !> The head of a table; `which`: what its fifth column is.
  pure function table_head(which, shown) result(text)
    character(len=*), intent(in) :: which
    logical, intent(in) :: shown(:)
    character(len=:), allocatable :: text
    integer :: k

    text = '     N    T       w         w'''//which
    do k = 1, size(shown)
      if (shown(k)) text = text//heads(k)
    end do
  end function table_head

  !> Prints the numbers of the points with a given status, and its meaning.
  subroutine list_points(results, status, meaning)
    type(results_type), intent(in) :: results
    integer, intent(in) :: status
    character(len=*), intent(in) :: meaning
    character(len=:), allocatable :: text
    integer :: p

    if (.not. allocated(results%point_status)) return
    text = ''
    do p = 1, size(results%point)
      if (results%point_status(p) == status) text = text//' '//to_text(p - 1)
    end do
    if (text /= '') call print_line(meaning//', points (from 0):'//text)
  end subroutine list_points

  !> Prints the task with the most processor time.
  subroutine print_slowest(results)
    type(results_type), intent(in) :: results
    real(dp), allocatable :: cpu_seconds(:, :)
    integer :: at(2)

    cpu_seconds = results%average(:, :, place_of('cpu_seconds', averaged_quantities()))
    at = maxloc(cpu_seconds, mask=results%task_status == task_complete)
    associate (r => at(1), p => at(2))
      call print_line('slowest task: '//duration_text(cpu_seconds(r, p)) &
        //' of a processor, N = '//to_text(results%point(p)%number)//', T = ' &
        //to_text(results%point(p)%threshold(1))//', w = ' &
        //to_text(results%point(p)%channel(channel1)%width)//', w'' = ' &
        //to_text(results%point(p)%channel(channel2)%width)//', replica '//to_text(r - 1))
    end associate
  end subroutine print_slowest

  !> Prints, for each point with two complete replicas or more, averages over the replicas and their
  !> standard errors from the scatter: of the polarised current, not of those with a sign.
  subroutine print_points(results, shown)
    type(results_type), intent(in) :: results
    !> Of `names`.
    logical, intent(in) :: shown(:)
    integer :: complete(size(results%point)), at(size(names)), k, p
    logical :: averaged(size(names))
    real(dp) :: mean(size(names)), error(size(names))
    real(dp), allocatable :: values(:)

    complete = count(results%task_status == task_complete, dim=1)
    if (all(complete < 2)) return
    averaged = shown
    if (shown(2)) averaged(3:) = .false.
    at = places()
    call print_line(table_head('  replicas', averaged)//'    (errors over replicas)')
    do p = 1, size(results%point)
      if (complete(p) < 2) cycle
      if (in_two_states(results, p)) then
        call print_line(line_head(results, p, complete(p))//states_text(results, p))
        cycle
      end if
      do k = 1, size(names)
        values = pack(results%average(:, p, at(k)), results%task_status(:, p) == task_complete)
        mean(k) = sum(values)/size(values)
        error(k) = error_of_mean(values)
      end do
      call print_line(line_head(results, p, complete(p))//pairs_text(mean, error, averaged))
    end do
  end subroutine print_points

  !> Whether the replicas of a point fall into two states.
  pure logical function in_two_states(results, p)
    type(results_type), intent(in) :: results
    integer, intent(in) :: p

    in_two_states = .false.
    if (allocated(results%point_status)) in_two_states = results%point_status(p) == point_two_states
  end function in_two_states

  !> Text for both states of such a point, in place of a mean that no replica has.
  function states_text(results, p) result(text)
    type(results_type), intent(in) :: results
    integer, intent(in) :: p
    character(len=:), allocatable :: text
    real(dp), allocatable :: chi(:), group(:)
    real(dp) :: cut
    integer :: k

    chi = pack(results%average(:, p, place_of('chi', averaged_quantities())), &
      results%task_status(:, p) == task_complete)
    cut = cut_between_groups(chi)
    text = '   two states:'
    do k = 1, 2
      group = pack(chi, (chi > cut) .eqv. k == 2)
      text = text//' chi = '//trim(adjustl(number_text(sum(group)/max(size(group), 1), 10, 5))) &
        //' in ' //to_text(size(group))//merge(',', ' ', k == 1)
    end do
    text = trim(text)
  end function states_text

  !> Prints one task: its averages and their errors.
  subroutine print_task_row(results, p, r, shown, lacking)
    type(results_type), intent(in) :: results
    integer, intent(in) :: p, r
    !> Of `names`.
    logical, intent(in) :: shown(:)
    !> Set if an error is not known.
    logical, intent(inout) :: lacking
    real(dp) :: error(size(names))

    error = results%error(r, p, places())
    lacking = lacking .or. any(shown .and. ieee_is_nan(error))
    call print_line(line_head(results, p, r - 1)//pairs_text(results%average(r, p, places()), &
      error, shown))
  end subroutine print_task_row

  !> Beginning of the line of a point; `which` is the replica, or the number of replicas.
  pure function line_head(results, p, which) result(text)
    type(results_type), intent(in) :: results
    integer, intent(in) :: p, which
    character(len=:), allocatable :: text

    text = whole_text(results%point(p)%number, 6)//whole_text(results%point(p)%threshold(1), 5) &
      //number_text(results%point(p)%channel(channel1)%width, 8, 4) &
      //number_text(results%point(p)%channel(channel2)%width, 11, 6)//whole_text(which, 10)
  end function line_head

  !> Text for the shown quantities, each with its error.
  pure function pairs_text(value, error, shown) result(text)
    !> Of each of `names`.
    real(dp), intent(in) :: value(:), error(:)
    logical, intent(in) :: shown(:)
    character(len=:), allocatable :: text
    integer :: k

    text = ''
    do k = 1, size(shown)
      if (shown(k)) text = text//number_text(value(k), 13, 5)//number_text(error(k), 9, 5)
    end do
  end function pairs_text

end module battery_summary
