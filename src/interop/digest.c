/* SHA-256 by OpenSSL's libcrypto, on which HDF5 depends; `sha256sum` and Python's `hashlib` give the
   same digits. */
#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <unistd.h>

/* Declared here, since the library may be installed without its headers. */
const void *EVP_sha256(void);
void *EVP_MD_CTX_new(void);
void EVP_MD_CTX_free(void *context);
int EVP_DigestInit_ex(void *context, const void *method, void *engine);
int EVP_DigestUpdate(void *context, const void *bytes, size_t count);
int EVP_DigestFinal_ex(void *context, unsigned char *digest, unsigned int *length);

/* files.c: identity of an open file. */
int battery_identify(int descriptor, int64_t seen[5]);

enum { digest_bytes = 32 };

/* Starts a digest; NULL: it cannot be computed, for instance for lack of memory. */
static void *begin(void) {
  void *context = EVP_MD_CTX_new();
  if (context != NULL && EVP_DigestInit_ex(context, EVP_sha256(), NULL) == 1) return context;
  EVP_MD_CTX_free(context);
  return NULL;
}

/* Ends a digest, as hexadecimal digits in small letters. Returns 0, or EIO if one of its steps failed. */
static int end(void *context, int good, char digits[2 * digest_bytes]) {
  unsigned char digest[digest_bytes];
  char text[2 * digest_bytes + 1];
  good = good && EVP_DigestFinal_ex(context, digest, NULL) == 1;
  EVP_MD_CTX_free(context);
  for (int k = 0; good && k < digest_bytes; k++) sprintf(text + 2 * k, "%02x", digest[k]);
  if (good) memcpy(digits, text, 2 * digest_bytes);
  return good ? 0 : EIO;
}

/* Digest of `count` bytes in memory. */
int battery_digest(const char *bytes, int64_t count, char digits[2 * digest_bytes]) {
  void *context = begin();
  return end(context, context != NULL && EVP_DigestUpdate(context, bytes, (size_t)count) == 1, digits);
}

/* Reads a file once: its length, its identity, its first `capacity` bytes or fewer, its last `behind`
   bytes if it is longer, and the digest of those before. Returns 0, an error number of the system, or -1:
   another program has a lock on it that excludes readers, as HDF5 does while a file is open for writing. */
int battery_digest_file(const char *path, int64_t behind, char *first, int64_t capacity, char *last,
                        char digits[2 * digest_bytes], int64_t *length, int64_t seen[5]) {
  char piece[1 << 16];
  int descriptor;
  do descriptor = open(path, O_RDONLY | O_NONBLOCK | O_CLOEXEC); while (descriptor < 0 && errno == EINTR);
  int status = descriptor >= 0 ? battery_identify(descriptor, seen) : errno;
  if (status == 0 && flock(descriptor, LOCK_SH | LOCK_NB) != 0 && errno == EWOULDBLOCK) status = -1;
  if (status == 0) {
    flock(descriptor, LOCK_UN);
    int64_t content = *length = seen[2], at = 0;
    if (content > behind) content -= behind;
    void *context = begin();
    int good = context != NULL, failure = 0;
    while (good && at < *length) {
      int64_t stop = at < content ? content : *length, most = stop - at;
      ssize_t got = read(descriptor, piece, (size_t)(most < (int64_t)sizeof piece ? most : (int64_t)sizeof piece));
      if (got < 0 && errno == EINTR) continue;
      if (got < 0) failure = errno;
      if (got <= 0) good = 0;
      else if (at >= content) memcpy(last + (at - content), piece, (size_t)got);
      else good = EVP_DigestUpdate(context, piece, (size_t)got) == 1;
      if (got > 0 && at < capacity && at < content)
        memcpy(first + at, piece, (size_t)(got < capacity - at ? got : capacity - at));
      at += got;
    }
    status = end(context, good, digits);
    if (failure != 0) status = failure;
  }
  if (descriptor >= 0) close(descriptor);
  return status;
}
