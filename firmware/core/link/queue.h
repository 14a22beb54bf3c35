/* queue.h: a bounded queue of messages from one producer to one consumer, without locks.
 *
 * One producer context and one consumer context, for example an interrupt and main, or both the same. Two interrupts of
 * different priority must not share the producer side. The producer writes only head and lost, the consumer only tail;
 * both are single words, published after the message they cover (C11 release and acquire), so the queue is right for
 * interrupts on one core and for threads alike.
 *
 * Order: first in, first out. Loss: when full, the new message is refused and counted; what is queued is never
 * overwritten. Latency: a message leaves after at most capacity - 1 others. Drained to the serial line of 2,000,000
 * baud (at most 80 us a message) a queue of 128 holds a message for at most 10.3 ms, as long as the consumer keeps the
 * line busy; on CAN at 1 Mbit/s (at most 160 us for a frame of 8 bytes with all stuff bits) 20.5 ms, plus the time that
 * frames of lower id from other nodes hold the bus.
 *
 * Memory: the caller's array. Time: push and pop about 30 instructions each, no loops but the copy of one message.
 */
#ifndef GOLDFIELD_QUEUE_H
#define GOLDFIELD_QUEUE_H

#include <stdbool.h>
#include <stdint.h>

#include "core/link/frame.h"

typedef struct {
    frame_t *messages;
    uint32_t capacity; /* A power of two. */
    uint32_t head;     /* Messages ever pushed, modulo 2^32. Producer's. */
    uint32_t tail;     /* Messages ever taken. Consumer's. */
    uint32_t lost;     /* Messages refused; stops at its maximum. Producer's. */
} queue_t;

/* An empty queue over the caller's array. False, and nothing done, unless capacity is a power of two, 1..2^31. */
bool queue_init(queue_t *queue, frame_t *messages, uint32_t capacity);

/* Producer: add a message. False: the queue is full, the message is lost and counted. */
bool queue_push(queue_t *queue, const frame_t *message);

/* Consumer: the oldest message, which stays queued; NULL if there is none. Valid until queue_drop. */
const frame_t *queue_front(const queue_t *queue);

/* Consumer: take the oldest message away. Nothing happens if there is none. */
void queue_drop(queue_t *queue);

/* Any context: messages queued; may be out of date as soon as it is read. */
uint32_t queue_count(const queue_t *queue);

#endif
