!> Checks the scatterers in channel 2.
!>
!> One length, the least that coordinates resolve, bounds the radii of discs, their distances from
!> each other, from the walls, and from the openings. For the openings, only the part of a disc
!> within the channel counts; for other discs, the whole disc. A disc may overlap a wall; where it
!> touches one the gap beside it has no width, and rounding would keep a particle there for ever.
module battery_scatterer_checks
  use battery_kinds, only: wp
  use battery_text, only: to_text, numbers_text
  use battery_bounds, only: finest
  use battery_plan, only: plan_type, point_type, refuse_key, values_of
  use battery_table, only: channel2
  implicit none (type, external)
  private
  public :: check_scatterers

contains

  !> Checks that the scatterers fit into channel 2 of a point; adds what is wrong to the problems of
  !> the plan.
  subroutine check_scatterers(plan, point)
    type(plan_type), intent(inout) :: plan
    type(point_type), intent(in) :: point
    !> Least radius, and least gap.
    real(wp) :: least
    real(wp) :: half_length, half_width
    character(len=:), allocatable :: gap
    integer :: k, count, other

    if (size(plan%scatterers) == 0) return
    if (plan%shape == 'urn') then
      call refuse_key(plan, 'scatterers', 'is given', &
        'nothing, since the shape ''urn'' has no channel 2')
      return
    end if
    count = size(plan%scatterers)/3
    if (size(plan%scatterers) /= 3*count) call add('is wrong: has ' &
      //to_text(size(plan%scatterers))//' values', 'three for each disc: z, y, radius')
    half_length = 0.5_wp*point%channel(channel2)%length
    half_width = 0.5_wp*point%channel(channel2)%width
    if (.not. half_width > 0.0_wp) then
      call add('is given where channel 2 is closed', 'nothing, or a channel2_width above 0')
      return
    end if
    least = finest*max(maxval(point%urn_radius), maxval(point%channel%length))
    gap = ', by '//to_text(least)//' or more'
    do k = 1, count
      associate (values => plan%scatterers, z => plan%scatterers(3*k - 2), &
        y => plan%scatterers(3*k - 1), radius => plan%scatterers(3*k))
        if (.not. radius >= least) then
          call add(' is too small', 'a radius from '//to_text(least)//' up', k)
        else if (.not. abs(y) - radius <= half_width - least) then
          call add(' is outside of the channel', '|y| - radius below channel2_width/2' &
            //which_is(half_width, 'channel2_width')//gap, k)
        else if (.not. abs(half_width - abs(y) - radius) >= least) then
          call add(' touches a wall of the channel', '|y| + radius below or above ' &
            //'channel2_width/2'//which_is(half_width, 'channel2_width')//gap, k)
        else if (.not. abs(z) + reach_of(y, radius) <= half_length - least) then
          call add(' reaches into an opening', '|z| + '//to_text(reach_of(y, radius)) &
            //', which is how far it reaches within the channel, below channel2_length/2' &
            //which_is(half_length, 'channel2_length')//gap, k)
        end if
        do other = 1, k - 1
          if (hypot(values(3*other - 2) - z, values(3*other - 1) - y) >= values(3*other) + radius &
            + least) cycle
          call add(' meets '//place(other), 'discs that are apart'//gap, k)
        end do
      end associate
    end do

  contains

    !> Extent of a disc along the channel, from its centre to either side, within the channel.
    pure real(wp) function reach_of(y, radius) result(reach)
      real(wp), intent(in) :: y, radius
      real(wp) :: beyond

      beyond = max(abs(y) - half_width, 0.0_wp)
      reach = sqrt((radius - beyond)*(radius + beyond))
    end function reach_of

    !> Text for the bound that follows from a key; empty if that has several values: then one line
    !> is for all points that have the fault.
    pure function which_is(bound, key) result(text)
      real(wp), intent(in) :: bound
      character(len=*), intent(in) :: key
      character(len=:), allocatable :: text

      text = ', which is '//to_text(bound)
      if (size(values_of(plan, key)) > 1) text = ''
    end function which_is

    !> Adds a problem, of one disc if its index is given.
    subroutine add(state, allowed, disc)
      character(len=*), intent(in) :: state, allowed
      integer, intent(in), optional :: disc
      character(len=:), allocatable :: all

      all = state
      if (present(disc)) all = 'is wrong: '//place(disc)//state
      call refuse_key(plan, 'scatterers', all, allowed)
    end subroutine add

    !> Text for a disc: its index and its numbers.
    pure function place(k) result(text)
      integer, intent(in) :: k
      character(len=:), allocatable :: text

      text = 'disc '//to_text(k)//' (values '//to_text(3*k - 2)//' to '//to_text(3*k)//': ' &
        //numbers_text(plan%scatterers(3*k - 2:3*k), ', ')//')'
    end function place

  end subroutine check_scatterers

end module battery_scatterer_checks
