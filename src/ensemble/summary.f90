!> The summary at the end of a run: averages, errors, failed tasks, and the load of the ranks.
module battery_summary
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use battery_blocks, only: error_of_mean
  use battery_command_line, only: command_line_words
  use battery_keys, only: key_threshold, key_threshold_fraction, key_number, key_width
  use battery_kinds, only: wp, dp, int64
  use battery_plan, only: plan_type, point_text, is_scanned, table_of
  use battery_table, only: channel1, channel2, relaxation_time
  use battery_tasks, only: task_count
  use battery_precision, only: cut_between_groups, in_two_states, signed_chi
  use battery_quantities, only: real_quantities, integer_quantities, place_of
  use battery_results, only: results_type, task_complete, task_not_asked, point_not_precise
  use battery_files, only: file_exists
  use battery_terminal, only: print_line
  use battery_text, only: string_type, duration_text, rate_text, to_text, count_text, numbers_text
  implicit none (type, external)
  private
  public :: print_summary, stopped_text

  !> What a run that was stopped early says.
  character(len=*), parameter :: stopped_text = &
    'stopped early, the state is saved: the same command, without --overwrite, goes on'

  !> Up to this many tasks are printed one by one; up to this many points, with averages over their
  !> replicas. If some are not, the command that prints all is.
  integer, parameter :: most_rows = 12

  !> What the tables may show, and their heads there, with that of the error: the currents of both
  !> channels where they have an error. Their sign is that of the polarity, which must have changed
  !> some times for it.
  character(len=*), parameter :: names(4) = [character(len=17) :: 'chi', 'polarised_current', &
    'current1', 'current2']
  character(len=*), parameter :: heads(4) = [character(len=22) :: '          chi  +-error', &
    '    polarised  +-error', '    current 1  +-error', '    current 2  +-error']
  integer, parameter :: chi = 1, polarised_current = 2, current2 = 4

  !> The keys that have columns in the tables.
  integer, parameter :: column_keys(5) = [key_number, key_threshold, key_threshold_fraction, &
    key_width]

