!> One-particle theory by simulation: many independent walkers, each between gates that count all of
!> them.
!>
!> Visits are exact. There are several `copies` of the circuit, with N walkers to each, and an entry
!> into a gate takes place in a randomly drawn copy. So a gate is independent of the past of the
!> walkers that enter it: the entries into one copy are a thinned sequence of all entries, a Poisson
!> process in the limit of many copies, with the rate and the stays of the walkers themselves. That
!> is the renewal gate, made self-consistent, and the number of walkers is conserved. With a single
!> copy nothing is drawn, and the simulation is that of the circuit itself.
!>
!> A window is as long as the shortest excursion, so all entries in it are known at its start.
!> Channel 2 has no gate: a walker that leaves through it begins its next visit at once, and its
!> crossing is counted at a time that may lie ahead.
!>
!> With `well_mixed` a visit has no memory of its start: its end is drawn from the measure of
!> entries, and its length, beyond the shortest excursion, is exponential about the mean.
module battery_walkers
  use battery_kinds, only: wp, int64, pi
  use battery_table, only: table_type, gated, ungated, urn_at, x_direction, are_mirror_images, &
    mean_visit, shortest_excursion
  use battery_engine, only: particles_type
  use battery_chamber, only: cross_channels
  use battery_urn, only: compute_visits
  use battery_visits, only: visits_type, reserve_visits, no_channel
  use battery_gate, only: gate_type, new_gate, enter_gate, must_reverse, uncount_first, &
    uncount_all, number_inside, counted_particle, next_crossing_time
  use battery_tally, only: tally_type, new_tally, add_entry, add_reversed, add_crossing
  use battery_draws, only: draws_type, new_draws, next_uniform
  implicit none (type, external)
  private
  public :: walkers_type, new_walkers, advance_walkers

  !> Largest number of entries in a window, about.
  integer, parameter :: batch = 4096

  !> Walkers, the copies of the gates, and what has been measured.
  type :: walkers_type
    type(tally_type) :: tally
    type(table_type) :: table
    integer :: copies = 1
    logical :: well_mixed = .false.
    real(wp) :: now = 0.0_wp
    !> Gates by (copy, urn).
    type(gate_type), allocatable :: gate(:, :)
    !> How each walker will enter its next gate, or entered the one that counts it: time (huge:
    !> never), height, |u_x| and u_y, duration of the passage through the whole channel; urn of that
    !> gate.
    real(wp), allocatable :: time(:), y(:), u_axial(:), u_lateral(:), through(:)
    integer, allocatable :: urn(:)
    !> Visits by chamber (mirror-image urns share one): those to be computed, and those that follow
    !> them.
    type(visits_type) :: visits(2, 2)
    integer :: chambers = 1, under_way = 1
    !> Longest window; shortest and mean length of a visit if urns are well mixed.
    real(wp) :: window = 0.0_wp, shortest = 0.0_wp, mean(2) = 0.0_wp
    type(draws_type) :: draws
    !> Walkers that enter in a window, by gate and then by time; index at which those of each gate
    !> start.
    integer, allocatable :: who(:), first(:)
  end type walkers_type

