/* Limits of this process on memory. */
#include <malloc.h>
#include <sys/resource.h>

/* Limit of this process in bytes: of its address space, or of its data if `of_data`; negative: none. */
double process_memory_limit(int of_data)
{
  struct rlimit limit;
  if (getrlimit(of_data ? RLIMIT_DATA : RLIMIT_AS, &limit) != 0) return -1.0;
  return limit.rlim_cur == RLIM_INFINITY ? -1.0 : (double)limit.rlim_cur;
}

/* Makes threads (MPI has some) share one heap if address space is limited: glibc would reserve 64 MB
   or 128 MB of it for each thread. */
void spare_address_space_of_threads(void)
{
  if (process_memory_limit(0) >= 0.0) mallopt(M_ARENA_MAX, 1);
}
