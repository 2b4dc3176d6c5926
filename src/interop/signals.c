/* Signals that request a stop; the handler uses async-signal-safe operations only. */
#include <signal.h>
#include <stddef.h>
#include <time.h>
#include <unistd.h>

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

static void receive(int number)
{
  if (!received) {
    received_at = now();
    received = number;
  } else if (now() - received_at > same_signal) {
    _exit(128 + number);
  }
}

/* Sets the handlers: the three signals request a stop; a write beyond a size limit or to a closed pipe
   fails, but does not end the program. */
void signals_watch(void)
{
  struct sigaction stop = {0}, ignore = {0};
  stop.sa_handler = receive;
  stop.sa_flags = SA_RESTART;
  sigemptyset(&stop.sa_mask);
  ignore.sa_handler = SIG_IGN;
  sigemptyset(&ignore.sa_mask);
  sigaction(SIGINT, &stop, NULL);
  sigaction(SIGUSR1, &stop, NULL);
  sigaction(SIGTERM, &stop, NULL);
  sigaction(SIGXFSZ, &ignore, NULL);
  sigaction(SIGPIPE, &ignore, NULL);
}

/* The first signal received: 0 none, 1 SIGINT, 2 SIGUSR1, 3 SIGTERM. */
int signals_received(void)
{
  switch (received) {
  case 0: return 0;
  case SIGINT: return 1;
  case SIGUSR1: return 2;
  default: return 3;
  }
}

void signals_forget(void) { received = 0; }
