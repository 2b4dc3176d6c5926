!> Rows of the speed tables: the parameters of a case, the rates of its rounds, and their output as
!> text and as JSON.
module battery_bench_rows
  use, intrinsic :: iso_fortran_env, only: compiler_version
  use battery_kinds, only: wp, dp, int64
  use battery_build_information, only: program_version, git_commit
  implicit none (type, external)
  private
  public :: case_type, rate_type, cost_of_collision, cost_of_visit, cost_of_time, write_title, &
    write_row, begin_json, write_json_row, end_json, processor_name, peak_memory

  !> Parameters of a case.
  type :: case_type
    !> Name of the engine; number of particles, threshold of both gates; widths of the channels.
    character(len=12) :: engine = 'excursion'
    integer :: number = 1000, threshold = 7
    real(wp) :: width1 = 0.3_wp, width2 = 0.01_wp
    !> Sides of urns that are regular polygons; 0: discs.
    integer :: sides = 0
    !> Number of discs in channel 2.
    integer :: scatterers = 0
    !> Duration of a round in seconds; of the warm-up before the first round, in time units.
    real(dp) :: seconds = 0.5_dp
    real(wp) :: warm_up = 50.0_wp
  end type case_type

  !> Rates of one round, per second of processor time: wall collisions, passages through an urn, and
  !> simulated time summed over the particles.
  type :: rate_type
    real(dp) :: collisions = 0.0_dp, visits = 0.0_dp, particle_time = 0.0_dp
  end type rate_type

  ! Quantity whose cost a table gives relative to its first row.
  integer, parameter :: cost_of_collision = 1, cost_of_visit = 2, cost_of_time = 3

