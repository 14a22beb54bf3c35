#include "apps/beacon.h"

#include <string.h>

#include "services/drive_report.h"
#include "services/upkeep.h"

/* ---- Interrupts ---- */

static void on_plan(void *context, uint32_t block, hal_plan_t *plan) {
    beacon_t *beacon = context;
    drive_plan(&beacon->drive, block, plan);
    liveness_moved(&beacon->node.liveness, LIVENESS_BLOCKS);
}

static void on_current(void *context, uint32_t chip, const uint16_t count[HAL_CHANNELS]) {
    beacon_t *beacon = context;
    drive_current(&beacon->drive, chip, count);
    liveness_moved(&beacon->node.liveness, LIVENESS_CURRENTS);
}

static void on_edge(void *context, uint32_t chip, const uint16_t count[HAL_CHANNELS]) {
    beacon_t *beacon = context;
    drive_edge(&beacon->drive, chip, count);
}

static void on_middle(void *context, uint32_t chip, const uint16_t count[HAL_CHANNELS]) {
    beacon_t *beacon = context;
    drive_middle(&beacon->drive, chip, count);
}

static void on_fault(void *context, hal_fault_t fault) {
    beacon_t *beacon = context;
    drive_fault(&beacon->drive, fault);
}

static void on_sync(void *context, uint32_t chip, uint16_t ticks) {
    beacon_t *beacon = context;
    timing_edge(&beacon->timing, beacon->hal, chip, ticks);
}

/* ---- Main ---- */

void beacon_start(beacon_t *beacon, hal_t *hal) {
    memset(beacon, 0, sizeof *beacon);
    beacon->hal = hal;
    upkeep_start(&beacon->node, hal, HAL_ROLE_BEACON);
    timing_start(&beacon->timing, &beacon->node, true);
    drive_start(&beacon->drive, &beacon->node, &beacon->timing);
    const hal_events_t events = {
        .context = beacon,
        .plan = on_plan,
        .current = on_current,
        .edge = on_edge,
        .middle = on_middle,
        .fault = on_fault,
        .sync = on_sync,
    };
    hal_chips_start(hal, HAL_ROLE_BEACON, &events);
}

void beacon_step(beacon_t *beacon) {
    node_t *node = &beacon->node;
    drive_step(&beacon->drive);
    drive_report(&beacon->drive);
    node->state = drive_state(&beacon->drive);
    upkeep_step(node);
    if (node->parameters_changed) {
        node->parameters_changed = false;
        drive_configure(&beacon->drive);
    }
    timing_step(&beacon->timing, node);
}
