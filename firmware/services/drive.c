#include "services/drive.h"

#include <string.h>

#include "core/drive/thermistor.h"
#include "core/link/spread.h"
#include "goldfield.h"

static void drive_stop(drive_t *drive) {
    drive->phase = DRIVE_IDLE; /* It comes first: the current interrupt now keeps its hands off. */
    hal_drive_enable(drive->node->hal, false);
    for (uint32_t channel = 0; channel < HAL_CHANNELS; channel++) {
        current_stop(&drive->current[channel]);
    }
}

/* Returns whether all driven channels are in a state. */
static bool all(const drive_t *drive, current_state_t state) {
    return drive->current[0].state == state && (drive->channels == 1u || drive->current[1].state == state);
}

/* Returns whether the zero of each driven channel's sense is known. */
static bool ready(const drive_t *drive) {
    return current_ready(&drive->current[0]) && (drive->channels == 1u || current_ready(&drive->current[1]));
}

/* ---- Interrupts ---- */

/* Plans one channel of a block from chip first on: bridge, set-point, and what the measurement must know. Level 0 is
 * not driven. */
static void plan_channel(drive_t *drive, hal_plan_t *plan, uint32_t block, uint32_t channel, uint32_t first,
                         const uint16_t positions[HAL_BLOCK_CHIPS]) {
    current_t *const current = &drive->current[channel];
    const int16_t *const levels = drive->levels[channel];
    int16_t *const asked = drive->blocks[block & 1u].asked[channel];
    uint32_t driven = 0;
    for (uint32_t i = 0; i < HAL_BLOCK_CHIPS; i++) {
        const int32_t level = i < first ? 0 : levels[positions[i]];
        const int16_t set_point = current_set_point(current, level);
        const int32_t along = set_point != 0 ? set_point : level;
        const uint32_t bridge = along > 0 ? HAL_DRIVE_POSITIVE : along < 0 ? HAL_DRIVE_NEGATIVE : HAL_DRIVE_OFF;
        plan->set_point[channel][i] = (uint16_t)(set_point < 0 ? -set_point : set_point);
        plan->drive[i] = (uint8_t)(plan->drive[i] | bridge << HAL_DRIVE_BITS * channel);
        asked[i] = set_point;
        driven |= (level != 0 ? 1u : 0u) << i;
    }
    drive->blocks[block & 1u].driven[channel] = driven;
}

/* A sync period begins with a chip of the block: the signature goes on to its other half. */
static void turn_signature(drive_t *drive, uint32_t chip) {
    if (drive->halve_to != 0u) {
        drive->halve_to = (uint8_t)chip;
    } else {
        drive->halve_from = (uint8_t)chip;
        drive->halve_to = HAL_BLOCK_CHIPS;
    }
}

/* Halves the set-points of the chips of a planned block that the signature wants so, and goes on to the next block. */
static void halve(drive_t *drive, hal_plan_t *plan, uint32_t block) {
    for (uint32_t channel = 0; channel < drive->channels; channel++) {
        int16_t *const asked = drive->blocks[block & 1u].asked[channel];
        for (uint32_t i = drive->halve_from; i < drive->halve_to; i++) {
            asked[i] = (int16_t)(asked[i] / 2);
            plan->set_point[channel][i] = (uint16_t)(asked[i] < 0 ? -asked[i] : asked[i]);
        }
    }
    drive->halve_from = 0;
    drive->halve_to = drive->halve_to == HAL_BLOCK_CHIPS ? HAL_BLOCK_CHIPS : 0u;
}

/* Returns whether a block that begins with this chip of the sync period is the one in which the board tells its status.
 * Each period has exactly one, whatever its blocks begin with, as a place is as long as a block. */
static bool own_place(const drive_t *drive, uint32_t chip) {
    const uint32_t places = drive->timing->clock.config.chips / HAL_BLOCK_CHIPS;
    return chip / HAL_BLOCK_CHIPS == spread_place(drive->node->id, places);
}

