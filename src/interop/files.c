/* System calls for files.f90, paths.f90 and file_text.f90 that need a structure, a constant or errno
   of C headers. A result is 0 or an error number unless said otherwise. */
#define _GNU_SOURCE
#include <ISO_Fortran_binding.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <fnmatch.h>
#include <limits.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>
#ifdef __linux__
#include <sys/xattr.h>
#endif

/* Number of the last error. */
int battery_errno(void) { return errno; }

/* Whether the last error is one of the disk: a failure, a full disk, an exhausted quota, a file that
   is too large. */
int battery_is_disk_error(void) {
  return errno == EIO || errno == EFBIG || errno == ENOSPC || errno == EDQUOT;
}

/* Whether the last error says that nothing has the name; after any other error that is not known. */
static int is_missing(void) { return errno == ENOENT || errno == ENOTDIR || errno == ENAMETOOLONG; }

/* Network file systems (Lustre, FUSE) may give up a call at a signal, whatever its handler wants. */
#define AGAIN_AFTER_SIGNALS(result, call) do result = (call); while (result < 0 && errno == EINTR)

/* Removes a file, a link or an empty folder; a missing one is no error, and a folder that is not empty
   stays, for instance one in which a file server keeps a removed file that is still open. */
int battery_remove(const char *path) {
  return remove(path) == 0 || errno == ENOENT || errno == ENOTDIR || errno == ENOTEMPTY || errno == EEXIST
    ? 0 : errno;
}

/* Kind of object that a path names, links followed: 0 none, or not known, 1 a file, 2 a folder, 3 another. */
int battery_kind_of(const char *path) {
  struct stat found;
  if (stat(path, &found) != 0) return 0;
  return S_ISREG(found.st_mode) ? 1 : S_ISDIR(found.st_mode) ? 2 : 3;
}

/* Replaces a path by the final target of its links, which need not exist; `path` has `capacity` bytes. */
int battery_follow(char *path, int capacity) {
  char target[PATH_MAX], joined[2 * PATH_MAX + 1];
  const int most_links = 40;
  for (int link = 0; link < most_links; link++) {
    ssize_t length = readlink(path, target, sizeof target - 1);
    if (length < 0) return errno == EINVAL || errno == ENOENT ? 0 : errno;
    target[length] = '\0';
    char *slash = strrchr(path, '/');
    int folder = target[0] == '/' || slash == NULL ? 0 : (int)(slash - path) + 1;
    snprintf(joined, sizeof joined, "%.*s%s", folder, path, target);
    if (strlen(joined) >= (size_t)capacity) return ENAMETOOLONG;
    strcpy(path, joined);
  }
  return ELOOP;
}

/* Whether two paths name the same object, or would if it were made. */
int battery_same_file(const char *one, const char *other) {
  struct stat found[2];
  const char *given[2] = {one, other};
  char path[2][PATH_MAX], *name[2];
  int missing[2];
  for (int k = 0; k < 2; k++) {
    if (given[k][0] == '\0' || strlen(given[k]) >= PATH_MAX) return 0;
    strcpy(path[k], given[k]);
    if (battery_follow(path[k], PATH_MAX) != 0) return 0;
    name[k] = path[k];
    missing[k] = stat(path[k], &found[k]) != 0;
    if (!missing[k]) continue;
    char *slash = strrchr(path[k], '/');
    if (slash != NULL) {
      name[k] = slash + 1;
      *slash = '\0';
    }
    const char *folder = slash == NULL ? "." : slash == path[k] ? "/" : path[k];
    if (stat(folder, &found[k]) != 0) return 0;
  }
  return missing[0] == missing[1] && found[0].st_dev == found[1].st_dev
    && found[0].st_ino == found[1].st_ino && (!missing[0] || strcmp(name[0], name[1]) == 0);
}

/* Bytes of the longest path. */
int battery_longest_path(void) { return PATH_MAX; }

/* Folder of a path, with links resolved; `folder` has `capacity` bytes, PATH_MAX or more. Returns its
   length, 0 if it does not exist. */
int battery_real_folder(const char *path, char *folder, int capacity) {
  if (capacity < PATH_MAX || realpath(path, folder) == NULL) return 0;
  char *slash = strrchr(folder, '/');
  return slash == folder ? 1 : (int)(slash - folder);
}

