!> The identity of a task: a fingerprint of all that decides its motion. It is the seed of the task.
!>
!> The identity depends on values, never on the place in a scan: numbers that are equal to 12
!> digits are equal, and a given value is the same as a default value. So a point has the same
!> random numbers whatever other points are scanned. The series, snapshots and event log do not
!> affect the motion, and are no part of the identity. `task_id_with` adds them: the `task_id` names
!> results and states of a task in files.
module battery_identity
  use battery_kinds, only: wp, int64
  use battery_engines, only: has_step
  use battery_fingerprint, only: fingerprint_start, fingerprint_of, mix_word
  use battery_random, only: splitmix64
  use battery_setup, only: run_type, setup_type
  use battery_urn, only: shape_polygon
  implicit none (type, external)
  private
  public :: identity_of, task_id_with, twelve_digits

contains

  !> The identity of a task, which is its seed as well.
  function identity_of(setup, initial_fingerprint, seed, replica) result(identity)
    !> Table, thresholds, numbers, engine and length; its seed is not used.
    type(setup_type), intent(in) :: setup
    !> Fingerprint of the initial file; 0: the start is random.
    integer(int64), intent(in) :: initial_fingerprint
    !> Base seed of the run.
    integer(int64), intent(in) :: seed
    !> Index of the replica, from 1.
    integer, intent(in) :: replica
    integer(int64) :: identity
    integer :: k, j, number_of

    identity = fingerprint_start
    call mix_word(identity, fingerprint_of(setup%engine))
    associate (table => setup%table)
      call mix_word(identity, int(table%urn_count, int64))
      do k = 1, table%urn_count
        call mix_real(identity, table%urn(k)%radius)
        if (table%urn(k)%shape == shape_polygon) then
          do j = 1, table%urn(k)%polygon%sides
            call mix_real(identity, table%urn(k)%polygon%x(j))
            call mix_real(identity, table%urn(k)%polygon%y(j))
          end do
        end if
        call mix_word(identity, int(setup%threshold(k), int64))
      end do
      do k = 1, 2
        call mix_real(identity, table%channel(k)%width)
        if (table%channel(k)%width > 0.0_wp) call mix_real(identity, table%channel(k)%length)
      end do
      do k = 1, size(table%scatterers, 2)
        do number_of = 1, 3
          call mix_real(identity, table%scatterers(number_of, k))
        end do
      end do
    end associate
    if (has_step(setup%engine)) call mix_real(identity, setup%time_step)
    if (setup%duration > 0.0_wp) then
      call mix_real(identity, setup%duration)
      call mix_real(identity, setup%transient_duration)
    else
      call mix_word(identity, setup%collisions)
      call mix_word(identity, setup%transient_collisions)
    end if
    call mix_real(identity, setup%start_time)
    call mix_word(identity, int(setup%number, int64))
    call mix_word(identity, merge(int(setup%urn1_number, int64), initial_fingerprint, &
      initial_fingerprint == 0))
    call mix_word(identity, seed)
    call mix_word(identity, int(replica, int64))
    identity = splitmix64(identity)
  end function identity_of

  !> `task_id` of a task together with its output, a hash: the task, and which series, snapshots and
  !> so on are stored.
  integer(int64) function task_id_with(identity, run) result(task_id)
    !> Identity of the task, from `identity_of`.
    integer(int64), intent(in) :: identity
    class(run_type), intent(in) :: run
    integer :: k

    task_id = identity
    call mix_real(task_id, run%series_interval)
    call mix_word(task_id, size(run%snapshot_times, kind=int64))
    do k = 1, size(run%snapshot_times)
      call mix_real(task_id, run%snapshot_times(k))
    end do
    call mix_word(task_id, merge(1_int64, 0_int64, run%event_log))
    call mix_word(task_id, merge(1_int64, 0_int64, run%final_state))
    task_id = splitmix64(task_id)
  end function task_id_with

  !> Mixes a number, rounded to 12 digits, into a fingerprint.
  subroutine mix_real(fingerprint, number)
    integer(int64), intent(inout) :: fingerprint
    real(wp), intent(in) :: number

    call mix_word(fingerprint, fingerprint_of(digits_of(number)))
  end subroutine mix_real

  !> A number to 12 digits, as text; the same for 0 and -0.
  pure function digits_of(number) result(text)
    real(wp), intent(in) :: number
    character(len=24) :: text

    write (text, '(es24.11e4)') number
    if (.not. abs(number) > 0.0_wp) text = '0'
  end function digits_of

  !> A number rounded to 12 digits.
  elemental real(wp) function twelve_digits(number) result(rounded)
    !> A finite number.
    real(wp), intent(in) :: number
    character(len=24) :: text

    text = digits_of(number)
    read (text, *) rounded
  end function twelve_digits

end module battery_identity
