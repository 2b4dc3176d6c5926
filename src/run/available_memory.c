/* Limits of this process on memory. */
#include <malloc.h>
#include <sys/resource.h>

/* Bytes of address space, or of data if `of_data`, that the process may have; negative: no limit. */
double process_memory_limit(int of_data)
{
  struct rlimit limit;
  if (getrlimit(of_data ? RLIMIT_DATA : RLIMIT_AS, &limit) != 0) return -1.0;
  return limit.rlim_cur == RLIM_INFINITY ? -1.0 : (double)limit.rlim_cur;
}

/* Where address space is limited, threads (MPI has some) share one heap: glibc would reserve 64 MB or
   128 MB of it for each. */
void spare_address_space_of_threads(void)
{
  if (process_memory_limit(0) >= 0.0) mallopt(M_ARENA_MAX, 1);
}
