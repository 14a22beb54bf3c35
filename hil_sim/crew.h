/* crew.h: threads that do the same numbered tasks again and again, together with the caller.
 *
 * crew_step() does tasks 0 .. tasks - 1, each once, in any order and on any thread, and returns when all are done. Steps are short (tens of
 * microseconds), so helpers look for tasks without sleeping between crew_begin() and crew_end(), and sleep outside.
 *
 * Helpers help only where that is faster: on a busy machine a helper that holds a task and is not scheduled keeps everybody waiting. The crew measures
 * blocks of CREW_BLOCK_STEPS steps with and without help, goes on with what is faster, and tries the other way now and then. What the tasks compute
 * must not depend on it.
 *
 * One thread owns a crew. Memory: a few words and the threads.
 */
#ifndef GOLDFIELD_CREW_H
#define GOLDFIELD_CREW_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>

#define CREW_BLOCK_STEPS 5000 /* Of 20 us: 0.1 s, the length of a code cycle, so that blocks are alike. */

typedef void crew_task_t(void *context, unsigned number);

typedef struct {
    crew_task_t *task;
    void *context;
    unsigned tasks;
    pthread_t *threads; /* Helpers. */
    unsigned count;
    pthread_mutex_t mutex;
    pthread_cond_t wake;
    bool running; /* Helpers look for tasks without sleeping. */
    bool quit;
    bool helped;      /* In the block of steps that runs now. */
    double cost_s[2]; /* Of a block without and with help, smoothed; 0: not known yet. */
    double begun_s;   /* When the block, or the part of it since crew_begin(), began. */
    double block_s;   /* Of the block before that. */
    unsigned block_steps, blocks;
    /* Tasks are handed out by number: 0, 1, 2, ... for ever; number n is task n % tasks. */
    atomic_uint_fast64_t offered, taken, done;
} crew_t;

/* Start a crew that is all zeros, with threads - 1 helpers. False if there is no memory, or the system gives fewer threads: free it all the same. */
bool crew_init(crew_t *crew, unsigned threads, unsigned tasks, crew_task_t *task, void *context);
/* Ends the helpers. A crew that is still all zeros needs no freeing, but may be freed. */
void crew_free(crew_t *crew);

void crew_begin(crew_t *crew);
void crew_step(crew_t *crew);
void crew_end(crew_t *crew);

#endif
