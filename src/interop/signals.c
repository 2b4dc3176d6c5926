/* Signals that request a stop; the handler uses async-signal-safe operations only. */
#include <signal.h>
#include <stddef.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

/* The signals that request a stop, in the order of their names in signals.f90. */
static const int requests[] = {SIGINT, SIGUSR1, SIGTERM, SIGUSR2, SIGXCPU, SIGHUP};
enum { request_count = sizeof requests / sizeof requests[0] };

/* Seconds after the first signal within which further signals are ignored. */
static const double same_signal = 0.5;

static volatile sig_atomic_t received;
static volatile double received_at;

static double now(void)
{
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return (double)time.tv_sec + 1e-9*(double)time.tv_nsec;
}

/* As a further signal only SIGINT and SIGTERM ask for an end at once. The system sends SIGXCPU once a
   second, SIGHUP again when the shell ends, and SIGUSR1 when a Python that has sent it already ends. */
static void receive(int number)
{
  if (!received) {
    received_at = now();
    received = number;
  } else if ((number == SIGINT || number == SIGTERM) && now() - received_at > same_signal) {
    _exit(128 + number);
  }
}

/* Whether SIGHUP was ignored (nohup) when the program started: before libraries set handlers for it as
   they are loaded, which UCX does. */
static int hangup_ignored;

/* Removes variables of the environment that change what a Fortran library reads and writes, and where: the
   order of bytes, the signs of numbers, its units. It reads them as it is loaded. */
static void forget_formats(char **environment)
{
  static const char *const names[] = {"GFORTRAN_", "FORT_CONVERT="};
  char **kept = environment;
  for (char **at = environment; *at != NULL; at++) {
    int is_kept = 1;
    for (size_t k = 0; k < sizeof names / sizeof names[0]; k++)
      if (strncmp(*at, names[k], strlen(names[k])) == 0) is_kept = 0;
    if (is_kept) *kept++ = *at;
  }
  *kept = NULL;
}

static void at_start(int count, char **words, char **environment)
{
  (void)count;
  (void)words;
  forget_formats(environment);
  struct sigaction before = {0};
  sigaction(SIGHUP, NULL, &before);
  hangup_ignored = before.sa_handler == SIG_IGN;
}

__attribute__((section(".preinit_array"), used)) static void (*const before_libraries)(int, char **, char **)
  = at_start;

/* Sets the handlers: the signals of the list request a stop, also where whoever started the program has
   blocked them; a write beyond a size limit or to a closed pipe fails, but does not end the program. SIGHUP
   stays ignored where it was ignored. */
void signals_watch(void)
{
  struct sigaction stop = {0}, ignore = {0};
  sigset_t heard;
  sigemptyset(&heard);
  stop.sa_handler = receive;
  stop.sa_flags = SA_RESTART;
  sigemptyset(&stop.sa_mask);
  ignore.sa_handler = SIG_IGN;
  sigemptyset(&ignore.sa_mask);
  for (int at = 0; at < request_count; at++) {
    sigaction(requests[at], requests[at] == SIGHUP && hangup_ignored ? &ignore : &stop, NULL);
    sigaddset(&heard, requests[at]);
  }
  sigaction(SIGXFSZ, &ignore, NULL);
  sigaction(SIGPIPE, &ignore, NULL);
  sigprocmask(SIG_UNBLOCK, &heard, NULL);
}

/* Place in the list of the first signal received, from 1; 0: none. */
int signals_received(void)
{
  if (!received) return 0;
  for (int at = 0; at < request_count; at++)
    if (received == requests[at]) return at + 1;
  return 0;
}

void signals_forget(void) { received = 0; }