contains

  !> Writes the start of a JSON file, up to the list of rows.
  subroutine begin_json(file)
    integer, intent(in) :: file

    write (file, '(a)') '{"version": "'//program_version//'", "commit": "'//git_commit()//'",', &
      ' "compiler": "'//compiler_version()//'", "processor": "'//processor_name()//'", "rows": ['
  end subroutine begin_json

  !> Writes the end of a JSON file, after the last row.
  subroutine end_json(file)
    integer, intent(in) :: file

    write (file, '(a, i0, a)') '], "peak_memory_kilobytes": ', peak_memory(), '}'
  end subroutine end_json

  !> Writes one row: an object that has, for each rate, the list of its rounds.
  subroutine write_json_row(file, key, one, rates, first)
    integer, intent(in) :: file
    !> Name of the table.
    character(len=*), intent(in) :: key
    type(case_type), intent(in) :: one
    !> By round.
    type(rate_type), intent(in) :: rates(:)
    !> Whether it is the first row of the file; a comma precedes all others.
    logical, intent(in) :: first

    write (file, '(5a, i0, a, i0, a, es12.5, a, es12.5, a, i0, a, i0, a)') merge(' ', ',', first), &
      '{"table": "', key, '", "engine": "'//trim(one%engine), '", "number": ', one%number, &
      ', "threshold": ', one%threshold, ', "channel1_width": ', one%width1, &
      ', "channel2_width": ', one%width2, ', "sides": ', one%sides, ', "scatterers": ', &
      one%scatterers, ','
    call write_list('collisions_per_second', rates%collisions, ',')
    call write_list('visits_per_second', rates%visits, ',')
    call write_list('particle_time_per_second', rates%particle_time, '}')

  contains

    !> Writes the values of one rate, by round.
    subroutine write_list(name, values, end)
      character(len=*), intent(in) :: name, end
      real(dp), intent(in) :: values(:)

      write (file, '(3a, *(es12.5, :, ", "))', advance='no') '  "', name, '": [', values
      write (file, '(2a)') ']', end
    end subroutine write_list

  end subroutine write_json_row

  !> Writes the title of a table and the headings of its columns.
  subroutine write_title(unit, title, cost)
    integer, intent(in) :: unit, cost
    character(len=*), intent(in) :: title
    character(len=14), parameter :: costs(3) = [character(len=14) :: 'cost/collision', &
      '    cost/visit', 'cost/time unit']

    write (unit, '(/, a, /, t71, a, t86, a)') title, 'ns per time', costs(cost)
    write (unit, '(a, t19, a, t26, a, t34, a, t41, a, t49, a, t63, a, t72, a, t86, a)') 'engine', &
      'N', 'T', 'w', 'w''', 'collisions/s', 'visits/s', '& particle', 'over the first'
  end subroutine write_title

  !> Writes one row: medians over the rounds, and after +- half the range in per cent.
  subroutine write_row(unit, one, rates, reference, cost)
    integer, intent(in) :: unit, cost
    type(case_type), intent(in) :: one
    !> Rates by round: of this row, and of the first row of the table.
    type(rate_type), intent(in) :: rates(:), reference(:)
    real(dp) :: collisions(3), visits(3), time(3), ratio(3)
    character(len=12) :: name

    name = one%engine
    if (one%sides > 0) write (name, '(i0, a)') one%sides, ' sides'
    collisions = least_median_greatest(rates%collisions)
    visits = least_median_greatest(rates%visits)
    time = least_median_greatest(1.0e9_dp/rates%particle_time)
    select case (cost)
    case (cost_of_collision)
      ratio = least_median_greatest(reference%collisions/rates%collisions)
    case (cost_of_visit)
      ratio = least_median_greatest(reference%visits/rates%visits)
    case default
      ratio = least_median_greatest(reference%particle_time/rates%particle_time)
    end select
    write (unit, '(a11, i8, i7, 2es8.1, es10.2, a, f4.1, a, es10.2, es11.3, f10.2, a, f4.1, a)') &
      name, one%number, one%threshold, one%width1, one%width2, collisions(2), &
      ' +-', half_spread_percent(collisions), '%', visits(2), &
      time(2), ratio(2), ' +-', half_spread_percent(ratio), '%'
    flush (unit)
  end subroutine write_row

  !> Half the range in per cent of the median; at most 99.9, the largest number that the column
  !> holds.
  pure function half_spread_percent(summary) result(percent)
    !> Least, median and greatest value.
    real(dp), intent(in) :: summary(3)
    real(dp) :: percent

    percent = min(50.0_dp*(summary(3) - summary(1))/summary(2), 99.9_dp)
  end function half_spread_percent

  !> Least, median and greatest value.
  pure function least_median_greatest(values) result(summary)
    real(dp), intent(in) :: values(:)
    real(dp) :: summary(3)
    real(dp) :: sorted(size(values))
    integer :: k, at

    do k = 1, size(values)
      at = k
      do while (at > 1)
        if (sorted(at - 1) <= values(k)) exit
        sorted(at) = sorted(at - 1)
        at = at - 1
      end do
      sorted(at) = values(k)
    end do
    summary = [sorted(1), sorted((size(values) + 1)/2), sorted(size(values))]
  end function least_median_greatest

  !> Name, family and model of the processor, as Linux gives them. Many models have the same name.
  function processor_name() result(name)
    character(len=:), allocatable :: name
    character(len=*), parameter :: file = '/proc/cpuinfo'

    name = value_of_line(file, 'model name')//', family '//value_of_line(file, 'cpu family') &
      //' model '//value_of_line(file, 'model'//achar(9))
  end function processor_name

  !> Peak memory of this process in kB, as Linux gives it; 0 if it is unknown.
  function peak_memory() result(kilobytes)
    integer(int64) :: kilobytes
    character(len=:), allocatable :: text
    integer :: status

    text = value_of_line('/proc/self/status', 'VmHWM')
    kilobytes = 0
    read (text, *, iostat=status) kilobytes
    if (status /= 0) kilobytes = 0
  end function peak_memory

  !> Text after the colon in the first line of a file that starts with `key`; or `unknown`.
  function value_of_line(file, key) result(value)
    character(len=*), intent(in) :: file, key
    character(len=:), allocatable :: value
    character(len=512) :: line
    integer :: unit, status

    value = 'unknown'
    open (newunit=unit, file=file, action='read', status='old', iostat=status)
    if (status /= 0) return
    do
      read (unit, '(a)', iostat=status) line
      if (status /= 0) exit
      if (index(line, key) /= 1) cycle
      value = trim(adjustl(line(index(line, ':') + 1:)))
      exit
    end do
    close (unit)
  end function value_of_line

end module battery_bench_rows
