/* lockstep_internal.h: the rig's own state, for lockstep.c, which builds and runs it, and observer.c, its outside. */
#ifndef GOLDFIELD_LOCKSTEP_INTERNAL_H
#define GOLDFIELD_LOCKSTEP_INTERNAL_H

#include "rig/board_slot.h"
#include "rig/lockstep.h"
#include "rig/thread_pool.h"

struct rig {
    rig_config_t config;
    unsigned slots; /* Boards: the sensor and the beacons. */
    board_slot_t *slot;
    coils_t coils; /* Those of all boards. */
    int64_t now_ps;
    can_bus_t *bus;
    can_transfer_t *transfers; /* Transfers for the host; the oldest is number transfer_first. */
    size_t transfer_first, transfer_count, transfer_capacity;
    unsigned leader;       /* The beacon that runs ahead of the others. */
    unsigned wire_drivers; /* Boards that drive the sync wire high. */
    int64_t *edges_ps;     /* Rising edges of the sync wire. */
    size_t edge_count, edge_capacity;
    unsigned stopped; /* The board that ended the last run. */
    thread_pool_t pool;
};

#endif
