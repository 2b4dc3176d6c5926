/* The time of day as text. */

#include <time.h>

/* 2026-01-31T23:59:59Z; the length, 0 where it does not fit */
int battery_utc(char *text, int room)
{
    time_t now = time(NULL);
    struct tm parts;

    return (int)strftime(text, (size_t)room, "%Y-%m-%dT%H:%M:%SZ", gmtime_r(&now, &parts));
}
