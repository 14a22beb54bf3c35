#include "beacon.h"

#include <string.h>

#include "goldfield.h"
#include "sync.h"

/* ---- Drive ---- */

static void drive_stop(beacon_t *beacon) {
    beacon->drive = BEACON_IDLE; /* First: from here on the current interrupt keeps its hands off. */
    hal_drive_enable(beacon->hal, false);
    for (uint32_t channel = 0; channel < HAL_CHANNELS; channel++) {
        current_stop(&beacon->current[channel]);
    }
}

/* Of one of the driven channels at least; the state of all of them. */
static bool any(const beacon_t *beacon, current_state_t state) {
    return beacon->current[0].state == state || (beacon->channels == 2u && beacon->current[1].state == state);
}

static bool all(const beacon_t *beacon, current_state_t state) {
    return beacon->current[0].state == state && (beacon->channels == 1u || beacon->current[1].state == state);
}

static bool faulty(const beacon_t *beacon) {
    return beacon->no_waveform || beacon->driver_fault || any(beacon, CURRENT_FAULT);
}

/* ---- Interrupts ---- */

/* One channel of a block, from chip first on: bridge, set-point, and what the measurement must know. Level 0 is not driven. */
static void plan_channel(beacon_t *beacon, hal_plan_t *plan, uint32_t block, uint32_t channel, uint32_t first, const uint16_t positions[HAL_BLOCK_CHIPS]) {
    const uint32_t reference = beacon->current[channel].reference;
    const int16_t *const levels = beacon->levels[channel];
    int16_t *const asked = beacon->blocks[block & 1u].asked[channel];
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
    beacon->blocks[block & 1u].driven[channel] = driven;
}

static void on_plan(void *context, uint32_t block, hal_plan_t *plan) {
    beacon_t *beacon = context;
    sync_link_serve(&beacon->link, &beacon->clock, &beacon->format, beacon->hal);
    if (beacon->sync_blocks > 0u) {
        beacon->sync_blocks--;
        beacon->sync_due |= beacon->sync_blocks == 0u;
    }
    const bool allowed = beacon->wanted && beacon->clock.locked && !faulty(beacon);
    if (!allowed && beacon->drive != BEACON_IDLE) {
        drive_stop(beacon);
    }
    uint32_t first = beacon->drive == BEACON_IDLE ? HAL_BLOCK_CHIPS : 0u; /* Chip from which on the block is driven. */
    uint16_t positions[HAL_BLOCK_CHIPS];
    for (uint32_t i = 0; i < HAL_BLOCK_CHIPS; i++) {
        const chip_clock_chip_t chip = chip_clock_plan(&beacon->clock);
        positions[i] = chip.code_chip;
        plan->period_ticks[i] = chip.period_ticks;
        plan->drive[i] = beacon->master && chip.code_chip == 0 ? HAL_PLAN_SYNC_OUT : 0u;
        if (chip.code_chip == 0) {
            beacon->cycles++;
            beacon->sync_blocks = !beacon->master ? 0u : i == 0u ? 1u : 2u; /* plan for a block is called when the block before it begins. */
            beacon->sync_cycle = sync_cycle(&beacon->format, &chip);
            if (allowed && beacon->drive == BEACON_IDLE) {
                beacon->start_chip = block * HAL_BLOCK_CHIPS + i;
                beacon->drive = BEACON_ARMED;
                first = i;
            }
        }
    }
    memset(plan->set_point, 0, sizeof plan->set_point);
    memset(beacon->blocks[block & 1u].driven, 0, sizeof beacon->blocks[0].driven);
    for (uint32_t channel = 0; channel < beacon->channels; channel++) {
        plan_channel(beacon, plan, block, channel, first, positions);
    }
}

static void trip(beacon_t *beacon, const current_t *current) {
    hal_drive_enable(beacon->hal, false);
    beacon->drive = BEACON_IDLE;
    beacon->over_current += current->fault == CURRENT_FAULT_OVER;
    beacon->open_coil += current->fault == CURRENT_FAULT_OPEN;
}

