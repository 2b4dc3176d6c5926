/* Random numbers of the GNU Scientific Library, for gsl.f90.

   In C, since GSL's generators are variables, of which a Fortran program would get a copy of its
   own, empty. */

#include <gsl/gsl_errno.h> /* type "fpm @release": "fpm build" has no switches (docs/install.md) */
#include <gsl/gsl_rng.h>
#include <gsl/gsl_version.h>
#include <stdint.h>
#include <stdlib.h>

/* Version of the library at run time. */
const char *battery_gsl_version(void) { return gsl_version; }

/* Two generators of different kind: one shifts bits, the other multiplies modulo primes. */
typedef struct {
  gsl_rng *twister, *recursive;
} generator;

void battery_generator_free(generator *both)
{
  if (!both) return;
  if (both->twister) gsl_rng_free(both->twister);
  if (both->recursive) gsl_rng_free(both->recursive);
  free(both);
}

/* Makes a generator; null if there is no memory. GSL's own error handler, which aborts, is switched
   off. */
generator *battery_generator_new(uint64_t seed)
{
  gsl_set_error_handler_off();
  generator *both = calloc(1, sizeof *both);
  if (!both) return NULL;
  both->twister = gsl_rng_alloc(gsl_rng_mt19937);
  both->recursive = gsl_rng_alloc(gsl_rng_cmrg);
  if (!both->twister || !both->recursive) {
    battery_generator_free(both);
    return NULL;
  }
  gsl_rng_set(both->twister, (unsigned long)(seed & UINT32_MAX));
  gsl_rng_set(both->recursive, (unsigned long)(seed >> 32));
  return both;
}

/* Sum, modulo one, of 53 bits of one generator and the number of the other. */
double battery_generator_uniform(generator *both)
{
  uint64_t high = gsl_rng_get(both->twister) >> 5, low = gsl_rng_get(both->twister) >> 6;
  double one = (double)(high << 26 | low) * 0x1p-53, other = gsl_rng_uniform(both->recursive);
  double number = one < 1.0 - other ? one + other : one - (1.0 - other);
  /* The sum may have been rounded up. */
  return number < 1.0 ? number : 0.0;
}
