!> The kinds of chambers: a new one is a file and a line here.
module battery_chambers
  use battery_table, only: table_type
  use battery_chamber, only: chamber_type
  use battery_disc, only: new_disc
  implicit none (type, external)
  private
  public :: urn_chamber_type, new_chamber

  !> The chamber of an urn.
  type :: urn_chamber_type
    class(chamber_type), allocatable :: chamber
  end type urn_chamber_type

contains

  !> The chamber that the urn of a side of the table is: a disc, the only kind so far.
  subroutine new_chamber(table, side, urn)
    type(table_type), intent(in) :: table
    !> 1 or 2.
    integer, intent(in) :: side
    !> Holds the chamber.
    type(urn_chamber_type), intent(out) :: urn

    allocate (urn%chamber, source=new_disc(table, side))
  end subroutine new_chamber

end module battery_chambers