void drive_plan(drive_t *drive, uint32_t block, hal_plan_t *plan) {
    timing_t *const timing = drive->timing;
    timing_serve(timing, drive->node->hal, block);
    drive->planned = block;
    if (drive->sync_blocks > 0u) {
        drive->sync_blocks--;
        drive->sync_due |= drive->sync_blocks == 0u;
    }
    const bool allowed = drive->wanted && !drive->node->drive_hold && timing->clock.locked && !drive_faulty(drive) &&
                         ready(drive);
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
            if (drive->node->signing || drive->halve_to != 0u) {
                turn_signature(drive, i);
            }
            /* The plan for a block is made when the block before it begins. */
            drive->sync_blocks = !timing->master ? 0u : i == 0u ? 1u : 2u;
            drive->sync_cycle = sync_cycle(&timing->format, &chip);
            timing->announce = false;
            if (allowed && drive->phase == DRIVE_IDLE) {
                drive->start_chip = block * HAL_BLOCK_CHIPS + i;
                drive->phase = DRIVE_ARMED;
                first = i;
            }
        }
    }
    drive->sync_due |= timing->announce;
    timing->announce = false;
    drive->statuses += own_place(drive, positions[0]) ? 1u : 0u;
    for (uint32_t channel = 0; channel < drive->channels; channel++) {
        plan_channel(drive, plan, block, channel, first, positions);
    }
    if (drive->halve_to != 0u) {
        halve(drive, plan, block);
    }
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
    const bool armed = parameters_unsigned(&node->parameters, PARAMETER_ARMED) != 0u;
    drive_settings_t settings = {
        .waveform =
            {
                .kind = parameters_unsigned(&node->parameters, PARAMETER_WAVEFORM),
                .code = parameters_unsigned(&node->parameters, PARAMETER_CODE),
                .slots = parameters_unsigned(&node->parameters, PARAMETER_SLOTS),
                .slot = parameters_unsigned(&node->parameters, PARAMETER_SLOT),
                .periods = parameters_unsigned(&node->parameters, PARAMETER_PERIODS),
            },
        .amplitude_A = armed ? parameters_float(&node->parameters, PARAMETER_AMPLITUDE) : 0.0f,
        .over_current_A = parameters_float(&node->parameters, PARAMETER_OVER_CURRENT),
        .open_fraction = parameters_float(&node->parameters, PARAMETER_OPEN_COIL),
        .rms_A = parameters_float(&node->parameters, PARAMETER_RMS_CURRENT),
        .rms_s = parameters_float(&node->parameters, PARAMETER_RMS_TIME),
        .supply_low_V = parameters_float(&node->parameters, PARAMETER_SUPPLY_LOW),
        .supply_high_V = parameters_float(&node->parameters, PARAMETER_SUPPLY_HIGH),
        .coil_hot_degC = parameters_float(&node->parameters, PARAMETER_COIL_HOT),
        .driver_hot_degC = parameters_float(&node->parameters, PARAMETER_DRIVER_HOT),
    };
    for (uint32_t place = 0; place < PARAMETER_CODES_ROWS; place++) {
        settings.waveform.codes[place] = read_code(node, place);
    }
    return settings;
}

_Static_assert(sizeof(waveform_config_t) == (5u + 4u * WAVEFORM_CODES) * sizeof(uint32_t),
               "words without gaps: equal if their bytes are");

static bool same(const drive_settings_t *a, const drive_settings_t *b) {
    return memcmp(&a->waveform, &b->waveform, sizeof a->waveform) == 0 && a->amplitude_A == b->amplitude_A &&
           a->over_current_A == b->over_current_A && a->open_fraction == b->open_fraction && a->rms_A == b->rms_A &&
           a->rms_s == b->rms_s && a->supply_low_V == b->supply_low_V && a->supply_high_V == b->supply_high_V &&
           a->coil_hot_degC == b->coil_hot_degC && a->driver_hot_degC == b->driver_hot_degC;
}

_Static_assert(WAVEFORM_CHANNELS == HAL_CHANNELS && WAVEFORM_CODES == PARAMETER_CODES_ROWS, "one and the same");
_Static_assert(WAVEFORM_ONE == CURRENT_ONE, "levels are handed on as they are");

/* Writes the levels of all chips, while wanted is false and the drive is idle: the planner then looks at no level. */
static void write_waveform(drive_t *drive) {
    waveform_t waveform;
    drive->no_waveform = !waveform_start(&waveform, drive->timing->format.degree, &drive->settings.waveform);
    drive->channels = waveform_channels(drive->settings.waveform.kind);
    if (drive->no_waveform) {
        return;
    }
    int16_t one_size = 0;
    drive->several_levels = false;
    for (uint32_t t = 0; t < drive->timing->clock.config.chips; t++) {
        int16_t level[WAVEFORM_CHANNELS];
        waveform_next(&waveform, level);
        drive->levels[0][t] = level[0];
        drive->levels[1][t] = level[1];
        const int16_t size = (int16_t)(level[0] < 0 ? -level[0] : level[0]);
        drive->several_levels |= size != 0 && one_size != 0 && size != one_size;
        one_size = size != 0 ? size : one_size;
    }
}

