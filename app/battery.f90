!> The program `battery`.
program battery
  use battery_build_information, only: program_version, git_commit
  implicit none (type, external)

  print '(a)', 'battery '//program_version//' ('//git_commit//')'
end program battery
