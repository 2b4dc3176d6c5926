/* Standard streams that are closed, and what standard output is and takes, for terminal.f90. */
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

/* Opens closed standard streams such that writing to them fails: otherwise the next file that is opened
   would get their descriptor, and text would be written to it. */
void terminal_guard(void)
{
  for (int stream = 0; stream <= 2; stream++)
    if (fcntl(stream, F_GETFD) < 0 && errno == EBADF) {
      int null = open("/dev/null", O_RDONLY);
      if (null >= 0 && null != stream) {
        dup2(null, stream);
        close(null);
      }
    }
}

/* Whether standard output takes text without waiting: a terminal may be stopped (Ctrl-S, a connection that
   does not answer), and a pipe full. */
int terminal_takes_text(void)
{
  struct pollfd output = {.fd = STDOUT_FILENO, .events = POLLOUT};
  return poll(&output, 1, 0) != 0;
}

/* Whether the parent's standard output is a terminal, as far as this can be determined. */
static int parent_output(void)
{
  char path[64];
  snprintf(path, sizeof path, "/proc/%ld/fd/1", (long)getppid());
  int stream = open(path, O_WRONLY | O_NOCTTY | O_NONBLOCK);
  if (stream < 0) return 1;
  int yes = isatty(stream);
  close(stream);
  return yes;
}

/* Whether standard output goes to a terminal. The output of a rank that Open MPI's mpirun has started is
   always a pseudo-terminal; then the output of mpirun itself is tested. */
int terminal_output(void)
{
  const char *rank = getenv("OMPI_COMM_WORLD_RANK");
  return isatty(STDOUT_FILENO) && (rank == NULL || *rank == '\0' || parent_output());
}
