#include "services/drive_looks.h"

#define SET_POINT_COUNTS 2     /* Counts of a set-point that are as much as one of the sense (hal.h). */
#define MONITORED_BLOCK  4u    /* With the plan of this block the boards' first measurements are there (hal.h). */
#define THERMISTOR_OPEN  4000u /* More counts than a thermistor at -40 degC gives: it is not connected. */

/* ---- What ends the drive ---- */

/* Switches the drive off, and latches why; the first cause stays. */
static void trip(drive_t *drive, cause_t cause, uint32_t channel) {
    hal_drive_enable(drive->node->hal, false);
    drive->phase = DRIVE_IDLE;
    if (drive->latch.cause == CAUSE_NONE) {
        drive->channel = (uint8_t)channel;
        drive->over_current += cause == CAUSE_OVER_CURRENT;
        drive->open_coil += cause == CAUSE_OPEN_COIL;
    }
    latch_set(&drive->latch, cause);
}

static bool hot(uint16_t count, uint16_t limit) {
    return limit > 0u && (count < limit || count > THERMISTOR_OPEN);
}

cause_t drive_standing(const drive_t *drive, uint32_t *channel) {
    hal_monitor_t monitor;
    hal_monitor(drive->node->hal, &monitor);
    *channel = DRIVE_COMMON;
    if (hal_drive_fault(drive->node->hal)) {
        return CAUSE_DRIVER;
    }
    if (drive->planned < MONITORED_BLOCK || drive->settings.amplitude_A == 0.0f) {
        return CAUSE_NONE; /* Nothing is measured yet, or there may be nothing to measure. */
    }
    for (uint32_t c = 0; c < drive->channels; c++) {
        if (hot(monitor.coil[c], drive->limits.coil_hot)) {
            *channel = c;
            return CAUSE_COIL_HOT;
        }
    }
    return hot(monitor.driver, drive->limits.driver_hot) ? CAUSE_DRIVER_HOT
           : monitor.supply < drive->limits.supply_low   ? CAUSE_SUPPLY_LOW
           : monitor.supply > drive->limits.supply_high  ? CAUSE_SUPPLY_HIGH
                                                         : CAUSE_NONE;
}

/* ---- Interrupts ---- */

/* The bridges go on with the first driven chip. */
static void switch_on(drive_t *drive) {
    for (uint32_t channel = 0; channel < drive->channels; channel++) {
        current_start(&drive->current[channel]);
    }
    if (!hal_drive_enable(drive->node->hal, true)) {
        trip(drive, CAUSE_DRIVER, DRIVE_COMMON); /* The input was active before anybody looked. */
        return;
    }
    drive->phase = DRIVE_ON;
    latch_on(&drive->latch, true);
}

void drive_edge(drive_t *drive, uint32_t chip, const uint16_t count[HAL_CHANNELS]) {
    const uint32_t block = chip / HAL_BLOCK_CHIPS, i = chip - block * HAL_BLOCK_CHIPS;
    const drive_block_t *const planned = &drive->blocks[block & 1u];
    const bool on = drive->phase == DRIVE_ON;
    hal_monitor_t monitor;
    hal_monitor(drive->node->hal, &monitor);
    for (uint32_t channel = 0; channel < drive->channels; channel++) {
        const int16_t asked = on ? planned->asked[channel][i] : 0; /* It is 0 where the chip is not driven. */
        cause_t cause = current_edge(&drive->current[channel], asked, count[channel]);
        if (on && cause == CAUSE_NONE) {
            const fall_edge_t edge = {
                .before = (int32_t)drive->start[channel] - CURRENT_MID_SCALE,
                .wanted = asked / SET_POINT_COUNTS,
                .came = (int32_t)count[channel] - CURRENT_MID_SCALE,
                .supply = monitor.supply,
            };
            cause = fall_edge(&drive->fall[channel], &edge);
        }
        drive->start[channel] = count[channel];
        if (cause != CAUSE_NONE) {
            trip(drive, cause, channel);
        }
    }
}

/* Looks at what is measured beside the currents. */
static void look_beside(drive_t *drive) {
    uint32_t channel;
    const cause_t cause = drive_standing(drive, &channel);
    if (cause != CAUSE_NONE) {
        trip(drive, cause, channel);
    }
}

void drive_middle(drive_t *drive, uint32_t chip, const uint16_t count[HAL_CHANNELS]) {
    const uint32_t block = chip / HAL_BLOCK_CHIPS, i = chip - block * HAL_BLOCK_CHIPS;
    const drive_block_t *const planned = &drive->blocks[block & 1u];
    const bool on = drive->phase == DRIVE_ON;
    for (uint32_t channel = 0; channel < drive->channels; channel++) {
        const int16_t asked = on ? planned->asked[channel][i] : 0; /* It is 0 where the chip is not driven. */
        const cause_t cause = current_middle(&drive->current[channel], asked, drive->start[channel], count[channel]);
        if (cause != CAUSE_NONE) {
            trip(drive, cause, channel);
        }
    }
    look_beside(drive);
}

void drive_current(drive_t *drive, uint32_t chip, const uint16_t count[HAL_CHANNELS]) {
    const uint32_t block = chip / HAL_BLOCK_CHIPS, i = chip - block * HAL_BLOCK_CHIPS;
    const drive_block_t *const planned = &drive->blocks[block & 1u];
    const bool on = drive->phase == DRIVE_ON;
    for (uint32_t channel = 0; channel < drive->channels; channel++) {
        const bool driven = on && (planned->driven[channel] >> i & 1u) != 0u;
        const int16_t asked = driven ? planned->asked[channel][i] : 0;
        drive->start[channel] = count[channel];
        const cause_t cause = current_sample(&drive->current[channel], driven, asked, count[channel]);
        if (cause != CAUSE_NONE) {
            trip(drive, cause, channel);
        }
    }
    look_beside(drive);
    if (drive->phase == DRIVE_ARMED && (int32_t)(chip + 1 - drive->start_chip) >= 0 && !drive_faulty(drive)) {
        switch_on(drive);
    }
}

void drive_fault(drive_t *drive, hal_fault_t fault) {
    static const uint8_t causes[] = {
        [HAL_FAULT_DRIVER] = CAUSE_DRIVER,
        [HAL_FAULT_STALE] = CAUSE_STALE,
        [HAL_FAULT_CLOCK] = CAUSE_CLOCK,
        [HAL_FAULT_SUPPLY] = CAUSE_SUPPLY_LOW, /* COUNTER tells that it is the processor's. */
    };
    trip(drive, (cause_t)causes[fault], DRIVE_COMMON);
}
