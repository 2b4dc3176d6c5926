/* A lock file: the process that creates it owns it. Another process takes it over only if its owner
   was on this machine and does not hold the kernel's lock on it any more. */
#define _GNU_SOURCE
#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* Outcomes of an attempt to own a file, and of an attempt to lock it. */
enum { taken = 0, held = 1, unknown = 2, again = 3, failed = 4, not_a_file = 5 };
enum { locked, locked_by_another, no_locks };

int battery_write_all(int descriptor, const char *bytes, size_t length);

/* Whether a path still names the open file; -1: the system does not say. */
static int names(const char *path, int descriptor) {
  struct stat named, opened;
  if (lstat(path, &named) != 0) return errno == ENOENT ? 0 : -1;
  if (fstat(descriptor, &opened) != 0) return -1;
  return named.st_dev == opened.st_dev && named.st_ino == opened.st_ino;
}

/* Tried more than once, since a signal may interrupt it. */
static int lock(int descriptor) {
  struct flock whole = {.l_type = F_WRLCK, .l_whence = SEEK_SET};
  for (int tries = 0; tries < 3; tries++) {
    if (fcntl(descriptor, F_OFD_SETLK, &whole) == 0) return locked;
    if (errno == EAGAIN || errno == EACCES) return locked_by_another;
  }
  return no_locks;
}

/* Reads the text of a file, and returns its length; 0 if there is none. `text` has `capacity` bytes, and
   ends with a null character. The file is opened again, since a network disk may show its present
   contents only then. */
int battery_read_owner(const char *path, char *text, int capacity) {
  int descriptor = open(path, O_RDONLY | O_NOFOLLOW | O_CLOEXEC | O_NONBLOCK);
  ssize_t length = descriptor < 0 ? 0 : pread(descriptor, text, (size_t)capacity - 1, 0);
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

/* Whether a text is that of an owner ("host process time"), or the beginning of one, at least up to
   the first blank, if the owner was killed while it wrote. */
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

/* Locks the file, and writes the text of its owner; 0, or an error number. */
static int write_owner(int descriptor, const char *text) {
  lock(descriptor);
  int status = battery_write_all(descriptor, text, strlen(text));
  return status == 0 && fsync(descriptor) != 0 ? errno : status;
}

/* Removes the file of an ended run of this machine; `taken` if there is no file now. If the file
   belongs, or may belong, to another run, `holder` (`capacity` bytes) is its text. Where it cannot be
   removed, it is taken over in its place, and stays open, as `kept`; for a moment it is empty. */
static int remove_of_ended(const char *path, const char *text, char *holder, int capacity, int *kept) {
  int descriptor = open(path, O_RDWR | O_NOFOLLOW | O_CLOEXEC | O_NONBLOCK), outcome = taken, got;
  struct stat found;
  holder[0] = '\0';
  if (descriptor < 0) {
    if (errno == ENOENT) return taken;
    return errno == ELOOP || errno == EISDIR || errno == ENXIO ? not_a_file : failed;
  }
  int length = battery_read_owner(path, holder, capacity);
  if (fstat(descriptor, &found) != 0) outcome = failed;
  else if (!S_ISREG(found.st_mode)) outcome = not_a_file;
  else if (length > 0 && (strlen(holder) != (size_t)length || !is_of_an_owner(holder)))
    outcome = not_a_file;
  /* Another machine may be about to write to an empty file: a network disk may show it empty for many
     seconds. */
  else if (!same_host(holder, text))
    outcome = unknown;
  if (outcome == taken) {
    got = lock(descriptor);
    int named = names(path, descriptor);
    /* An owner that releases its file removes it: then this lock is on a file without a name. */
    if (named == 0) {
      holder[0] = '\0';
      outcome = again;
    }
    else if (named < 0) outcome = failed;
    else if (got != locked) outcome = got == locked_by_another ? held : unknown;
    else if (unlink(path) != 0) {
      if (ftruncate(descriptor, 0) == 0 && write_owner(descriptor, text) == 0) *kept = descriptor;
      else outcome = failed;
    }
  }
  int status = errno;
  if (*kept < 0) close(descriptor);
  errno = status;
  return outcome;
}

/* Creates the file, locked and with its text; returns its descriptor, or -1. It is written before it
   gets a name, so that after a kill there is either the complete file or none. */
static int create_at_once(const char *path, const char *text) {
  char folder[PATH_MAX], unnamed[64];
  const char *slash = strrchr(path, '/');
  int length = slash == NULL ? 0 : (int)(slash - path) + 1, status;
  if (snprintf(folder, sizeof folder, "%.*s.", length, path) >= (int)sizeof folder) return -1;
  int descriptor = open(folder, O_TMPFILE | O_RDWR | O_CLOEXEC, 0666);
  if (descriptor < 0) return -1;
  snprintf(unnamed, sizeof unnamed, "/proc/self/fd/%d", descriptor);
  status = write_owner(descriptor, text);
  if (status == 0 && linkat(AT_FDCWD, unnamed, AT_FDCWD, path, AT_SYMLINK_FOLLOW) == 0)
    return descriptor;
  if (status == 0) status = errno;
  close(descriptor);
  errno = status;
  return -1;
}

/* As `create_at_once`, for file systems without files that have no name: for a moment, the file is
   empty. */
static int create_and_write(const char *path, const char *text) {
  int descriptor = open(path, O_RDWR | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0666);
  if (descriptor < 0) return -1;
  int status = write_owner(descriptor, text);
  if (status == 0) return descriptor;
  unlink(path);
  close(descriptor);
  errno = status;
  return -1;
}

/* Tries to own the file `path`, whose text is then `text` ("host process time"); it stays open and locked,
   with this `descriptor`. If it belongs, or may belong, to another run, `holder` (`capacity` bytes) is its
   text. If it belonged to an ended run of this machine, it is removed, `holder` is the text that it had, and
   the outcome is `again`; where it cannot be removed, it is taken over, and the outcome is `taken`. */
int battery_own(const char *path, const char *text, char *holder, int capacity, int *descriptor) {
  *descriptor = -1;
  int outcome = remove_of_ended(path, text, holder, capacity, descriptor);
  if (outcome != taken || *descriptor >= 0) return outcome;
  if (holder[0] != '\0') return again;
  *descriptor = create_at_once(path, text);
  if (*descriptor < 0 && errno != EEXIST) *descriptor = create_and_write(path, text);
  if (*descriptor >= 0) return taken;
  return errno == EEXIST ? again : failed;
}

/* Removes the file, if it is still that of the owner, and releases the lock. Where no open file can be
   removed, it is removed after that, unless another run has written its own text to it. */
void battery_disown(const char *path, int descriptor) {
  char text[256], now[256];
  ssize_t length = 0;
  if (names(path, descriptor) > 0 && unlink(path) != 0) length = pread(descriptor, text, sizeof text, 0);
  close(descriptor);
  if (length > 0 && battery_read_owner(path, now, sizeof now) == length && memcmp(text, now, (size_t)length) == 0)
    unlink(path);
}

/* Name of this machine, without blanks, and its length; `name` has `capacity` bytes. */
int battery_host_name(char *name, int capacity) {
  if (gethostname(name, (size_t)capacity) != 0 || name[0] == '\0') strncpy(name, "unknown", (size_t)capacity);
  name[capacity - 1] = '\0';
  for (char *at = name; *at != '\0'; at++)
    if (*at <= ' ') *at = '_';
  return (int)strlen(name);
}
