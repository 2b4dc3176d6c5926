!> What a run shows while it goes on and when it is over.
!>
!> On a terminal one line that is written over and over; in a log a plain line now and then. Only
!> rank 0 speaks.
module battery_screen
  use battery_kinds, only: dp, int64
  use battery_clocks, only: wall_seconds
  use battery_communicator, only: task_queue_type, read_counter, output_is_terminal, &
    tasks_finished, collisions_done
  use battery_terminal, only: print_line, print_text
  implicit none (type, external)
  private
  public :: screen_type, new_screen, show_ensemble, end_progress, duration_text, rate_text

  !> What is shown, and when next.
  type :: screen_type
    !> Whether anything is shown, and whether lines can be written over.
    logical :: speaks = .false., terminal = .false.
    real(dp) :: began = 0.0_dp, next = 0.0_dp
    logical :: line_open = .false.
    !> Tasks of the ensemble.
    integer :: tasks = 0
  end type screen_type

  !> Seconds between two lines: on a terminal, in a log.
  real(dp), parameter :: terminal_interval = 0.2_dp, log_interval = 60.0_dp

  !> Columns of the progress line: one that wraps cannot be written over.
  integer, parameter :: screen_width = 79

contains

  !> A screen that speaks or not.
  function new_screen(speaks, tasks) result(screen)
    !> Whether anything is shown.
    logical, intent(in) :: speaks
    !> Of the ensemble.
    integer, intent(in) :: tasks
    type(screen_type) :: screen

    screen%speaks = speaks
    screen%terminal = output_is_terminal()
    screen%tasks = tasks
    screen%began = wall_seconds()
    screen%next = screen%began + merge(terminal_interval, log_interval, screen%terminal)
  end function new_screen

  !> Tells how far the ensemble is, if it is time to: tasks finished of all, and the collisions a
  !> second. This rank's task is done to `share` (0 to 1); the tasks of the other ranks are taken to
  !> be as far.
  subroutine show_ensemble(screen, task_queue, share)
    type(screen_type), intent(inout) :: screen
    type(task_queue_type), intent(in) :: task_queue
    real(dp), intent(in) :: share
    integer :: finished, finished_before
    real(dp) :: now, spent, left, done, done_before
    character(len=:), allocatable :: line
    character(len=160) :: buffer

    now = wall_seconds()
    if (.not. screen%speaks .or. now < screen%next) return
    screen%next = now + merge(terminal_interval, log_interval, screen%terminal)
    finished_before = screen%tasks - task_queue%tasks
    finished = int(read_counter(task_queue, tasks_finished)) + finished_before
    done_before = real(finished_before, dp)/screen%tasks
    done = min(1.0_dp, (finished + share*min(task_queue%communicator%size, screen%tasks &
      - finished)) /screen%tasks)
    spent = now - screen%began
    left = 0.0_dp
    if (done > done_before) left = spent*(1.0_dp - done)/(done - done_before)
    write (buffer, '(i0, a, i0, a, f5.1, a)') finished, ' of ', screen%tasks, ' tasks ', &
      100.0_dp*done, ' %  '//rate_text(real(read_counter(task_queue, collisions_done), dp) &
      /max(spent, 1.0e-9_dp))//' collisions/s  '//duration_text(left)//' left'
    line = bar_of(done, screen_width - len_trim(buffer) - 2)//trim(buffer)
    if (screen%terminal) then
      call print_text(achar(13)//line//repeat(' ', max(0, screen_width - len(line))))
      screen%line_open = .true.
    else
      call print_line(line)
    end if
  end subroutine show_ensemble

  !> A bar as wide as there is room for, within reason, with two blanks behind it.
  pure function bar_of(share, room) result(text)
    real(dp), intent(in) :: share
    integer, intent(in) :: room
    character(len=:), allocatable :: text
    integer, parameter :: widest = 24, narrowest = 4
    integer :: width, filled

    text = ''
    width = min(room, widest)
    if (width < narrowest) return
    filled = max(0, min(width, int(share*width)))
    text = repeat('#', filled)//repeat('.', width - filled)//'  '
  end function bar_of

  !> Clears the progress line.
  subroutine end_progress(screen)
    type(screen_type), intent(inout) :: screen

    if (screen%line_open) call print_text(achar(13)//repeat(' ', screen_width)//achar(13))
    screen%line_open = .false.
  end subroutine end_progress

  !> A time as a reader would say it: `8 s`, `3 min 20 s`, `2 h 05 min`.
  pure function duration_text(seconds) result(text)
    !> Negative ones are 0.
    real(dp), intent(in) :: seconds
    character(len=:), allocatable :: text
    character(len=32) :: buffer
    integer(int64) :: whole

    whole = nint(min(max(seconds, 0.0_dp), 1.0e12_dp), int64)
    if (seconds < 0.095_dp) then
      write (buffer, '(f5.3, a)') max(seconds, 0.0_dp), ' s'
    else if (seconds < 9.95_dp) then
      write (buffer, '(f3.1, a)') max(seconds, 0.0_dp), ' s'
    else if (whole < 60) then
      write (buffer, '(i0, a)') whole, ' s'
    else if (whole < 3600) then
      write (buffer, '(i0, a, i0, a)') whole/60, ' min ', mod(whole, 60_int64), ' s'
    else
      write (buffer, '(i0, a, i2.2, a)') whole/3600, ' h ', mod(whole, 3600_int64)/60, ' min'
    end if
    text = trim(buffer)
  end function duration_text

  !> A rate with three digits, such as `2.13e8`.
  pure function rate_text(rate) result(text)
    !> In any unit, not negative.
    real(dp), intent(in) :: rate
    character(len=:), allocatable :: text
    character(len=32) :: buffer
    integer :: power

    power = 0
    if (rate > 0.0_dp) power = floor(log10(rate))
    write (buffer, '(f4.2, a, i0)') rate/10.0_dp**power, 'e', power
    text = trim(buffer)
  end function rate_text

end module battery_screen
