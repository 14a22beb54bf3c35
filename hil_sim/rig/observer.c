/* observer.c: what lockstep.h offers to whoever stands beside the bench: links, looks, faults. */
#include <string.h>

#include "rig/lockstep_internal.h"

size_t rig_serial_read(rig_t *rig, unsigned board, uint8_t *bytes, size_t capacity) {
    return serial_line_read(&rig->slot[board].serial, bytes, capacity);
}

void rig_serial_write(rig_t *rig, unsigned board, const uint8_t *bytes, size_t count) {
    board_slot_t *const slot = &rig->slot[board];
    serial_line_write(&slot->serial, bytes, count, rig_now(rig) + slot->lead_ps);
    rig->written[board] = rig->written[board] || count > 0;
}

bool rig_can_read(rig_t *rig, can_transfer_t *transfer) {
    if (rig->transfer_count == 0) {
        return false;
    }
    *transfer = rig->transfers[rig->transfer_first++];
    if (--rig->transfer_count == 0) {
        rig->transfer_first = 0;
    }
    return true;
}

bool rig_can_write(rig_t *rig, const board_frame_t *frame) {
    if (rig->config.host_on_can) {
        can_bus_request(rig->bus, rig->slots, 0, frame, rig_now(rig));
    }
    return rig->config.host_on_can;
}

void rig_can_errors(rig_t *rig, double probability, uint64_t seed) {
    can_bus_errors(rig->bus, probability, seed);
}

void rig_can_corrupt(rig_t *rig, unsigned frames) {
    can_bus_corrupt(rig->bus, frames);
}

void rig_can_delay(rig_t *rig, int64_t delay_ps) {
    can_bus_delay(rig->bus, delay_ps);
}

void rig_can_statistics(const rig_t *rig, can_statistics_t *statistics) {
    can_bus_statistics(rig->bus, statistics);
}

size_t rig_sync_edges(const rig_t *rig, size_t first, int64_t *times_ps, size_t capacity) {
    size_t count = rig->edge_count;
    while (count > 0 && rig->edges_ps[count - 1] > rig_now(rig)) {
        --count; /* The master is ahead. */
    }
    for (size_t i = first; i < count && i - first < capacity; ++i) {
        times_ps[i - first] = rig->edges_ps[i];
    }
    return count;
}

void rig_watch_pins(rig_t *rig, bool watch) {
    for (unsigned board = 0; board < rig->slots; ++board) {
        rig->slot[board].watch = watch;
    }
}

size_t rig_pin_changes(rig_t *rig, unsigned board, rig_pin_change_t *changes, size_t capacity) {
    board_slot_t *const slot = &rig->slot[board];
    const size_t waiting = slot->change_count - slot->change_first;
    const size_t count = waiting < capacity ? waiting : capacity;
    if (count > 0) {
        memcpy(changes, slot->changes + slot->change_first, count * sizeof *changes);
        slot->change_first += count;
    }
    if (slot->change_first == slot->change_count) {
        slot->change_first = slot->change_count = 0;
    }
    return count;
}

double rig_coil_current(const rig_t *rig, unsigned board, unsigned coil) {
    return coil_current(&rig->slot[board].coil[coil], rig_now(rig));
}

void rig_sensor_field(const rig_t *rig, unsigned board, double field_T[3]) {
    sensing_field(&rig->slot[board].sensing, rig_now(rig), field_T);
}

double rig_coil_temperature(const rig_t *rig, unsigned board, unsigned coil) {
    return coil_temperature(&rig->slot[board].coil[coil], rig_now(rig));
}

void rig_sensor_fault(rig_t *rig, unsigned board, unsigned axis, front_end_fault_t fault, double value) {
    front_end_break(&rig->slot[board].sensing.front_end, axis, fault, value);
}

void rig_ambient(rig_t *rig, const ambient_t *ambient) {
    const uint64_t seed = rig->config.ambient.seed;
    const double lag_s = rig->config.ambient.lag_s;
    rig->config.ambient = *ambient;
    rig->config.ambient.seed = seed;
    rig->config.ambient.lag_s = lag_s;
}

void rig_supply(rig_t *rig, unsigned board, double volts) {
    board_slot_t *const slot = &rig->slot[board];
    for (unsigned i = 0; i < slot->coils; ++i) {
        coil_supply(&slot->coil[i], volts, rig_now(rig) + slot->lead_ps);
    }
}

void rig_fault(rig_t *rig, unsigned board, unsigned coil, rig_fault_t fault, bool active) {
    static const coil_fault_t of_coil[] = {
        [RIG_FAULT_COIL_OPEN] = COIL_OPEN,
        [RIG_FAULT_SENSE_SHORTED] = COIL_SENSE_LOW,
        [RIG_FAULT_COIL_SHORTED] = COIL_SHORTED,
        [RIG_FAULT_DRIVER_RUNAWAY] = COIL_RUNAWAY,
        [RIG_FAULT_DRIVER_STUCK] = COIL_STUCK_ON,
        [RIG_FAULT_SENSE_HELD] = COIL_SENSE_HELD,
        [RIG_FAULT_BRIDGE_SWAPPED] = COIL_BRIDGE_SWAPPED,
        [RIG_FAULT_COIL_REVERSED] = COIL_REVERSED,
    };
    board_slot_t *const slot = &rig->slot[board];
    const int64_t time_ps = rig_now(rig) + slot->lead_ps;
    switch (fault) {
    case RIG_FAULT_DRIVER:
        board_slot_driver_fault(slot, active, time_ps);
        break;
    case RIG_FAULT_SYNC_WIRE_CUT:
        slot->sync_cut = active;
        slot->operations->pin_in(slot->instance, BOARD_PIN_SYNC_IN, false, time_ps);
        break;
    case RIG_FAULT_CAN_CUT:
        slot->can_cut = active;
        can_bus_join(rig->bus, board, active ? INT64_MAX : rig_now(rig));
        break;
    case RIG_FAULT_PULL_DOWNS_LOST:
        board_slot_lose_pull_downs(slot, active, time_ps);
        break;
    case RIG_FAULT_COIL_HOT:
        slot->coil_hot[coil] = active;
        break;
    case RIG_FAULT_DRIVER_HOT:
        slot->driver_hot = active;
        break;
    default:
        coil_fault(&slot->coil[coil], of_coil[fault], active, time_ps);
        break;
    }
}
