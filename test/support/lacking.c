/* A file system that lacks something: loaded before a program (LD_PRELOAD), it makes `flock`, and `fsync` of a
   folder or of a file that is open for reading only, fail with the error numbers in the variables NO_FLOCK,
   NO_FOLDER_SYNC and NO_SYNC_FOR_READING; with SIGNALS set, signals interrupt every second open, fsync, ftruncate
   and close of journals and new results (a close is done); with NO_REMOVAL_OF_OPEN set, no file that this process
   has open is removed, as in folders that a virtual machine shares with Windows; with NO_REPLACEMENT set, no
   rename replaces a file; with NO_USER set, the machine does not know its users. The call that NO_CALL names
   (read, pread64, close, opendir, readdir, stat, lstat, access, mkdir) with that in NO_CALL_WITH, from the
   NO_CALL_AFTER-th such call on, of paths that end with NO_CALL_OF; a rename or renameat2 so named is done before. With
   HANGUP_HANDLER set, a handler of SIGHUP is there before the program begins, as UCX sets one. */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pwd.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#define NEXT(type, name) ((type)dlsym(RTLD_NEXT, name))

static int number_in(const char *name) {
  const char *text = getenv(name);
  return text == NULL ? 0 : atoi(text);
}

static void hear(int number) { (void)number; }

__attribute__((constructor)) static void load(void) {
  if (getenv("HANGUP_HANDLER") != NULL) signal(SIGHUP, hear);
}

/* Whether a call fails; sets errno then. */
static int fails(const char *call, const char *path) {
  static int calls = 0;
  const char *wanted = getenv("NO_CALL"), *end = getenv("NO_CALL_OF");
  if (wanted == NULL || end == NULL || strcmp(call, wanted) != 0) return 0;
  size_t length = strlen(path), most = strlen(end);
  if (length < most || strcmp(path + length - most, end) != 0) return 0;
  if (++calls < number_in("NO_CALL_AFTER")) return 0;
  errno = number_in("NO_CALL_WITH");
  return 1;
}

/* Path of an open file; empty: it has none. */
static const char *path_of(int file) {
  static char path[4096];
  char link[64];
  snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  ssize_t length = readlink(link, path, sizeof path - 1);
  path[length < 0 ? 0 : length] = '\0';
  return path;
}

/* Whether a call fails for an open file. */
static int fails_for(const char *call, int file) { return getenv("NO_CALL") != NULL && fails(call, path_of(file)); }

/* Whether a signal interrupts a call: the first of every two of its kind; sets errno then. */
static int interrupts(const char *path, int *calls) {
  if (getenv("SIGNALS") == NULL || (strstr(path, "out.h5.tasks") == NULL && strstr(path, "out.h5.part") == NULL)
      || ++*calls % 2 == 0) return 0;
  errno = EINTR;
  return 1;
}

int open(const char *path, int how, ...) {
  static int calls = 0;
  va_list more;
  va_start(more, how);
  mode_t mode = how & (O_CREAT | __O_TMPFILE) ? va_arg(more, mode_t) : 0;
  va_end(more);
  return interrupts(path, &calls) ? -1 : NEXT(int (*)(const char *, int, ...), "open")(path, how, mode);
}

int ftruncate(int file, off_t length) {
  static int calls = 0;
  return interrupts(path_of(file), &calls) ? -1 : NEXT(int (*)(int, off_t), "ftruncate")(file, length);
}

int close(int file) {
  static int calls = 0;
  int interrupted = getenv("SIGNALS") != NULL && interrupts(path_of(file), &calls);
  int failed = fails_for("close", file);  // done, as on a disk that is away
  int status = NEXT(int (*)(int), "close")(file);
  if (interrupted) errno = EINTR;
  if (failed) errno = number_in("NO_CALL_WITH");
  return interrupted || failed ? -1 : status;
}

int flock(int file, int operation) {
  errno = number_in("NO_FLOCK");
  return errno != 0 ? -1 : NEXT(int (*)(int, int), "flock")(file, operation);
}

int fsync(int file) {
  static int calls = 0;
  struct stat found;
  int is_folder = fstat(file, &found) == 0 && S_ISDIR(found.st_mode);
  int reads = (fcntl(file, F_GETFL) & O_ACCMODE) == O_RDONLY;
  int number = is_folder ? number_in("NO_FOLDER_SYNC") : reads ? number_in("NO_SYNC_FOR_READING") : 0;
  if (number == 0) return interrupts(path_of(file), &calls) ? -1 : NEXT(int (*)(int), "fsync")(file);
  errno = number;
  return -1;
}

ssize_t read(int file, void *bytes, size_t count) {
  return fails_for("read", file) ? -1 : NEXT(ssize_t(*)(int, void *, size_t), "read")(file, bytes, count);
}

ssize_t pread64(int file, void *bytes, size_t count, off64_t place) {
  if (fails_for("pread64", file)) return -1;
  return NEXT(ssize_t(*)(int, void *, size_t, off64_t), "pread64")(file, bytes, count, place);
}

DIR *opendir(const char *path) {
  return fails("opendir", path) ? NULL : NEXT(DIR * (*)(const char *), "opendir")(path);
}

struct dirent *readdir(DIR *folder) {
  return fails_for("readdir", dirfd(folder)) ? NULL : NEXT(struct dirent * (*)(DIR *), "readdir")(folder);
}

int stat(const char *path, struct stat *found) {
  return fails("stat", path) ? -1 : NEXT(int (*)(const char *, struct stat *), "stat")(path, found);
}

int lstat(const char *path, struct stat *found) {
  return fails("lstat", path) ? -1 : NEXT(int (*)(const char *, struct stat *), "lstat")(path, found);
}

int access(const char *path, int mode) {
  return fails("access", path) ? -1 : NEXT(int (*)(const char *, int), "access")(path, mode);
}

int mkdir(const char *path, mode_t mode) {
  return fails("mkdir", path) ? -1 : NEXT(int (*)(const char *, mode_t), "mkdir")(path, mode);
}

int renameat2(int from, const char *old, int into, const char *new, unsigned int how) {
  int done = NEXT(int (*)(int, const char *, int, const char *, unsigned int), "renameat2")(from, old, into, new, how);
  return fails("renameat2", new) ? -1 : done;
}

int unlink(const char *path) {
  struct stat named, opened;
  if (number_in("NO_REMOVAL_OF_OPEN") != 0 && NEXT(int (*)(const char *, struct stat *), "stat")(path, &named) == 0)
    for (int file = 3; file < 256; file++)
      if (fstat(file, &opened) == 0 && opened.st_dev == named.st_dev && opened.st_ino == named.st_ino) {
        errno = number_in("NO_REMOVAL_OF_OPEN");
        return -1;
      }
  return NEXT(int (*)(const char *), "unlink")(path);
}

int rename(const char *old, const char *new) {
  struct stat found;
  if (number_in("NO_REPLACEMENT") != 0 && NEXT(int (*)(const char *, struct stat *), "lstat")(new, &found) == 0) {
    errno = number_in("NO_REPLACEMENT");
    return -1;
  }
  int done = NEXT(int (*)(const char *, const char *), "rename")(old, new);
  return fails("rename", new) ? -1 : done;
}

struct passwd *getpwuid(uid_t user) {
  return number_in("NO_USER") != 0 ? NULL : NEXT(struct passwd * (*)(uid_t), "getpwuid")(user);
}
