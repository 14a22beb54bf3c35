#define _POSIX_C_SOURCE 200809L
#include "crew.h"

#include <sched.h>
#include <stdlib.h>
#include <time.h>

enum { SPINS_BEFORE_YIELD = 2000, BLOCKS_BEFORE_TRYING_AGAIN = 16 };

/* Do one task if one is offered. A number is only taken while its step is open: the step cannot end before that number is done. */
static bool do_a_task(crew_t *crew)
{
    uint_fast64_t number = atomic_load(&crew->taken);
    if (number >= atomic_load(&crew->offered) || !atomic_compare_exchange_strong(&crew->taken, &number, number + 1)) {
        return false;
    }
    crew->task(crew->context, (unsigned)(number % crew->tasks));
    (void)atomic_fetch_add(&crew->done, 1);
    return true;
}

static void *helper(void *context)
{
    crew_t *const crew = context;
    unsigned spins = 0;
    for (;;) {
        if (do_a_task(crew)) {
            spins = 0;
        } else if (++spins >= SPINS_BEFORE_YIELD) {
            spins = 0;
            (void)pthread_mutex_lock(&crew->mutex);
            while (!crew->running && !crew->quit) {
                (void)pthread_cond_wait(&crew->wake, &crew->mutex);
            }
            const bool quit = crew->quit;
            (void)pthread_mutex_unlock(&crew->mutex);
            if (quit) {
                return NULL;
            }
            (void)sched_yield();
        }
    }
}

static void set(crew_t *crew, bool running, bool quit)
{
    (void)pthread_mutex_lock(&crew->mutex);
    crew->running = running;
    crew->quit = quit;
    (void)pthread_cond_broadcast(&crew->wake);
    (void)pthread_mutex_unlock(&crew->mutex);
}

static double wall_clock(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void choose_help(crew_t *crew)
{
    double *const cost_s = &crew->cost_s[crew->helped];
    *cost_s = *cost_s > 0.0 ? 0.5 * (*cost_s + crew->block_s) : crew->block_s;
    crew->block_s = 0.0;
    crew->block_steps = 0;
    crew->helped = crew->cost_s[1] < crew->cost_s[0];
    if (++crew->blocks % BLOCKS_BEFORE_TRYING_AGAIN == 0) {
        crew->helped = !crew->helped;
    }
}

bool crew_init(crew_t *crew, unsigned threads, unsigned tasks, crew_task_t *task, void *context)
{
    crew->task = task;
    crew->context = context;
    crew->tasks = tasks;
    (void)pthread_mutex_init(&crew->mutex, NULL);
    (void)pthread_cond_init(&crew->wake, NULL);
    const unsigned wanted = threads - 1; /* The caller is one of them. */
    crew->threads = calloc(wanted + 1u, sizeof *crew->threads);
    while (crew->threads != NULL && crew->count < wanted && pthread_create(&crew->threads[crew->count], NULL, helper, crew) == 0) {
        ++crew->count;
    }
    return crew->threads != NULL && crew->count == wanted;
}

void crew_free(crew_t *crew)
{
    if (crew->threads == NULL) {
        return;
    }
    set(crew, false, true);
    for (unsigned i = 0; i < crew->count; ++i) {
        (void)pthread_join(crew->threads[i], NULL);
    }
    (void)pthread_mutex_destroy(&crew->mutex);
    (void)pthread_cond_destroy(&crew->wake);
    free(crew->threads);
}

void crew_begin(crew_t *crew)
{
    crew->begun_s = wall_clock();
    set(crew, crew->helped && crew->count > 0, false);
}

void crew_step(crew_t *crew)
{
    const uint_fast64_t end = atomic_load(&crew->offered) + crew->tasks;
    atomic_store(&crew->offered, end);
    unsigned spins = 0;
    while (atomic_load(&crew->done) < end) {
        if (!do_a_task(crew) && ++spins >= SPINS_BEFORE_YIELD) {
            spins = 0;
            (void)sched_yield();
        }
    }
    if (++crew->block_steps == CREW_BLOCK_STEPS) {
        crew_end(crew);
        choose_help(crew);
        crew_begin(crew);
    }
}

void crew_end(crew_t *crew)
{
    set(crew, false, false);
    crew->block_s += wall_clock() - crew->begun_s;
}
