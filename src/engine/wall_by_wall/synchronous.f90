!> The engine `synchronous`: the algorithm of the paper, in which all particles move to every event.
!> An exact reference for `excursion`.
!>
!> At each event one pass over all particles moves them along their straight lines, reduces the time
!> that each has left until its next event, and finds the least of these times. Then the event of
!> that particle is processed alone. An event costs O(N). Since other engines are measured
!> against this one, the pass is as fast as it can be made:
!> - Memory layout: particles are stored in rows of `row_length`, the five numbers of a row next to
!>   each other. Five separate arrays, as long as a power of two, fell onto the same cache lines and
!>   took twice the time.
!> - The pass keeps a minimum for each lane, not for each row: vector instructions without a branch,
!>   and without a reduction before the lanes themselves are compared.
!> - Every other pass goes backwards, and finds rows of the pass before in the cache: 1000 particles
!>   are slightly more than the first level holds. That saves another third.
!> - Rows start at a cache line. Vectors across two lines took a quarter more time, and the address
!>   of an array depends on earlier allocations.
module battery_synchronous
  use battery_kinds, only: wp, int8, int64
  use battery_motion, only: motion_type, meets_nothing, wall_kind
  use battery_wall_by_wall, only: wall_by_wall_type, reset_counts, load_motions, &
    serialize_counts, process_event, end_instant, longest_window, end_of_window, window_events, &
    most_hits
  use battery_engine, only: particles_type
  use battery_event_record, only: event_record_type
  use battery_memory, only: bytes_to_next_line, line_bytes
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: synchronous_type

  !> Number of particles in a row: a multiple of any vector length, and large enough that the
  !> compiler does not unroll the loop over a row before it vectorises it. About the number of rows
  !> for N = 1000, since both a row and a lane are searched at each event.
  integer, parameter :: row_length = 32

  !> Numbers stored of a particle: position, velocity, time left until its next event.
  integer, parameter :: in_x = 1, in_y = 2, in_ux = 3, in_uy = 4, in_left = 5

  !> Largest number of moves of particles in a window.
  real(wp), parameter :: window_moves = 1.0e9_wp

  !> The engine: state of all particles now, in rows.
  type, extends(wall_by_wall_type) :: synchronous_type
    private
    !> From `begins` on: (lane, number (`in_x` ...), row). Padding, and particles without a next
    !> event, have velocity 0 and a huge time left.
    real(wp), allocatable :: field(:)
    integer :: begins = 1, rows = 0
    integer(int8), allocatable :: urn(:), chamber(:)
    integer(wall_kind), allocatable :: next(:)
    !> Whether the next pass goes backwards.
    logical :: backwards = .false.
    !> Velocities of particles without a next event.
    real(wp), allocatable :: trapped_ux(:), trapped_uy(:)
    !> Least time left in each lane.
    real(wp) :: least(row_length) = 0.0_wp
  contains
    procedure :: prepare_engine, load_particles, process_window, serialize_own_state, motion_now, &
      store_motion
  end type synchronous_type

