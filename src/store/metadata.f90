!> Where results come from: the attributes at the root of a results file.
module battery_metadata
  use battery_kinds, only: dp, int32
  use battery_error, only: error_type, fatal_error
  use battery_hdf5_file, only: hdf5_file_type, open_file, close_file
  use battery_hdf5_attributes, only: write_attribute, read_attribute
  use battery_seal, only: check_seal
  implicit none (type, external)
  private
  public :: metadata_type, write_metadata, read_metadata, utc_text

  !> Texts that are not allocated are written as empty ones.
  type :: metadata_type
    character(len=:), allocatable :: program, version, git_commit
    character(len=:), allocatable :: compiler, compiler_options
    character(len=:), allocatable :: mpi_library
    integer :: mpi_ranks = 0
    !> The whole text of the input.
    character(len=:), allocatable :: namelist
    !> Fingerprint of the initial file in hexadecimal digits; empty if there is none.
    character(len=:), allocatable :: initial_file_fingerprint
    !> When the file was written, ISO 8601, UTC; not allocated: now.
    character(len=:), allocatable :: created
    !> `complete` or `partial`.
    character(len=:), allocatable :: status
    !> As in the namelist, so that readers need not parse it.
    character(len=:), allocatable :: shape, engine
    !> Time on the clock when the runs start; times in the file count from there.
    real(dp) :: start_time = 0.0_dp
  end type metadata_type

contains

  !> Writes the attributes of the root.
  subroutine write_metadata(file, metadata, error)
    !> Open, to be written.
    type(hdf5_file_type), intent(in) :: file
    type(metadata_type), intent(in) :: metadata
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: created

    call put_text(file, 'program', metadata%program, error)
    call put_text(file, 'version', metadata%version, error)
    call put_text(file, 'git_commit', metadata%git_commit, error)
    call put_text(file, 'compiler', metadata%compiler, error)
    call put_text(file, 'compiler_options', metadata%compiler_options, error)
    call put_text(file, 'mpi_library', metadata%mpi_library, error)
    if (.not. allocated(error)) &
      call write_attribute(file, '/', 'mpi_ranks', int(metadata%mpi_ranks, int32), error)
    call put_text(file, 'namelist', metadata%namelist, error)
    call put_text(file, 'initial_file_fingerprint', metadata%initial_file_fingerprint, error)
    created = utc_now()
    if (allocated(metadata%created)) created = metadata%created
    call put_text(file, 'created', created, error)
    call put_text(file, 'status', metadata%status, error)
    call put_text(file, 'shape', metadata%shape, error)
    call put_text(file, 'engine', metadata%engine, error)
    call put_real(file, 'start_time', metadata%start_time, error)
  end subroutine write_metadata

  !> An attribute of the root, unless an error came before.
  subroutine put_text(file, name, text, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: name
    character(len=:), allocatable, intent(in) :: text
    type(error_type), allocatable, intent(inout) :: error

    if (allocated(error)) return
    if (allocated(text)) then
      call write_attribute(file, '/', name, text, error)
    else
      call write_attribute(file, '/', name, '', error)
    end if
  end subroutine put_text

  !> An attribute of the root, unless an error came before.
  subroutine put_real(file, name, value, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: name
    real(dp), intent(in) :: value
    type(error_type), allocatable, intent(inout) :: error

    if (allocated(error)) return
    call write_attribute(file, '/', name, value, error)
  end subroutine put_real

  !> From which input a results file was made, and whether it is complete, once its seal was found
  !> right; else an error, as `check_seal` gives it.
  subroutine read_metadata(name, input_text, status, error, initial_file_fingerprint)
    !> Path of the file.
    character(len=*), intent(in) :: name
    !> The namelist, and `complete` or `partial`.
    character(len=:), allocatable, intent(out) :: input_text, status
    type(error_type), allocatable, intent(out) :: error
    !> In hexadecimal digits; empty if there was no initial file.
    character(len=:), allocatable, intent(out), optional :: initial_file_fingerprint
    type(error_type), allocatable :: close_error
    type(hdf5_file_type) :: file

    input_text = ''
    status = ''
    if (present(initial_file_fingerprint)) initial_file_fingerprint = ''
    call check_seal(name, error)
    if (.not. allocated(error)) call open_file(file, name, error)
    if (allocated(error)) return
    call read_attribute(file, '/', 'namelist', input_text, error)
    if (.not. allocated(error)) call read_attribute(file, '/', 'status', status, error)
    if (.not. allocated(error) .and. present(initial_file_fingerprint)) &
      call read_attribute(file, '/', 'initial_file_fingerprint', initial_file_fingerprint, error)
    call close_file(file, close_error)
    if (.not. allocated(error) .and. allocated(close_error)) call move_alloc(close_error, error)
    if (allocated(error)) return
    if (status /= 'complete' .and. status /= 'partial') &
      call fatal_error(error, name//': status is '''//status//''', neither complete nor partial')
  end subroutine read_metadata

  !> The time now, as `utc_text` writes it.
  function utc_now() result(text)
    character(len=:), allocatable :: text
    integer :: values(8)

    call date_and_time(values=values)
    text = utc_text(values)
  end function utc_now

  !> What `date_and_time` gives (year, month, day, minutes ahead of UTC, hour, minute, second,
  !> milliseconds) in UTC: 2026-01-31T23:59:59Z.
  !> Source: days and dates of the Gregorian calendar, Fliegel and Van Flandern, Communications of
  !> the ACM 11, 657 (1968), doi:10.1145/364096.364097.
  pure function utc_text(values) result(text)
    !> As listed above.
    integer, intent(in) :: values(8)
    character(len=20) :: text
    integer :: year, month, day, minutes, l, n, shift

    shift = (values(2) - 14)/12
    day = values(3) - 32075 + 1461*(values(1) + 4800 + shift)/4 + 367*(values(2) - 2 &
      - shift*12)/12 - 3*((values(1) + 4900 + shift)/100)/4
    minutes = 60*values(5) + values(6) - values(4)
    l = day + floor(minutes/1440.0_dp) + 68569
    minutes = modulo(minutes, 1440)
    n = 4*l/146097
    l = l - (146097*n + 3)/4
    year = 4000*(l + 1)/1461001
    l = l - 1461*year/4 + 31
    month = 80*l/2447
    day = l - 2447*month/80
    l = month/11
    month = month + 2 - 12*l
    year = 100*(n - 49) + year + l
    write (text, '(i4.4, 2("-", i2.2), "T", i2.2, 2(":", i2.2), "Z")') year, month, day, &
      minutes/60, mod(minutes, 60), values(7)
  end function utc_text

end module battery_metadata
