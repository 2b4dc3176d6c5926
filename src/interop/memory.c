/* Advice to the operating system on memory, for memory.f90. */
#define _GNU_SOURCE
#include <stdint.h>
#include <sys/mman.h>
#include <unistd.h>

/* Asks for large pages for the whole pages within `bytes` bytes from `address` on. */
void battery_prefer_large_pages(void *address, size_t bytes)
{
  uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE);
  uintptr_t first = ((uintptr_t)address + page - 1) / page * page;
  uintptr_t end = ((uintptr_t)address + bytes) / page * page;
  if (end > first) madvise((void *)first, end - first, MADV_HUGEPAGE);
}
