/* host_hal.c: the functions of hal.h on a host board. */
#include "boards/host/host_internal.h"

#include <string.h>

/* ---- What the files above need as well ---- */

int64_t host_tick(const hal_t *hal) {
    return hal->now_ps == hal->tick_ps ? hal->tick : host_tick_at(hal, hal->now_ps);
}

void host_go_to(hal_t *hal, int64_t tick) {
    const int64_t time_ps = host_time(hal, tick);
    if (time_ps >= hal->now_ps) {
        hal->now_ps = hal->tick_ps = time_ps;
        hal->tick = tick;
    } else if (hal->tick_ps != hal->now_ps) {
        hal->tick = host_tick(hal);
        hal->tick_ps = hal->now_ps;
    }
}

void host_pin_write(hal_t *hal, unsigned pin, bool level) {
    const uint64_t bit = UINT64_C(1) << pin;
    if (hal->pin_out[pin] != level || (hal->pins_driven & bit) == 0) {
        hal->pin_out[pin] = level;
        hal->pins_driven |= bit;
        if (hal->edge.pin_out && !hal->dead) {
            hal->edge.pin_out(hal->edge.context, pin, level, hal->now_ps);
        }
    }
}

void host_bridges_write(hal_t *hal) {
    static const unsigned bridges[HAL_CHANNELS] = {PIN_BRIDGE_0, PIN_BRIDGE_1};
    enum { TOLD = 1u << 2 * HAL_DRIVE_BITS, INPUTS = TOLD - 1u };
    engine_t *engine = &hal->engine;
    const bool on = engine->running && hal->pin_out[PIN_ENABLE];
    const uint32_t drive = on ? engine->plan[engine->block & 1].drive[engine->chip_in_block] & (uint32_t)INPUTS : 0u;
    if (engine->bridges == (drive | (uint32_t)TOLD)) {
        return;
    }
    engine->bridges = drive | (uint32_t)TOLD;
    for (unsigned channel = 0; channel < HAL_CHANNELS; channel++) {
        const uint32_t bridge = drive >> HAL_DRIVE_BITS * channel & 3u;
        host_pin_write(hal, bridges[channel], bridge == HAL_DRIVE_POSITIVE);
        host_pin_write(hal, bridges[channel] + 1, bridge == HAL_DRIVE_NEGATIVE);
    }
}

/* ---- Chip engine and drive ---- */

void hal_chips_start(hal_t *hal, hal_role_t role, const hal_events_t *events) {
    if (hal->config.clock == HAL_CLOCK_SLOW) {
        return;
    }
    engine_t *engine = &hal->engine;
    *engine = (engine_t){.running = true,
                         .role = role,
                         .events = *events,
                         .chip_start = host_tick(hal) + 168,
                         .next_tick = host_tick(hal) + 168,
                         .set_point = {UINT16_MAX, UINT16_MAX}};
    events->plan(events->context, 0, &engine->plan[0]);
    events->plan(events->context, 1, &engine->plan[1]);
    if (!hal->fault_level && events->fault) {
        events->fault(events->context, HAL_FAULT_DRIVER); /* It was active before the start. */
    }
    host_pin_write(hal, PIN_LED, true);
}

bool hal_drive_fault(const hal_t *hal) {
    return !hal->fault_level;
}

bool hal_drive_enable(hal_t *hal, bool enable) {
    const bool on = enable && !hal_drive_fault(hal);
    if (on && !hal->pin_out[PIN_ENABLE]) {
        hal->engine.unmeasured = 0;
    }
    host_pin_write(hal, PIN_ENABLE, on);
    host_bridges_write(hal);
    return on == enable;
}

void hal_monitor(const hal_t *hal, hal_monitor_t *monitor) {
    *monitor = hal->engine.monitor;
}

/* ---- Serial ---- */

