/* drive_report.h: tells a host how a drive fares: DRIVE_STATUS once a sync period, DRIVE_HEALTH with each heartbeat, of
 * each channel that is driven; index is the channel. Both come at once, too, when the bridges go on or off, the clock
 * finds or loses its lock, or the cause for which the drive is off or its headroom changes.
 *
 * A board's DRIVE_STATUS comes in the block of the period that its number tells (spread.h), counted in the chips of the
 * code: so those of all beacons do not hold up what their sensors send.
 *
 * DRIVE_STATUS. While the bridges are off current and reference are 0 A.
 *   target                   is the amplitude parameter: the current at level 1, the peak of the waveform (superposed
 *                            codes reach it where all agree).
 *   current                  is that peak as it is measured (current.h: the lines of all chips, at the set-point), not
 * a mean of magnitudes. reference                is the set-point of level 1. over_current, open_coil  are the
 * channel's own faults. driver_fault, enabled    are common to both channels.
 *
 * DRIVE_HEALTH.cause is that of cause.h, for the channel that it is of; what concerns the board is told of both.
 */
#ifndef GOLDFIELD_DRIVE_REPORT_H
#define GOLDFIELD_DRIVE_REPORT_H

#include "services/drive.h"

/* Send what is due, in one turn of the main loop. */
void drive_report(drive_t *drive);

#endif