contains

  !> Sets the length of the longest window, from the table and the number of particles; allocates
  !> the rows, with padding only.
  subroutine prepare_engine(self)
    class(synchronous_type), intent(inout) :: self
    integer :: number, bytes, i

    call reset_counts(self)
    number = self%number
    self%rows = (number + row_length - 1)/row_length
    bytes = storage_size(1.0_wp)/8
    self%window = longest_window(self, min(window_events, window_moves/real(number, wp)))
    if (allocated(self%field)) deallocate (self%field, self%urn, self%chamber, self%next, &
      self%trapped_ux, self%trapped_uy)
    allocate (self%field(row_length*in_left*self%rows + line_bytes/bytes - 1), source=0.0_wp)
    self%begins = 1 + bytes_to_next_line(self%field)/bytes
    do i = 1, row_length*self%rows
      self%field(field_index(self, i, in_left)) = huge(1.0_wp)
    end do
    allocate (self%urn(number), self%chamber(number), source=1_int8)
    allocate (self%next(number), source=meets_nothing)
    allocate (self%trapped_ux(number), self%trapped_uy(number), source=0.0_wp)
  end subroutine prepare_engine

  !> Index in `field` of the number `which` (`in_x` ...) of particle `i`.
  pure function field_index(self, i, which) result(at)
    class(synchronous_type), intent(in) :: self
    integer, intent(in) :: i, which
    integer :: at

    at = self%begins + modulo(i - 1, row_length) + row_length*(which - 1 + in_left*((i - 1) &
      /row_length))
  end function field_index

  !> Loads the particles, and finds the least time left in each lane.
  subroutine load_particles(self, particles)
    class(synchronous_type), intent(inout) :: self
    type(particles_type), intent(inout) :: particles

    call load_motions(self, particles)
    call move_all_particles(self, 0.0_wp)
  end subroutine load_particles

  !> Processes the events of a window, moving all particles to each event. It lasts `duration`, or
  !> less if the longest window or the epoch ends before, or after `most_hits` wall hits.
  subroutine process_window(self, event_record, duration)
    class(synchronous_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    real(wp), intent(in) :: duration
    real(wp) :: window_end, wait

    window_end = end_of_window(self, duration)
    do
      wait = least_of_lanes(self%least)
      if (self%now + wait >= window_end) exit
      if (event_record%collisions_seen >= most_hits) then
        window_end = self%now
        exit
      end if
      call move_all_particles(self, wait)
      self%now = self%now + wait
      self%window_time = self%now - self%window_start
      call process_instant(self, event_record)
    end do
    ! At most the least time left: by rounding, the next event might otherwise lie in the past.
    wait = min(wait, window_end - self%now)
    call move_all_particles(self, wait)
    self%now = window_end
    self%window_time = window_end - self%window_start
  end subroutine process_window

  !> Moves all particles by `time`.
  subroutine move_all_particles(self, time)
    type(synchronous_type), intent(inout) :: self
    real(wp), intent(in) :: time

    call move_rows(self%rows, self%backwards, time, self%field(self%begins), self%least)
    self%backwards = .not. self%backwards
  end subroutine move_all_particles

  !> Kernel of the pass: moves all rows by `time`, and returns the least time left in each lane.
  !> Vectorised over the lanes.
  pure subroutine move_rows(rows, backwards, time, field, least)
    integer, intent(in) :: rows
    logical, intent(in) :: backwards
    real(wp), intent(in) :: time
    real(wp), intent(inout) :: field(row_length, in_left, rows)
    real(wp), intent(out) :: least(row_length)
    real(wp) :: left
    integer :: k, row, lane

    least = huge(1.0_wp)
    do k = 1, rows
      row = merge(rows + 1 - k, k, backwards)
      do lane = 1, row_length
        field(lane, in_x, row) = field(lane, in_x, row) + field(lane, in_ux, row)*time
        field(lane, in_y, row) = field(lane, in_y, row) + field(lane, in_uy, row)*time
        left = field(lane, in_left, row) - time
        field(lane, in_left, row) = left
        least(lane) = merge(left, least(lane), left < least(lane))
      end do
    end do
  end subroutine move_rows

  !> Least time over all lanes, by comparing halves, which is vectorised.
  pure function least_of_lanes(least) result(time)
    real(wp), intent(in) :: least(row_length)
    real(wp) :: time
    real(wp) :: lowest(row_length)
    integer :: width

    lowest = least
    width = row_length
    do while (width > 1)
      width = width/2
      lowest(:width) = min(lowest(:width), lowest(width + 1:2*width))
    end do
    time = lowest(1)
  end function least_of_lanes

  !> Processes all events that are due now, then the decisions of the gates.
  subroutine process_instant(self, event_record)
    type(synchronous_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    type(motion_type) :: motion
    real(wp) :: wait
    integer(int64) :: reversals(2)
    integer :: i, first

    first = event_record%events + 1
    reversals = event_record%reversals
    do
      call find_due_particle(self, i)
      if (i == 0) exit
      motion = self%motion_now(i)
      call process_event(self, event_record, i, motion, wait)
      call self%store_motion(i, motion, wait)
      call update_lane_minimum(self%rows, modulo(i - 1, row_length) + 1, self%field(self%begins), &
        self%least)
    end do
    call end_instant(self, first, event_record)
    if (any(event_record%reversals > reversals)) call update_all_minima(self%rows, &
      self%field(self%begins), self%least)
  end subroutine process_instant

  !> Finds a particle with no time left; 0 if there is none.
  pure subroutine find_due_particle(self, i)
    type(synchronous_type), intent(in) :: self
    integer, intent(out) :: i
    integer :: lane, row, at

    do lane = 1, row_length
      if (self%least(lane) <= 0.0_wp) then
        at = field_index(self, lane, in_left)
        do row = 1, self%rows
          i = row_length*(row - 1) + lane
          if (self%field(at) <= 0.0_wp) return
          at = at + row_length*in_left
        end do
      end if
    end do
    i = 0
  end subroutine find_due_particle

  !> State of particle `i` now; if it is trapped, with its true velocity.
  pure function motion_now(self, i) result(motion)
    class(synchronous_type), intent(in) :: self
    integer, intent(in) :: i
    type(motion_type) :: motion

    motion%x = self%field(field_index(self, i, in_x))
    motion%y = self%field(field_index(self, i, in_y))
    motion%ux = self%field(field_index(self, i, in_ux))
    motion%uy = self%field(field_index(self, i, in_uy))
    motion%urn = self%urn(i)
    motion%chamber = self%chamber(i)
    motion%next = self%next(i)
    if (motion%next /= meets_nothing) return
    motion%ux = self%trapped_ux(i)
    motion%uy = self%trapped_uy(i)
  end function motion_now

  !> Stores particle `i` in its row, with the time `wait` left until its next event.
  subroutine store_motion(self, i, motion, wait)
    class(synchronous_type), intent(inout) :: self
    integer, intent(in) :: i
    type(motion_type), intent(in) :: motion
    real(wp), intent(in) :: wait
    integer :: which
    real(wp) :: own(in_left)

    own = [motion%x, motion%y, motion%ux, motion%uy, wait]
    if (motion%next == meets_nothing) own(in_ux:in_uy) = 0.0_wp
    do which = in_x, in_left
      self%field(field_index(self, i, which)) = own(which)
    end do
    self%urn(i) = motion%urn
    self%chamber(i) = motion%chamber
    self%next(i) = motion%next
    if (motion%next /= meets_nothing) return
    self%trapped_ux(i) = motion%ux
    self%trapped_uy(i) = motion%uy
  end subroutine store_motion

  !> Updates the least time left in one lane.
  pure subroutine update_lane_minimum(rows, lane, field, least)
    integer, intent(in) :: rows, lane
    real(wp), intent(in) :: field(row_length, in_left, rows)
    real(wp), intent(inout) :: least(row_length)
    real(wp) :: time
    integer :: row

    time = huge(1.0_wp)
    do row = 1, rows
      time = merge(field(lane, in_left, row), time, field(lane, in_left, row) < time)
    end do
    least(lane) = time
  end subroutine update_lane_minimum

  !> Updates the least time left in each lane.
  pure subroutine update_all_minima(rows, field, least)
    integer, intent(in) :: rows
    real(wp), intent(in) :: field(row_length, in_left, rows)
    real(wp), intent(out) :: least(row_length)
    integer :: row

    least = huge(1.0_wp)
    do row = 1, rows
      least = min(least, field(:, in_left, row))
    end do
  end subroutine update_all_minima

  !> Saves or restores the counts and the rows.
  subroutine serialize_own_state(self, archive)
    class(synchronous_type), intent(inout) :: self
    type(archive_type), intent(inout) :: archive
    integer :: row, which, first

    call serialize_counts(self, archive)
    do row = 1, self%rows
      do which = in_x, in_left
        first = field_index(self, row_length*(row - 1) + 1, which)
        call archive%serialize('field', self%field(first:first + row_length - 1))
      end do
    end do
    call archive%serialize('side', self%urn)
    call archive%serialize('chamber', self%chamber)
    call archive%serialize('next', self%next)
    call archive%serialize('kept_ux', self%trapped_ux, 'kept_uy', self%trapped_uy, 'least', &
      self%least)
    call archive%serialize('backwards', self%backwards)
  end subroutine serialize_own_state

end module battery_synchronous