/* Whether a path names anything, as far as is known; whether this process may write to it. */
int battery_exists(const char *path) { return access(path, F_OK) == 0 || !is_missing(); }
int battery_may_write(const char *path) { return access(path, W_OK) == 0; }

/* Whether this process may have so many files open at the same time; raises its limit if that is allowed. */
int battery_may_open(int64_t count) {
  struct rlimit limit;
  if (getrlimit(RLIMIT_NOFILE, &limit) != 0 || limit.rlim_cur >= (rlim_t)count) return 1;
  limit.rlim_cur = (rlim_t)count;
  return limit.rlim_max >= limit.rlim_cur && setrlimit(RLIMIT_NOFILE, &limit) == 0;
}

/* Makes a folder with the usual permissions. */
int battery_make_folder(const char *path) {
  return mkdir(path, S_IRWXU | S_IRWXG | S_IRWXO) == 0 ? 0 : errno;
}

/* Closes a file; after a signal it is closed, too. */
static int close_file(int descriptor) { return close(descriptor) == 0 || errno == EINTR ? 0 : -1; }

/* Syncs a file, or the entries of a folder, to disk. SMB syncs only a file that is open for writing.
   Folders of some file systems cannot be synced (shared folders of virtual machines, old SMB): for a
   folder, only an error of the disk is one. */
int battery_sync(const char *path) {
  int descriptor, result = -1;
  AGAIN_AFTER_SIGNALS(descriptor, open(path, O_RDWR | O_CLOEXEC));
  if (descriptor < 0) AGAIN_AFTER_SIGNALS(descriptor, open(path, O_RDONLY | O_CLOEXEC));
  if (descriptor >= 0) AGAIN_AFTER_SIGNALS(result, fsync(descriptor));
  int status = result == 0 ? 0 : errno;
  if (descriptor >= 0 && close_file(descriptor) != 0 && status == 0) status = errno;
  errno = status;
  return status != 0 && !battery_is_disk_error() && battery_kind_of(path) == 2 ? 0 : status;
}

/* Makes a new empty file: a file or a link that had the name is removed. */
static int create_new(const char *path) {
  if (unlink(path) != 0 && errno != ENOENT) return errno;
  int descriptor;
  AGAIN_AFTER_SIGNALS(descriptor, open(path, O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0666));
  if (descriptor < 0) return errno;
  return close_file(descriptor) == 0 ? 0 : errno;
}

/* Identity of a file: device, inode, size, time of its last change. */
static void identify(const struct stat *found, int64_t seen[5]) {
  seen[0] = (int64_t)found->st_dev;
  seen[1] = (int64_t)found->st_ino;
  seen[2] = (int64_t)found->st_size;
  seen[3] = found->st_mtim.tv_sec;
  seen[4] = found->st_mtim.tv_nsec;
}

/* Identity of an open file. */
int battery_identify(int descriptor, int64_t seen[5]) {
  struct stat found;
  if (fstat(descriptor, &found) != 0) return errno;
  identify(&found, seen);
  return 0;
}

/* Whether a name refers to the file with the given identity (all 0: to none), links not followed, as
   far as is known without opening it. */
int battery_has_stamp(const char *path, const int64_t seen[5]) {
  struct stat found;
  int64_t now[5] = {0};
  if (lstat(path, &found) == 0) identify(&found, now);
  else if (!is_missing()) return 1;
  return memcmp(now, seen, sizeof now) == 0;
}

/* Whether a name refers to a file. */
static int is_file_of(const char *path, const struct stat *file) {
  struct stat found;
  return lstat(path, &found) == 0 && found.st_dev == file->st_dev && found.st_ino == file->st_ino;
}

/* Renames a file; done, too, if only the answer of a file server was lost, so that the call fails. */
static int renamed(const char *old, const char *new, const struct stat *mine) {
  int status = rename(old, new) == 0 ? 0 : errno;
  return is_file_of(new, mine) ? 0 : status;
}

/* Renames a file in place of another. Some file servers do not replace a file (old SMB: EEXIST; SFTP without
   an extension: EPERM): there it is removed before, and a stop between the two leaves the file under its old
   name alone. */
