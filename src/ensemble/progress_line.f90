!> Progress of a running ensemble on standard output.
!>
!> On a terminal, one line is overwritten; in a log, lines are written at intervals. Only rank 0
!> prints.
module battery_progress_line
  use battery_kinds, only: dp
  use battery_clocks, only: wall_seconds
  use battery_communicator, only: task_queue_type, read_counter, &
    tasks_finished, collisions_done
  use battery_terminal, only: print_line, print_text, is_terminal, output_is_ready
  use battery_text, only: duration_text, rate_text
  implicit none (type, external)
  private
  public :: progress_line_type, new_progress_line, show_progress, clear_progress_line

  !> State of the progress line.
  type :: progress_line_type
    !> Whether anything is printed, and whether lines can be overwritten.
    logical :: speaks = .false., terminal = .false.
    !> Time of the start and of the next line, and seconds between two lines.
    real(dp) :: began = 0.0_dp, next = 0.0_dp, interval = 0.0_dp
    logical :: line_open = .false.
    !> Number of tasks of the ensemble, and the fraction that was printed last. As ranks begin other
    !> tasks the estimate falls, which is not shown.
    integer :: tasks = 0
    real(dp) :: done = 0.0_dp
  end type progress_line_type

  !> Seconds between two lines: on a terminal, in a log.
  real(dp), parameter :: terminal_interval = 0.2_dp, log_interval = 60.0_dp

  !> Columns of the progress line: a line that wraps cannot be overwritten.
  integer, parameter :: screen_width = 79

contains

  !> Makes a progress line, which prints or is silent.
  function new_progress_line(speaks, tasks) result(progress_line)
    !> Whether anything is printed.
    logical, intent(in) :: speaks
    !> Number of tasks of the ensemble.
    integer, intent(in) :: tasks
    type(progress_line_type) :: progress_line

    progress_line%speaks = speaks
    progress_line%terminal = is_terminal()
    progress_line%tasks = tasks
    progress_line%began = wall_seconds()
    progress_line%interval = merge(terminal_interval, log_interval, progress_line%terminal)
    progress_line%next = progress_line%began + progress_line%interval
  end function new_progress_line

  !> Prints the progress of the ensemble, if a line is due: tasks finished, total, and collisions
  !> per second. `share` is the completed fraction of this rank's task (0 to 1), which is assumed
  !> for the tasks of the other ranks too.
  subroutine show_progress(progress_line, task_queue, share)
    type(progress_line_type), intent(inout) :: progress_line
    type(task_queue_type), intent(in) :: task_queue
    real(dp), intent(in) :: share
    integer :: finished, finished_before
    real(dp) :: now, spent, left, done_before
    character(len=:), allocatable :: line
    character(len=160) :: buffer

    now = wall_seconds()
    if (.not. progress_line%speaks .or. now < progress_line%next) return
    progress_line%next = now + progress_line%interval
    ! A run does not wait for its terminal: it would save no states, and hear no request to stop.
    if (.not. output_is_ready()) return
    finished_before = progress_line%tasks - task_queue%tasks
    finished = int(read_counter(task_queue, tasks_finished)) + finished_before
    done_before = real(finished_before, dp)/progress_line%tasks
    progress_line%done = max(progress_line%done, min(1.0_dp, (finished + share*min( &
      task_queue%communicator%size, progress_line%tasks - finished))/progress_line%tasks))
    spent = now - progress_line%began
    left = 0.0_dp
    associate (done => progress_line%done)
      if (done > done_before) left = spent*(1.0_dp - done)/(done - done_before)
      write (buffer, '(i0, a, i0, a, f5.1, a)') finished, ' of ', progress_line%tasks, ' tasks ', &
        100.0_dp*done, ' %  '//rate_text(real(read_counter(task_queue, collisions_done), dp) &
        /max(spent, 1.0e-9_dp))//' collisions/s  '//duration_text(left)//' left'
      line = bar_of(done, screen_width - len_trim(buffer) - 2)//trim(buffer)
    end associate
    if (progress_line%terminal) then
      call print_text(achar(13)//line//repeat(' ', max(0, screen_width - len(line))))
      progress_line%line_open = .true.
    else
      call print_line(line)
    end if
  end subroutine show_progress

  !> A bar for a fraction, as wide as `columns` allows, up to a limit, followed by two blanks.
  pure function bar_of(share, columns) result(text)
    real(dp), intent(in) :: share
    integer, intent(in) :: columns
    character(len=:), allocatable :: text
    integer, parameter :: widest = 24, narrowest = 4
    integer :: width, filled

    text = ''
    width = min(columns, widest)
    if (width < narrowest) return
    filled = max(0, min(width, int(share*width)))
    text = repeat('#', filled)//repeat('.', width - filled)//'  '
  end function bar_of

  !> Clears the progress line.
  subroutine clear_progress_line(progress_line)
    type(progress_line_type), intent(inout) :: progress_line

    if (progress_line%line_open) call print_text(achar(13)//repeat(' ', screen_width)//achar(13))
    progress_line%line_open = .false.
  end subroutine clear_progress_line

end module battery_progress_line
