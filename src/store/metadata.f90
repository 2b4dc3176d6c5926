!> Metadata of results: the attributes at the root of a results file.
module battery_metadata
  use battery_kinds, only: dp, int32
  use battery_clocks, only: utc_now
  use battery_error, only: error_type
  use battery_hdf5_file, only: hdf5_file_type, open_file, close_file, make_group
  use battery_hdf5_attributes, only: write_attribute, write_text_attribute, read_text_attribute
  implicit none (type, external)
  private
  public :: metadata_type, add_text_metadata, write_metadata, read_metadata

  !> Name and text of an attribute.
  type :: text_attribute_type
    character(len=:), allocatable :: name, text
  end type text_attribute_type

  !> Attributes of the root: texts by name, and numbers.
  type :: metadata_type
    type(text_attribute_type), allocatable :: texts(:)
    !> Command line and start of the run that wrote the file; hosts of all tasks, one per line.
    character(len=:), allocatable :: command_line, begun, hosts
    integer :: mpi_ranks = 0
    !> Of urns that are polygons: number of sides if they are regular, else the corners of each urn,
    !> counterclockwise, (x, y) in columns, with x towards channel 1.
    integer :: urn_sides = 0
    real(dp), allocatable :: urn_vertices(:, :), urn2_vertices(:, :)
    !> Clock time at the start of the runs; times in the file count from then.
    real(dp) :: start_time = 0.0_dp
  end type metadata_type

contains

  !> Adds an attribute that is a text.
  pure subroutine add_text_metadata(metadata, name, text)
    type(metadata_type), intent(inout) :: metadata
    !> Name of the attribute, and its text.
    character(len=*), intent(in) :: name, text
    type(text_attribute_type) :: attribute

    attribute%name = name
    attribute%text = text
    if (.not. allocated(metadata%texts)) allocate (metadata%texts(0))
    metadata%texts = [metadata%texts, attribute]
  end subroutine add_text_metadata

  !> Writes the attributes of the root, with the present date and time.
  subroutine write_metadata(file, metadata, error)
    !> File, open for writing.
    type(hdf5_file_type), intent(in) :: file
    type(metadata_type), intent(in) :: metadata
    !> After an earlier error, nothing is written.
    type(error_type), allocatable, intent(inout) :: error
    integer :: k

    do k = 1, size(metadata%texts)
      call write_text_attribute(file, '/', metadata%texts(k)%name, metadata%texts(k)%text, error)
    end do
    if (metadata%urn_sides > 0) call write_attribute(file, '/', 'urn_sides', &
      int(metadata%urn_sides, int32), error)
    if (allocated(metadata%urn_vertices)) then
      call write_attribute(file, '/', 'urn_vertices', metadata%urn_vertices, error)
      call write_attribute(file, '/', 'urn2_vertices', metadata%urn2_vertices, error)
    end if
    call write_text_attribute(file, '/', 'created', utc_now(), error)
    call make_group(file, '/provenance', error)
    call write_text_attribute(file, '/provenance', 'command_line', metadata%command_line, error)
    call write_text_attribute(file, '/provenance', 'begun', metadata%begun, error)
    call write_text_attribute(file, '/provenance', 'ended', utc_now(), error)
    call write_text_attribute(file, '/provenance', 'hosts', metadata%hosts, error)
    call write_attribute(file, '/', 'mpi_ranks', int(metadata%mpi_ranks, int32), error)
    call write_attribute(file, '/', 'start_time', metadata%start_time, error)
  end subroutine write_metadata

  !> Reads the version and the input that a results file was made with, and whether it is complete.
  !> The caller has checked its footer (`check_footer`).
  subroutine read_metadata(name, version, input_text, status, initial_file_fingerprint, error)
    !> Path of the file.
    character(len=*), intent(in) :: name
    !> Version of the program; the namelist; `complete` or `partial`.
    character(len=:), allocatable, intent(out) :: version, input_text, status
    !> Fingerprint in hexadecimal digits; empty if there was no initial file.
    character(len=:), allocatable, intent(out) :: initial_file_fingerprint
    type(error_type), allocatable, intent(out) :: error
    type(error_type), allocatable :: close_error
    type(hdf5_file_type) :: file

    call open_file(file, name, error)
    if (allocated(error)) return
    call read_text_attribute(file, '/', 'version', version, error)
    call read_text_attribute(file, '/', 'namelist', input_text, error)
    call read_text_attribute(file, '/', 'status', status, error)
    call read_text_attribute(file, '/', 'initial_file_fingerprint', initial_file_fingerprint, error)
    call close_file(file, close_error)
    if (.not. allocated(error)) call move_alloc(close_error, error)
  end subroutine read_metadata

end module battery_metadata
