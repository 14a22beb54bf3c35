#include "apps/anchor.h"

#include <string.h>

#include "services/drive_report.h"
#include "services/upkeep.h"

/* ---- Interrupts ---- */

static void on_plan(void *context, uint32_t block, hal_plan_t *plan) {
    anchor_t *anchor = context;
    drive_plan(&anchor->drive, block, plan);
    liveness_moved(&anchor->node.liveness, LIVENESS_BLOCKS);
}

static void on_samples(void *context, uint32_t block, const hal_samples_t *samples) {
    anchor_t *anchor = context;
    sense_samples(&anchor->sense, block, samples, NULL);
    liveness_moved(&anchor->node.liveness, LIVENESS_SAMPLES);
}

static void on_current(void *context, uint32_t chip, const uint16_t count[HAL_CHANNELS]) {
    anchor_t *anchor = context;
    drive_current(&anchor->drive, chip, count);
    liveness_moved(&anchor->node.liveness, LIVENESS_CURRENTS);
}

static void on_middle(void *context, uint32_t chip, const uint16_t count[HAL_CHANNELS]) {
    anchor_t *anchor = context;
    drive_middle(&anchor->drive, chip, count);
}

static void on_fault(void *context, hal_fault_t fault) {
    anchor_t *anchor = context;
    drive_fault(&anchor->drive, fault);
}

static void on_sync(void *context, uint32_t chip, uint16_t ticks) {
    anchor_t *anchor = context;
    timing_edge(&anchor->timing, anchor->hal, chip, ticks);
}

/* ---- Main ---- */

void anchor_start(anchor_t *anchor, onboard_t *onboard, tracking_t *tracking, hal_t *hal) {
    memset(anchor, 0, sizeof *anchor);
    anchor->hal = hal;
    upkeep_start(&anchor->node, hal, HAL_ROLE_ANCHOR);
    timing_start(&anchor->timing, &anchor->node, true);
    drive_start(&anchor->drive, &anchor->node, &anchor->timing);
    sense_start(&anchor->sense, &anchor->node, &anchor->timing, onboard, tracking);
    const hal_events_t events = {
        .context = anchor,
        .plan = on_plan,
        .samples = on_samples,
        .current = on_current,
        .middle = on_middle,
        .fault = on_fault,
        .sync = on_sync,
    };
    hal_chips_start(hal, HAL_ROLE_ANCHOR, &events);
}

void anchor_step(anchor_t *anchor) {
    node_t *node = &anchor->node;
    drive_step(&anchor->drive);
    drive_report(&anchor->drive);
    sense_blocks(&anchor->sense);
    sense_step(&anchor->sense);
    node->state = drive_state(&anchor->drive);
    upkeep_step(node);
    sense_spare(&anchor->sense);
    if (node->parameters_changed) {
        node->parameters_changed = false;
        drive_configure(&anchor->drive);
        sense_configure(&anchor->sense);
    }
    timing_step(&anchor->timing, node);
}
