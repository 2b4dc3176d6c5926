!> The summary at the end of a run: what came out, and how the ranks were used.
module battery_summary
  use, intrinsic :: iso_fortran_env, only: output_unit
  use battery_kinds, only: dp, int64
  use battery_plan, only: plan_type
  use battery_tasks, only: task_count
  use battery_results, only: results_type, task_complete
  use battery_screen, only: duration_text, rate_text
  use battery_command_line, only: ways_to_stop
  use battery_text, only: string_type, to_text
  implicit none (type, external)
  private
  public :: print_summary

  !> With so few tasks each is shown.
  integer, parameter :: most_rows = 12

contains

  !> Prints what came out, and which tasks failed and why; `busy` is the least, mean and greatest
  !> share of the time that a rank spent in tasks.
  subroutine print_summary(plan, results, failures, ranks, busy, seconds, collisions, all_done, &
      quiet)
    type(plan_type), intent(in) :: plan
    type(results_type), intent(in) :: results
    type(string_type), intent(in) :: failures(:)
    integer, intent(in) :: ranks
    real(dp), intent(in) :: busy(3), seconds
    integer(int64), intent(in) :: collisions
    logical, intent(in) :: all_done, quiet
    integer :: point, replica, done, task

    done = count(results%task_status == task_complete)
    do task = 1, size(failures)
      if (allocated(failures(task)%text)) write (output_unit, '(a, i0, a)') 'task ', task, &
        ' failed: '//failures(task)%text
    end do
    if (quiet) return
    if (task_count(plan) <= most_rows) then
      write (output_unit, '(a)') '     N    T       w         w''   replica       chi  +-error' &
        //'    current 1  +-error    current 2  +-error'
      do point = 1, size(results%number)
        do replica = 1, plan%replicas
          if (results%task_status(replica, point) == task_complete) call print_row(results, point, &
            replica)
        end do
      end do
    end if
    write (output_unit, '(i0, a, i0, a)') done, ' of ', task_count(plan), ' tasks are complete'
    write (output_unit, '(a, i0, a, 3(i0, a))') 'ranks ', ranks, ', busy ', &
      nint(100.0_dp*busy(1)), ' / ', &
      nint(100.0_dp*busy(2)), ' / ', nint(100.0_dp*busy(3)), ' % (least, mean, greatest)'
    write (output_unit, '(a)') rate_text(real(collisions, dp)/max(seconds, 1.0e-9_dp)) &
      //' collisions/s in '//duration_text(seconds)
    if (done > 0) call print_slowest(results)
    if (sum(results%trapped, mask=results%task_status == task_complete) > 0) &
      write (output_unit, &
      '(a)') 'some particles are on orbits that never leave: see the dataset trapped'
    if (.not. all_done) write (output_unit, '(a)') &
      'stopped early, the state is saved: the same command goes on', ways_to_stop
    write (output_unit, '(a)') 'results: '//plan%file
  end subroutine print_summary

  !> The task that took the most time of a processor.
  subroutine print_slowest(results)
    type(results_type), intent(in) :: results
    integer :: at(2)

    at = maxloc(results%cpu_seconds, mask=results%task_status == task_complete)
    associate (r => at(1), p => at(2))
      write (output_unit, '(a, i0, a, i0, a)') 'slowest task: ' &
        //duration_text(results%cpu_seconds(r, p))//' of a processor, N = ', results%number(p), &
        ', T = ', results%threshold(p), ', w = '//to_text(results%channel1_width(p)) &
        //', w'' = '//to_text(results%channel2_width(p))//', replica '//to_text(r)
    end associate
  end subroutine print_slowest

  subroutine print_row(results, p, r)
    type(results_type), intent(in) :: results
    integer, intent(in) :: p, r

    write (output_unit, &
      '(i6, i5, f8.4, f11.6, i10, f10.5, f9.5, 2(f13.5, f9.5))') results%number(p), &
      results%threshold(p), results%channel1_width(p), results%channel2_width(p), r, &
      results%chi(r, p), &
      results%chi_error(r, p), results%current1(r, p), results%current1_error(r, p), &
      results%current2(r, p), results%current2_error(r, p)
  end subroutine print_row

end module battery_summary
