#include "beacon.h"

#include <string.h>

#include "goldfield.h"
#include "sync.h"

/* ---- Drive ---- */

static void drive_stop(beacon_t *beacon) {
    beacon->drive = BEACON_IDLE; /* First: from here on the current interrupt keeps its hands off. */
    hal_drive_enable(beacon->hal, false);
    current_stop(&beacon->current);
}

static bool faulty(const beacon_t *beacon) {
    return beacon->no_waveform || beacon->driver_fault || beacon->current.state == CURRENT_FAULT;
}

/* ---- Interrupts ---- */

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
    uint8_t mask = beacon->drive == BEACON_IDLE ? HAL_PLAN_SYNC_OUT : 0xFFu;
    uint32_t driven = 0;
    for (uint32_t i = 0; i < HAL_BLOCK_CHIPS; i++) {
        const chip_clock_chip_t chip = chip_clock_plan(&beacon->clock);
        if (chip.code_chip == 0) {
            beacon->cycles++;
            beacon->sync_blocks = !beacon->master ? 0u : i == 0u ? 1u : 2u; /* plan for a block is called when the block before it begins. */
            beacon->sync_cycle = sync_cycle(&beacon->format, &chip);
            if (allowed && beacon->drive == BEACON_IDLE) {
                beacon->start_chip = block * HAL_BLOCK_CHIPS + i;
                beacon->drive = BEACON_ARMED;
                mask = 0xFFu;
            }
        }
        plan->period_ticks[i] = chip.period_ticks;
        plan->drive[i] = beacon->chips[chip.code_chip] & mask;
        driven |= (uint32_t)((plan->drive[i] & (HAL_DRIVE_POSITIVE | HAL_DRIVE_NEGATIVE)) != 0u) << i;
    }
    beacon->driven[block & 1u] = driven;
}

static void on_current(void *context, uint32_t chip, uint16_t count) {
    beacon_t *beacon = context;
    if (beacon->drive == BEACON_ON) {
        const uint32_t block = chip / HAL_BLOCK_CHIPS;
        if ((beacon->driven[block & 1u] >> (chip - block * HAL_BLOCK_CHIPS) & 1u) == 0) {
            return;
        }
        const current_action_t action = current_sample(&beacon->current, count);
        if (action == CURRENT_SET_REFERENCE) {
            hal_drive_reference(beacon->hal, beacon->current.reference);
        } else if (action == CURRENT_DRIVE_OFF) {
            hal_drive_enable(beacon->hal, false);
            beacon->drive = BEACON_IDLE;
            beacon->over_current += beacon->current.fault == CURRENT_FAULT_OVER;
            beacon->open_coil += beacon->current.fault == CURRENT_FAULT_OPEN;
        }
    } else if (beacon->drive == BEACON_ARMED && (int32_t)(chip + 1 - beacon->start_chip) >= 0) {
        current_start(&beacon->current);
        hal_drive_reference(beacon->hal, beacon->current.reference);
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

static beacon_settings_t read_settings(const node_t *node) {
    return (beacon_settings_t){
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
}

static bool same(const beacon_settings_t *a, const beacon_settings_t *b) {
    const waveform_config_t *const v = &a->waveform, *const w = &b->waveform;
    const bool waveform = v->kind == w->kind && v->code == w->code && v->slots == w->slots && v->slot == w->slot && v->periods == w->periods;
    return waveform && a->amplitude_A == b->amplitude_A && a->over_current_A == b->over_current_A &&
           a->open_fraction == b->open_fraction;
}

/* While wanted is false and the drive idle: the planner then uses only the sync bit of chips, which is the same before and after. */
static void write_waveform(beacon_t *beacon) {
    waveform_t waveform;
    beacon->no_waveform = !waveform_start(&waveform, beacon->format.degree, &beacon->settings.waveform);
    for (uint32_t t = 0; t < beacon->clock.config.chips; t++) {
        const int8_t level = beacon->no_waveform ? 0 : waveform_next(&waveform);
        const uint8_t polarity = level > 0 ? HAL_DRIVE_POSITIVE : level < 0 ? HAL_DRIVE_NEGATIVE : HAL_DRIVE_OFF;
        beacon->chips[t] = t == 0 && beacon->master ? polarity | HAL_PLAN_SYNC_OUT : polarity;
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
    const bool configured = current_configure(&beacon->current, &config);
    hal_drive_reference(beacon->hal, 0);
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
    return !beacon->wanted || beacon->current.state == CURRENT_HOLDING ? NODE_RUNNING : NODE_SOFT_START;
}

static int16_t milliamperes(float amperes) {
    return (int16_t)node_clamp((int32_t)(amperes * 1000.0f + (amperes < 0.0f ? -0.5f : 0.5f)), INT16_MAX);
}

static void send_status(beacon_t *beacon) {
    const current_t *current = &beacon->current;
    const bool on = beacon->drive == BEACON_ON;
    const struct goldfield_drive_status_t status = {
        .current = milliamperes(on ? current_amperes(current, current->mean) : 0.0f),
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
    node_send(&beacon->node, NODE_BOTH, GOLDFIELD_DRIVE_STATUS_FRAME_ID, 0, data, length);
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
        send_status(beacon);
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
