#include "services/drive.h"

#include <string.h>

#include "goldfield.h"

static void drive_stop(drive_t *drive) {
    drive->phase = DRIVE_IDLE; /* It comes first: the current interrupt now keeps its hands off. */
    hal_drive_enable(drive->node->hal, false);
    for (uint32_t channel = 0; channel < HAL_CHANNELS; channel++) {
        current_stop(&drive->current[channel]);
    }
}

/* Returns whether one driven channel at least is in a state. */
static bool any(const drive_t *drive, current_state_t state) {
    return drive->current[0].state == state || (drive->channels == 2u && drive->current[1].state == state);
}

/* Returns whether all driven channels are in a state. */
static bool all(const drive_t *drive, current_state_t state) {
    return drive->current[0].state == state && (drive->channels == 1u || drive->current[1].state == state);
}

static bool faulty(const drive_t *drive) {
    return drive->no_waveform || drive->driver_fault || any(drive, CURRENT_FAULT);
}

/* ---- Interrupts ---- */

/* Plans one channel of a block from chip first on: bridge, set-point, and what the measurement must know. Level 0 is
 * not driven. */
static void plan_channel(drive_t *drive, hal_plan_t *plan, uint32_t block, uint32_t channel, uint32_t first,
                         const uint16_t positions[HAL_BLOCK_CHIPS]) {
    const uint32_t reference = drive->current[channel].reference;
    const int16_t *const levels = drive->levels[channel];
    int16_t *const asked = drive->blocks[block & 1u].asked[channel];
    uint32_t driven = 0;
    for (uint32_t i = first; i < HAL_BLOCK_CHIPS; i++) {
        const int32_t level = levels[positions[i]];
        const uint32_t size = (uint32_t)(level < 0 ? -level : level);
        const uint32_t set_point = (size * reference + WAVEFORM_ONE / 2u) / WAVEFORM_ONE;
        const uint32_t bridge = level > 0 ? HAL_DRIVE_POSITIVE : level < 0 ? HAL_DRIVE_NEGATIVE : HAL_DRIVE_OFF;
        plan->set_point[channel][i] = (uint16_t)set_point;
        plan->drive[i] = (uint8_t)(plan->drive[i] | bridge << HAL_DRIVE_BITS * channel);
        asked[i] = (int16_t)(level < 0 ? -(int32_t)set_point : (int32_t)set_point);
        driven |= (uint32_t)(level != 0) << i;
    }
    drive->blocks[block & 1u].driven[channel] = driven;
}

void drive_plan(drive_t *drive, uint32_t block, hal_plan_t *plan) {
    timing_t *const timing = drive->timing;
    timing_serve(timing, drive->node->hal);
    if (drive->sync_blocks > 0u) {
        drive->sync_blocks--;
        drive->sync_due |= drive->sync_blocks == 0u;
    }
    const bool allowed = drive->wanted && timing->clock.locked && !faulty(drive);
    if (!allowed && drive->phase != DRIVE_IDLE) {
        drive_stop(drive);
    }
    uint32_t first = drive->phase == DRIVE_IDLE ? HAL_BLOCK_CHIPS
                                                : 0u; /* The chip from which on the block is driven. */
    uint16_t positions[HAL_BLOCK_CHIPS];
    for (uint32_t i = 0; i < HAL_BLOCK_CHIPS; i++) {
        const chip_clock_chip_t chip = chip_clock_plan(&timing->clock);
        positions[i] = chip.code_chip;
        plan->period_ticks[i] = chip.period_ticks;
        plan->drive[i] = timing->master && chip.code_chip == 0 ? HAL_PLAN_SYNC_OUT : 0u;
        plan->set_point[0][i] = 0; /* It is cleared here, since memset goes byte by byte. */
        plan->set_point[1][i] = 0;
        if (chip.code_chip == 0) {
            drive->cycles++;
            /* The plan for a block is made when the block before it begins. */
            drive->sync_blocks = !timing->master ? 0u : i == 0u ? 1u : 2u;
            drive->sync_cycle = sync_cycle(&timing->format, &chip);
            if (allowed && drive->phase == DRIVE_IDLE) {
                drive->start_chip = block * HAL_BLOCK_CHIPS + i;
                drive->phase = DRIVE_ARMED;
                first = i;
            }
        }
    }
    memset(drive->blocks[block & 1u].driven, 0, sizeof drive->blocks[0].driven);
    for (uint32_t channel = 0; channel < drive->channels; channel++) {
        plan_channel(drive, plan, block, channel, first, positions);
    }
}

