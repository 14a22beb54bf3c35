/* drive.h: the part of an application that drives one coil, or two crossed coils, with a waveform in step with the
 * board's chip clock. It also does the sync master's duties. A waveform (waveform.h) is a Gold code, several at once,
 * a pulse in a time slot, a square wave, or a rotating field.
 *
 * Calls, in the order they are made
 *   1. drive_start      main, once, before the chip engine starts.
 *   2. drive_plan       interrupt, once a block: it plans the lengths of the next 31 chips from chip_clock, the bridge
 *                       polarities and set-points from the waveform and the current loops, and a master's sync wire.
 *      drive_current    interrupt, once a chip, driven or not, bridge on or off: it gives each channel to
 *                       current_sample, and looks at supply and temperatures. What is wrong with one channel switches
 *                       both bridges off within that chip.
 *      drive_edge       interrupt, once a chip of a beacon, behind its edge: it gives each channel to current_edge and
 *                       fall_edge.
 *      drive_middle     interrupt, once a chip, amid it: it gives each channel to current_middle, and looks at supply
 *                       and temperatures. So half a chip passes at most until something wrong is seen.
 *      drive_fault      interrupt: the board has switched the bridges off by itself.
 *   3. drive_step       main, once a turn: it sends SYNC (and FOLLOW_UP) if the board is master, once a sync period
 *                       (sync.h: a cycle, or about 0.1 s of shorter ones), and clears what it is told to. drive_report
 *                       (drive_report.h) follows it.
 *      drive_state      main, to tell the board's state.
 *      drive_configure  main, when a parameter has changed.
 *
 * Protection. Whatever switches the drive off is one of cause.h, and is latched as latch.h says: no parameter ends it,
 * but the command to clear alone (framing.md), which is refused as long as the fault input is active, the supply is out
 * of its range, something is hot, or the drive is locked out. DRIVE_HEALTH (drive_report.h) tells the cause.
 *
 * States (HEARTBEAT.state)
 *   starting        No cycle has been planned yet.
 *   syncing         The chip clock is not locked; the bridge is off.
 *   soft_start      The clock is locked. When the zero of the current sense is known (25 ms after the start) the bridge
 *                   goes on at the next sync period that is planned (at most a period and two blocks away), and the
 *                   current rises for 0.1 s.
 *   running         The current is at its amplitude. With amplitude 0, or while the board is not armed, and with a
 *                   locked clock the state is running, too, with the bridge off.
 *   fault           The drive was switched off for a cause that is latched, or has yet to wait after it; or the
 *                   waveform does not exist (waveform.h), until a parameter makes one that does.
 *   clock_fallback  The crystal failed: 1 % off frequency nobody could follow, so the bridge stays off for good.
 * Loss of lock switches the bridge off at once and leads to syncing; from there the drive goes on as after a start.
 *
 * A board that is not armed (parameter armed) is for the drive one whose amplitude is 0: nothing is driven, and neither
 * supply nor temperatures are watched, so that boards may be commissioned before their supply is switched on.
 *
 * The master, or the deputy that leads in its place (timing.h; parameter sync_master, read once at start with degree),
 * runs free. The sync wire is high for the first chip of a sync period. SYNC with the cycle's number leaves on both
 * links after that edge, at most two blocks (6.06 ms) later: with degree 10 at the next turn of the main loop, which is
 * much sooner when main is idle. The other beacons take the cycle's number from SYNC. With sync_source 2, read once at
 * start, they follow SYNC and FOLLOW_UP on CAN instead of the wire (sync.h); a wire that is there all the same is then
 * only compared (DRIVE_STATUS.phase).
 *
 * A pulse is driven, and its current measured, only in its slot. The soft start then takes 1023 driven chips, that is
 * as many cycles as there are slots.
 *
 * While node.signing is set the set-points of every other sync period are halved, in that of a degree below 10 as in a
 * cycle of degree 10: a sensor sees a beacon whose field comes and goes. The guards judge each chip by what it asks
 * for, and all of them go on.
 *
 * While node.drive_hold is set (a save is under way) the drive is off from the next block that is planned, within two
 * blocks, and starts softly again behind it.
 *
 * A PARAM_SET, a start or a stop that changes the waveform or one of its numbers, the amplitude, armed or a limit of
 * the protection stops the drive, and starts it softly again unless a cause is latched.
 *
 * Memory: 8.8 kB.
 *
 * Time, as tests/firmware/apps/test_app_instructions.py counts it (Cortex-M4, -O2), for one channel and, in brackets,
 * for a rotating field: drive_plan takes 4,600 (6,500) instructions a block, drive_current 230 (330), once in 31 chips
 * 600 (700), drive_edge 105 (155), and 220 at most, drive_middle 160 (225).
 */
#ifndef GOLDFIELD_DRIVE_H
#define GOLDFIELD_DRIVE_H

#include "services/drive_looks.h"

/* Read the parameters and prepare the waveform; main calls it before the chip engine starts. node and timing have been
 * started, and live for ever. Costs nearly all of what beacon.h gives for beacon_start. */
void drive_start(drive_t *drive, node_t *node, timing_t *timing);

/* The interrupt that hal_events_t has as plan; drive_looks.h declares the others. Nobody else plans chips of this
 * clock.
 */
void drive_plan(drive_t *drive, uint32_t block, hal_plan_t *plan);

/* Send the messages that are due and write the node's counters: one turn of the main loop, before upkeep_step. Where a
 * bit has flipped in what makes the current, or in whether a drive is wanted, the board starts anew and does not return
 * from here. */
void drive_step(drive_t *drive);

/* Returns the board's state as the drive sees it. */
node_state_t drive_state(const drive_t *drive);

/* Read the parameters again. If one of the drive has changed it stops, and starts softly with the new ones. */
void drive_configure(drive_t *drive);

#endif