contains

  !> Prints the averages, and the tasks that failed, with reasons.
  subroutine print_summary(plan, results, ranks, busy, seconds, collisions, all_done, &
      quiet)
    type(plan_type), intent(in) :: plan
    type(results_type), intent(in) :: results
    !> Number of ranks.
    integer, intent(in) :: ranks
    !> Fraction of their time that ranks spent in tasks; duration of the run in seconds.
    real(dp), intent(in) :: busy, seconds
    !> Wall collisions of this start, on all ranks.
    integer(int64), intent(in) :: collisions
    !> Whether no task is pending; whether to print errors only.
    logical, intent(in) :: all_done, quiet
    character(len=:), allocatable :: rate
    real(dp), allocatable :: cpu_seconds(:, :)
    integer :: done, task, slowest(2)

    do task = 1, size(results%failure)
      if (allocated(results%failure(task)%text)) call print_line(task_text(plan, task) &
        //' failed: '//results%failure(task)%text)
    end do
    if (quiet) return
    call print_tables(plan, results)
    if (task_count(plan) > most_rows .and. (plan%point_count > most_rows .or. any(count( &
      results%task_status == task_complete, 1) == 1))) call print_line('all points: ' &
      //postproc_command()//' table '//plan%file)
    done = count(results%task_status == task_complete)
    call print_line(to_text(done)//' of '//to_text(count(results%task_status /= task_not_asked)) &
      //' tasks are complete')
    call list_points(in_two_states(plan, results), 'replicas fall into two states')
    if (allocated(results%point_status)) call list_points(results%point_status &
      == point_not_precise, 'the precision asks for more than largest_replicas')
    rate = rate_text(real(collisions, dp)/max(seconds, 1.0e-9_dp))//' collisions/s in ' &
      //duration_text(seconds)//' on '//count_text(ranks, 'rank')
    if (ranks > 1) rate = rate//', busy for '//to_text(nint(100.0_dp*busy))//' % of the time'
    call print_line(rate)
    if (done > 0) then
      cpu_seconds = results%average(:, :, place_of('cpu_seconds', real_quantities()))
      slowest = maxloc(cpu_seconds, mask=results%task_status == task_complete)
      call print_line('slowest task: '//duration_text(cpu_seconds(slowest(1), slowest(2))) &
        //' of a processor, '//task_text(plan, (slowest(2) - 1)*plan%replicas + slowest(1)))
    end if
    if (any(results%counted(:, :, place_of('trapped', integer_quantities())) > 0)) &
      call print_line('some particles are on orbits that never leave: see the dataset trapped')
    if (results%short_tasks > 0) call print_line(to_text(results%short_tasks)//' of the complete ' &
      //'tasks ended before the last of snapshot_times: the later snapshots are NaN')
    if (.not. all_done) call print_line(stopped_text)
    call print_line('results: '//plan%file)
  end subroutine print_summary

  !> Prints a table of the complete tasks, each with its own errors, and one of the points with two
  !> complete replicas or more, with errors from their scatter: of the polarised current, not of
  !> those with a sign.
  subroutine print_tables(plan, results)
    type(plan_type), intent(in) :: plan
    type(results_type), intent(in) :: results
    logical :: complete(plan%replicas, plan%point_count)
    integer, allocatable :: shown(:)
    !> Whether a task lacks the error of each quantity shown; whether a point is in two states.
    logical, allocatable :: lacks(:), two_states(:)
    character(len=:), allocatable :: text
    integer :: p, r

    complete = results%task_status == task_complete
    shown = shown_quantities(results)
    lacks = [(any(complete .and. ieee_is_nan(results%error(:, :, places(shown(r))))), r=1, &
      size(shown))]
    if (task_count(plan) <= most_rows .and. any(complete)) then
      call print_line(table_head('   replica', shown))
      do p = 1, plan%point_count
        do r = 1, plan%replicas
          if (complete(r, p)) call print_line(row_text(plan, results, p, r - 1, pairs_text( &
            results%average(r, p, places(shown)), results%error(r, p, places(shown)))))
        end do
      end do
    end if
    if (plan%point_count <= most_rows .and. any(count(complete, dim=1) > 1)) then
      if (any(shown == polarised_current)) shown = pack(shown, shown <= polarised_current)
      call print_line(table_head('  replicas', shown)//'    (errors over replicas)')
      two_states = in_two_states(plan, results)
      do p = 1, plan%point_count
        if (count(complete(:, p)) > 1) call print_line(row_text(plan, results, p, &
          count(complete(:, p)), means_text(plan, results, p, shown, two_states(p))))
      end do
    end if
    if (task_count(plan) > most_rows .or. .not. any(lacks)) return
    ! Why an error is missing: battery_observer.
    if (any([(relaxation_time(table_of(plan, results%point(p))), p=1, plan%point_count)] &
      >= huge(1.0_wp))) then
      text = 'directions of motion never relax in these urns, or too slowly'
    else if (lacks(1)) then
      text = 'the run is too short, its slowest changes are by far its largest, or (chi) one urn ' &
        //'is nearly empty'
    else
      text = 'the gate of the emptier urn reversed, or the polarity changed, too rarely'
    end if
    if (plan%replicas > 1) then
      text = text//'; use those over replicas'
    else if (plan%initial_file == '') then
      text = text//'; &scan replicas = 8 gives one'
    end if
    call print_line('-: no error of its own: '//text)
  end subroutine print_tables

  !> Places in `names` of what the tables show: chi and the polarised current where they are known,
  !> the currents of the channels where a task has an error of them, or nothing else is known; none
  !> of channel 2 where it is closed.
  pure function shown_quantities(results) result(shown)
    type(results_type), intent(in) :: results
    integer, allocatable :: shown(:)
    logical :: is_shown(size(names))
    real(dp), allocatable :: values(:, :)
    integer :: k

    is_shown = .false.
    do k = 1, size(names)
      values = results%average(:, :, places(k))
      if (k > polarised_current .and. any(is_shown(:polarised_current))) &
        values = results%error(:, :, places(k))
      is_shown(k) = any(results%task_status == task_complete .and. .not. ieee_is_nan(values))
    end do
    if (.not. any(results%point%channel(channel2)%width > 0.0_wp)) is_shown(current2) = .false.
    shown = pack([(k, k=1, size(names))], is_shown)
  end function shown_quantities

  !> Place among the averages of what has the place `k` in `names`.
  elemental integer function places(k)
    integer, intent(in) :: k

    places = place_of(trim(names(k)), real_quantities())
  end function places

  !> The head of a table; `which`: what its fifth column is.
  pure function table_head(which, shown) result(text)
    character(len=*), intent(in) :: which
    !> Places in `names`.
    integer, intent(in) :: shown(:)
    character(len=:), allocatable :: text
    integer :: k

    text = '     N    T       w         w'''//which
    do k = 1, size(shown)
      text = text//heads(shown(k))
    end do
  end function table_head

  !> A row of a table: the point, `which` is the replica or the number of replicas, and `values`,
  !> then the keys of the scan that have no column.
  function row_text(plan, results, p, which, values) result(text)
    type(plan_type), intent(in) :: plan
    type(results_type), intent(in) :: results
    integer, intent(in) :: p, which
    character(len=*), intent(in) :: values
    character(len=:), allocatable :: text
    integer :: k

    associate (point => results%point(p))
      text = whole_text(point%number, 6)//whole_text(point%threshold(1), 5) &
        //number_text(point%channel(channel1)%width, 8, 4) &
        //number_text(point%channel(channel2)%width, 11, 6)//whole_text(which, 10)//values
    end associate
    ! The column of T is that of gate 1.
    if (is_scanned(plan, 'threshold2') .or. any([(all(column_keys /= plan%scanned(k)%place), k=1, &
      size(plan%scanned))])) text = trim(text//'  '//point_text(plan, p, ''))
  end function row_text

  !> Text for quantities, each with its error.
  pure function pairs_text(value, error) result(text)
    real(dp), intent(in) :: value(:), error(:)
    character(len=:), allocatable :: text
    integer :: k

    text = ''
    do k = 1, size(value)
      text = text//' '//number_text(value(k), 12, 5)//' '//number_text(error(k), 8, 5)
    end do
  end function pairs_text

  !> An integer in `width` columns, or, if it does not fit, a blank and the integer.
  pure function whole_text(number, width) result(text)
    !> Any integer; number of columns.
    integer, intent(in) :: number, width
    character(len=:), allocatable :: text

    text = repeat(' ', max(1, width - len(to_text(number))))//to_text(number)
  end function whole_text

  !> A number in `width` columns, of which the first is blank, with `digits` decimals, or as many as
  !> there is room for; with an exponent if there is none, or if it is so small that no digit would
  !> be visible; a dash if it is not known.
  pure function number_text(number, width, digits) result(text)
    !> Any number, or NaN.
    real(dp), intent(in) :: number
    !> Number of columns, and of decimals.
    integer, intent(in) :: width, digits
    character(len=width) :: text
    integer :: k

    text = repeat(' ', width - 1)//'-'
    if (ieee_is_nan(number)) return
    do k = digits, 1, -1
      if (abs(number) > 0.0_dp .and. abs(number) < 0.5_dp*0.1_dp**digits) exit
      write (text, '(f'//to_text(width)//'.'//to_text(k)//')') number
      if (text(:1) == ' ') return
    end do
    write (text, '(es'//to_text(width)//'.'//to_text(min(width - 7, digits))//')') number
  end function number_text

  !> Text for the means over the complete replicas of a point, with errors from their scatter; where
  !> replicas fall into two states, for chi in both, in place of a mean that no replica has.
  function means_text(plan, results, p, shown, two_states) result(text)
    type(plan_type), intent(in) :: plan
    type(results_type), intent(in) :: results
    integer, intent(in) :: p
    !> Places in `names`.
    integer, intent(in) :: shown(:)
    !> Whether they fall into two states.
    logical, intent(in) :: two_states
    character(len=:), allocatable :: text
    !> Values of all that has a name, by replica.
    real(dp), allocatable :: values(:, :), spread(:), group(:)
    integer, allocatable :: complete(:)
    real(dp) :: mean, cut
    integer :: k

    text = ''
    associate (status => results%task_status(:, p))
      complete = pack([(k, k=1, size(status))], status == task_complete)
      values = results%average(complete, p, places([(k, k=1, size(names))]))
    end associate
    if (two_states) then
      spread = signed_chi(plan, results, complete, p)
      cut = cut_between_groups(spread)
      text = '   two states:'
      do k = 1, 2
        group = pack(spread, (spread > cut) .eqv. k == 2)
        text = text//trim(merge(' (N1 - N2)/N', ' chi        ', any(spread < 0.0_dp)))//' = '
        text = text//trim(adjustl(number_text(sum(group)/max(size(group), 1), 10, 5)))//' in ' &
          //to_text(size(group))//trim(merge(',', ' ', k == 1))
      end do
      return
    end if
    do k = 1, size(shown)
      associate (value => values(:, shown(k)))
        mean = sum(value)/size(value)
        ! A sum of values that cancel has an error of rounding, which is not shown.
        if (abs(mean) < epsilon(mean)*maxval(abs(value))) mean = 0.0_dp
        text = text//pairs_text([mean], [error_of_mean(value)])
      end associate
    end do
  end function means_text

  !> Prints the numbers of points, if there are any.
  subroutine list_points(chosen, meaning)
    !> Whether each point is one of them; what they have in common.
    logical, intent(in) :: chosen(:)
    character(len=*), intent(in) :: meaning
    integer :: p

    if (any(chosen)) call print_line(meaning//', points (from 0): ' &
      //numbers_text(pack([(real(p - 1, wp), p=1, size(chosen))], chosen), ' '))
  end subroutine list_points

  !> The values of the keys of the scan, and the replica, of a task.
  function task_text(plan, task) result(text)
    type(plan_type), intent(in) :: plan
    !> Number of the task.
    integer, intent(in) :: task
    character(len=:), allocatable :: text

    text = point_text(plan, 1 + (task - 1)/plan%replicas, '')
    if (text /= '') text = text//', '
    text = text//'replica '//to_text(modulo(task - 1, plan%replicas))
  end function task_text

  !> The command of the Python package: that beside the program, where there is one.
  function postproc_command() result(text)
    character(len=:), allocatable :: text
    type(string_type), allocatable :: words(:)

    words = command_line_words()
    text = words(1)%text(:index(words(1)%text, '/', back=.true.))//'battery-postproc'
    if (.not. file_exists(text)) text = 'battery-postproc'
  end function postproc_command

end module battery_summary