static void trip(drive_t *drive, const current_t *current) {
    hal_drive_enable(drive->node->hal, false);
    drive->phase = DRIVE_IDLE;
    drive->over_current += current->fault == CURRENT_FAULT_OVER;
    drive->open_coil += current->fault == CURRENT_FAULT_OPEN;
}

void drive_current(drive_t *drive, uint32_t chip, const uint16_t count[HAL_CHANNELS]) {
    if (drive->phase == DRIVE_ON) {
        const uint32_t block = chip / HAL_BLOCK_CHIPS, i = chip - block * HAL_BLOCK_CHIPS;
        const drive_block_t *const planned = &drive->blocks[block & 1u];
        for (uint32_t channel = 0; channel < drive->channels; channel++) {
            const bool driven = (planned->driven[channel] >> i & 1u) != 0u;
            if (driven && !current_sample(&drive->current[channel], planned->asked[channel][i], count[channel])) {
                trip(drive, &drive->current[channel]);
                return;
            }
        }
    } else if (drive->phase == DRIVE_ARMED && (int32_t)(chip + 1 - drive->start_chip) >= 0 && !faulty(drive)) {
        for (uint32_t channel = 0; channel < drive->channels; channel++) {
            current_start(&drive->current[channel]);
        }
        if (!hal_drive_enable(drive->node->hal, true)) {
            drive_fault(drive); /* The input was active before its edge could tell. */
            return;
        }
        drive->phase = DRIVE_ON;
    }
}

void drive_fault(drive_t *drive) {
    hal_drive_enable(drive->node->hal, false);
    drive->phase = DRIVE_IDLE;
    drive->driver_fault = true;
}

/* ---- Main ---- */

static waveform_code_t read_code(const node_t *node, uint32_t place) {
    const uint32_t id = PARAMETER_CODES + place * PARAMETER_CODES_STRIDE;
    return (waveform_code_t){
        .degree = parameters_unsigned(&node->parameters, id),
        .index = parameters_unsigned(&node->parameters, id + 1u),
        .offset = parameters_unsigned(&node->parameters, id + 2u),
        .hold = parameters_unsigned(&node->parameters, id + 3u),
    };
}

static drive_settings_t read_settings(const node_t *node) {
    drive_settings_t settings = {
        .waveform =
            {
                .kind = parameters_unsigned(&node->parameters, PARAMETER_WAVEFORM),
                .code = parameters_unsigned(&node->parameters, PARAMETER_CODE),
                .slots = parameters_unsigned(&node->parameters, PARAMETER_SLOTS),
                .slot = parameters_unsigned(&node->parameters, PARAMETER_SLOT),
                .periods = parameters_unsigned(&node->parameters, PARAMETER_PERIODS),
            },
        .amplitude_A = parameters_float(&node->parameters, PARAMETER_AMPLITUDE),
        .over_current_A = parameters_float(&node->parameters, PARAMETER_OVER_CURRENT),
        .open_fraction = parameters_float(&node->parameters, PARAMETER_OPEN_COIL),
    };
    for (uint32_t place = 0; place < PARAMETER_CODES_ROWS; place++) {
        settings.waveform.codes[place] = read_code(node, place);
    }
    return settings;
}

_Static_assert(sizeof(waveform_config_t) == (5u + 4u * WAVEFORM_CODES) * sizeof(uint32_t),
               "words without gaps: equal if their bytes are");
_Static_assert(WAVEFORM_CHANNELS == HAL_CHANNELS && WAVEFORM_CODES == PARAMETER_CODES_ROWS, "one and the same");

static bool same(const drive_settings_t *a, const drive_settings_t *b) {
    return memcmp(&a->waveform, &b->waveform, sizeof a->waveform) == 0 && a->amplitude_A == b->amplitude_A &&
           a->over_current_A == b->over_current_A && a->open_fraction == b->open_fraction;
}

/* Writes the levels of all chips, while wanted is false and the drive is idle: the planner then looks at no level. */
static void write_waveform(drive_t *drive) {
    waveform_t waveform;
    drive->no_waveform = !waveform_start(&waveform, drive->timing->format.degree, &drive->settings.waveform);
    drive->channels = waveform_channels(drive->settings.waveform.kind);
    if (drive->no_waveform) {
        return;
    }
    for (uint32_t t = 0; t < drive->timing->clock.config.chips; t++) {
        int16_t level[WAVEFORM_CHANNELS];
        waveform_next(&waveform, level);
        drive->levels[0][t] = level[0];
        drive->levels[1][t] = level[1];
    }
}

