!> The command line: options and the namelist file.
module battery_command_line
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_findings, only: findings_type, finding_type, finding_of, add_finding, findings_text, &
    suggestion
  use battery_foreign_bytes, only: foreign_byte_text, unseen_bytes_text, is_other_dash
  use battery_text, only: string_type, closest_word, is_one_of, join, new_line_character
  use battery_key, only: keys_text, distinct_names
  use battery_keys, only: all_keys
  use battery_schema, only: schema_text
  implicit none (type, external)
  private
  public :: command_line_type, command_line_words, parse_arguments, usage_text
  public :: check, overwrite, quiet, accept, partial, self_test, version

  !> First line of the help.
  character(len=*), parameter :: usage_line = &
    'usage: battery [--check] [--overwrite] [--quiet] [--json FILE] FILE.nml, '// &
    'battery --accept FILE.nml, battery --partial FILE.nml, battery --help, battery --schema, '// &
    'battery --self-test, battery --version'

  !> All options, and their places in the list. Only check the input and show the plan; discard
  !> existing results; print errors only. In place of a run: accept results that another program has
  !> changed; write what is finished of a run; test the installation; print something.
  character(len=11), parameter :: options(10) = [character(len=11) :: '--check', '--overwrite', &
    '--quiet', '--json', '--accept', '--partial', '--help', '--schema', '--self-test', '--version']
  integer, parameter :: check = 1, overwrite = 2, quiet = 3, accept = 5, partial = 6, help = 7, &
    schema = 8, self_test = 9, version = 10

  !> Ways to stop a run without loss: Open MPI kills ranks that take longer than a second (version
  !> 5: a quarter of a second) to save their states.
  character(len=*), parameter :: ways_to_stop = &
    'SIGUSR1 to mpirun or srun, or &limits wall_minutes, loses nothing. Open MPI''s mpirun' &
    //new_line_character &
    //'kills its ranks within 1 s of SIGTERM or SIGINT: a large run may lose what it did since' &
    //new_line_character//'its last checkpoint.'

  !> Contents of the command line.
  type :: command_line_type
    !> The namelist file; empty if `text_to_print` is not.
    character(len=:), allocatable :: file
    !> The JSON file for scripts; empty: none.
    character(len=:), allocatable :: json
    !> What is printed instead of a run: help or schema; empty if neither.
    character(len=:), allocatable :: text_to_print
    !> Whether each option is given, besides `--json`.
    logical :: has(size(options)) = .false.
  end type command_line_type

