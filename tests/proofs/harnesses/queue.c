/* queue.c: each call on a queue whose counts are anything. */
#include "core/link/queue.h"

#include "any.h"

#define LARGEST 65536u

static frame_t messages[LARGEST];

static void use(uint32_t capacity) {
    queue_t queue;
    frame_t *const room = messages + (LARGEST - capacity); /* Behind its last message there is nothing. */
    if (!queue_init(&queue, room, capacity)) {
        return;
    }
    //@ assert capacity > 0;
    queue.head = any_word();
    queue.tail = any_word();
    queue.lost = any_word();
    const frame_t message = {.id = any_word(), .length = any_byte()};
    (void)queue_push(&queue, &message);
    const frame_t *const front = queue_front(&queue);
    //@ assert front == \null || \valid_read(front);
    if (front != NULL) {
        //@ assert room <= front < room + capacity;
    }
    queue_drop(&queue);
    (void)queue_count(&queue);
}

int main(void) {
    use(any_up_to(0));
    for (uint32_t capacity = 1; capacity <= LARGEST; capacity *= 2u) {
        use(capacity);
    }
    queue_t other;
    (void)queue_init(&other, messages, any_word());
    return 0;
}
