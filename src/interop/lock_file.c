/* A file that one process owns: who makes it has it. Whoever finds it there takes it over only if
   its owner was on this machine and holds the lock of the kernel no more. */
#define _GNU_SOURCE
#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* What an attempt came to. */
enum { taken = 0, held = 1, unknown = 2, again = 3, failed = 4, not_a_file = 5 };
enum { locked, locked_by_another, no_locks };

typedef struct {
  int descriptor;
  char path[PATH_MAX];
} owner_type;

/* Whether a path still names the file that is open. */
static int names(const char *path, int descriptor) {
  struct stat named, opened;
  return lstat(path, &named) == 0 && fstat(descriptor, &opened) == 0
    && named.st_dev == opened.st_dev && named.st_ino == opened.st_ino;
}

static int lock(int descriptor) {
  struct flock whole = {.l_type = F_WRLCK, .l_whence = SEEK_SET};
  if (fcntl(descriptor, F_OFD_SETLK, &whole) == 0) return locked;
  return errno == EAGAIN || errno == EACCES ? locked_by_another : no_locks;
}

/* Reads what the file says, and gives its length; 0 if there is none. `text` has `room` bytes, and
   ends with a null sign. The file is opened anew: only then a network disk shows what is in it. */
int battery_read_owner(const char *path, char *text, int room) {
  int descriptor = open(path, O_RDONLY | O_NOFOLLOW | O_CLOEXEC | O_NONBLOCK);
  ssize_t length = descriptor < 0 ? 0 : pread(descriptor, text, (size_t)room - 1, 0);
  if (length < 0) length = 0;
  text[length] = '\0';
  if (descriptor >= 0) close(descriptor);
  return (int)length;
}

/* Whether two texts begin with the same word: the name of the host. */
static int same_host(const char *one, const char *other) {
  size_t length = strcspn(one, " ");
  return length > 0 && length == strcspn(other, " ") && strncmp(one, other, length) == 0;
}

/* Whether a text is an owner's ("host process time"), or as much of it, from the first blank on, as
   was written before a kill. */
static int is_of_an_owner(const char *found) {
  size_t host = strcspn(found, " ");
  if (found[host] == '\0') return 0;
  for (size_t at = 0; at < host; at++)
    if (iscntrl((unsigned char)found[at])) return 0;
  const char *at = found + host + 1, *shape = "0000-00-00 00:00:00.000";
  size_t digits = strspn(at, "0123456789");
  if (host == 0 || (digits == 0 && at[0] != '\0')) return 0;
  at += digits;
  if (*at == ' ') at++;
  else if (*at != '\0') return 0;
  for (; *at != '\0'; at++, shape++)
    if (*shape == '0' ? !isdigit((unsigned char)*at) : *at != *shape) return 0;
  return 1;
}

/* Writes who owns the file. */
static int settle(const char *path, const char *text, int descriptor, owner_type **result) {
  ssize_t length = (ssize_t)strlen(text);
  owner_type *owner = calloc(1, sizeof *owner);
  int status = ENOMEM;
  if (owner != NULL) {
    errno = EIO;
    status = ftruncate(descriptor, 0) == 0 && pwrite(descriptor, text, (size_t)length, 0) == length
      && fsync(descriptor) == 0 ? 0 : errno;
    owner->descriptor = descriptor;
    strncpy(owner->path, path, sizeof owner->path - 1);
  }
  if (status == 0) {
    *result = owner;
    return taken;
  }
  unlink(path);
  close(descriptor);
  free(owner);
  errno = status;
  return failed;
}

/* Tries to own the file `path`, which then says `text` ("host process time"). Where it is another's,
   or may be, `holder` (`room` bytes) is what it says. */
int battery_own(const char *path, const char *text, char *holder, int room, owner_type **owner) {
  int is_new = 1;
  int descriptor = open(path, O_RDWR | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0666);
  holder[0] = '\0';
  if (descriptor < 0 && errno == EEXIST) {
    is_new = 0;
    descriptor = open(path, O_RDWR | O_NOFOLLOW | O_CLOEXEC | O_NONBLOCK);
    if (descriptor < 0 && errno == ENOENT) return again;
    if (descriptor < 0 && (errno == ELOOP || errno == EISDIR || errno == ENXIO)) return not_a_file;
  }
  if (descriptor < 0) return failed;
  struct stat found;
  if (fstat(descriptor, &found) != 0 || !S_ISREG(found.st_mode)) {
    close(descriptor);
    return not_a_file;
  }
  int length = battery_read_owner(path, holder, room), outcome = taken, got;
  if (length > 0 && (strlen(holder) != (size_t)length || !is_of_an_owner(holder)))
    outcome = not_a_file;
  /* An empty one is what a kill may leave, or what another machine is about to write to: a network
     disk may show it empty for many seconds. */
  else if (!is_new && !same_host(holder, text))
    outcome = unknown;
  if (outcome == taken) {
    got = lock(descriptor);
    /* Who gives a file up removes it: then the lock is one on a file without a name. */
    if (!names(path, descriptor)) outcome = again;
    else if (got == locked_by_another) outcome = held;
    else if (got == no_locks && !is_new) outcome = unknown;
  }
  if (outcome == taken) return settle(path, text, descriptor, owner);
  close(descriptor);
  return outcome;
}

/* Removes the file if it is still there, and ends the lock. */
void battery_disown(owner_type *owner) {
  if (names(owner->path, owner->descriptor)) unlink(owner->path);
  close(owner->descriptor);
  free(owner);
}

/* Name of this machine, without blanks, and its length; `name` has `room` bytes. */
int battery_host_name(char *name, int room) {
  if (gethostname(name, (size_t)room) != 0 || name[0] == '\0') strncpy(name, "unknown", (size_t)room);
  name[room - 1] = '\0';
  for (char *at = name; *at != '\0'; at++)
    if (*at <= ' ') *at = '_';
  return (int)strlen(name);
}
