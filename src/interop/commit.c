/* The git commit that the program was built from; only `make` knows it. The path is that from this
   file, so that builds of fpm alone, and packages that depend on this one, need no switch for it. */
#if __has_include("../../build/generated/commit.h")
#include "../../build/generated/commit.h"
#else
#define BATTERY_COMMIT "unknown"
#endif

/* 40 digits, then `-dirty` if sources were changed, then null characters. */
const char battery_commit[48] = BATTERY_COMMIT;
