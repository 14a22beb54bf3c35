/* machine_events.c: time, and the events as a binary heap; the order number keeps equal times first come, first served.
 */
#include "emulator/machine_internal.h"

#include <stdlib.h>

int64_t machine_now(const machine_t *machine) {
    return machine->now_ps;
}

void machine_set_core_clock(machine_t *machine, double hz) {
    machine->core_hz = hz;
    if (machine->processor.processor != NULL) {
        machine->processor.clock(machine->processor.processor, hz);
    }
}

void machine_set_flash_access(machine_t *machine, uint32_t acr) {
    if (machine->processor.processor != NULL) {
        machine->processor.flash_access(machine->processor.processor, acr);
    }
}

void machine_event_init(machine_event_t *event, void (*fire)(void *context, int64_t time_ps), void *context) {
    *event = (machine_event_t){.fire = fire, .context = context, .heap_index = -1};
}

static bool earlier(const machine_event_t *a, const machine_event_t *b) {
    return a->time_ps != b->time_ps ? a->time_ps < b->time_ps : a->order < b->order;
}

static void place(machine_t *machine, size_t index, machine_event_t *event) {
    machine->heap[index] = event;
    event->heap_index = (int32_t)index;
}

static void sift(machine_t *machine, size_t index, machine_event_t *event) {
    while (index > 0 && earlier(event, machine->heap[(index - 1) / 2])) {
        place(machine, index, machine->heap[(index - 1) / 2]);
        index = (index - 1) / 2;
    }
    for (;;) {
        size_t child = 2 * index + 1;
        if (child + 1 < machine->heap_count && earlier(machine->heap[child + 1], machine->heap[child])) {
            child++;
        }
        if (child >= machine->heap_count || !earlier(machine->heap[child], event)) {
            break;
        }
        place(machine, index, machine->heap[child]);
        index = child;
    }
    place(machine, index, event);
}

void machine_cancel(machine_t *machine, machine_event_t *event) {
    if (event->heap_index < 0) {
        return;
    }
    const size_t index = (size_t)event->heap_index;
    event->heap_index = -1;
    machine->heap_count--;
    machine_event_t *const last = machine->heap[machine->heap_count];
    if (last != event) {
        sift(machine, index, last);
    }
}

void machine_schedule(machine_t *machine, machine_event_t *event, int64_t time_ps) {
    const bool pending = event->heap_index >= 0;
    if (!pending && machine->heap_count == machine->heap_capacity) {
        const size_t capacity = machine->heap_capacity == 0 ? 64 : 2 * machine->heap_capacity;
        machine_event_t **const heap = realloc(machine->heap, capacity * sizeof *heap);
        if (heap == NULL) {
            abort(); /* A simulation that lost an event would be wrong without a sign. */
        }
        machine->heap = heap;
        machine->heap_capacity = capacity;
    }
    event->time_ps = time_ps;
    event->order = machine->event_order++;
    machine->heap_count += pending ? 0 : 1;
    sift(machine, pending ? (size_t)event->heap_index : machine->heap_count - 1, event);
    if (event->heap_index == 0 && machine->processor.processor != NULL) {
        machine->processor.attention(machine->processor.processor);
    }
}

void machine_fire(machine_t *machine, int64_t time_ps) {
    while (machine->heap_count > 0 && machine->heap[0]->time_ps <= time_ps) {
        machine_event_t *const event = machine->heap[0];
        machine_cancel(machine, event);
        if (event->time_ps > machine->now_ps) {
            machine->now_ps = event->time_ps;
        }
        event->fire(event->context, event->time_ps);
    }
    if (time_ps > machine->now_ps) {
        machine->now_ps = time_ps;
    }
}