contains

  !> Sets up walkers in the state of `particles`, which are all in the urns.
  subroutine new_walkers(walkers, table, threshold, copies, particles, seed, well_mixed, from, to)
    type(walkers_type), intent(out) :: walkers
    !> A circuit.
    type(table_type), intent(in) :: table
    !> Thresholds of the gates of urn 1 and 2.
    integer, intent(in) :: threshold(2)
    !> Number of copies of the circuit; each has its share of the particles.
    integer, intent(in) :: copies
    !> N of them for each copy.
    type(particles_type), intent(in) :: particles
    !> Seed of the random numbers: any 64 bits.
    integer(int64), intent(in) :: seed
    !> Whether visits have no memory of their start.
    logical, intent(in) :: well_mixed
    !> Times since the start: what happens after `from`, up to `to`, is measured.
    real(wp), intent(in) :: from, to
    integer :: number, urn, copy

    number = size(particles%x)
    walkers%table = table
    walkers%copies = copies
    walkers%well_mixed = well_mixed
    walkers%tally = new_tally(from, to, copies, count(particles%x >= 0.0_wp))
    walkers%chambers = merge(1, 2, are_mirror_images(table%urn))
    walkers%shortest = shortest_excursion(table)
    allocate (walkers%gate(copies, 2))
    do urn = 1, 2
      walkers%mean(urn) = mean_visit(table%urn(urn))
      do copy = 1, copies
        call new_gate(walkers%gate(copy, urn), threshold(urn))
      end do
    end do
    walkers%window = min(walkers%shortest, real(batch, wp)*minval(walkers%mean)/real(number, wp))
    walkers%draws = new_draws(seed)
    allocate (walkers%time(number), walkers%y(number), walkers%u_axial(number), &
      walkers%u_lateral(number), walkers%through(number), source=0.0_wp)
    allocate (walkers%urn(number), walkers%who(number), source=0)
    allocate (walkers%first(2*copies + 1), source=0)
    call begin_first_visits(walkers, particles)
  end subroutine new_walkers

  !> Computes the first visits, which start inside the urns.
  subroutine begin_first_visits(walkers, particles)
    type(walkers_type), intent(inout) :: walkers
    type(particles_type), intent(in) :: particles
    integer :: i, urn

    call reserve_batch(walkers, 1, size(particles%x))
    do i = 1, size(particles%x)
      urn = urn_at(walkers%table, particles%x(i))
      associate (v => walkers%visits(min(urn, walkers%chambers), 1))
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
    walkers%under_way = 1
    call compute_visits_under_way(walkers)
    call complete_visits(walkers)
  end subroutine begin_first_visits

  !> Advances all walkers to a time since the start.
  subroutine advance_walkers(walkers, time)
    type(walkers_type), intent(inout) :: walkers
    !> If it lies in the past, nothing happens.
    real(wp), intent(in) :: time
    real(wp) :: ends
    integer :: urn, copy, bucket

    do while (walkers%now < time)
      ends = min(time, walkers%now + walkers%window)
      call find_entrants(walkers, ends)
      ! At most the walkers that enter and those in the gates begin a visit.
      call reserve_batch(walkers, walkers%under_way, walkers%first(2*walkers%copies + 1) &
        + sum(number_inside(walkers%gate)))
      do urn = 1, 2
        do copy = 1, walkers%copies
          bucket = (urn - 1)*walkers%copies + copy
          call run_gate(walkers, urn, copy, walkers%who(walkers%first(bucket) &
            + 1:walkers%first(bucket + 1)), ends)
        end do
      end do
      walkers%now = ends
      call complete_visits(walkers)
    end do
  end subroutine advance_walkers

  !> Finds the walkers that enter a gate before `ends`, and draws their copies: those of a gate are
  !> `who(first + 1:)` up to the `first` of the next gate.
  subroutine find_entrants(walkers, ends)
    type(walkers_type), intent(inout) :: walkers
    real(wp), intent(in) :: ends
    integer :: due(size(walkers%time)), bucket(size(walkers%time))
    integer :: found, i, k

    found = 0
    do i = 1, size(walkers%time)
      due(found + 1) = i
      if (walkers%time(i) >= walkers%now .and. walkers%time(i) < ends) found = found + 1
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
      walkers%who(walkers%first(bucket(k) + 1)) = due(k)
      walkers%first(bucket(k) + 1) = walkers%first(bucket(k) + 1) - 1
    end do
    ! Each `first` is now the start of its bucket, but one place late.
    walkers%first(:size(walkers%first) - 1) = walkers%first(2:)
    walkers%first(size(walkers%first)) = found
  end subroutine find_entrants

  !> Processes one copy of a gate until `ends`: entries in the order of time, crossings, reversals.
  subroutine run_gate(walkers, urn, copy, who, ends)
    type(walkers_type), intent(inout) :: walkers
    integer, intent(in) :: urn, copy
    integer, intent(inout) :: who(:)
    real(wp), intent(in) :: ends
    real(wp) :: time
    integer :: k

    call sort_by_time(who, walkers%time)
    associate (gate => walkers%gate(copy, urn))
      do k = 1, size(who)
        time = walkers%time(who(k))
        do while (next_crossing_time(gate) <= time)
          call cross_middle_line(walkers, urn, gate)
        end do
        call enter_gate(gate, time + 0.5_wp*walkers%through(who(k)), who(k))
        call add_entry(walkers%tally, urn, time)
        if (must_reverse(gate)) call reverse_gate(walkers, urn, gate, time)
      end do
      do while (next_crossing_time(gate) < ends)
        call cross_middle_line(walkers, urn, gate)
      end do
    end associate
  end subroutine run_gate

  !> Sorts the entries into a gate by time; few, so by insertion.
  pure subroutine sort_by_time(who, time)
    integer, intent(inout) :: who(:)
    real(wp), intent(in) :: time(:)
    integer :: k, at, one

    do k = 2, size(who)
      one = who(k)
      do at = k - 1, 1, -1
        if (time(who(at)) <= time(one)) exit
        who(at + 1) = who(at)
      end do
      who(at + 1) = one
    end do
  end subroutine sort_by_time

  !> Takes the earliest counted walker across the middle line, and begins its visit to the other
  !> urn.
  subroutine cross_middle_line(walkers, urn, gate)
    type(walkers_type), intent(inout) :: walkers
    integer, intent(in) :: urn
    type(gate_type), intent(inout) :: gate
    integer :: i

    call uncount_first(gate, i)
    call add_crossing(walkers%tally, urn, gated, walkers%time(i) + 0.5_wp*walkers%through(i))
    call begin_visit_from_gate(walkers, i, walkers%table%beyond(urn), walkers%through(i))
  end subroutine cross_middle_line

  !> Reverses a gate: each counted walker begins a visit to its own urn. The way out takes as long
  !> as the way in.
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
    call add_reversed(walkers%tally, urn, time, number_inside(gate))
    call uncount_all(gate)
  end subroutine reverse_gate

  !> Begins a visit from channel 1, which the walker leaves `passage` after it entered it.
  pure subroutine begin_visit_from_gate(walkers, i, urn, passage)
    type(walkers_type), intent(inout) :: walkers
    integer, intent(in) :: i, urn
    real(wp), intent(in) :: passage

    call add_visit(walkers%visits(min(urn, walkers%chambers), walkers%under_way), i, urn, gated, &
      walkers%time(i), passage, walkers%y(i), walkers%u_axial(i), walkers%u_lateral(i))
    walkers%time(i) = huge(1.0_wp)
  end subroutine begin_visit_from_gate

  !> Adds a visit to a batch: of a walker that entered a channel at `time`, and is in it for
  !> `passage`.
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

  !> Computes visits, and those that follow through channel 2, until each walker heads for a gate.
  subroutine complete_visits(walkers)
    type(walkers_type), intent(inout) :: walkers
    integer :: chamber

    do while (sum(walkers%visits(:, walkers%under_way)%count) > 0)
      do chamber = 1, walkers%chambers
        associate (v => walkers%visits(chamber, walkers%under_way))
          if (v%count > 0) call cross_channels(walkers%table%urn(chamber), v)
        end associate
      end do
      call compute_visits_under_way(walkers)
    end do
  end subroutine complete_visits

  !> Computes the visits of the present batch from the urn to the next channel; those that follow
  !> through channel 2 become the present batch.
  subroutine compute_visits_under_way(walkers)
    type(walkers_type), intent(inout) :: walkers
    integer :: chamber

    call reserve_batch(walkers, 3 - walkers%under_way, sum(walkers%visits(:, &
      walkers%under_way)%count))
    do chamber = 1, walkers%chambers
      associate (v => walkers%visits(chamber, walkers%under_way))
        if (v%count == 0) cycle
        if (walkers%well_mixed) then
          call draw_visit_ends(walkers, v)
        else
          call compute_visits(walkers%table%urn(chamber), v)
        end if
        call store_entries(walkers, v)
      end associate
    end do
    walkers%visits(:, walkers%under_way)%count = 0
    walkers%under_way = 3 - walkers%under_way
  end subroutine compute_visits_under_way

  !> Draws the ends of visits from the measure of entries: the opening by its width, the height
  !> uniform, the direction by the cosine law.
  subroutine draw_visit_ends(walkers, v)
    type(walkers_type), intent(inout) :: walkers
    type(visits_type), intent(inout) :: v
    integer :: j, channel

    associate (width => walkers%table%channel%width, length => walkers%table%channel%length)
      do j = 1, v%count
        channel = merge(gated, ungated, next_uniform(walkers%draws)*sum(width) < width(gated))
        v%channel(j) = channel
        v%y(j) = (next_uniform(walkers%draws) - 0.5_wp)*width(channel)
        v%u_lateral(j) = 2.0_wp*next_uniform(walkers%draws) - 1.0_wp
        v%u_axial(j) = sqrt((1.0_wp - v%u_lateral(j))*(1.0_wp + v%u_lateral(j)))
        v%through(j) = length(channel)/v%u_axial(j)
        v%length(j) = walkers%shortest &
          - log(next_uniform(walkers%draws))*max(walkers%mean(v%urn(j)) - walkers%shortest, 0.0_wp)
      end do
    end associate
  end subroutine draw_visit_ends

  !> Stores how each walker of a batch enters its next gate, or adds its visit through channel 2.
  subroutine store_entries(walkers, v)
    type(walkers_type), intent(inout) :: walkers
    type(visits_type), intent(in) :: v
    integer :: j, i, urn, beyond
    real(wp) :: leaves

    do j = 1, v%count
      i = v%particle(j)
      urn = v%urn(j)
      leaves = v%time(j) + v%length(j)
      walkers%time(i) = huge(1.0_wp)
      if (v%channel(j) == no_channel) cycle
      if (v%channel(j) == gated) then
        walkers%time(i) = leaves
        walkers%urn(i) = urn
        walkers%y(i) = v%y(j)
        walkers%u_axial(i) = v%u_axial(j)
        walkers%u_lateral(i) = v%u_lateral(j)
        walkers%through(i) = v%through(j)
        cycle
      end if
      call add_crossing(walkers%tally, urn, ungated, leaves + 0.5_wp*v%through(j))
      beyond = walkers%table%beyond(urn)
      call add_visit(walkers%visits(min(beyond, walkers%chambers), 3 - walkers%under_way), i, &
        beyond, ungated, leaves, v%through(j), v%y(j), v%u_axial(j), v%u_lateral(j))
    end do
  end subroutine store_entries

  !> Empties the batches of all chambers, and allocates them for that many visits.
  subroutine reserve_batch(walkers, which, room)
    type(walkers_type), intent(inout) :: walkers
    integer, intent(in) :: which, room
    integer :: chamber

    do chamber = 1, walkers%chambers
      call reserve_visits(walkers%visits(chamber, which), room)
    end do
  end subroutine reserve_batch

end module battery_walkers
