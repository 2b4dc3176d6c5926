/* A file system that lacks something: loaded before a program (LD_PRELOAD), it makes `flock`, `fsync` of a
   folder, and `read` of files whose path ends with NO_READ_OF, fail with the error numbers in the variables
   NO_FLOCK, NO_FOLDER_SYNC and NO_READ. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static int number_in(const char *name) {
  const char *text = getenv(name);
  return text == NULL ? 0 : atoi(text);
}

int flock(int file, int operation) {
  errno = number_in("NO_FLOCK");
  if (errno != 0) return -1;
  return ((int (*)(int, int))dlsym(RTLD_NEXT, "flock"))(file, operation);
}

int fsync(int file) {
  struct stat found;
  int number = number_in("NO_FOLDER_SYNC");
  if (number == 0 || fstat(file, &found) != 0 || !S_ISDIR(found.st_mode))
    return ((int (*)(int))dlsym(RTLD_NEXT, "fsync"))(file);
  errno = number;
  return -1;
}

ssize_t read(int file, void *bytes, size_t count) {
  const char *end = getenv("NO_READ_OF");
  char link[64], path[4096];
  snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  ssize_t length = end == NULL ? -1 : readlink(link, path, sizeof path);
  size_t most = end == NULL ? 0 : strlen(end);
  if (length < (ssize_t)most || length < 0 || memcmp(path + length - most, end, most) != 0)
    return ((ssize_t(*)(int, void *, size_t))dlsym(RTLD_NEXT, "read"))(file, bytes, count);
  errno = number_in("NO_READ");
  return -1;
}
