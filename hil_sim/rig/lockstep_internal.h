/* lockstep_internal.h: the rig's own state, for lockstep.c, which builds and runs it, lockstep_look_ahead.c, which says
 * how far a step goes, lockstep_wires.c, which serves the wires between steps, and observer.c, the rig's outside. */
#ifndef GOLDFIELD_LOCKSTEP_INTERNAL_H
#define GOLDFIELD_LOCKSTEP_INTERNAL_H

#include "rig/board_slot.h"
#include "rig/lockstep.h"
#include "rig/thread_pool.h"

#define WIRES_SILENT_PS INT64_C(210000000000) /* Time without an edge that is longer than any sync period. */

struct rig {
    rig_config_t config;
    unsigned slots; /* Boards: the sensor and the beacons. */
    board_slot_t *slot;
    /* One a board, side by side: a look at all of them costs little. */
    board_ahead_t *ahead; /* What it does next, with what came to it taken into account. */
    bool *asked;          /* It has requests for the bus. */
    bool *written;        /* Bytes are on their way to it. */
    bool *stuck;          /* It did not get through its step. */
    unsigned *leading;    /* The boards whose sync output is on the wire; leaders of them. */
    unsigned leaders;
    bool others_sense; /* A beacon has a sensor of its own. */
    int64_t until_ps;  /* End of the run under way. */
    int64_t begin_ps;  /* Beginning and end of the step. */
    int64_t end_ps;
    bool staged;      /* The step has stages: leaders, then the other beacons, then the sensor. */
    bool leaders_run; /* It is in the first: the others are where the step began. */
    /* Beacons off the bus, that nobody hears of but by their coils, and that hear of nothing but the sync wire. They
     * have run up to loose_ps, beyond the step as a rule. */
    bool *loose;
    unsigned loose_count;
    int64_t loose_ps;
    unsigned boards_a_task; /* Boards of a task of the pool. */
    coil_head_t *latest;    /* Heads of all coils at the end of the step. */
    coils_t coils;          /* Those of all boards. */
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

/* Returns how many quanta the next step may have: in none but the first can anything that boards do now reach another,
 * other than by the sync wire. */
unsigned look_ahead_quanta(const rig_t *rig);

/* Returns whether it is open who drives the sync wire next: of those that may, any can begin to. They then go first, so
 * that no other board hears an edge late. */
bool look_ahead_open(const rig_t *rig);

/* Returns how far loose boards can run, once the leaders have got through the step. */
int64_t look_ahead_loose(const rig_t *rig);

/* Returns whether the sync wire has been silent at a time for longer than any period. */
bool wires_is_silent(const rig_t *rig, int64_t time_ps);

/* Hand on what the boards have done on the wires up to the present, and the bytes that arrive in the next step. */
void wires_serve_sync(rig_t *rig);
void wires_serve_bus(rig_t *rig);
void wires_serve_serial(rig_t *rig);

#endif