static uint16_t supply_count(float volts) {
    const float count = volts / HAL_SUPPLY_PER_COUNT;
    return (uint16_t)(count < (float)HAL_SAMPLE_MAX ? count : (float)HAL_SAMPLE_MAX);
}

static drive_limits_t limits_of(const drive_settings_t *settings) {
    return (drive_limits_t){
        .supply_low = supply_count(settings->supply_low_V),
        .supply_high = supply_count(settings->supply_high_V),
        .coil_hot = settings->coil_hot_degC > 0.0f ? thermistor_count(settings->coil_hot_degC) : (uint16_t)0u,
        .driver_hot = settings->driver_hot_degC > 0.0f ? thermistor_count(settings->driver_hot_degC) : (uint16_t)0u,
    };
}

static void set_wanted(drive_t *drive, bool wanted) {
    drive->wanted = drive->meant = wanted;
}

/* Whether no bit has flipped in what changes the current, or ends it, and is noticed by nothing else. */
static bool intact(const drive_t *drive) {
    return drive->wanted == drive->meant && current_alike(&drive->current[0], &drive->current[1]);
}

static void apply_settings(drive_t *drive) {
    set_wanted(drive, false);
    drive_stop(drive);
    drive->settings = read_settings(drive->node);
    drive->limits = limits_of(&drive->settings);
    write_waveform(drive);
    const current_config_t config = {
        .sense_A = HAL_CURRENT_PER_COUNT,
        .reference_A = HAL_REFERENCE_PER_COUNT,
        .amplitude_A = drive->settings.amplitude_A,
        .open_fraction = drive->settings.open_fraction,
        .several_levels = drive->several_levels,
        .guard =
            {
                .over_current_A = drive->settings.over_current_A,
                .rms_A = drive->settings.rms_A,
                .rms_chips = drive->settings.rms_s * ((float)HAL_TICKS_PER_SECOND / (float)HAL_CHIP_TICKS),
            },
    };
    const bool configured = current_configure(&drive->current[0], &config) &&
                            current_configure(&drive->current[1], &config);
    set_wanted(drive, configured && !drive->no_waveform && drive->settings.amplitude_A > 0.0f &&
                          hal_clock(drive->node->hal) == HAL_CLOCK_CRYSTAL);
}

/* Somebody asks to clear what is latched: node.h has seen to it that it is not in vain. A current that is in a fault
 * tells its cause at every look: it is configured anew before the latch forgets it. */
static void clear(drive_t *drive) {
    apply_settings(drive);
    (void)latch_clear(&drive->latch, hal_microseconds(drive->node->hal));
}

node_state_t drive_state(const drive_t *drive) {
    if (hal_clock(drive->node->hal) != HAL_CLOCK_CRYSTAL) {
        return NODE_CLOCK_FALLBACK;
    }
    if (drive_faulty(drive)) {
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

static void send_sync(drive_t *drive) {
    const struct goldfield_sync_t sync = {
        .cycle = drive->sync_cycle & SYNC_CYCLE_MASK,
        .chips = drive->timing->format.chips,
        .rank = (uint8_t)drive->timing->election.rank,
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
    drive->health_us = node->heartbeat_us; /* The first one comes with the next. */
    drive->channel = DRIVE_COMMON;
    const bool watchdog = hal_last_reset(node->hal)->cause == HAL_RESET_WATCHDOG;
    latch_start(&drive->latch, hal_retained(node->hal), watchdog, hal_microseconds(node->hal));
    apply_settings(drive);
}

void drive_configure(drive_t *drive) {
    const drive_settings_t settings = read_settings(drive->node);
    if (!same(&settings, &drive->settings)) {
        apply_settings(drive);
    }
}

void drive_step(drive_t *drive) {
    node_t *const node = drive->node;
    if (!intact(drive)) {
        hal_reset(node->hal); /* Nobody has set what is in force: the board starts anew, and tells that. */
    }
    if (drive->phase != DRIVE_ON) {
        latch_on(&drive->latch, false);
    }
    latch_step(&drive->latch, hal_microseconds(node->hal));
    if (node->clear_wanted) {
        node->clear_wanted = false;
        clear(drive);
    }
    node->drive_on = drive->phase != DRIVE_IDLE;
    uint32_t channel;
    node->clear_refused = drive->latch.locked_out || drive_standing(drive, &channel) != CAUSE_NONE;
    if (drive->sync_due) {
        drive->sync_due = false;
        send_sync(drive);
    }
    sync_link_answer(&drive->timing->link, node);
    node->counters[COUNTER_OVER_CURRENT] = drive->over_current;
    node->counters[COUNTER_OPEN_COIL] = drive->open_coil;
}
