/* A file system that lacks something: loaded before a program (LD_PRELOAD), it makes `flock`, and
   `fsync` of a folder, fail with the error numbers in the variables NO_FLOCK and NO_FOLDER_SYNC. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdlib.h>
#include <sys/stat.h>

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
