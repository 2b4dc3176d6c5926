!> Simulation of one-particle theory: independent walkers, between gates that count all of them.
!>
!> It computes the renewal gate self-consistently, with a fixed number of walkers. Visits are exact.
!> There are several `copies` of the circuit, with N walkers for each, and each entry into a gate
!> takes place in a randomly drawn copy. So the state of a gate is independent of the past of the
!> walkers that enter it: the entries into one copy are a thinned sequence of all entries. In the
!> limit of many copies they are a Poisson process, with the rate and the passage times of the
!> walkers: that is the renewal gate. With a single copy no copy is drawn, and the simulation is
!> that of the circuit itself.
!>
!> A window is at most as long as the shortest excursion, so all entries in it are known at its
!> start. Channel 2 has no gate: the next visit of a walker that leaves through it is computed at
!> once, and its crossing is counted at a time that may be later than the present window.
!>
!> With `well_mixed` a passage through an urn is independent of its start: its end is drawn from the
!> invariant measure of entries, and its length is the shortest excursion plus an exponential random
!> number, with the exact mean.
module battery_walkers
  use battery_kinds, only: wp, int64, pi
  use battery_table, only: table_type, channel1, channel2, urn_at, x_direction, are_mirror_images, &
    mean_urn_passage, shortest_excursion
  use battery_engine, only: particles_type
  use battery_sampling, only: entry_of
  use battery_urn_shape, only: cross_channels
  use battery_urn, only: compute_passages
  use battery_visits, only: visits_type, reserve_visits, no_channel
  use battery_gate, only: gate_type, new_gate, enter_gate, must_reverse, uncount_first, &
    uncount_all, number_inside, counted_particle, next_crossing_time
  use battery_tally, only: tally_type, new_tally, add_count, add_crossing, entered, reversed
  use battery_draws, only: draws_type, new_draws, next_uniform
  implicit none (type, external)
  private
  public :: walkers_type, new_walkers, advance_walkers

  !> Approximate upper bound of the number of entries in a window.
  integer, parameter :: batch = 4096

  !> State of all walkers and of all copies of the gates, and the counts so far.
  type :: walkers_type
    type(tally_type) :: tally
    type(table_type) :: table
    integer :: copies = 1
    logical :: well_mixed = .false.
    !> Time since the start.
    real(wp) :: now = 0.0_wp
    !> Gates by (copy, urn).
    type(gate_type), allocatable :: gate(:, :)
    !> Entry of each walker into its next gate, or into the one that counts it: time (huge: never),
    !> height, |u_x| and u_y, time through the whole channel; urn of that gate.
    real(wp), allocatable :: time(:), y(:), u_axial(:), u_lateral(:), through(:)
    integer, allocatable :: urn(:)
    !> Visits by (urn kind, batch): `current` is the batch to be computed, the other one has the
    !> visits that follow. Urns that are mirror images are one kind.
    type(visits_type) :: visits(2, 2)
    integer :: urn_kinds = 1, current = 1
    !> Greatest length of a window; shortest excursion; mean length of a
    !> passage through an urn, by urn.
    real(wp) :: window = 0.0_wp, lookahead = 0.0_wp, mean(2) = 0.0_wp
    type(draws_type) :: draws
    !> Walkers that enter in a window, ordered by gate, those of a gate by time; for each gate, the
    !> number of them before its own.
    integer, allocatable :: entrants(:), first(:)
  end type walkers_type

