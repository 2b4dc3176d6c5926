/* The time of day, as text and as a number. */

#include <time.h>

/* Writes the time of day, as in 2026-01-31T23:59:59Z; returns the length, 0 if it does not fit. */
int battery_utc(char *text, int capacity)
{
    time_t now = time(NULL);
    struct tm parts;

    return (int)strftime(text, (size_t)capacity, "%Y-%m-%dT%H:%M:%SZ", gmtime_r(&now, &parts));
}

/* Seconds since 1970. */
double battery_utc_seconds(void)
{
    struct timespec now;

    clock_gettime(CLOCK_REALTIME, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}
