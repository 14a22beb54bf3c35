/* lockstep.h: the rig: boards, coils, field, sync wire, CAN and serial lines in one virtual time.
 *
 * Time runs in quanta of RIG_QUANTUM_PS, counted from 0, whatever slices the caller asks for: rig_run() executes the
 * quanta that end by then. In one step all boards run at the same time, in up to as many threads as asked for (fewer
 * while that is faster), each through one quantum of its own:
 *
 *     the sync master two quanta ahead of the sensor, the other beacons one quantum ahead, the sensor at the rig's
 *       present.
 *
 * A step has more quanta than one where the boards tell what they do next (board_edge.h) and nothing that they do can
 * reach another before its end: as long as a frame is on the bus, and no longer than a shortest frame after the first
 * moment at which a board may ask for one. Those that may drive the sync wire then go first, the sensor last. Beacons
 * that are not on the bus run further still, up to the sync wire's next edge: each of them goes through many chips
 * while it is in the processor's cache. What happens is the same, whatever the number of quanta; only if a board stops
 * have the others gone on.
 *
 * Nothing passes between boards inside a step; between steps, in a fixed order, the wires are served. So the result
 * depends neither on threads nor on slices, and it is causal and exact:
 *   - an edge of the master's sync wire reaches a board that has not yet lived through that moment. So does one of a
 *     deputy that takes over: with its first SYNC, which comes before its first edge, it goes ahead, and the master
 *     before, dead or not, falls back. Of a board that begins a time of its own the first edge comes before its SYNC:
 *     it goes ahead with that edge, which others that may lead hear up to a quantum late, and so do two boards that
 *     drive the wire at once;
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
 * Order of calls: rig_create(); for each board, create it with rig_edge() and hand it over with rig_connect();
 * rig_set_path() for each sensor; then rig_run() again and again, and between two runs the links, looks and faults;
 * rig_destroy(), and only then the boards. Board 0 is the sensor, the beacons follow. One thread calls the rig.
 * Functions with a board number do not check it.
 */
#ifndef GOLDFIELD_LOCKSTEP_H
#define GOLDFIELD_LOCKSTEP_H

#include "boards/board_edge.h"
#include "rig/can_bus.h"
#include "rig/rig_board.h"
#include "world/ambient.h"
#include "world/path.h"

#define RIG_QUANTUM_PS 20000000 /* 20 us: see the bus's rule above. */
#define RIG_SENSOR     0        /* The sensor's board number. */

typedef struct rig rig_t;

typedef struct {
    uint64_t seed;
    unsigned beacons;
    unsigned sync_master;         /* Board number, 1..beacons. */
    unsigned threads;             /* Most threads of a step, 1 or more. */
    uint32_t can_bits_per_second; /* 1,000,000 or less. */
    uint32_t baud;                /* Bit rate of bytes sent to the boards. */
    /* The host's adapter is on the bus: it acknowledges, and its frames are kept for rig_can_read(). */
    bool host_on_can;
    ambient_t ambient;
    const rig_board_config_t *boards; /* beacons + 1: the sensor's, then the beacons'. Copied. */
} rig_config_t;

typedef enum {
    RIG_OK = 0,
    RIG_BOARD_STOPPED = 1,  /* rig_stopped_board() says which; its report says why. */
    RIG_DRIVER_TOO_FAST = 2 /* A board changed its driver's inputs more than COIL_CHANGES_MAX times in one quantum. */
} rig_status_t;

typedef enum {
    RIG_FAULT_DRIVER = 0,        /* The driver pulls its fault output low (one for both channels). */
    RIG_FAULT_COIL_OPEN = 1,     /* The coil's wire is broken. */
    RIG_FAULT_SENSE_SHORTED = 2, /* The coil's current sense output lies at 0 V. */
    RIG_FAULT_SYNC_WIRE_CUT = 3, /* The board's sync input stays low. */
    RIG_FAULT_COIL_SHORTED = 4,  /* Turns of the coil are shorted (coil_config_t.shorted_fraction). */
    RIG_FAULT_DRIVER_RUNAWAY = 5,
    RIG_FAULT_DRIVER_STUCK = 6, /* A half of the bridge is shorted: full supply, whatever inputs and enable say. */
    RIG_FAULT_SENSE_HELD = 7,   /* The coil's current sense output stays where it is. */
    RIG_FAULT_COIL_HOT = 8,     /* The coil's thermistor is at 200 degC. */
    RIG_FAULT_DRIVER_HOT = 9,   /* The driver's is. */
    /* The pull-downs at the board's enable and sync output are not connected: released, these pins float. */
    RIG_FAULT_PULL_DOWNS_LOST = 10,
    RIG_FAULT_CAN_CUT = 11,        /* The board is not on the CAN bus: what it asks of it waits. */
    RIG_FAULT_BRIDGE_SWAPPED = 12, /* The bridge's inputs are exchanged. */
    RIG_FAULT_COIL_REVERSED = 13   /* The coil's wires are exchanged, behind the current sense. */
} rig_fault_t;