contains

  !> Creates walkers, gates and counts.
  subroutine new_walkers(walkers, table, threshold, copies, particles, seed, well_mixed, from, to)
    type(walkers_type), intent(out) :: walkers
    !> A circuit.
    type(table_type), intent(in) :: table
    !> Thresholds of the gates of urn 1 and 2.
    integer, intent(in) :: threshold(2)
    !> Number of copies of the circuit.
    integer, intent(in) :: copies
    !> Initial state of the walkers, N for each copy, all in the urns.
    type(particles_type), intent(in) :: particles
    !> Seed of the random numbers: any 64 bits.
    integer(int64), intent(in) :: seed
    !> Whether visits are independent of their start.
    logical, intent(in) :: well_mixed
    !> Interval that is measured, in time since the start; it includes `to`, not `from`.
    real(wp), intent(in) :: from, to
    integer :: number, urn, copy

    number = size(particles%x)
    walkers%table = table
    walkers%copies = copies
    walkers%well_mixed = well_mixed
    walkers%tally = new_tally(from, to, copies, count(particles%x >= 0.0_wp))
    walkers%urn_kinds = merge(1, 2, are_mirror_images(table%urn))
    walkers%lookahead = shortest_excursion(table)
    allocate (walkers%gate(copies, 2))
    do urn = 1, 2
      walkers%mean(urn) = mean_urn_passage(table%urn(urn))
      do copy = 1, copies
        call new_gate(walkers%gate(copy, urn), threshold(urn))
      end do
    end do
    walkers%window = min(walkers%lookahead, real(batch, wp)*minval(walkers%mean)/real(number, wp))
    walkers%draws = new_draws(seed)
    allocate (walkers%time(number), walkers%y(number), walkers%u_axial(number), &
      walkers%u_lateral(number), walkers%through(number), source=0.0_wp)
    allocate (walkers%urn(number), walkers%entrants(number), source=0)
    allocate (walkers%first(2*copies + 1), source=0)
    call begin_first_visits(walkers, particles)
  end subroutine new_walkers

  !> Computes the first visit of each walker, which starts inside an urn.
  subroutine begin_first_visits(walkers, particles)
    type(walkers_type), intent(inout) :: walkers
    type(particles_type), intent(in) :: particles
    integer :: i, urn

    call reserve_batch(walkers, 1, size(particles%x))
    do i = 1, size(particles%x)
      urn = urn_at(walkers%table, particles%x(i))
      associate (v => walkers%visits(min(urn, walkers%urn_kinds), 1))
        v%count = v%count + 1
        v%particle(v%count) = i
        v%urn(v%count) = urn
        v%time(v%count) = 0.0_wp
        v%hits(v%count) = 0.0_wp
        v%x(v%count) = walkers%table%urn(urn)%centre - abs(particles%x(i))
        v%y(v%count) = particles%y(i)
        v%u_axial(v%count) = -x_direction(urn)*particles%ux(i)
        v%u_lateral(v%count) = particles%uy(i)
      end associate
    end do
    walkers%current = 1
    call compute_current_visits(walkers)
    call complete_visits(walkers)
  end subroutine begin_first_visits

  !> Advances all walkers, window by window.
  subroutine advance_walkers(walkers, time)
    type(walkers_type), intent(inout) :: walkers
    !> Final time since the start; if it is not later than the present time, nothing is done.
    real(wp), intent(in) :: time
    real(wp) :: window_end
    integer :: urn, copy, bucket

    do while (walkers%now < time)
      window_end = min(time, walkers%now + walkers%window)
      call find_entrants(walkers, window_end)
      ! Only walkers that enter a gate or are counted in one can begin a visit in this window.
      call reserve_batch(walkers, walkers%current, walkers%first(2*walkers%copies + 1) &
        + sum(number_inside(walkers%gate)))
      do urn = 1, 2
        do copy = 1, walkers%copies
          bucket = (urn - 1)*walkers%copies + copy
          call run_gate(walkers, urn, copy, walkers%entrants(walkers%first(bucket) &
            + 1:walkers%first(bucket + 1)), window_end)
        end do
      end do
      walkers%now = window_end
      call complete_visits(walkers)
    end do
  end subroutine advance_walkers

  !> Finds the walkers that enter a gate before `window_end`, and draws their copies. Those of a
  !> gate are `entrants(first + 1:)`, up to the `first` of the next gate.
  subroutine find_entrants(walkers, window_end)
    type(walkers_type), intent(inout) :: walkers
    real(wp), intent(in) :: window_end
    integer :: due(size(walkers%time)), bucket(size(walkers%time))
    integer :: found, i, k

    found = 0
    do i = 1, size(walkers%time)
      due(found + 1) = i
      if (walkers%time(i) >= walkers%now .and. walkers%time(i) < window_end) found = found + 1
      if (found == size(due)) exit
    end do
    walkers%first = 0
    do k = 1, found
      bucket(k) = (walkers%urn(due(k)) - 1)*walkers%copies + 1
      if (walkers%copies > 1) bucket(k) = bucket(k) &
        + int(next_uniform(walkers%draws)*walkers%copies)
      walkers%first(bucket(k) + 1) = walkers%first(bucket(k) + 1) + 1
    end do
    do k = 2, size(walkers%first)
      walkers%first(k) = walkers%first(k) + walkers%first(k - 1)
    end do
    do k = found, 1, -1
      walkers%entrants(walkers%first(bucket(k) + 1)) = due(k)
      walkers%first(bucket(k) + 1) = walkers%first(bucket(k) + 1) - 1
    end do
    ! Element k + 1 of `first` is now that of bucket k.
    walkers%first(:size(walkers%first) - 1) = walkers%first(2:)
    walkers%first(size(walkers%first)) = found
  end subroutine find_entrants

  !> Processes the events of one copy of a gate until `window_end`: entries, crossings, reversals.
  subroutine run_gate(walkers, urn, copy, entrants, window_end)
    type(walkers_type), intent(inout) :: walkers
    integer, intent(in) :: urn, copy
    !> Walkers that enter; sorted by time on return.
    integer, intent(inout) :: entrants(:)
    real(wp), intent(in) :: window_end
    real(wp) :: time
    integer :: k

    call sort_by_time(entrants, walkers%time)
    associate (gate => walkers%gate(copy, urn))
      do k = 1, size(entrants)
        time = walkers%time(entrants(k))
        do while (next_crossing_time(gate) <= time)
          call cross_middle_line(walkers, urn, gate)
        end do
        call enter_gate(gate, time + 0.5_wp*walkers%through(entrants(k)), entrants(k))
        call add_count(walkers%tally, entered + urn, time, 1)
        if (must_reverse(gate)) call reverse_gate(walkers, urn, gate, time)
      end do
      do while (next_crossing_time(gate) < window_end)
        call cross_middle_line(walkers, urn, gate)
      end do
    end associate
  end subroutine run_gate

  !> Sorts the walkers that enter a gate by time (insertion sort, since they are few).
  pure subroutine sort_by_time(entrants, time)
    integer, intent(inout) :: entrants(:)
    !> Time of entry of each walker.
    real(wp), intent(in) :: time(:)
    integer :: k, at, one

    do k = 2, size(entrants)
      one = entrants(k)
      do at = k - 1, 1, -1
        if (time(entrants(at)) <= time(one)) exit
        entrants(at + 1) = entrants(at)
      end do
      entrants(at + 1) = one
    end do
  end subroutine sort_by_time

  !> Processes the earliest crossing of a gate: the walker is no longer counted, and its visit to
  !> the other urn begins.
  subroutine cross_middle_line(walkers, urn, gate)
    type(walkers_type), intent(inout) :: walkers
    integer, intent(in) :: urn
    type(gate_type), intent(inout) :: gate
    integer :: i

    call uncount_first(gate, i)
    call add_crossing(walkers%tally, urn, channel1, walkers%time(i) + 0.5_wp*walkers%through(i))
    call begin_visit_from_gate(walkers, i, walkers%table%urn_across(urn), walkers%through(i))
  end subroutine cross_middle_line

  !> Reverses a gate: each counted walker begins a visit to the urn that it came from. Its way out
  !> takes as long as its way in.
  subroutine reverse_gate(walkers, urn, gate, time)
    type(walkers_type), intent(inout) :: walkers
    integer, intent(in) :: urn
    type(gate_type), intent(inout) :: gate
    real(wp), intent(in) :: time
    integer :: k

    do k = 1, number_inside(gate)
      associate (i => counted_particle(gate, k))
        call begin_visit_from_gate(walkers, i, urn, 2.0_wp*(time - walkers%time(i)))
      end associate
    end do
    call add_count(walkers%tally, reversed + urn, time, number_inside(gate))
    call uncount_all(gate)
  end subroutine reverse_gate

  !> Begins the visit of a walker to an urn from channel 1, in which it spends the time `passage`.
  pure subroutine begin_visit_from_gate(walkers, i, urn, passage)
    type(walkers_type), intent(inout) :: walkers
    integer, intent(in) :: i, urn
    real(wp), intent(in) :: passage

    call add_visit(walkers%visits(min(urn, walkers%urn_kinds), walkers%current), i, urn, channel1, &
      walkers%time(i), passage, walkers%y(i), walkers%u_axial(i), walkers%u_lateral(i))
    walkers%time(i) = huge(1.0_wp)
  end subroutine begin_visit_from_gate

  !> Adds to a batch the visit of a walker that enters the channel before the urn at `time`, and
  !> spends the time `passage` in it.
  pure subroutine add_visit(v, i, urn, channel, time, passage, y, u_axial, u_lateral)
    type(visits_type), intent(inout) :: v
    integer, intent(in) :: i, urn, channel
    real(wp), intent(in) :: time, passage, y, u_axial, u_lateral

    v%count = v%count + 1
    v%particle(v%count) = i
    v%urn(v%count) = urn
    v%channel(v%count) = channel
    v%time(v%count) = time
    v%passage(v%count) = passage
    v%y(v%count) = y
    v%u_axial(v%count) = u_axial
    v%u_lateral(v%count) = u_lateral
  end subroutine add_visit

  !> Computes the visits of the current batch, and those that follow through channel 2, until the
  !> next entry of each walker into a gate is known.
  subroutine complete_visits(walkers)
    type(walkers_type), intent(inout) :: walkers
    integer :: urn_kind

    do while (sum(walkers%visits(:, walkers%current)%count) > 0)
      do urn_kind = 1, walkers%urn_kinds
        associate (v => walkers%visits(urn_kind, walkers%current))
          if (v%count > 0) call cross_channels(walkers%table%urn(urn_kind), v)
        end associate
      end do
      call compute_current_visits(walkers)
    end do
  end subroutine complete_visits

  !> Computes the visits of the current batch, from the entry into the urn to the next channel;
  !> those that follow through channel 2 become the current batch.
  subroutine compute_current_visits(walkers)
    type(walkers_type), intent(inout) :: walkers
    integer :: urn_kind

    call reserve_batch(walkers, 3 - walkers%current, sum(walkers%visits(:, &
      walkers%current)%count))
    do urn_kind = 1, walkers%urn_kinds
      associate (v => walkers%visits(urn_kind, walkers%current))
        if (v%count == 0) cycle
        if (walkers%well_mixed) then
          call draw_visit_ends(walkers, v)
        else
          call compute_passages(walkers%table%urn(urn_kind), v)
        end if
        call store_entries(walkers, v)
      end associate
    end do
    walkers%visits(:, walkers%current)%count = 0
    walkers%current = 3 - walkers%current
  end subroutine compute_current_visits

  !> Draws the ends of passages through an urn from the invariant measure of entries: opening in
  !> proportion to its width, height uniform, direction by the cosine law.
  subroutine draw_visit_ends(walkers, v)
    type(walkers_type), intent(inout) :: walkers
    type(visits_type), intent(inout) :: v
    real(wp) :: place, direction
    integer :: j

    do j = 1, v%count
      place = next_uniform(walkers%draws)
      direction = next_uniform(walkers%draws)
      call entry_of(walkers%table, int(v%urn(j)), place, direction, v%channel(j), v%x(j), v%y(j), &
        v%u_axial(j), v%u_lateral(j))
      v%u_axial(j) = abs(v%u_axial(j))
      v%through(j) = walkers%table%channel(v%channel(j))%length/v%u_axial(j)
      v%length(j) = walkers%lookahead &
        - log(next_uniform(walkers%draws))*max(walkers%mean(v%urn(j)) - walkers%lookahead, 0.0_wp)
    end do
  end subroutine draw_visit_ends

  !> Stores the next entry of each walker of a batch into a gate, or adds its visit after channel 2.
  subroutine store_entries(walkers, v)
    type(walkers_type), intent(inout) :: walkers
    type(visits_type), intent(in) :: v
    integer :: j, i, urn, to_urn
    real(wp) :: exit_time

    do j = 1, v%count
      i = v%particle(j)
      urn = v%urn(j)
      exit_time = v%time(j) + v%length(j)
      walkers%time(i) = huge(1.0_wp)
      if (v%channel(j) == no_channel) cycle
      if (v%channel(j) == channel1) then
        walkers%time(i) = exit_time
        walkers%urn(i) = urn
        walkers%y(i) = v%y(j)
        walkers%u_axial(i) = v%u_axial(j)
        walkers%u_lateral(i) = v%u_lateral(j)
        walkers%through(i) = v%through(j)
        cycle
      end if
      call add_crossing(walkers%tally, urn, channel2, exit_time + 0.5_wp*v%through(j))
      to_urn = walkers%table%urn_across(urn)
      call add_visit(walkers%visits(min(to_urn, walkers%urn_kinds), 3 - walkers%current), i, &
        to_urn, channel2, exit_time, v%through(j), v%y(j), v%u_axial(j), v%u_lateral(j))
    end do
  end subroutine store_entries

  !> Empties batch `batch_index` (1 or 2) of all urn kinds, and allocates it for `capacity` visits.
  subroutine reserve_batch(walkers, batch_index, capacity)
    type(walkers_type), intent(inout) :: walkers
    integer, intent(in) :: batch_index, capacity
    integer :: urn_kind

    do urn_kind = 1, walkers%urn_kinds
      call reserve_visits(walkers%visits(urn_kind, batch_index), capacity)
    end do
  end subroutine reserve_batch

end module battery_walkers