void hal_links_start(hal_t *hal, uint32_t can_bit_s, uint32_t serial_baud) {
    hal->can_bit_s = can_bit_s;
    hal->serial_baud = serial_baud;
    hal->transmitter.byte_ticks = (10 * (int64_t)HAL_TICKS_PER_SECOND + serial_baud / 2u) / serial_baud;
}

bool hal_serial_write(hal_t *hal, const uint8_t *bytes, size_t count) {
    transmitter_t *transmitter = &hal->transmitter;
    if (transmitter->count + count > hal_serial_room(hal->serial_baud)) {
        return false;
    }
    if (transmitter->count == 0) {
        transmitter->byte_end = host_tick(hal) + transmitter->byte_ticks;
    }
    for (size_t i = 0; i < count; i++) {
        transmitter->bytes[(transmitter->head + transmitter->count++) % HAL_SERIAL_BUFFER] = bytes[i];
    }
    return true;
}

uint32_t hal_serial_waiting(const hal_t *hal) {
    return hal->transmitter.count;
}

void hal_serial_write_polled(hal_t *hal, const uint8_t *bytes, size_t count) {
    /* No instruction takes time here, so the bytes leave after the call: at the same moments as on the chip. */
    (void)hal_serial_write(hal, bytes, count);
}

size_t hal_serial_read(hal_t *hal, uint8_t *bytes, size_t capacity) {
    size_t count = 0;
    while (count < capacity && hal->received_count > 0) {
        bytes[count++] = hal->received[hal->received_head];
        hal->received_head = (hal->received_head + 1) % RECEIVE_BYTES;
        hal->received_count--;
    }
    return count;
}

/* ---- CAN ---- */

void host_can_request(hal_t *hal) {
    const bool understood = hal->can_bit_s == hal->bus_bit_s; /* Else the frame fails for ever. */
    if (hal->edge.can_request && hal->mailbox_count > 0 && understood && !hal->dead) {
        const hal_frame_t *frame = &hal->mailbox[hal->mailbox_head];
        board_frame_t out = {.id = frame->id, .extended = true, .length = frame->length};
        memcpy(out.data, frame->data, sizeof out.data);
        hal->edge.can_request(hal->edge.context, hal->mailbox_head, &out, hal->now_ps);
    }
}

bool hal_can_send(hal_t *hal, const hal_frame_t *frame) {
    if (hal->mailbox_count == MAILBOXES) {
        return false;
    }
    hal->mailbox[(hal->mailbox_head + hal->mailbox_count++) % MAILBOXES] = *frame;
    if (hal->mailbox_count == 1) {
        host_can_request(hal);
    }
    return true;
}

bool hal_can_stamp(hal_t *hal, hal_stamp_t *stamp) {
    if (hal->stamps_count == 0) {
        return false;
    }
    *stamp = hal->stamps[hal->stamps_head];
    hal->stamps_head = (hal->stamps_head + 1) % STAMPS;
    hal->stamps_count--;
    return true;
}

bool hal_can_receive(hal_t *hal, hal_frame_t *frame) {
    if (hal->frames_count == 0) {
        return false;
    }
    *frame = hal->frames[hal->frames_head];
    hal->frames_head = (hal->frames_head + 1) % RECEIVE_FRAMES;
    hal->frames_count--;
    return true;
}

/* ---- Housekeeping ---- */

hal_clock_t hal_clock(const hal_t *hal) {
    return hal->config.clock;
}

void hal_counters(const hal_t *hal, hal_counters_t *counters) {
    *counters = hal->counters;
}

uint64_t hal_microseconds(hal_t *hal) {
    return (uint64_t)host_tick(hal) / (HAL_TICKS_PER_SECOND / 1000000u);
}

hal_burst_t hal_burst_timing(void) {
    return (hal_burst_t){HAL_CHIP_TICKS - BURST_MARGIN_TICKS - HAL_BURST * CONVERSION_TICKS + SAMPLE_TICKS,
                         CONVERSION_TICKS};
}

int16_t hal_temperature(const hal_t *hal) {
    const double tenths = hal->config.temperature_degc * 10.0;
    return (int16_t)(tenths < 0 ? tenths - 0.5 : tenths + 0.5);
}

