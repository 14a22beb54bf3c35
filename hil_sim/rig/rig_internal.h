/* rig_internal.h: the rig itself, for those that make it up: lockstep.c builds and runs it, observer.c is its
 * outside. */
#ifndef GOLDFIELD_RIG_INTERNAL_H
#define GOLDFIELD_RIG_INTERNAL_H

#include "rig/board_slot.h"
#include "rig/thread_pool.h"

struct rig {
    rig_config_t config;
    unsigned slots;
    board_slot_t *slot;
    coils_t coils;
    int64_t now_ps;
    can_bus_t *bus;
    can_transfer_t *transfers; /* For the host. */
    size_t transfer_first, transfer_count, transfer_capacity;
    int64_t *edges_ps; /* Rising edges of the sync wire. */
    size_t edge_count, edge_capacity;
    unsigned stopped;
    thread_pool_t pool;
};

#endif
