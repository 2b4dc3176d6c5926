!> Remarks on a plan: choices that are allowed but hardly ever intended, and known deficits of its
!> results.
module battery_plan_remarks
  use battery_current_age, only: current_remark
  use battery_keys, only: key_radius
  use battery_kinds, only: wp
  use battery_findings, only: finding_type, finding_of, of_remark
  use battery_plan, only: plan_type, point_type, point_of, points_text
  use battery_table, only: channel2
  use battery_text, only: string_type, to_text, join
  implicit none (type, external)
  private
  public :: remarks_of

  !> Conditions that are tested at a point. A gate reverses when it counts more than T particles, so
  !> never if T >= N.
  integer, parameter :: no_gate = 1, not_gate_1 = 2, not_gate_2 = 3, shut = 4

contains

  !> Remarks on a plan without problems, one sentence each, with the points of the scan.
  function remarks_of(plan) result(remarks)
    type(plan_type), intent(in) :: plan
    type(string_type), allocatable :: remarks(:)
    type(point_type) :: point
    logical :: never(2)
    !> Number of points that satisfy each condition, and the first of them.
    integer :: points(shut), first(shut)
    type(string_type) :: on_currents, radii(2)
    integer :: at

    points = 0
    first = 0
    do at = 1, plan%point_count
      point = point_of(plan, at)
      never = point%threshold >= point%number
      if (plan%shape == 'urn') never(2) = never(1)
      call count_point(no_gate, all(never))
      call count_point(not_gate_1, never(1) .and. .not. never(2))
      call count_point(not_gate_2, never(2) .and. .not. never(1))
      call count_point(shut, shutting_disc(plan, point) > 0)
    end do
    allocate (remarks(0))
    call add(no_gate, trim(merge('the gate never reverses   ', 'neither gate ever reverses', &
      plan%shape == 'urn'))//', for T is not below N')
    call add(not_gate_1, 'gate 1 never reverses, for its T is not below N')
    call add(not_gate_2, 'gate 2 never reverses, for its T is not below N')
    if (points(shut) > 0) call add(shut, 'disc '//to_text(shutting_disc(plan, point_of(plan, &
      first(shut))))//' of scatterers reaches from wall to wall: no particle passes channel 2')
    ! A decimal comma separates two numbers.
    do at = 1, 2
      radii(at)%text = to_text(plan%base%of(key_radius)%real(at))
    end do
    if (plan%shape /= 'urn' .and. radii(1)%text /= radii(2)%text) remarks = [remarks, &
      string_type('urn_radius = '//join(radii, ', ')//' are two radii: '//radii(1)%text &
      //' of urn 1, '//radii(2)%text//' of urn 2')]
    on_currents%text = current_remark(plan)
    if (on_currents%text /= '') remarks = [remarks, on_currents]

  contains

    !> Counts the present point of the scan for remark number `what`, if `is_so` holds there.
    subroutine count_point(what, is_so)
      integer, intent(in) :: what
      logical, intent(in) :: is_so

      if (.not. is_so) return
      if (points(what) == 0) first(what) = at
      points(what) = points(what) + 1
    end subroutine count_point

    !> Adds remark number `what` to the list, if it holds at any point of the scan.
    subroutine add(what, sentence)
      integer, intent(in) :: what
      character(len=*), intent(in) :: sentence
      type(finding_type) :: finding

      if (points(what) == 0) return
      finding = finding_of(0, sentence, key='', kind=of_remark)
      finding%points = points(what)
      finding%first_point = first(what)
      remarks = [remarks, string_type(sentence//points_text(plan, finding))]
    end subroutine add

  end function remarks_of

  !> The first disc that reaches from wall to wall of channel 2; 0: none. Discs do not touch each
  !> other, so they close the channel only if one of them does.
  pure integer function shutting_disc(plan, point) result(disc)
    type(plan_type), intent(in) :: plan
    type(point_type), intent(in) :: point

    do disc = 1, size(plan%scatterers)/3
      associate (y => plan%scatterers(3*disc - 1), radius => plan%scatterers(3*disc))
        if (abs(y) + 0.5_wp*point%channel(channel2)%width <= radius) return
      end associate
    end do
    disc = 0
  end function shutting_disc

end module battery_plan_remarks
