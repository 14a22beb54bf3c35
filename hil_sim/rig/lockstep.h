/* lockstep.h: the rig: boards, coils, field, sync wire, CAN and serial lines in one virtual time.
 *
 * Time runs in quanta of RIG_QUANTUM_PS, counted from 0, whatever slices the caller asks for: rig_run() executes the
 * quanta that end by then. In one step all boards run at the same time, in up to as many threads as asked for (fewer
 * while that is faster), each through one quantum of its own:
 *
 *     the sync master two quanta ahead of the sensor, the other beacons one quantum ahead, the sensor at the rig's
 *       present.
 *
 * Nothing passes between boards inside a step; between steps, in a fixed order, the wires are served. So the result
 * depends neither on threads nor on slices, and it is causal and exact:
 *   - an edge of the master's sync wire reaches a board that has not yet lived through that moment;
 *   - the sensor samples currents that already happened, its converter's few microseconds of look-ahead (board_edge.h)
 *     included;
 *   - a beacon with a sensor of its own (an anchor) samples its own currents as they are, and those of the others as
 *     far as they have happened at the start of its step, from there on as the coil's law has it (sensing.h). So it
 *     does not see a change of another board's bridge, enable or set-point in the quantum before, if it is the sync
 *     master in the two quanta before. Samples at the ends of chips, more than 40 us after any change, are exact;
 *   - the bus arbitrates up to the sensor's present, when every request made before is known. A frame that starts in
 *     the quantum before a present T reaches its receivers at T - quantum + 63 us or later (one bit before the end of
 *     64 bits: the shortest frame with a 29-bit identifier, at 1 Mbit/s), the master is at T + 2 quanta: with 3 quanta
 *     <= 63 us no frame is received in any board's past. rig_create() refuses a bit rate that breaks this rule. The
 *     exception: short frames with 11-bit identifiers (44 to 63 bits; no goldfield board sends any) may be received up
 *     to 17 us in the past of a beacon, which then gets them at its present.
 *
 * All random numbers are functions of seed, board and time (world/noise.h).
 *
 * Board 0 is the sensor, the beacons follow. The caller creates each board with rig_edge(), connects it, and destroys
 * it after the rig. One thread calls the rig. Functions with a board number do not check it.
 */
#ifndef GOLDFIELD_LOCKSTEP_H
#define GOLDFIELD_LOCKSTEP_H

#include "boards/board_edge.h"
#include "rig/can_bus.h"
#include "world/ambient.h"
#include "world/coil.h"
#include "world/front_end.h"
#include "world/path.h"

#define RIG_QUANTUM_PS 20000000 /* 20 us. */
#define RIG_SENSOR     0
#define RIG_COILS      2 /* Most coils of a board: one a channel of its drive. */

typedef struct rig rig_t;

/* One board's analog side. */
typedef struct {
    unsigned coils; /* 0..RIG_COILS; coil i hangs on channel i. Coils of one board are crossed and do not couple. */
    coil_config_t coil[RIG_COILS];
    bool senses; /* It has a front end on its field converters. */
    front_end_config_t front_end;
} rig_board_config_t;

typedef struct {
    uint64_t seed;
    unsigned beacons;
    unsigned sync_master;         /* Board number, 1..beacons. */
    unsigned threads;             /* 1.. */
    uint32_t can_bits_per_second; /* 1,000,000 or less. */
    uint32_t baud;                /* Of bytes sent to the boards. */
    bool host_on_can; /* The host's adapter is on the bus: it acknowledges, and its frames are kept for rig_can_read().
                       */
    ambient_t ambient;
    const rig_board_config_t *boards; /* beacons + 1: the sensor's, then the beacons'. */
} rig_config_t;

/* NULL if the configuration breaks a rule above or there is no memory. */
rig_t *rig_create(const rig_config_t *config);
void rig_destroy(rig_t *rig);

/* The edge to create a board with, and its power-on time: from then on it is on the CAN bus. */
const board_edge_t *rig_edge(rig_t *rig, unsigned board);
void rig_connect(rig_t *rig, unsigned board, board_t *instance, const board_operations_t *operations,
                 int64_t power_on_ps);

/* The path of a board's sensor from now on; coefficients are copied. Columns must be 3 * coils + 9 (all boards'
 * coils, in order of board and channel). False if they are not, or the board has no sensor. */
bool rig_set_path(rig_t *rig, unsigned board, const path_t *path);

typedef enum {
    RIG_OK = 0,
    RIG_BOARD_STOPPED = 1, /* rig_stopped_board() says which; ask its report. */
    RIG_DRIVER_TOO_FAST =
        2 /* A board changed its coil driver's inputs more than COIL_CHANGES_MAX times in one quantum. */
} rig_status_t;

/* Run all quanta that end at or before until_ps. All boards must be connected and the paths of all sensors set. */
rig_status_t rig_run(rig_t *rig, int64_t until_ps);
int64_t rig_now(const rig_t *rig); /* The sensor's present. */
unsigned rig_stopped_board(const rig_t *rig);

/* ---- Serial ---- */
size_t rig_serial_read(rig_t *rig, unsigned board, uint8_t *bytes, size_t capacity);
void rig_serial_write(rig_t *rig, unsigned board, const uint8_t *bytes, size_t count);

/* ---- CAN ---- */
/* Take the oldest transfer that the host's adapter saw. False if there is none. The node of the host is beacons + 1. */
bool rig_can_read(rig_t *rig, can_transfer_t *transfer);
/* The host's adapter wants to send. False if it is not on the bus. */
bool rig_can_write(rig_t *rig, const board_frame_t *frame);
void rig_can_statistics(const rig_t *rig, can_statistics_t *statistics);

/* ---- What an observer of the bench sees ---- */
/* Rising edges of the sync wire since the start, at or before the present; returns how many there are, copies from
 * number first on. */
size_t rig_sync_edges(const rig_t *rig, size_t first, int64_t *times_ps, size_t capacity);

typedef struct {
    int64_t time_ps;
    uint16_t board;
    uint8_t pin;
    bool level;
} rig_pin_change_t;

/* Keep the changes of every board's bridge inputs, enable and sync output from now on, and take them (board by board
 * in order of time). */
void rig_watch_pins(rig_t *rig, bool watch);
size_t rig_pin_changes(rig_t *rig, unsigned board, rig_pin_change_t *changes, size_t capacity);

double rig_coil_current(const rig_t *rig, unsigned board,
                        unsigned coil); /* At the present, ampere; the coil must be there. */
/* The field at a board's sensor at the present, in its frame, before the front end; the board must have one. */
void rig_sensor_field(const rig_t *rig, unsigned board, double field_T[3]);

/* ---- Faults, from the present on ---- */
typedef enum {
    RIG_FAULT_DRIVER = 0,        /* The driver pulls its fault output low (one for both channels). */
    RIG_FAULT_COIL_OPEN = 1,     /* The coil's wire is broken. */
    RIG_FAULT_SENSE_SHORTED = 2, /* The coil's current sense output lies at 0 V. */
    RIG_FAULT_SYNC_WIRE_CUT = 3  /* The board's sync input stays low. */
} rig_fault_t;
/* coil, which must be there, counts for the faults of a coil alone. */
void rig_fault(rig_t *rig, unsigned board, unsigned coil, rig_fault_t fault, bool active);

#endif
