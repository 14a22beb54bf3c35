/* drive_looks.h: the part of the drive (drive.h, which tells in which order all is called) that looks at what is
 * measured of coils and driver, and switches the drive off for it.
 */
#ifndef GOLDFIELD_DRIVE_LOOKS_H
#define GOLDFIELD_DRIVE_LOOKS_H

#include "services/drive_state.h"

/* The interrupts that hal_events_t has as current, edge, middle and fault. */
void drive_current(drive_t *drive, uint32_t chip, const uint16_t count[HAL_CHANNELS]);
void drive_edge(drive_t *drive, uint32_t chip, const uint16_t count[HAL_CHANNELS]);
void drive_middle(drive_t *drive, uint32_t chip, const uint16_t count[HAL_CHANNELS]);
void drive_fault(drive_t *drive, hal_fault_t fault);

/* For drive.c. Returns whether the drive must stay off: for a cause that is latched, or since its waveform does not
 * exist. */
static inline bool drive_faulty(const drive_t *drive) {
    return drive->no_waveform || !latch_open(&drive->latch);
}

/* For drive.c. Returns what is wrong with fault input, supply or temperatures now, and with which channel, or
 * DRIVE_COMMON. */
cause_t drive_standing(const drive_t *drive, uint32_t *channel);

#endif
