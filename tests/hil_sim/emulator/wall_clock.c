/* wall_clock.c: clocks that move on by WALL_STEP_NS nanoseconds each time they are read, to be loaded before all
 * others.
 */
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>

static long long read_clock(void) {
    static long long now = 1700000000000000000;
    const char *const step = getenv("WALL_STEP_NS");
    now += step != NULL ? atoll(step) : 0;
    return now;
}

int clock_gettime(clockid_t clock, struct timespec *time) {
    (void)clock;
    const long long now = read_clock();
    *time = (struct timespec){.tv_sec = now / 1000000000, .tv_nsec = now % 1000000000};
    return 0;
}

int gettimeofday(struct timeval *restrict time, void *restrict zone) {
    (void)zone;
    const long long now = read_clock();
    *time = (struct timeval){.tv_sec = now / 1000000000, .tv_usec = now % 1000000000 / 1000};
    return 0;
}
