#include "services/drive_report.h"

#include "core/drive/thermistor.h"
#include "core/math/roots.h"
#include "goldfield.h"

#define WAIT_MAX_S 31u /* Longest wait that is told. */

static int32_t rounded(float value) {
    return (int32_t)(value + (value < 0.0f ? -0.5f : 0.5f));
}

static int16_t milliamperes(float amperes) {
    return (int16_t)node_clamp(rounded(amperes * 1000.0f), INT16_MAX);
}

/* Returns the cause as it concerns a channel. One of a channel that is not driven, as a bit that flips may have it,
 * concerns all: it is told. */
static cause_t cause_of(const drive_t *drive, uint32_t channel) {
    return drive->channel == channel || drive->channel >= drive->channels ? (cause_t)drive->latch.cause : CAUSE_NONE;
}

static void send_status(drive_t *drive, uint32_t channel) {
    const current_t *current = &drive->current[channel];
    const bool on = drive->phase == DRIVE_ON;
    const cause_t cause = cause_of(drive, channel);
    const struct goldfield_drive_status_t status = {
        .current = milliamperes(on ? current->measured_A : 0.0f),
        .reference = milliamperes(on ? (float)current->reference * HAL_REFERENCE_PER_COUNT : 0.0f),
        .target = milliamperes(drive->settings.amplitude_A),
        .over_current = cause == CAUSE_OVER_CURRENT,
        .open_coil = cause == CAUSE_OPEN_COIL,
        .driver_fault = cause == CAUSE_DRIVER,
        .enabled = on,
        .locked = drive->timing->clock.locked,
        .phase = (int16_t)node_clamp(sync_phase(drive->timing->clock.phase_ticks), 1023),
    };
    uint8_t data[8];
    const uint8_t length = (uint8_t)goldfield_drive_status_pack(data, &status, sizeof data);
    node_send(drive->node, NODE_BOTH, GOLDFIELD_DRIVE_STATUS_FRAME_ID, channel, data, length);
}

static int16_t quarters(uint16_t count) {
    return (int16_t)rounded(thermistor_degC(count) * 4.0f);
}

static void send_health(drive_t *drive, uint32_t channel, uint64_t now_us) {
    const current_t *current = &drive->current[channel];
    const uint32_t wait_s = latch_wait_s(&drive->latch, now_us);
    const float rms_A = square_root(current->guard.heat) * HAL_CURRENT_PER_COUNT;
    const bool on = drive->phase == DRIVE_ON;
    hal_monitor_t monitor;
    hal_monitor(drive->node->hal, &monitor);
    const struct goldfield_drive_health_t health = {
        .cause = (uint8_t)cause_of(drive, channel),
        .locked_out = drive->latch.locked_out,
        .headroom_lost = on && current->headroom_lost,
        .trips = drive->latch.trips,
        .wait = (uint8_t)(wait_s < WAIT_MAX_S ? wait_s : WAIT_MAX_S),
        .supply = monitor.supply,
        .coil_temperature = quarters(monitor.coil[channel]),
        .driver_temperature = quarters(monitor.driver),
        .rms = (uint8_t)node_clamp(rounded(rms_A * 16.0f), UINT8_MAX),
        .direct = (int8_t)node_clamp(rounded(on ? current->dc_A * 1000.0f : 0.0f), INT8_MAX),
    };
    uint8_t data[8];
    const uint8_t length = (uint8_t)goldfield_drive_health_pack(data, &health, sizeof data);
    node_send(drive->node, NODE_BOTH, GOLDFIELD_DRIVE_HEALTH_FRAME_ID, channel, data, length);
}

/* Returns what a host should hear at once when it changes: else it might take a cycle's fields for those of a current
 * that had ended in it. */
static uint8_t urgent(const drive_t *drive) {
    const bool on = drive->phase == DRIVE_ON;
    const bool lost = drive->current[0].headroom_lost || drive->current[1].headroom_lost;
    return (uint8_t)((uint32_t)drive->latch.cause << 3 | (on && lost ? 4u : 0u) | (on ? 2u : 0u) |
                     (drive->timing->clock.locked ? 1u : 0u));
}

void drive_report(drive_t *drive) {
    const uint8_t now = urgent(drive);
    const bool changed = now != drive->urgent_told;
    drive->urgent_told = now;
    if (changed || drive->statuses_told != drive->statuses) {
        drive->statuses_told = drive->statuses;
        for (uint32_t channel = 0; channel < drive->channels; channel++) {
            send_status(drive, channel);
        }
    }
    if (changed || drive->health_us != drive->node->heartbeat_us) {
        drive->health_us = drive->node->heartbeat_us;
        const uint64_t now_us = hal_microseconds(drive->node->hal);
        for (uint32_t channel = 0; channel < drive->channels; channel++) {
            send_health(drive, channel, now_us);
        }
    }
}