int battery_rename(const char *old, const char *new) {
  struct stat mine;
  if (lstat(old, &mine) != 0) return errno;
  int status = renamed(old, new, &mine);
  if (status == EEXIST || status == EPERM) status = unlink(new) == 0 ? renamed(old, new, &mine) : errno;
  return status;
}

/* Gives a file the access control list of another, or none as that has none. Returns whether it has. With
   a list, the group's bits of the mode are only a bound on the others'. */
static int copy_access_list(const char *from, const char *to) {
#ifdef __linux__
  const char name[] = "system.posix_acl_access";
  char list[65536]; /* the longest attribute */
  ssize_t size = getxattr(from, name, list, sizeof list);
  if (size >= 0) return setxattr(to, name, list, (size_t)size, 0) == 0;
  if (errno != ENODATA && errno != ENOTSUP) return 0;
  (void)!removexattr(to, name);
#endif
  return 1;
}

/* Renames a file to a name that no file has, or only the file with the given identity; -1: another
   file has it. */
int battery_put_in_place(const char *old, const char *new, const int64_t seen[5]) {
  const int64_t nothing[5] = {0};
  int64_t now[5] = {0};
  struct stat found, mine;
  if (lstat(old, &mine) != 0) return errno;
  /* It is opened, since NFS and sshfs answer `lstat` from what they knew some seconds ago; `open`
     makes them ask the server. */
  int descriptor = open(new, O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
  int status = (descriptor < 0 ? lstat(new, &found) : fstat(descriptor, &found)) == 0 ? 0 : errno;
  int is_known = status == 0 || is_missing();
  if (descriptor >= 0) close(descriptor);
  if (!is_known) return status;
  if (status == 0) identify(&found, now);
  if (memcmp(now, nothing, sizeof now) != 0) {
    if (memcmp(now, seen, sizeof now) != 0) return -1;
    /* Who may read it stays, but for a group that it cannot be given to; some file systems have no
       such modes. */
    mode_t mode = found.st_mode & 0777;
    if ((chown(old, found.st_uid, found.st_gid) != 0 && chown(old, (uid_t)-1, found.st_gid) != 0)
        || !copy_access_list(new, old))
      mode &= ~(mode_t)070;
    (void)!chmod(old, mode);
    return battery_rename(old, new);
  }
#ifdef RENAME_NOREPLACE
  status = renameat2(AT_FDCWD, old, AT_FDCWD, new, RENAME_NOREPLACE) == 0 ? 0 : errno;
  if (status == 0 || is_file_of(new, &mine)) return 0;
  if (status == EEXIST) return -1;
  /* Some file systems do not support this. */
#endif
  status = renamed(old, new, &mine);
  return status == EEXIST ? -1 : status;
}

/* Opens a file or a pipe for reading, without waiting for a writer; negative: an error. */
int battery_open_input(const char *path) {
  return open(path, O_RDONLY | O_NONBLOCK | O_CLOEXEC);
}

/* Size in bytes of an open file, as far as it is known. */
int64_t battery_size_of(int descriptor) {
  struct stat found;
  return fstat(descriptor, &found) == 0 && S_ISREG(found.st_mode) ? (int64_t)found.st_size : 0;
}

/* Reads up to `capacity` bytes. Returns their number, 0 at the end, -1 on an error, -2 if there was nothing
   to read for a tenth of a second. */
int64_t battery_read_some(int descriptor, char *bytes, int64_t capacity) {
  struct pollfd source = {.fd = descriptor, .events = POLLIN};
  const int tenth_of_a_second = 100;
  if (poll(&source, 1, tenth_of_a_second) == 0) return -2;
  ssize_t length = read(descriptor, bytes, (size_t)capacity);
  if (length < 0 && (errno == EAGAIN || errno == EINTR)) return -2;
  return length;
}

/* Whether a path names standard output, such as /dev/stdout or the file that it is redirected to. */
int battery_is_standard_output(const char *path) {
  struct stat found, output;
  int access_mode = fcntl(STDOUT_FILENO, F_GETFL) & O_ACCMODE;
  return stat(path, &found) == 0 && fstat(STDOUT_FILENO, &output) == 0
    && found.st_dev == output.st_dev && found.st_ino == output.st_ino && access_mode != O_RDONLY;
}

/* Writes all bytes to an open file, a pipe or a terminal, and waits while it takes none. If `close` is
   checked too, no failure goes unnoticed: a full disk may be found out only then. */
int battery_write_all(int descriptor, const char *bytes, size_t length) {
  while (length > 0) {
    ssize_t written = write(descriptor, bytes, length);
    if (written == 0) return EIO;
    if (written > 0) {
      bytes += written;
      length -= (size_t)written;
    } else if (errno == EAGAIN) {
      struct pollfd ready = {.fd = descriptor, .events = POLLOUT};
      poll(&ready, 1, -1);
    } else if (errno != EINTR) {
      return errno;
    }
  }
  return 0;
}

/* Puts /dev/null in the place of the file of a descriptor, whose own close cannot fail then. */
void battery_replace_descriptor(const int *descriptor) {
  int null = open("/dev/null", O_RDONLY | O_CLOEXEC);
  if (null < 0) return;
  dup2(null, *descriptor);
  close(null);
}

/* Writes a whole file, which is emptied first unless it is standard output, to which is appended. */
int battery_write_file(const char *path, const char *bytes, size_t length) {
  int shared = battery_is_standard_output(path);
  int descriptor = shared ? STDOUT_FILENO
    : open(path, O_WRONLY | O_CREAT | O_TRUNC | O_NOCTTY | O_CLOEXEC, 0666);
  if (descriptor < 0) return errno;
  int status = battery_write_all(descriptor, bytes, length);
  return shared || close(descriptor) == 0 || status != 0 ? status : errno;
}

/* Bytes of an array. gfortran 11 gives an empty array the extent -1. */
static size_t bytes_of(const CFI_cdesc_t *values) {
  size_t bytes = values->elem_len;
  for (int k = 0; k < values->rank; k++)
    bytes *= values->dim[k].extent > 0 ? (size_t)values->dim[k].extent : 0;
  return bytes;
}

/* Writes three contiguous arrays one after the other into a file from an offset on, and ends the file
   there; if the offset is 0, the file is made anew. */
int battery_write_parts(const char *path, int64_t at, const CFI_cdesc_t *first, const CFI_cdesc_t *second,
                        const CFI_cdesc_t *third) {
  const CFI_cdesc_t *part[3] = {first, second, third};
  int status = at == 0 ? create_new(path) : 0;
  if (status != 0) return status;
  int descriptor, result;
  AGAIN_AFTER_SIGNALS(descriptor, open(path, O_WRONLY | O_CREAT | O_NOFOLLOW | O_CLOEXEC, 0666));
  if (descriptor < 0) return errno;
  if (lseek(descriptor, at, SEEK_SET) < 0) status = errno;
  for (int k = 0; k < 3 && status == 0; k++) {
    status = battery_write_all(descriptor, part[k]->base_addr, bytes_of(part[k]));
    at += (int64_t)bytes_of(part[k]);
  }
  // Only where the file is longer: smbnetfs cuts it, but returns EIO.
  struct stat now;
  result = fstat(descriptor, &now);
  if (result == 0 && now.st_size != at) AGAIN_AFTER_SIGNALS(result, ftruncate(descriptor, at));
  if (status == 0 && result != 0) status = errno;
  return close_file(descriptor) == 0 || status != 0 ? status : errno;
}

/* The next name in a folder that matches a pattern of a shell; NULL at the end, if there is no such
   folder, or after an error, whose number is in `status`. `*folder` is NULL at first: the folder is
   opened then, and closed at the end. */
const char *battery_next_like(DIR **folder, const char *path, const char *pattern, int *status) {
  struct dirent *entry;
  *status = 0;
  if (*folder == NULL) *folder = opendir(path);
  if (*folder == NULL) {
    *status = is_missing() ? 0 : errno;
    return NULL;
  }
  while (errno = 0, (entry = readdir(*folder)) != NULL)
    if (fnmatch(pattern, entry->d_name, FNM_PERIOD | FNM_NOESCAPE | FNM_EXTMATCH) == 0) return entry->d_name;
  *status = errno;
  closedir(*folder);
  return NULL;
}
