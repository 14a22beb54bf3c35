/* drive_looks.h: inside the drive: what is measured of coils and driver, and what of it switches the drive off.
 *
 * The interrupts drive_edge, drive_middle, drive_current and drive_fault of drive.h are in this file; drive.c uses the
 * functions below.
 */
#ifndef GOLDFIELD_DRIVE_LOOKS_H
#define GOLDFIELD_DRIVE_LOOKS_H

#include "services/drive.h"

/* Returns whether the drive must stay off: for a cause that is latched, or since its waveform does not exist. */
static inline bool drive_faulty(const drive_t *drive) {
    return drive->no_waveform || !latch_open(&drive->latch);
}

/* Returns what is wrong with fault input, supply or temperatures now, and with which channel, or DRIVE_COMMON. */
cause_t drive_standing(const drive_t *drive, uint32_t *channel);

#endif
