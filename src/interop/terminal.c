/* Standard output and standard error: written without a buffer, so that failed writes are known. */
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stddef.h>
#include <stdio.h>
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

/* Writes a whole text; returns 0 or an error number. */
int terminal_write(int to_errors, const char *text, size_t length)
{
  int stream = to_errors ? STDERR_FILENO : STDOUT_FILENO;
  while (length > 0) {
    ssize_t written = write(stream, text, length);
    if (written >= 0) {
      text += written;
      length -= (size_t)written;
    } else if (errno == EAGAIN) {
      struct pollfd ready = {stream, POLLOUT, 0};
      poll(&ready, 1, 100);
    } else if (errno != EINTR) {
      return errno;
    }
  }
  return 0;
}

int terminal_output(void) { return isatty(STDOUT_FILENO); }

/* Whether the parent's standard output is a terminal; -1 if this cannot be determined. */
int terminal_parent_output(void)
{
  char path[64];
  snprintf(path, sizeof path, "/proc/%ld/fd/1", (long)getppid());
  int stream = open(path, O_WRONLY | O_NOCTTY | O_NONBLOCK);
  if (stream < 0) return -1;
  int yes = isatty(stream);
  close(stream);
  return yes;
}
