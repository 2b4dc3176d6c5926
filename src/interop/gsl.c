/* Random numbers of the GNU Scientific Library, for gsl.f90.

   In C, since GSL's generators are variables, of which a Fortran program would get a copy of its
   own, empty. */

#include <gsl/gsl_errno.h> /* type "fpm @release": "fpm build" has no switches (docs/install.md) */
#include <gsl/gsl_rng.h>
#include <gsl/gsl_version.h>
#include <stdint.h>

/* Version of the library at run time. */
const char *battery_gsl_version(void) { return gsl_version; }

/* Two generators of different kind: one shifts bits, the other multiplies modulo primes. */
static gsl_rng *twister, *recursive;

/* Seeds both generators, which are made once. Returns 0 if there is no memory for them. GSL's own error
   handler, which aborts, is switched off. */
int battery_seed(uint64_t seed)
{
  gsl_set_error_handler_off();
  if (!twister) twister = gsl_rng_alloc(gsl_rng_mt19937);
  if (!recursive) recursive = gsl_rng_alloc(gsl_rng_cmrg);
  if (!twister || !recursive) return 0;
  gsl_rng_set(twister, (unsigned long)(seed & UINT32_MAX));
  gsl_rng_set(recursive, (unsigned long)(seed >> 32));
  return 1;
}

/* Sum, modulo one, of 53 bits of one generator and the number of the other. */
double battery_uniform(void)
{
  uint64_t high = gsl_rng_get(twister) >> 5, low = gsl_rng_get(twister) >> 6;
  double one = (double)(high << 26 | low) * 0x1p-53, other = gsl_rng_uniform(recursive);
  double number = one < 1.0 - other ? one + other : one - (1.0 - other);
  /* The sum may have been rounded up. */
  return number < 1.0 ? number : 0.0;
}