static void apply_settings(drive_t *drive) {
    drive->wanted = false;
    drive_stop(drive);
    drive->settings = read_settings(drive->node);
    write_waveform(drive);
    const current_config_t config = {
        .sense_A = HAL_CURRENT_PER_COUNT,
        .reference_A = HAL_REFERENCE_PER_COUNT,
        .amplitude_A = drive->settings.amplitude_A,
        .over_current_A = drive->settings.over_current_A,
        .open_fraction = drive->settings.open_fraction,
    };
    const bool configured = current_configure(&drive->current[0], &config) &&
                            current_configure(&drive->current[1], &config);
    drive->driver_fault = false;
    drive->wanted = configured && !drive->no_waveform && drive->settings.amplitude_A > 0.0f &&
                    hal_clock(drive->node->hal) == HAL_CLOCK_CRYSTAL;
}

node_state_t drive_state(const drive_t *drive) {
    if (hal_clock(drive->node->hal) != HAL_CLOCK_CRYSTAL) {
        return NODE_CLOCK_FALLBACK;
    }
    if (faulty(drive)) {
        return NODE_FAULT;
    }
    if (drive->cycles == 0) {
        return NODE_STARTING;
    }
    if (!drive->timing->clock.locked) {
        return NODE_SYNCING;
    }
    return !drive->wanted || all(drive, CURRENT_HOLDING) ? NODE_RUNNING : NODE_SOFT_START;
}

static int16_t milliamperes(float amperes) {
    return (int16_t)node_clamp((int32_t)(amperes * 1000.0f + (amperes < 0.0f ? -0.5f : 0.5f)), INT16_MAX);
}

static void send_status(drive_t *drive, uint32_t channel) {
    const current_t *current = &drive->current[channel];
    const bool on = drive->phase == DRIVE_ON;
    const struct goldfield_drive_status_t status = {
        .current = milliamperes(on ? current->measured_A : 0.0f),
        .reference = milliamperes(on ? (float)current->reference * HAL_REFERENCE_PER_COUNT : 0.0f),
        .target = milliamperes(drive->settings.amplitude_A),
        .over_current = current->fault == CURRENT_FAULT_OVER,
        .open_coil = current->fault == CURRENT_FAULT_OPEN,
        .driver_fault = drive->driver_fault,
        .enabled = on,
        .locked = drive->timing->clock.locked,
        .phase = (int16_t)node_clamp(sync_phase(drive->timing->clock.phase_ticks), 1023),
    };
    uint8_t data[8];
    const uint8_t length = (uint8_t)goldfield_drive_status_pack(data, &status, sizeof data);
    node_send(drive->node, NODE_BOTH, GOLDFIELD_DRIVE_STATUS_FRAME_ID, channel, data, length);
}

static void send_sync(drive_t *drive) {
    const struct goldfield_sync_t sync = {
        .cycle = drive->sync_cycle & SYNC_CYCLE_MASK,
        .chips = drive->timing->format.chips,
        .chip_period = (uint32_t)((uint64_t)HAL_CHIP_TICKS * 1000000000000u / HAL_TICKS_PER_SECOND), /* In ps. */
    };
    uint8_t data[8];
    const uint8_t length = (uint8_t)goldfield_sync_pack(data, &sync, sizeof data);
    node_send(drive->node, NODE_BOTH, GOLDFIELD_SYNC_FRAME_ID, 0, data, length);
}

void drive_start(drive_t *drive, node_t *node, timing_t *timing) {
    memset(drive, 0, sizeof *drive);
    drive->node = node;
    drive->timing = timing;
    apply_settings(drive);
}

void drive_configure(drive_t *drive) {
    const drive_settings_t settings = read_settings(drive->node);
    if (!same(&settings, &drive->settings) || faulty(drive)) {
        apply_settings(drive);
    }
}

void drive_step(drive_t *drive) {
    node_t *const node = drive->node;
    if (drive->sync_due) {
        drive->sync_due = false;
        send_sync(drive);
    }
    sync_link_answer(&drive->timing->link, node);
    if (drive->cycles_reported != drive->cycles) {
        drive->cycles_reported = drive->cycles;
        for (uint32_t channel = 0; channel < drive->channels; channel++) {
            send_status(drive, channel);
        }
    }
    node->counters[COUNTER_OVER_CURRENT] = drive->over_current;
    node->counters[COUNTER_OPEN_COIL] = drive->open_coil;
}
