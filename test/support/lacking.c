/* A file system that lacks something: loaded before a program (LD_PRELOAD), it makes `flock`, and `fsync` of a
   folder, fail with the error numbers in the variables NO_FLOCK and NO_FOLDER_SYNC, and the call that NO_CALL
   names (read, pread64, opendir, readdir, stat, lstat, access, mkdir) with that in NO_CALL_WITH, from the
   NO_CALL_AFTER-th such call on, of paths that end with NO_CALL_OF; a renameat2 so named is done before. With
   HANGUP_HANDLER set, a handler of SIGHUP is there before the program begins, as UCX sets one. */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <signal.h>
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

/* Whether a call fails for an open file. */
static int fails_for(const char *call, int file) {
  char link[64], path[4096];
  snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  ssize_t length = getenv("NO_CALL") == NULL ? -1 : readlink(link, path, sizeof path - 1);
  if (length < 0) return 0;
  path[length] = '\0';
  return fails(call, path);
}

int flock(int file, int operation) {
  errno = number_in("NO_FLOCK");
  return errno != 0 ? -1 : NEXT(int (*)(int, int), "flock")(file, operation);
}

int fsync(int file) {
  struct stat found;
  int number = number_in("NO_FOLDER_SYNC");
  if (number == 0 || fstat(file, &found) != 0 || !S_ISDIR(found.st_mode)) return NEXT(int (*)(int), "fsync")(file);
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
