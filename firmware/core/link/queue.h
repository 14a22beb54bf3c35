/* queue.h: a bounded queue of messages from one producer to one consumer, without locks.
 *
 * Calls, in the order they are made: queue_init once; queue_push by the producer; queue_front and then queue_drop by
 * the consumer.
 *
 * Contexts. There is one producer context and one consumer context, for example an interrupt and main, or both the
 * same. Two interrupts of different priority must not share the producer side. The producer writes only head and lost,
 * the consumer only tail; both are single words, published after the message they cover (C11 release and acquire), so
 * the queue is right for interrupts on one core and for threads alike.
 *
 * Order: first in, first out. Loss: when the queue is full, the new message is refused and counted; what is queued is
 * never overwritten.
 *
 * Latency: a message leaves after at most capacity - 1 others. Drained to the serial line of 2,000,000 baud (at most
 * 80 us a message) a queue of 128 holds a message for at most 10.3 ms, as long as the consumer keeps the line busy; on
 * CAN at 1 Mbit/s (at most 160 us for a frame of 8 bytes with all stuff bits) 20.5 ms, plus the time that frames of
 * lower id from other nodes hold the bus.
 *
 * Memory: the caller's array. Time: push and pop about 30 instructions each, no loops but the copy of one message.
 */
#ifndef GOLDFIELD_QUEUE_H
#define GOLDFIELD_QUEUE_H

#include <stdbool.h>
#include <stdint.h>

#include "core/link/frame.h"

typedef struct {
    frame_t *messages; /* The caller's array. */
    uint32_t capacity; /* Messages that it holds, a power of two. */
    uint32_t head;     /* Messages ever pushed, modulo 2^32; written by the producer. */
    uint32_t tail;     /* Messages ever taken, modulo 2^32; written by the consumer. */
    uint32_t lost;     /* Messages refused, written by the producer; the count stops at its maximum. */
} queue_t;

/* Make an empty queue over the caller's array.
 * Returns false, with nothing done, unless capacity is a power of two, 1..2^31. */
bool queue_init(queue_t *queue, frame_t *messages, uint32_t capacity);

/* Producer: add a message. Returns false if the queue is full; the message is then lost and counted. */
bool queue_push(queue_t *queue, const frame_t *message);

/* Consumer: look at the oldest message, which stays queued. Returns it, valid until queue_drop, or NULL if there is
 * none. */
const frame_t *queue_front(const queue_t *queue);

/* Consumer: take the oldest message away. Nothing happens if there is none. */
void queue_drop(queue_t *queue);

/* Any context. Returns the number of messages queued, which may be out of date as soon as it is read. */
uint32_t queue_count(const queue_t *queue);

#endif
