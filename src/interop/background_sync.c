/* Brings a file to the disk beside the program's other work, for background_sync.f90. */
#include <aio.h>
#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <unistd.h>

static int forget(struct aiocb *control, int status)
{
  close(control->aio_fildes);
  free(control);
  return status;
}

/* Begins to bring a file to the disk; NULL if that cannot be begun. What it gives stays where it is
   until `battery_sync_end`. */
struct aiocb *battery_sync_begin(const char *path)
{
  struct aiocb *control = calloc(1, sizeof *control);
  if (control == NULL) return NULL;
  control->aio_sigevent.sigev_notify = SIGEV_NONE;
  control->aio_fildes = open(path, O_RDONLY | O_CLOEXEC);
  if (control->aio_fildes >= 0 && aio_fsync(O_SYNC, control) == 0) return control;
  int status = errno;
  forget(control, status);
  errno = status;
  return NULL;
}

int battery_sync_is_under_way(struct aiocb *control) { return aio_error(control) == EINPROGRESS; }

/* Waits for the end and forgets what was under way; 0, or the number of the error. */
int battery_sync_end(struct aiocb *control)
{
  const struct aiocb *list[1] = {control};
  int status;
  /* A signal may end the wait; then it begins again. */
  while ((status = aio_error(control)) == EINPROGRESS) aio_suspend(list, 1, NULL);
  aio_return(control);
  return forget(control, status);
}
