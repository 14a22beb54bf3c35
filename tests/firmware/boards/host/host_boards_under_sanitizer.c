/* Two beacons, a sensor and an anchor on host boards, one sync wire, one bus, bytes from a stranger; built with the
 * address and undefined-behaviour sanitizers by test_sanitizers.py. Prints how many bytes and frames came out; any
 * finding of a sanitizer ends it with an error. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "boards/host/host_board.h"

enum { BOARDS = 4, MASTER = 0, PIN_SYNC_IN = 10, PIN_SYNC_OUT = 40 };
#define MS INT64_C(1000000000)

typedef struct world world_t;
typedef struct {
    world_t *world;
    unsigned index;
    unsigned long bytes, frames;
} board_slot_t;
struct world {
    board_t *boards[BOARDS];
    board_slot_t slots[BOARDS];
};

static void pin_out(void *context, unsigned pin, bool level, int64_t time_ps) {
    const board_slot_t *slot = context;
    for (unsigned i = 1; slot->index == MASTER && pin == PIN_SYNC_OUT && i < BOARDS; i++) {
        host_board_operations.pin_in(slot->world->boards[i], PIN_SYNC_IN, level, time_ps);
    }
}

static double analog_in(void *context, unsigned pin, int64_t time_ps) {
    (void)context;
    return pin == 0 ? 1.9 : (double)(time_ps / 977 % 3301) * 1e-3; /* From rail to rail. */
}

static void uart_out(void *context, unsigned uart, uint8_t byte, int64_t time_ps) {
    (void)uart, (void)byte, (void)time_ps;
    ((board_slot_t *)context)->bytes++;
}

static void can_request(void *context, unsigned mailbox, const board_frame_t *frame, int64_t time_ps) {
    board_slot_t *slot = context;
    slot->frames++;
    for (unsigned i = 0; i < BOARDS; i++) {
        if (i == slot->index) {
            host_board_operations.can_sent(slot->world->boards[i], mailbox, slot->frames % 50 != 0,
                                           time_ps + 130000000);
        } else {
            host_board_operations.can_in(slot->world->boards[i], frame, time_ps + 130000000);
        }
    }
}

static void put_parameter(uint8_t **at, uint16_t id, uint16_t kind, uint32_t bits) {
    memcpy(*at, &id, 2), memcpy(*at + 2, &kind, 2), memcpy(*at + 4, &bits, 4);
    *at += 8;
}

static uint32_t float_bits(float value) {
    uint32_t bits;
    memcpy(&bits, &value, 4);
    return bits;
}

static uint16_t crc16(const uint8_t *bytes, size_t count) {
    uint32_t crc = 0xFFFF;
    for (size_t i = 0; i < 8 * count; i++) {
        const uint32_t bit = (uint32_t)(bytes[i / 8] >> (7 - i % 8)) & 1u;
        crc = (crc << 1 ^ (((crc >> 15 & 1u) ^ bit) ? 0x1021u : 0u)) & 0xFFFFu;
    }
    return (uint16_t)crc;
}

static void fill_page(uint8_t *page, unsigned index) {
    uint8_t *at = page + 8;
    put_parameter(&at, 0, 0, index + 1);
    put_parameter(&at, 1, 0, 1000 + index);
    put_parameter(&at, 2, 2, float_bits(2.4f));
    put_parameter(&at, 3, 0, index == MASTER);
    put_parameter(&at, 4, 0, 1);
    put_parameter(&at, 5, 0, 64);
    const uint16_t count = (uint16_t)((at - page - 8) / 8), crc = crc16(page + 8, (size_t)(at - page - 8));
    memcpy(page, "GFP1", 4), memcpy(page + 4, &count, 2), memcpy(page + 6, &crc, 2);
}

int main(void) {
    static const hal_role_t roles[BOARDS] = {HAL_ROLE_BEACON, HAL_ROLE_BEACON, HAL_ROLE_SENSOR, HAL_ROLE_ANCHOR};
    static world_t world;
    for (unsigned i = 0; i < BOARDS; i++) {
        host_board_config_t config = {.role = roles[i], .crystal_ppm = 60.0 * i - 60.0, .temperature_degc = -12.3};
        fill_page(config.parameter_page, i);
        world.slots[i] = (board_slot_t){.world = &world, .index = i};
        const board_edge_t edge = {.context = &world.slots[i],
                                   .pin_out = pin_out,
                                   .analog_in = analog_in,
                                   .uart_out = uart_out,
                                   .can_request = can_request};
        world.boards[i] = host_board_create(&config, &edge, i * 7 * MS);
        if (!world.boards[i])
            return 1;
    }
    uint32_t random = 1;
    for (int64_t now = MS; now <= 1500 * MS; now += MS) {
        for (unsigned i = 0; i < BOARDS; i++) {
            for (unsigned k = 0; k < 20; k++) {
                random = random * 1664525u + 1013904223u;
                const uint8_t byte = random >> 29 == 0 ? 0 : (uint8_t)(random >> 16);
                host_board_operations.uart_in(world.boards[i], 1, byte, 2000000, now + k * 5000000);
            }
            host_board_operations.run(world.boards[i], now);
        }
    }
    for (unsigned i = 0; i < BOARDS; i++) {
        printf("%lu %lu\n", world.slots[i].bytes, world.slots[i].frames);
        host_board_operations.destroy(world.boards[i]);
    }
    return 0;
}
