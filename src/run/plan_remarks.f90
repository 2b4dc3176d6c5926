!> Remarks on a plan: choices that are allowed but hardly ever intended, and known deficits of its
!> results.
module battery_plan_remarks
  use battery_current_age, only: current_remark
  use battery_keys, only: key_radius
  use battery_kinds, only: wp, dp
  use battery_findings, only: findings_type, finding_type, finding_of, add_finding, of_remark
  use battery_plan, only: plan_type, point_type, point_of, points_text, is_scanned
  use battery_settings, only: find_setting
  use battery_table, only: channel2
  use battery_text, only: string_type, to_text, join
  implicit none (type, external)
  private
  public :: remarks_of

contains

  !> Remarks on a plan without problems, one sentence each, with the points of the scan.
  function remarks_of(plan, seconds) result(remarks)
    type(plan_type), intent(in) :: plan
    !> Expected duration of the run in seconds; 0: not known.
    real(dp), intent(in) :: seconds
    type(findings_type) :: remarks
    type(point_type) :: point
    type(finding_type) :: finding
    type(string_type) :: sentences(4), radii(2)
    character(len=:), allocatable :: young
    !> Whether each gate never reverses: it does when it counts more than T particles.
    logical :: never(2)
    !> Whether each sentence holds at a point; number of points where it does, and the first.
    logical :: holds(4)
    integer :: points(4), first(4), at

    points = 0
    do at = 1, plan%point_count
      point = point_of(plan, at)
      never = point%threshold >= point%number
      if (plan%shape == 'urn') never(2) = never(1)
      holds = [all(never), never(1) .and. .not. never(2), never(2) .and. .not. never(1), &
        shutting_disc(plan, point) > 0]
      where (holds .and. points == 0) first = at
      where (holds) points = points + 1
    end do
    sentences(1)%text = trim(merge('the gate never reverses   ', 'neither gate ever reverses', &
      plan%shape == 'urn'))//', for T is not below N'
    sentences(2)%text = 'gate 1 never reverses, for its T is not below N'
    sentences(3)%text = 'gate 2 never reverses, for its T is not below N'
    if (points(4) > 0) sentences(4)%text = 'disc '//to_text(shutting_disc(plan, point_of(plan, &
      first(4))))//' of scatterers reaches from wall to wall: no particle passes channel 2'
    do at = 1, size(sentences)
      if (points(at) == 0) cycle
      finding = finding_of(0, sentences(at)%text, key='', kind=of_remark)
      finding%points = points(at)
      finding%first_point = first(at)
      call add_finding(remarks, finding_of(0, finding%value//points_text(plan, finding)))
    end do
    ! A decimal comma separates two numbers.
    do at = 1, 2
      radii(at)%text = to_text(plan%base%of(key_radius)%real(at))
    end do
    if (may_be_one()) call add_finding(remarks, finding_of(0, 'urn_radius = '//join(radii, ', ') &
      //' are two radii: '//radii(1)%text//' of urn 1, '//radii(2)%text//' of urn 2'))
    young = current_remark(plan, seconds)
    if (young /= '') call add_finding(remarks, finding_of(0, young))

  contains

    !> Whether two radii may be meant as one: they differ, or both are whole numbers, as 1,1.
    logical function may_be_one() result(yes)

      yes = plan%shape /= 'urn' .and. .not. (is_scanned(plan, 'urn_radius') .or. is_scanned(plan, &
        'urn_radius2'))
      associate (given => plan%settings%all(find_setting(plan%settings, 'urn_radius'))%reals)
        if (yes) yes = size(given) == 2 .and. (radii(1)%text /= radii(2)%text .or. &
          all(abs(given - anint(given)) <= 0.0_wp))
      end associate
    end function may_be_one

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