void hal_led(hal_t *hal, bool on) {
    host_pin_write(hal, PIN_LED, on);
}

void hal_reset(hal_t *hal) {
    hal_drive_enable(hal, false);
    hal->reset_wanted = true;
}

void hal_note_stalled(hal_t *hal, uint32_t stalled) {
    (void)hal;
    (void)stalled; /* No watchdog strikes here. */
}

const hal_reset_t *hal_last_reset(const hal_t *hal) {
    return &hal->reset;
}

uint32_t *hal_retained(hal_t *hal) {
    return hal->retained;
}

void hal_unique_id(const hal_t *hal, uint8_t id[HAL_UNIQUE_ID_BYTES]) {
    memcpy(id, hal->config.unique_id, HAL_UNIQUE_ID_BYTES);
}

/* SplitMix64 (Steele, Lea and Flood, 2014), which is random enough for a board in memory. */
static uint64_t mixed(uint64_t *state) {
    uint64_t z = *state += 0x9E3779B97F4A7C15u;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
    z = (z ^ z >> 27) * 0x94D049BB133111EBu;
    return z ^ z >> 31;
}

bool hal_random(hal_t *hal, uint64_t *number) {
    if (hal->failed[HOST_FAILURE_NO_RANDOM]) {
        return false;
    }
    if (hal->random_state == 0) {
        hal->random_state = hal->config.random_seed;
        for (uint32_t i = 0; i < HAL_UNIQUE_ID_BYTES; i++) {
            hal->random_state ^= hal->config.unique_id[i];
            hal->random_state = mixed(&hal->random_state);
        }
    }
    *number = mixed(&hal->random_state);
    return true;
}

const uint8_t *hal_parameter_page(const hal_t *hal) {
    return hal->config.parameter_page;
}

const uint32_t *hal_flash_slot(const hal_t *hal, uint32_t slot) {
    return hal->flash.slot[slot];
}

bool hal_flash_program(hal_t *hal, uint32_t slot, uint32_t index, uint32_t value) {
    if (slot >= HAL_FLASH_SLOTS || index >= HAL_FLASH_WORDS || hal->dead) {
        return false;
    }
    if (hal->flash.program) {
        hal->dead = !hal->flash.program(hal->flash.context, slot, index, value);
        return !hal->dead;
    }
    hal->flash.slot[slot][index] &= value;
    return true;
}

bool hal_flash_erase(hal_t *hal, uint32_t slot) {
    if (slot >= HAL_FLASH_SLOTS || hal->dead) {
        return false;
    }
    if (hal->flash.erase) {
        hal->dead = !hal->flash.erase(hal->flash.context, slot);
        return !hal->dead;
    }
    memset(hal->flash.slot[slot], 0xFF, HAL_FLASH_WORDS * sizeof(uint32_t));
    return true;
}

hal_images_t hal_images(const hal_t *hal) {
    return hal->images.images;
}

bool hal_image_program(hal_t *hal, uint32_t slot, uint32_t index, uint32_t value) {
    const hal_images_t *const images = &hal->images.images;
    const uint32_t words = slot == images->running ? HAL_IMAGE_STATE_WORDS : images->words;
    if (slot >= HAL_IMAGE_SLOTS || index >= words || images->words == 0u || hal->dead) {
        return false;
    }
    hal->dead = !hal->images.program(hal->images.context, slot, index, value);
    return !hal->dead;
}

bool hal_image_erase(hal_t *hal, uint32_t slot, uint32_t words) {
    const hal_images_t *const images = &hal->images.images;
    if (slot >= HAL_IMAGE_SLOTS || slot == images->running || words > images->words || images->words == 0u ||
        hal->dead) {
        return false;
    }
    hal->dead = !hal->images.erase(hal->images.context, slot, words);
    return !hal->dead;
}

void hal_watchdog_kick(hal_t *hal) {
    hal->kick_tick = host_tick(hal);
}
