/* Alignment and page size of arrays in memory, and limits of this process on memory, for memory.f90. */
#define _GNU_SOURCE
#include <malloc.h>
#include <math.h>
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

/* Limit of this process in bytes: of its address space, or of its data if `of_data`; infinite: none. */
double battery_memory_limit(int of_data)
{
  struct rlimit limit;
  if (getrlimit(of_data ? RLIMIT_DATA : RLIMIT_AS, &limit) != 0) return HUGE_VAL;
  return limit.rlim_cur == RLIM_INFINITY ? HUGE_VAL : (double)limit.rlim_cur;
}

/* Makes threads (MPI has some) share one heap if address space is limited: glibc would reserve 64 MB
   or 128 MB of it for each thread. */
void battery_spare_address_space(void)
{
  if (battery_memory_limit(0) < HUGE_VAL) mallopt(M_ARENA_MAX, 1);
}