static void on_current(void *context, uint32_t chip, const uint16_t count[HAL_CHANNELS]) {
    beacon_t *beacon = context;
    if (beacon->drive == BEACON_ON) {
        const uint32_t block = chip / HAL_BLOCK_CHIPS, i = chip - block * HAL_BLOCK_CHIPS;
        const beacon_block_t *const planned = &beacon->blocks[block & 1u];
        for (uint32_t channel = 0; channel < beacon->channels; channel++) {
            const bool driven = (planned->driven[channel] >> i & 1u) != 0u;
            if (driven && !current_sample(&beacon->current[channel], planned->asked[channel][i], count[channel])) {
                trip(beacon, &beacon->current[channel]);
                return;
            }
        }
    } else if (beacon->drive == BEACON_ARMED && (int32_t)(chip + 1 - beacon->start_chip) >= 0 && !faulty(beacon)) {
        for (uint32_t channel = 0; channel < beacon->channels; channel++) {
            current_start(&beacon->current[channel]);
        }
        hal_drive_enable(beacon->hal, true);
        beacon->drive = BEACON_ON;
    }
}

static void on_fault(void *context) {
    beacon_t *beacon = context;
    hal_drive_enable(beacon->hal, false);
    beacon->drive = BEACON_IDLE;
    beacon->driver_fault = true;
}

