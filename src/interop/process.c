/* Ends this process even if it is blocked. */
#include <signal.h>
#include <stddef.h>
#include <unistd.h>

static int exit_code;

static void leave_now(int number)
{
  (void)number;
  _exit(exit_code);
}

void process_leave_after(int seconds, int code)
{
  struct sigaction end = {0};
  exit_code = code;
  end.sa_handler = leave_now;
  sigemptyset(&end.sa_mask);
  sigaction(SIGALRM, &end, NULL);
  alarm((unsigned)seconds);
}
