/* thread_pool.h: threads that do the same numbered tasks again and again, together with the caller.
 *
 * thread_pool_init() starts the helpers; then any number of blocks of steps: thread_pool_begin(), thread_pool_step()
 * again and again, thread_pool_end(). thread_pool_free() ends the helpers.
 *
 * A step does tasks 0 .. tasks - 1, each once, in any order and on any thread. Steps may be short (tens of
 * microseconds), so between thread_pool_begin() and thread_pool_end() helpers look for tasks for a tenth of a
 * millisecond before they sleep.
 *
 * Helpers help only where that is faster: on a busy machine a helper that holds a task and is not scheduled keeps
 * everybody waiting. The pool measures blocks of THREAD_POOL_BLOCK_STEPS steps, or fewer long ones, with and without
 * help, goes on with what is faster, and tries the other way now and then. What the tasks compute must not depend on
 * it.
 *
 * One thread owns a pool. Memory: a few words and the threads.
 */
#ifndef GOLDFIELD_THREAD_POOL_H
#define GOLDFIELD_THREAD_POOL_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>

/* Steps in a block: 0.1 s of steps of 20 us, the length of a code cycle, so that blocks are alike. */
#define THREAD_POOL_BLOCK_STEPS 5000
#define THREAD_POOL_BLOCK_S     0.5 /* A block ends when it has lasted so long, of however few steps. */

typedef void thread_pool_task_t(void *context, unsigned number);

typedef struct {
    thread_pool_task_t *task;
    void *context;
    unsigned tasks;
    pthread_t *threads; /* The helpers; count of them. */
    unsigned count;
    pthread_mutex_t mutex;
    pthread_cond_t wake;
    bool running;     /* Helpers look for tasks without sleeping. */
    bool quit;        /* Helpers end. */
    bool helped;      /* Helpers help in the block of steps that runs now. */
    double cost_s[2]; /* Duration of a step without and with help, smoothed; 0: not known yet. */
    double begun_s;   /* When the block, or the part of it since thread_pool_begin(), began. */
    double block_s;   /* Duration of the block's parts before that. */
    unsigned block_steps, blocks;
    atomic_uint asleep; /* Helpers that sleep or are about to. */
    /* Tasks are handed out by number: 0, 1, 2, ... for ever; number n is task n % tasks. */
    atomic_uint_fast64_t offered, taken, done;
} thread_pool_t;

/* Start a pool that is all zeros, with threads - 1 helpers. Returns false if there is no memory, or the system gives
 * fewer threads: the pool must be freed all the same. */
bool thread_pool_init(thread_pool_t *pool, unsigned threads, unsigned tasks, thread_pool_task_t *task, void *context);

/* Wake the helpers, if they are to help. */
void thread_pool_begin(thread_pool_t *pool);

/* Do every task once. Returns when all are done. */
void thread_pool_step(thread_pool_t *pool);

/* Let the helpers sleep. */
void thread_pool_end(thread_pool_t *pool);

/* End the helpers. A pool that is still all zeros needs no freeing, but may be freed. */
void thread_pool_free(thread_pool_t *pool);

#endif