static void on_sync(void *context, uint32_t chip, uint16_t ticks) {
    beacon_t *beacon = context;
    if (beacon->link.follows) {
        chip_clock_compare(&beacon->clock, chip, ticks);
    } else {
        chip_clock_edge(&beacon->clock, chip, ticks);
    }
    beacon->edge_us = (uint32_t)hal_microseconds(beacon->hal);
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

static beacon_settings_t read_settings(const node_t *node) {
    beacon_settings_t settings = {
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
    for (uint32_t place = 0; place < PARAMETER_CODES_LENGTH; place++) {
        settings.waveform.codes[place] = read_code(node, place);
    }
    return settings;
}

_Static_assert(sizeof(waveform_config_t) == (5u + 4u * WAVEFORM_CODES) * sizeof(uint32_t), "words without gaps: equal if their bytes are");
_Static_assert(WAVEFORM_CHANNELS == HAL_CHANNELS && WAVEFORM_CODES == PARAMETER_CODES_LENGTH, "one and the same");

static bool same(const beacon_settings_t *a, const beacon_settings_t *b) {
    return memcmp(&a->waveform, &b->waveform, sizeof a->waveform) == 0 && a->amplitude_A == b->amplitude_A &&
           a->over_current_A == b->over_current_A && a->open_fraction == b->open_fraction;
}

/* While wanted is false and the drive idle: the planner then looks at no level. */
static void write_waveform(beacon_t *beacon) {
    waveform_t waveform;
    beacon->no_waveform = !waveform_start(&waveform, beacon->format.degree, &beacon->settings.waveform);
    beacon->channels = waveform_channels(beacon->settings.waveform.kind);
    if (beacon->no_waveform) {
        return;
    }
    for (uint32_t t = 0; t < beacon->clock.config.chips; t++) {
        int16_t level[WAVEFORM_CHANNELS];
        waveform_next(&waveform, level);
        beacon->levels[0][t] = level[0];
        beacon->levels[1][t] = level[1];
    }
}

static void apply_settings(beacon_t *beacon) {
    beacon->wanted = false;
    drive_stop(beacon);
    beacon->settings = read_settings(&beacon->node);
    write_waveform(beacon);
    const current_config_t config = {
        .sense_A = HAL_CURRENT_PER_COUNT,
        .reference_A = HAL_REFERENCE_PER_COUNT,
        .amplitude_A = beacon->settings.amplitude_A,
        .over_current_A = beacon->settings.over_current_A,
        .open_fraction = beacon->settings.open_fraction,
    };
    const bool configured = current_configure(&beacon->current[0], &config) && current_configure(&beacon->current[1], &config);
    beacon->driver_fault = false;
    beacon->wanted = configured && !beacon->no_waveform && beacon->settings.amplitude_A > 0.0f && hal_clock(beacon->hal) == HAL_CLOCK_CRYSTAL;
}

static node_state_t state(const beacon_t *beacon) {
    if (hal_clock(beacon->hal) != HAL_CLOCK_CRYSTAL) {
        return NODE_CLOCK_FALLBACK;
    }
    if (faulty(beacon)) {
        return NODE_FAULT;
    }
    if (beacon->cycles == 0) {
        return NODE_STARTING;
    }
    if (!beacon->clock.locked) {
        return NODE_SYNCING;
    }
    return !beacon->wanted || all(beacon, CURRENT_HOLDING) ? NODE_RUNNING : NODE_SOFT_START;
}

static int16_t milliamperes(float amperes) {
    return (int16_t)node_clamp((int32_t)(amperes * 1000.0f + (amperes < 0.0f ? -0.5f : 0.5f)), INT16_MAX);
}

static void send_status(beacon_t *beacon, uint32_t channel) {
    const current_t *current = &beacon->current[channel];
    const bool on = beacon->drive == BEACON_ON;
    const struct goldfield_drive_status_t status = {
        .current = milliamperes(on ? current->measured_A : 0.0f),
        .reference = milliamperes(on ? (float)current->reference * HAL_REFERENCE_PER_COUNT : 0.0f),
        .target = milliamperes(beacon->settings.amplitude_A),
        .over_current = current->fault == CURRENT_FAULT_OVER,
        .open_coil = current->fault == CURRENT_FAULT_OPEN,
        .driver_fault = beacon->driver_fault,
        .enabled = on,
        .locked = beacon->clock.locked,
        .phase = (int16_t)node_clamp(sync_phase(beacon->clock.phase_ticks), 1023),
    };
    uint8_t data[8];
    const uint8_t length = (uint8_t)goldfield_drive_status_pack(data, &status, sizeof data);
    node_send(&beacon->node, NODE_BOTH, GOLDFIELD_DRIVE_STATUS_FRAME_ID, channel, data, length);
}

static void send_sync(beacon_t *beacon) {
    const struct goldfield_sync_t sync = {
        .cycle = beacon->sync_cycle & SYNC_CYCLE_MASK,
        .chips = beacon->format.chips,
        .chip_period = (uint32_t)((uint64_t)HAL_CHIP_TICKS * 1000000000000u / HAL_TICKS_PER_SECOND), /* ps */
    };
    uint8_t data[8];
    const uint8_t length = (uint8_t)goldfield_sync_pack(data, &sync, sizeof data);
    node_send(&beacon->node, NODE_BOTH, GOLDFIELD_SYNC_FRAME_ID, 0, data, length);
}

void beacon_start(beacon_t *beacon, hal_t *hal) {
    memset(beacon, 0, sizeof *beacon);
    beacon->hal = hal;
    node_start(&beacon->node, hal, HAL_ROLE_BEACON);
    beacon->master = parameters_unsigned(&beacon->node.parameters, PARAMETER_SYNC_MASTER) == 1;
    beacon->format = sync_format(parameters_unsigned(&beacon->node.parameters, PARAMETER_DEGREE));
    sync_clock_init(&beacon->clock, &beacon->format, !beacon->master);
    if (parameters_unsigned(&beacon->node.parameters, PARAMETER_SYNC_SOURCE) == SYNC_BY_CAN && !beacon->master) {
        sync_link_follow(&beacon->link, &beacon->clock, true);
    }
    apply_settings(beacon);
    const hal_events_t events = {
        .context = beacon,
        .plan = on_plan,
        .current = on_current,
        .fault = on_fault,
        .sync = on_sync,
    };
    hal_chips_start(hal, HAL_ROLE_BEACON, &events);
}

void beacon_step(beacon_t *beacon) {
    node_t *node = &beacon->node;
    if (beacon->sync_due) {
        beacon->sync_due = false;
        send_sync(beacon);
    }
    sync_link_answer(&beacon->link, node);
    if (beacon->cycles_reported != beacon->cycles) {
        beacon->cycles_reported = beacon->cycles;
        for (uint32_t channel = 0; channel < beacon->channels; channel++) {
            send_status(beacon, channel);
        }
    }
    node->state = state(beacon);
    node->counters[NODE_SYNC_REJECTED] = beacon->clock.edges_rejected;
    node->counters[NODE_OVER_CURRENT] = beacon->over_current;
    node->counters[NODE_OPEN_COIL] = beacon->open_coil;
    node_step(node);
    if (node->parameters_changed) {
        node->parameters_changed = false;
        const beacon_settings_t settings = read_settings(node);
        if (!same(&settings, &beacon->settings) || faulty(beacon)) {
            apply_settings(beacon);
        }
    }
    if (node->sync_received) {
        node->sync_received = false;
        const uint32_t age_us = (uint32_t)hal_microseconds(beacon->hal) - beacon->edge_us;
        node->counters[NODE_OTHER_DEGREE] += !sync_number(&beacon->clock, &beacon->format, &beacon->link, node->sync_chips, node->sync_cycle, age_us);
    }
}
