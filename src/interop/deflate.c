/* Inflated length of compressed values, for deflate.f90. */
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <unistd.h>

/* Procedure of zlib; null unless HDF5 has loaded it. */
extern int uncompress(unsigned char *, unsigned long *, const unsigned char *, unsigned long)
  __attribute__((weak));

int battery_inflates_to(const char *path, int64_t address, int64_t stored, int64_t size) {
  if (uncompress == NULL) return 1;
  if (address < 0 || size < 0 || stored < 0 || stored > 2*size + 64) return 0;
  unsigned char *from = malloc((size_t)stored + 1), *into = malloc((size_t)size + 1);
  unsigned long length = (unsigned long)size + 1;
  int descriptor = open(path, O_RDONLY | O_CLOEXEC), same = 0;
  if (from != NULL && into != NULL && descriptor >= 0)
    same = pread(descriptor, from, (size_t)stored, address) == stored
      && uncompress(into, &length, from, (unsigned long)stored) == 0 && length == (unsigned long)size;
  if (descriptor >= 0) close(descriptor);
  free(from);
  free(into);
  return same;
}