contains

  !> The command line of this process: the name of the program, and its own arguments.
  function command_line_words() result(words)
    type(string_type), allocatable :: words(:)
    integer :: at, length

    allocate (words(1 + command_argument_count()))
    do at = 1, size(words)
      call get_command_argument(at - 1, length=length)
      allocate (character(len=length) :: words(at)%text)
      if (length > 0) call get_command_argument(at - 1, words(at)%text)
    end do
  end function command_line_words

  !> Parses a list of arguments; after `--` a word is a file even if it begins with a dash.
  subroutine parse_arguments(words, command, error)
    !> Arguments, without the name of the program.
    type(string_type), intent(in) :: words(:)
    !> Options and the path of the namelist.
    type(command_line_type), intent(out) :: command
    !> Code `exit_bad_input`; all problems.
    type(error_type), allocatable, intent(out) :: error
    type(findings_type) :: problems
    type(finding_type) :: nameless
    logical :: only_files, json_next
    integer :: at

    command%file = ''
    command%json = ''
    command%text_to_print = ''
    nameless = finding_of(0, '--json: the name of its file is missing')
    only_files = .false.
    json_next = .false.
    do at = 1, size(words)
      if (json_next) then
        if (index(words(at)%text, '-') /= 1 .and. .not. is_other_dash(words(at)%text)) &
          command%json = words(at)%text
        if (command%json == '') call add_finding(problems, nameless)
        json_next = .false.
      else if (words(at)%text == '--' .and. .not. only_files) then
        only_files = .true.
      else if (words(at)%text == '--json' .and. .not. only_files) then
        json_next = .true.
      else if (is_other_dash(words(at)%text) .and. .not. only_files) then
        call add_finding(problems, finding_of(0, words(at)%text//': ' &
          //foreign_byte_text(words(at)%text), 'options begin with -'))
      else if (index(words(at)%text, '-') == 1 .and. .not. only_files) then
        call read_option(words(at)%text, command, problems)
      else if (words(at)%text == '') then
        call add_finding(problems, finding_of(0, 'an empty file name', 'FILE.nml'))
      else if (unseen_bytes_text(words(at)%text) /= '' .and. .not. only_files) then
        call add_finding(problems, finding_of(0, words(at)%text//': ' &
          //unseen_bytes_text(words(at)%text)))
      else if (command%file /= '') then
        call add_finding(problems, finding_of(0, words(at)%text//': a second file', 'one'))
      else
        command%file = words(at)%text
      end if
    end do
    if (json_next) call add_finding(problems, nameless)
    if (.not. any(command%has([help, schema, self_test, version])) .and. command%file == '' .and. &
      problems%count == 0) call add_finding(problems, finding_of(0, 'the namelist file is missing'))
    if (command%text_to_print /= '' .and. command%file /= '' .and. is_one_of('--schema', words)) &
      call add_finding(problems, finding_of(0, command%file &
      //': --schema takes no file; it is the same for all'))
    if (command%has(self_test) .and. command%file /= '') &
      call add_finding(problems, finding_of(0, command%file//': --self-test takes no file'))
    if (any(command%has([accept, partial])) .and. (any(command%has([check, overwrite])) .or. &
      command%json /= '' .or. all(command%has([accept, partial])))) call add_finding(problems, &
      finding_of(0, trim(merge('--accept ', '--partial', command%has(accept))) &
      //': cannot be given with --check, --overwrite, --json or ' &
      //trim(merge('--partial', '--accept ', command%has(accept)))))
    if (problems%count > 0) call fatal_error(error, findings_text(problems, 'battery') &
      //new_line_character//usage_line, exit_bad_input)
  end subroutine parse_arguments

  !> Parses one option.
  subroutine read_option(word, command, problems)
    character(len=*), intent(in) :: word
    type(command_line_type), intent(inout) :: command
    type(findings_type), intent(inout) :: problems
    integer :: option

    option = findloc(options == word, .true., dim=1)
    if (word == '-h') option = help
    if (option > 0) then
      command%has(option) = .true.
      if (option == help) command%text_to_print = usage_text()
      if (option == schema) command%text_to_print = schema_text(all_keys())
    else if (foreign_byte_text(word) /= '') then
      call add_finding(problems, finding_of(0, word//': '//foreign_byte_text(word)))
    else
      call add_finding(problems, finding_of(0, word//': there is no such option'//suggestion('', &
        closest_word(word, distinct_names(options))), join(distinct_names(options), ', ')))
    end if
  end subroutine read_option

  !> The whole help: usage, options, exit codes, and all groups and keys of the namelist.
  function usage_text() result(text)
    character(len=:), allocatable :: text
    character(len=1), parameter :: nl = new_line_character

    text = usage_line//nl//nl &
      //'Runs, or resumes, what FILE.nml describes; mpirun -n P battery FILE.nml shares it'//nl &
      //'among P ranks.'//nl//nl &
      //'  --check      check the input and print the plan; write nothing'//nl &
      //'  --overwrite  discard existing results'//nl &
      //'  --quiet      print problems only'//nl &
      //'  --json FILE  write the path of the results (--check: time and memory) as JSON'//nl &
      //'  --accept     take results as they are that another program opened for writing:'//nl &
      //'               check structure and seeds, write a new digest; run nothing'//nl &
      //'  --partial    write what is finished of a run that goes on, was stopped or died, to'//nl &
      //'               OUTPUT.partial.h5 (OUTPUT: the key file of &output); run nothing'//nl &
      //'  --help       print this'//nl &
      //'  --schema     print a JSON Schema of FILE.nml as f90nml turns it into JSON'//nl &
      //'  --self-test  test the installed program, on all ranks, in seconds'//nl &
      //'  --version    print version, commit, compiler and libraries'//nl//nl &
      //'Exit codes:'//nl &
      //'  0  every task is complete'//nl &
      //'  1  the run or some tasks failed; results of finished tasks are kept'//nl &
      //'  2  bad command line or input: all problems are listed, nothing was written'//nl &
      //'  3  stopped early, state saved; the same command resumes'//nl &
      //'Open MPI''s mpirun itself exits with 1 after SIGTERM or SIGINT.'//nl//nl &
      //'To stop a run: '//ways_to_stop//nl//nl &
      //'Groups and keys of the namelist, with their defaults:'//nl//nl &
      //keys_text(all_keys())
  end function usage_text

end module battery_command_line
