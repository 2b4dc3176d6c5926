!> Standard errors from blocks of a time series whose length is not known beforehand.
!>
!> The averages of equal blocks of time are kept; when there are `most_blocks`, neighbours are
!> merged and the blocks become twice as long. So between half of that many and all of them are
!> there at the end, and their scatter gives the error as long as they are longer than the memory of
!> the process; where they are not, replicas tell.
module battery_blocks
  use battery_kinds, only: wp, dp
  use battery_quantities, only: unknown_real
  use battery_stream, only: stream_type
  implicit none (type, external)
  private
  public :: blocks_type, most_blocks, add_block, standard_error, error_of_mean, &
    pass_blocks

  integer, parameter :: most_blocks = 64

  !> Averages over blocks of a run, all equally long.
  type :: blocks_type
    !> Length of a block in time units, and how many are complete.
    real(wp) :: length = 1.0_wp
    integer :: count = 0
    real(wp) :: average(most_blocks) = 0.0_wp
  end type blocks_type

contains

  !> Adds the average over the block just completed; merges when all places are taken.
  pure subroutine add_block(blocks, average)
    type(blocks_type), intent(inout) :: blocks
    !> In the unit of the quantity.
    real(wp), intent(in) :: average
    integer :: half

    blocks%count = blocks%count + 1
    blocks%average(blocks%count) = average
    if (blocks%count < most_blocks) return
    half = most_blocks/2
    blocks%average(:half) = 0.5_wp*(blocks%average(1:most_blocks:2) &
      + blocks%average(2:most_blocks:2))
    blocks%count = half
    blocks%length = 2.0_wp*blocks%length
  end subroutine add_block

  !> Standard error of the mean, in the unit of the quantity; NaN with fewer than two complete
  !> blocks.
  pure function standard_error(blocks) result(error)
    type(blocks_type), intent(in) :: blocks
    real(wp) :: error

    error = real(error_of_mean(real(blocks%average(:blocks%count), dp)), wp)
  end function standard_error

  !> Standard error of the mean of independent values, from their scatter; NaN of fewer than two.
  pure function error_of_mean(values) result(error)
    !> Any number of them, in the unit of the quantity, as the error is.
    real(dp), intent(in) :: values(:)
    real(dp) :: error
    real(dp), allocatable :: squares(:)
    integer :: n

    error = unknown_real()
    n = size(values)
    if (n < 2) return
    ! Kept before they are summed: whether a sum of products is of fused ones, and which, would
    ! depend on the length of the processor's vectors, and so would the last bit.
    squares = (values - sum(values)/n)**2
    error = sqrt(sum(squares)/(real(n, dp)*real(n - 1, dp)))
  end function error_of_mean

  !> Through a stream.
  pure subroutine pass_blocks(blocks, stream)
    type(blocks_type), intent(inout) :: blocks
    type(stream_type), intent(inout) :: stream

    call stream%pass('length', blocks%length)
    call stream%pass('count', blocks%count)
    call stream%pass('average', blocks%average)
  end subroutine pass_blocks

end module battery_blocks
