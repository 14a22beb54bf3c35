/* drive.h: the part of an application that drives: one coil, or two crossed coils, with a waveform (waveform.h: a Gold
 * code, several at once, a pulse in a time slot, a square wave, or a rotating field), in step with the board's chip
 * clock; and the sync master's duties.
 *
 * Which module runs when
 *   plan (once a block): lengths of the next 31 chips from chip_clock, bridge polarities and set-points from the
 *     waveform and the current loops, sync wire if master.
 *   current (once a driven chip): current_sample of each channel; over-current and open coil of one switch both bridges
 *     off within that chip.
 *   fault (drivers' fault input): bridges off.
 *   main: SYNC (and FOLLOW_UP) if master and DRIVE_STATUS, once a sync period (sync.h: a cycle, or about 0.1 s of
 *     shorter ones); parameters.
 *
 * States (HEARTBEAT.state)
 *   starting     until the first cycle is planned.
 *   syncing      the chip clock is not locked: bridge off.
 *   soft_start   locked: the bridge goes on at the next sync period that is planned (at most a period and two blocks
 *                away), the current rises for 0.1 s.
 *   running      at amplitude; also with amplitude 0 and locked, bridge off.
 *   fault        over-current, open coil, driver fault, or a waveform that does not exist (waveform.h): bridge off,
 *                until a parameter of the drive is set by PARAM_SET.
 *   clock_fallback  the crystal failed: 1 % off frequency nobody could follow, bridge off for good.
 * Loss of lock switches the bridge off at once and leads to syncing; from there on as after a start.
 *
 * The master (parameter sync_master) runs free from cycle 0; the sync wire is high for the first chip of a sync period;
 * SYNC with the cycle's number leaves on both links after the edge, at most two blocks (6.06 ms) later; with degree 10
 * at the next turn of the main loop, much less when main is idle. sync_master and degree are read once, at start. The
 * other beacons take the cycle's number from SYNC. With sync_source 2 they follow SYNC and FOLLOW_UP on CAN instead of
 * the wire (sync.h), read once, at start; a wire that is there all the same is then only compared: DRIVE_STATUS.phase.
 *
 * A pulse is driven, and its current measured, only in its slot: the soft start then takes 1023 driven chips, that is
 * as many cycles as there are slots.
 *
 * DRIVE_STATUS: index 0 is channel 0; a rotating field has one of index 1, too. target is the amplitude parameter: the
 * current at level 1, the peak of the waveform (superposed codes reach it where all agree). current is that peak as the
 * loop measures it (current.h: the driver's gain from all chips, times the set-point), not a mean of magnitudes;
 * reference is the set-point of level 1. over_current and open_coil are the channel's own; driver_fault and enabled are
 * common. All 0 A while the bridges are off.
 *
 * A PARAM_SET of any parameter but stream, node and those of a sensor stops the drive, if it changes a value, and
 * starts it softly again.
 *
 * Memory: 8.8 kB. Time: tests/firmware/apps/test_app_instructions.py counts (Cortex-M4, -O2), for one channel and, in
 * brackets, for a rotating field: plan of a block 3,400 (4,400) instructions, current 98 (155), once in 31 chips 205
 * (372).
 */
#ifndef GOLDFIELD_DRIVE_H
#define GOLDFIELD_DRIVE_H

#include "core/drive/current.h"
#include "core/drive/waveform.h"
#include "hal/hal.h"
#include "services/node.h"
#include "services/timing.h"

#define DRIVE_CHIPS_MAX 2047u /* Of a sync period (sync.h). */

/* The current interrupt preempts the others: it alone goes from ARMED to ON; all others only to IDLE, or from IDLE
 * to ARMED. */
typedef enum {
    DRIVE_IDLE = 0,  /* Planned chips are off. */
    DRIVE_ARMED = 1, /* Planned chips carry the waveform from start_chip on; the bridges are still off. */
    DRIVE_ON = 2     /* start_chip has come: the bridges are on. */
} drive_phase_t;

/* What the drive is made from; compared to see whether a PARAM_SET changed it. */
typedef struct {
    waveform_config_t waveform;
    float amplitude_A, over_current_A, open_fraction;
} drive_settings_t;

/* A block as it was planned, for the interrupt that measures it. */
typedef struct {
    uint32_t driven[HAL_CHANNELS];                /* Bit i: chip i is driven. */
    int16_t asked[HAL_CHANNELS][HAL_BLOCK_CHIPS]; /* Counts of set-point, with the bridge's sign. */
} drive_block_t;

/* Private but for tests. */
typedef struct {
    node_t *node;
    timing_t *timing;
    current_t current[HAL_CHANNELS];
    uint32_t channels; /* Driven: 1 or 2. Changes only while the drive is idle, as do levels. */
    drive_settings_t settings;
    int16_t levels[HAL_CHANNELS][DRIVE_CHIPS_MAX]; /* Of each chip of the sync period. */
    volatile bool wanted;                          /* Main: settings are complete, amplitude is not 0, clock is good. */
    bool no_waveform;                              /* The settings make none. */
    drive_block_t blocks[2];                       /* Even and odd ones: one is planned while the other runs. */
    volatile uint8_t phase;                        /* drive_phase_t */
    volatile uint32_t start_chip; /* Absolute chip. Chip 0 has none before it that could switch on: a master then starts
                                     with chip 1. */
    volatile bool driver_fault;
    volatile uint32_t over_current, open_coil; /* Events since reset. */
    volatile uint32_t cycles;                  /* Sync periods begun, as planned. */
    uint32_t cycles_reported;
    volatile uint8_t
        sync_blocks; /* A master's SYNC waits until so many blocks have begun: the sync wire's edge is then past. */
    volatile bool sync_due; /* They have. */
    volatile uint32_t sync_cycle;
} drive_t;

/* Main, before the chip engine starts; node and timing are started, and live for ever. Nearly all of what beacon.h
 * tells. */
void drive_start(drive_t *drive, node_t *node, timing_t *timing);

/* Interrupt: what hal_events_t has plan, current and fault for. Nobody else plans chips of this clock. */
void drive_plan(drive_t *drive, uint32_t block, hal_plan_t *plan);
void drive_current(drive_t *drive, uint32_t chip, const uint16_t count[HAL_CHANNELS]);
void drive_fault(drive_t *drive);

/* One turn of the main loop, before node_step: messages and counters that are due. */
void drive_step(drive_t *drive);

/* Main: what the drive says of the board's state. */
node_state_t drive_state(const drive_t *drive);

/* Main, when a parameter changed. */
void drive_configure(drive_t *drive);

#endif
