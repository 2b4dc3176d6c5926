/* Alignment and page size of arrays in memory, and the address space of threads, for memory.f90. */
#define _GNU_SOURCE
#include <malloc.h>
#include <stdint.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

/* Requests large pages for the whole pages within `bytes` bytes from `address` on. */
void battery_prefer_large_pages(void *address, size_t bytes)
{
  uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE);
  uintptr_t first = ((uintptr_t)address + page - 1) / page * page;
  uintptr_t end = ((uintptr_t)address + bytes) / page * page;
  if (end > first) madvise((void *)first, end - first, MADV_HUGEPAGE);
}

/* Bytes from `array` to the beginning of the next cache line of 64 bytes. */
int battery_bytes_to_next_line(const void *array)
{
  return (int)(-(uintptr_t)array % 64);
}

/* Makes threads (MPI has some) share one heap if address space is limited: glibc would reserve 64 MB
   or 128 MB of it for each thread. */
void battery_spare_address_space(void)
{
  struct rlimit limit;
  if (getrlimit(RLIMIT_AS, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY) mallopt(M_ARENA_MAX, 1);
}
