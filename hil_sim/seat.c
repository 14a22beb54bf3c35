#include "seat.h"

#include <stdlib.h>

#include "array.h"
#include "world/noise.h"

enum { PIN_FIELD_X = 1 };

typedef struct {
    unsigned bridge_1, bridge_2, current;
} channel_pins_t;

static const channel_pins_t channel_pins[RIG_COILS] = {{.bridge_1 = 38, .bridge_2 = 39, .current = 0}, {.bridge_1 = 36, .bridge_2 = 37, .current = 6}};

static void keep_change(rig_pin_change_t **changes, size_t *count, size_t *capacity, rig_pin_change_t change)
{
    *changes = array_reserve(*changes, capacity, *count + 1, sizeof **changes);
    (*changes)[(*count)++] = change;
}

static void on_pin_out(void *context, unsigned pin, bool level, int64_t time_ps)
{
    seat_t *const seat = context;
    const rig_pin_change_t change = {.time_ps = time_ps, .board = (uint16_t)seat->number, .pin = (uint8_t)pin, .level = level};
    bool wired = pin == SEAT_PIN_ENABLE || pin == SEAT_PIN_SYNC_OUT;
    for (unsigned i = 0; i < seat->coils; ++i) {
        if (pin == channel_pins[i].bridge_1 || pin == channel_pins[i].bridge_2) {
            coil_input(&seat->coil[i], pin == channel_pins[i].bridge_1 ? 1 : 2, level, time_ps);
            wired = true;
        } else if (pin == SEAT_PIN_ENABLE) {
            coil_enable(&seat->coil[i], level, time_ps);
        }
    }
    if (pin == SEAT_PIN_SYNC_OUT) {
        keep_change(&seat->sync_changes, &seat->sync_count, &seat->sync_capacity, change);
    }
    if (wired && seat->watch) {
        keep_change(&seat->changes, &seat->change_count, &seat->change_capacity, change);
    }
}

static void on_analog_out(void *context, unsigned channel, double volts, int64_t time_ps)
{
    seat_t *const seat = context;
    if (channel >= 1 && channel <= seat->coils) {
        coil_reference(&seat->coil[channel - 1], volts, time_ps);
    }
}

static double on_analog_in(void *context, unsigned pin, int64_t time_ps)
{
    seat_t *const seat = context;
    if (seat->senses && pin >= PIN_FIELD_X && pin < PIN_FIELD_X + 3) {
        return sensing_volts(&seat->sensing, pin - PIN_FIELD_X, time_ps);
    }
    for (unsigned i = 0; i < seat->coils; ++i) {
        if (pin == channel_pins[i].current) {
            return coil_sense(&seat->coil[i], seat->seed, noise_stream(NOISE_CURRENT_SENSE, seat->number, i), time_ps);
        }
    }
    return 0.0;
}

static void on_uart_out(void *context, unsigned uart, uint8_t byte, int64_t time_ps)
{
    seat_t *const seat = context;
    (void)time_ps;
    if (uart == SEAT_SERIAL_PORT) {
        serial_line_received(&seat->serial, byte);
    }
}

static void keep_wish(seat_t *seat, seat_wish_t wish)
{
    seat->wishes = array_reserve(seat->wishes, &seat->wish_capacity, seat->wish_count + 1, sizeof *seat->wishes);
    seat->wishes[seat->wish_count++] = wish;
}

static void on_can_request(void *context, unsigned mailbox, const board_frame_t *frame, int64_t time_ps)
{
    keep_wish(context, (seat_wish_t){.mailbox = mailbox, .frame = *frame, .time_ps = time_ps});
}

static void on_can_abort(void *context, unsigned mailbox, int64_t time_ps)
{
    keep_wish(context, (seat_wish_t){.abort = true, .mailbox = mailbox, .time_ps = time_ps});
}

void seat_init(seat_t *seat, unsigned number, uint64_t seed, const rig_board_config_t *config, coil_t *coil)
{
    *seat = (seat_t){.number = number, .seed = seed, .coils = config->coils, .coil = coil};
    seat->edge = (board_edge_t){
        .context = seat,
        .pin_out = on_pin_out,
        .analog_out = on_analog_out,
        .analog_in = on_analog_in,
        .uart_out = on_uart_out,
        .can_request = on_can_request,
        .can_abort = on_can_abort,
    };
    for (unsigned i = 0; i < config->coils; ++i) {
        coil_init(&coil[i], &config->coil[i]);
    }
}

void seat_free(seat_t *seat)
{
    if (seat->senses) {
        sensing_free(&seat->sensing);
    }
    serial_line_free(&seat->serial);
    free(seat->wishes);
    free(seat->sync_changes);
    free(seat->changes);
}
