/* The processor of this machine. */
#include <stdio.h>
#include <string.h>

/* Model of the processor; returns its length, 0 if it is unknown. `model` has `capacity` bytes. */
int battery_processor(char *model, int capacity) {
  FILE *file = fopen("/proc/cpuinfo", "r");
  int length = 0;
  if (file == NULL) return 0;
  char line[256];
  while (length == 0 && fgets(line, sizeof line, file) != NULL) {
    char *value = strstr(line, ": ");
    if (value == NULL || strncmp(line, "model name", 10) != 0) continue;
    length = snprintf(model, (size_t)capacity, "%.*s", (int)strcspn(value + 2, "\n"), value + 2);
  }
  fclose(file);
  return length < capacity ? length : capacity - 1;
}
