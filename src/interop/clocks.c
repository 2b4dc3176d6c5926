/* The time of day as text. */

#include <time.h>

/* 2026-01-31T23:59:59Z */
void battery_utc(char *text, int room)
{
    time_t now = time(NULL);
    struct tm parts;

    strftime(text, (size_t)room, "%Y-%m-%dT%H:%M:%SZ", gmtime_r(&now, &parts));
}
