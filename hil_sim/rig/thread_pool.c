#define _POSIX_C_SOURCE 200809L
#include "rig/thread_pool.h"

#include <sched.h>
#include <stdlib.h>
#include <time.h>

enum { SPINS_BEFORE_YIELD = 2000, YIELDS_BEFORE_SLEEP = 10, BLOCKS_BEFORE_TRYING_AGAIN = 16 };

/* Do one task if one is offered. A number is only taken while its step is open: the step cannot end before that
 * number is done. */
static bool do_a_task(thread_pool_t *pool) {
    uint_fast64_t number = atomic_load(&pool->taken);
    if (number >= atomic_load(&pool->offered) || !atomic_compare_exchange_strong(&pool->taken, &number, number + 1)) {
        return false;
    }
    pool->task(pool->context, (unsigned)(number % pool->tasks));
    (void)atomic_fetch_add(&pool->done, 1);
    return true;
}

static bool has_tasks(thread_pool_t *pool) {
    return atomic_load(&pool->taken) < atomic_load(&pool->offered);
}

/* Sleeps until there are tasks to help with. Returns false if the helper is to end. Who offers tasks looks for sleepers
 * afterwards, and a sleeper for tasks after it is one: one of the two sees the other. */
static bool sleep_long(thread_pool_t *pool) {
    (void)pthread_mutex_lock(&pool->mutex);
    (void)atomic_fetch_add(&pool->asleep, 1);
    while (!pool->quit && !(pool->running && has_tasks(pool))) {
        (void)pthread_cond_wait(&pool->wake, &pool->mutex);
    }
    (void)atomic_fetch_sub(&pool->asleep, 1);
    const bool goes_on = !pool->quit;
    (void)pthread_mutex_unlock(&pool->mutex);
    return goes_on;
}

static void *helper(void *context) {
    thread_pool_t *const pool = context;
    unsigned spins = 0, yields = 0;
    for (;;) {
        if (do_a_task(pool)) {
            spins = yields = 0;
        } else if (++spins >= SPINS_BEFORE_YIELD) {
            spins = 0;
            (void)sched_yield();
            if (++yields >= YIELDS_BEFORE_SLEEP) {
                yields = 0;
                if (!sleep_long(pool)) {
                    return NULL;
                }
            }
        }
    }
}

static void set(thread_pool_t *pool, bool running, bool quit) {
    (void)pthread_mutex_lock(&pool->mutex);
    pool->running = running;
    pool->quit = quit;
    (void)pthread_cond_broadcast(&pool->wake);
    (void)pthread_mutex_unlock(&pool->mutex);
}

static double wall_clock(void) {
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void choose_help(thread_pool_t *pool) {
    double *const cost_s = &pool->cost_s[pool->helped];
    const double step_s = pool->block_s / pool->block_steps;
    *cost_s = *cost_s > 0.0 ? 0.5 * (*cost_s + step_s) : step_s;
    pool->block_s = 0.0;
    pool->block_steps = 0;
    pool->helped = pool->cost_s[1] < pool->cost_s[0];
    if (++pool->blocks % BLOCKS_BEFORE_TRYING_AGAIN == 0) {
        pool->helped = !pool->helped;
    }
}

bool thread_pool_init(thread_pool_t *pool, unsigned threads, unsigned tasks, thread_pool_task_t *task, void *context) {
    pool->task = task;
    pool->context = context;
    pool->tasks = tasks;
    (void)pthread_mutex_init(&pool->mutex, NULL);
    (void)pthread_cond_init(&pool->wake, NULL);
    const unsigned wanted = threads - 1; /* The caller is one of them. */
    pool->threads = calloc(wanted + 1u, sizeof *pool->threads);
    while (pool->threads != NULL && pool->count < wanted &&
           pthread_create(&pool->threads[pool->count], NULL, helper, pool) == 0) {
        ++pool->count;
    }
    return pool->threads != NULL && pool->count == wanted;
}

void thread_pool_free(thread_pool_t *pool) {
    if (pool->threads == NULL) {
        return;
    }
    set(pool, false, true);
    for (unsigned i = 0; i < pool->count; ++i) {
        (void)pthread_join(pool->threads[i], NULL);
    }
    (void)pthread_mutex_destroy(&pool->mutex);
    (void)pthread_cond_destroy(&pool->wake);
    free(pool->threads);
}

void thread_pool_begin(thread_pool_t *pool) {
    pool->begun_s = wall_clock();
    set(pool, pool->helped && pool->count > 0, false);
}

void thread_pool_step(thread_pool_t *pool) {
    const uint_fast64_t end = atomic_load(&pool->offered) + pool->tasks;
    atomic_store(&pool->offered, end);
    if (pool->helped && atomic_load(&pool->asleep) > 0) {
        set(pool, true, false);
    }
    unsigned spins = 0;
    while (atomic_load(&pool->done) < end) {
        if (!do_a_task(pool) && ++spins >= SPINS_BEFORE_YIELD) {
            spins = 0;
            (void)sched_yield();
        }
    }
    const bool long_block = pool->block_s + wall_clock() - pool->begun_s > THREAD_POOL_BLOCK_S;
    if (++pool->block_steps == THREAD_POOL_BLOCK_STEPS || long_block) {
        thread_pool_end(pool);
        choose_help(pool);
        thread_pool_begin(pool);
    }
}

void thread_pool_end(thread_pool_t *pool) {
    set(pool, false, false);
    pool->block_s += wall_clock() - pool->begun_s;
}
