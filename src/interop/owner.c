/* A file that one process owns: by a lock of the kernel, which ends with the process, and by a beat
   (the file's time is set anew every few seconds) that others can see where the file system has no
   locks, or has them for one machine only. */
#define _GNU_SOURCE
#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

/* What an attempt came to. */
enum { taken = 0, held = 1, doubtful = 2, again = 3, failed = 4, not_a_file = 5 };
enum { locked, locked_by_another, no_locks };

/* Which file it is, and when it last beat. */
typedef struct { int64_t device, inode, seconds, nanoseconds; } beat_type;

typedef struct {
  int descriptor, stopping;
  double interval;
  pthread_t thread;
  pthread_mutex_t mutex;
  pthread_cond_t wake;
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

static beat_type beat_of(int descriptor) {
  struct stat found = {0};
  fstat(descriptor, &found);
  return (beat_type){(int64_t)found.st_dev, (int64_t)found.st_ino, found.st_mtim.tv_sec,
    found.st_mtim.tv_nsec};
}

/* Reads the text of an open file, and gives its length; `text` has `room` bytes. */
static size_t read_open(int descriptor, char *text, int room) {
  ssize_t length = pread(descriptor, text, (size_t)room - 1, 0);
  if (length < 0) length = 0;
  text[length] = '\0';
  return (size_t)length;
}

/* What the file says, and its length; empty if there is none. */
int battery_read_owner(const char *path, char *text, int room) {
  int descriptor = open(path, O_RDONLY | O_NOFOLLOW | O_CLOEXEC | O_NONBLOCK);
  text[0] = '\0';
  if (descriptor < 0) return 0;
  read_open(descriptor, text, room);
  close(descriptor);
  return (int)strlen(text);
}

/* Whether two texts begin with the same word: the name of the host. */
static int same_host(const char *one, const char *other) {
  size_t length = strcspn(one, " ");
  return length > 0 && length == strcspn(other, " ") && strncmp(one, other, length) == 0;
}

/* Whether a text is an owner's ("host process time"), or as much of it as was written before a kill.
   One that ends within the first word is an owner's only if it begins the name of this host, as
   `text` does: else it might be anyone's. */
static int is_of_an_owner(const char *found, const char *text) {
  size_t host = strcspn(found, " ");
  if (found[host] == '\0') return strncmp(found, text, host) == 0;
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

/* Sets the time of the file until told to stop. */
static void *keep_beating(void *argument) {
  owner_type *owner = argument;
  pthread_mutex_lock(&owner->mutex);
  while (!owner->stopping) {
    struct timespec next;
    clock_gettime(CLOCK_MONOTONIC, &next);
    int64_t nanoseconds = next.tv_nsec + (int64_t)(owner->interval * 1e9);
    next.tv_sec += nanoseconds / 1000000000;
    next.tv_nsec = nanoseconds % 1000000000;
    if (pthread_cond_timedwait(&owner->wake, &owner->mutex, &next) == ETIMEDOUT)
      futimens(owner->descriptor, NULL);
  }
  pthread_mutex_unlock(&owner->mutex);
  return NULL;
}

/* Begins the beat, in a thread that hears no signals. */
static int begin_beating(owner_type *owner) {
  pthread_condattr_t monotonic;
  sigset_t all, before;
  pthread_mutex_init(&owner->mutex, NULL);
  pthread_condattr_init(&monotonic);
  pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
  pthread_cond_init(&owner->wake, &monotonic);
  pthread_condattr_destroy(&monotonic);
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  int status = pthread_create(&owner->thread, NULL, keep_beating, owner);
  pthread_sigmask(SIG_SETMASK, &before, NULL);
  return status;
}

/* Writes who owns the file, and begins to beat. */
static int settle(const char *path, const char *text, double interval, int descriptor,
    owner_type **result) {
  ssize_t length = (ssize_t)strlen(text);
  owner_type *owner = calloc(1, sizeof *owner);
  int status = ENOMEM;
  if (owner != NULL) {
    errno = EIO;
    status = ftruncate(descriptor, 0) == 0 && pwrite(descriptor, text, (size_t)length, 0) == length
      && fsync(descriptor) == 0 ? 0 : errno;
    owner->descriptor = descriptor;
    owner->interval = interval;
    strncpy(owner->path, path, sizeof owner->path - 1);
    if (status == 0) status = begin_beating(owner);
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

/* Tries to own the file `path`, which then says `text` ("host process time"). `with_locks` 0 does
   as if there were none. Where another holds it, `holder` (`room` bytes) is what it says. Where that
   cannot be known, `beat` is its beat, to be watched; with `insist` it is taken over if it still has
   the beat that is passed in. */
int battery_own(const char *path, const char *text, double interval, int with_locks, int insist,
    beat_type *beat, char *holder, int room, owner_type **owner) {
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
  int got = with_locks ? lock(descriptor) : no_locks;
  /* Who gives a file up removes it: then the lock is one on a file without a name. */
  int named = names(path, descriptor);
  size_t length = read_open(descriptor, holder, room);
  if (!named || got == locked_by_another) {
    close(descriptor);
    return named ? held : again;
  }
  if (strlen(holder) != length || !is_of_an_owner(holder, text)) {
    close(descriptor);
    return not_a_file;
  }
  int dead = is_new || (got == locked && (holder[0] == '\0' || same_host(holder, text)));
  if (!dead) {
    beat_type now = beat_of(descriptor);
    if (!insist || memcmp(&now, beat, sizeof now) != 0) {
      *beat = now;
      close(descriptor);
      return doubtful;
    }
    /* A new file, so that of two who do this at once one sees that it has lost. */
    unlink(path);
    close(descriptor);
    descriptor = open(path, O_RDWR | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0666);
    if (descriptor < 0) return errno == EEXIST ? again : failed;
    if (with_locks && lock(descriptor) == locked_by_another) {
      close(descriptor);
      return again;
    }
  }
  return settle(path, text, interval, descriptor, owner);
}

/* Whether the path still names the file that is owned. */
int battery_still_owns(const owner_type *owner) { return names(owner->path, owner->descriptor); }

/* Ends the beat, removes the file if it is still there, and ends the lock. */
void battery_disown(owner_type *owner) {
  pthread_mutex_lock(&owner->mutex);
  owner->stopping = 1;
  pthread_cond_signal(&owner->wake);
  pthread_mutex_unlock(&owner->mutex);
  pthread_join(owner->thread, NULL);
  if (names(owner->path, owner->descriptor)) unlink(owner->path);
  close(owner->descriptor);
  pthread_cond_destroy(&owner->wake);
  pthread_mutex_destroy(&owner->mutex);
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
