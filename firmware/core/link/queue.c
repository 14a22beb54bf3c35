#include "core/link/queue.h"

#include <stddef.h>

bool queue_init(queue_t *queue, frame_t *messages, uint32_t capacity) {
    if (capacity == 0u || (capacity & (capacity - 1u)) != 0u) {
        return false;
    }
    *queue = (queue_t){.messages = messages, .capacity = capacity};
    return true;
}

bool queue_push(queue_t *queue, const frame_t *message) {
    const uint32_t head = queue->head;
    if (head - __atomic_load_n(&queue->tail, __ATOMIC_ACQUIRE) == queue->capacity) {
        const uint32_t lost = queue->lost;
        __atomic_store_n(&queue->lost, lost < UINT32_MAX ? lost + 1u : lost, __ATOMIC_RELAXED);
        return false;
    }
    queue->messages[head & (queue->capacity - 1u)] = *message;
    __atomic_store_n(&queue->head, head + 1u, __ATOMIC_RELEASE);
    return true;
}

const frame_t *queue_front(const queue_t *queue) {
    const uint32_t tail = queue->tail;
    if (__atomic_load_n(&queue->head, __ATOMIC_ACQUIRE) == tail) {
        return NULL;
    }
    return &queue->messages[tail & (queue->capacity - 1u)];
}

void queue_drop(queue_t *queue) {
    const uint32_t tail = queue->tail;
    if (__atomic_load_n(&queue->head, __ATOMIC_ACQUIRE) != tail) {
        __atomic_store_n(&queue->tail, tail + 1u, __ATOMIC_RELEASE);
    }
}

uint32_t queue_count(const queue_t *queue) {
    const uint32_t tail = __atomic_load_n(&queue->tail, __ATOMIC_ACQUIRE);
    return __atomic_load_n(&queue->head, __ATOMIC_ACQUIRE) - tail;
}