/* A rig without boards. Returns NULL if the configuration breaks a rule above or there is no memory. */
rig_t *rig_create(const rig_config_t *config);
void rig_destroy(rig_t *rig); /* rig may be NULL. */

/* The edge to create a board with. */
const board_edge_t *rig_edge(rig_t *rig, unsigned board);

/* Hand a board over; it is on the CAN bus from its power-on time on, in picoseconds. If it takes the place of another,
 * which has lost its power, the outputs of that one float now. */
void rig_connect(rig_t *rig, unsigned board, board_t *instance, const board_operations_t *operations,
                 int64_t power_on_ps);

/* The path of a board's sensor from now on; coefficients are copied. Columns must be 3 * coils + 12 (all boards'
 * coils, in order of board and channel). Returns false if they are not, or the board has no sensor. */
bool rig_set_path(rig_t *rig, unsigned board, const path_t *path);

/* Run all quanta that end at or before until_ps. All boards must be connected and the paths of all sensors set. */
rig_status_t rig_run(rig_t *rig, int64_t until_ps);

/* Returns the sensor's present, picoseconds. */
int64_t rig_now(const rig_t *rig);

/* Returns the board that ended the last run, if it did not end well. */
unsigned rig_stopped_board(const rig_t *rig);

/* ---- Links, between two runs ---- */

/* Take bytes that a board has sent, at most capacity. Returns how many. */
size_t rig_serial_read(rig_t *rig, unsigned board, uint8_t *bytes, size_t capacity);
/* Send bytes to a board, from its present on. */
void rig_serial_write(rig_t *rig, unsigned board, const uint8_t *bytes, size_t count);

/* Take the oldest transfer that the host's adapter saw; the host is node beacons + 1. Returns false if there is none.
 */
bool rig_can_read(rig_t *rig, can_transfer_t *transfer);
/* The host's adapter asks to send. Returns false if it is not on the bus. */
bool rig_can_write(rig_t *rig, const board_frame_t *frame);
/* The bus, and the host's adapter, have another bit rate from now on. Returns false, with nothing done, for one that
 * breaks the rule above. */
bool rig_can_rate(rig_t *rig, uint32_t bits_per_second);
/* Bit errors and delay of the bus from now on: see can_bus.h. */
void rig_can_errors(rig_t *rig, double probability, uint64_t seed);
void rig_can_corrupt(rig_t *rig, unsigned frames);
void rig_can_delay(rig_t *rig, int64_t delay_ps);
void rig_can_statistics(const rig_t *rig, can_statistics_t *statistics);

/* ---- What an observer of the bench sees, between two runs ---- */

/* Copy the times of the sync wire's rising edges from number first on, at most capacity. Returns how many there were
 * since the start, at or before the present. */
size_t rig_sync_edges(const rig_t *rig, size_t first, int64_t *times_ps, size_t capacity);

/* Keep the changes of every board's bridge inputs, enable and sync output from now on, or stop keeping them. */
void rig_watch_pins(rig_t *rig, bool watch);
/* Take a board's oldest kept changes, in order of time, at most capacity. Returns how many. */
size_t rig_pin_changes(rig_t *rig, unsigned board, rig_pin_change_t *changes, size_t capacity);

/* Returns a coil's current at the present, ampere; the coil must be there. */
double rig_coil_current(const rig_t *rig, unsigned board, unsigned coil);

/* The field at a board's sensor at the present, in its frame, before the front end; the board must have one. */
void rig_sensor_field(const rig_t *rig, unsigned board, double field_T[3]);

/* ---- Faults, from the board's present on ---- */

/* Make or mend a fault. coil counts for the faults of a coil alone, and must be there then. */
void rig_fault(rig_t *rig, unsigned board, unsigned coil, rig_fault_t fault, bool active);

/* Strike the sync wire: all boards that are on it see it high for width_ps, above 0, from after_ps (0 or more) behind
 * the first moment on that none of them has lived through. */
void rig_glitch(rig_t *rig, int64_t after_ps, int64_t width_ps);

/* Let an axis (0..2) of a board's sensor, which must have one, fail, or be sound again: see front_end.h. */
void rig_sensor_fault(rig_t *rig, unsigned board, unsigned axis, front_end_fault_t fault, double value);

/* Change the fields that are no beacon's and no magnet's, for all sensors. Seed and low-pass stay. */
void rig_ambient(rig_t *rig, const ambient_t *ambient);

/* Change the voltage, without load, of the supply of a board's coils. */
void rig_supply(rig_t *rig, unsigned board, double volts);

/* Returns the temperature of a coil's copper at the present, degC; the coil must be there. */
double rig_coil_temperature(const rig_t *rig, unsigned board, unsigned coil);

#endif
