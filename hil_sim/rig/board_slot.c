#include "rig/board_slot.h"

#include <stdlib.h>

#include "rig/array.h"
#include "world/noise.h"

enum {
    PIN_CURRENT_0 = 0,
    PIN_FIELD_X = 1,
    PIN_SUPPLY = 32,
    PIN_TEMPERATURE_0 = 33,
    PIN_DRIVER_TEMPERATURE = 34,
    PIN_TEMPERATURE_1 = 35,
    PIN_CURRENT_1 = 36
};

static const double supply_V_per_V = 3.3 / 160.0; /* Divider of the supply: 160 V is the converter's full scale. */
static const double glowing_degC = 200.0;         /* Temperature of what the faults make hot. */
static const double converter_V = 3.3;            /* What a thermistor that is not there leaves. */

typedef struct {
    unsigned bridge_1, bridge_2;
} channel_pins_t;

static const channel_pins_t channel_pins[RIG_COILS] = {{.bridge_1 = 29, .bridge_2 = 30},
                                                       {.bridge_1 = 16, .bridge_2 = 17}};

static void keep_change(rig_pin_change_t **changes, size_t *count, size_t *capacity, rig_pin_change_t change) {
    *changes = array_reserve(*changes, capacity, *count + 1, sizeof **changes);
    (*changes)[(*count)++] = change;
}

/* A pin's level at what it is wired to. */
static void set_level(board_slot_t *slot, unsigned pin, bool level, int64_t time_ps) {
    const uint64_t bit = UINT64_C(1) << pin % 64;
    if (((slot->levels & bit) != 0) == level) {
        return;
    }
    slot->levels ^= bit;
    const rig_pin_change_t change = {
        .time_ps = time_ps, .board = (uint16_t)slot->number, .pin = (uint8_t)pin, .level = level};
    bool wired = pin == BOARD_PIN_ENABLE || pin == BOARD_PIN_SYNC_OUT;
    for (unsigned i = 0; i < slot->coils; ++i) {
        if (pin == channel_pins[i].bridge_1 || pin == channel_pins[i].bridge_2) {
            coil_input(&slot->coil[i], pin == channel_pins[i].bridge_1 ? 1 : 2, level, time_ps);
            wired = true;
        } else if (pin == BOARD_PIN_ENABLE) {
            coil_enable(&slot->coil[i], level, time_ps);
        }
    }
    if (pin == BOARD_PIN_SYNC_OUT) {
        keep_change(&slot->sync_changes, &slot->sync_count, &slot->sync_capacity, change);
    }
    if (wired && slot->watch) {
        keep_change(&slot->changes, &slot->change_count, &slot->change_capacity, change);
    }
}

static void on_pin_out(void *context, unsigned pin, bool level, int64_t time_ps) {
    board_slot_t *const slot = context;
    slot->driven |= UINT64_C(1) << pin % 64;
    set_level(slot, pin, level, time_ps);
}

static void on_pin_release(void *context, unsigned pin, board_pull_t pull, int64_t time_ps) {
    board_slot_t *const slot = context;
    const bool pulled_down = !slot->pull_downs_lost && (pin == BOARD_PIN_ENABLE || pin == BOARD_PIN_SYNC_OUT);
    const uint64_t chance = noise_bits(noise_stream(slot->seed, NOISE_FLOATING, slot->number, pin), slot->releases++);
    slot->driven &= ~(UINT64_C(1) << pin % 64);
    set_level(slot, pin, !pulled_down && (pull == BOARD_PULL_NONE ? (chance & 1u) != 0 : pull == BOARD_PULL_UP),
              time_ps);
}

board_ahead_t board_slot_ahead(const board_slot_t *slot) {
    const board_ahead_t unknown = {.due_ps = INT64_MIN, .asks_ps = INT64_MIN};
    return slot->operations->ahead != NULL ? slot->operations->ahead(slot->instance) : unknown;
}

void board_slot_driver_fault(board_slot_t *slot, bool active, int64_t time_ps) {
    slot->operations->pin_in(slot->instance, BOARD_PIN_FAULT, !active, time_ps);
    slot->operations->pin_in(slot->instance, BOARD_PIN_FAULT_TOO, !active, time_ps);
}

void board_slot_power_lost(board_slot_t *slot, int64_t time_ps) {
    for (unsigned i = 0; i < slot->coils; ++i) {
        on_pin_release(slot, channel_pins[i].bridge_1, BOARD_PULL_NONE, time_ps);
        on_pin_release(slot, channel_pins[i].bridge_2, BOARD_PULL_NONE, time_ps);
    }
    on_pin_release(slot, BOARD_PIN_ENABLE, BOARD_PULL_NONE, time_ps);
    on_pin_release(slot, BOARD_PIN_SYNC_OUT, BOARD_PULL_NONE, time_ps);
}

void board_slot_lose_pull_downs(board_slot_t *slot, bool lost, int64_t time_ps) {
    static const unsigned pins[] = {BOARD_PIN_ENABLE, BOARD_PIN_SYNC_OUT};
    slot->pull_downs_lost = lost;
    for (unsigned i = 0; i < sizeof pins / sizeof pins[0]; ++i) {
        if ((slot->driven >> pins[i] & 1u) == 0) {
            on_pin_release(slot, pins[i], BOARD_PULL_NONE, time_ps);
        }
    }
}

static void on_analog_out(void *context, unsigned channel, double volts, int64_t time_ps) {
    board_slot_t *const slot = context;
    if (channel >= 1 && channel <= slot->coils) {
        coil_reference(&slot->coil[channel - 1], volts, time_ps);
    }
}

/* Returns the volts of a thermistor that is as warm as when it was last looked at, as a rule. */
static double look_at(slot_thermistor_t *thermistor, double temperature_degC) {
    if (thermistor->volts == 0.0 || thermistor->temperature_degC != temperature_degC) {
        *thermistor = (slot_thermistor_t){temperature_degC, thermistor_volts(temperature_degC)};
    }
    return thermistor->volts;
}

static double channel_volts(board_slot_t *slot, unsigned channel, bool current, int64_t time_ps) {
    if (channel >= slot->coils) {
        return current || slot->coils == 0 ? 0.0 : converter_V;
    }
    coil_t *const coil = &slot->coil[channel];
    if (current) {
        return coil_sense(coil, slot->sense_stream[channel], time_ps);
    }
    return look_at(&slot->thermistor[channel],
                   slot->coil_hot[channel] ? glowing_degC : coil_temperature(coil, time_ps));
}

static double on_analog_in(void *context, unsigned pin, int64_t time_ps) {
    board_slot_t *const slot = context;
    switch (pin) {
    case PIN_FIELD_X:
    case PIN_FIELD_X + 1:
    case PIN_FIELD_X + 2:
        return slot->senses ? sensing_volts(&slot->sensing, pin - PIN_FIELD_X, time_ps) : 0.0;
    case PIN_CURRENT_0:
    case PIN_CURRENT_1:
        return channel_volts(slot, pin == PIN_CURRENT_1, true, time_ps);
    case PIN_TEMPERATURE_0:
    case PIN_TEMPERATURE_1:
        return channel_volts(slot, pin == PIN_TEMPERATURE_1, false, time_ps);
    case PIN_SUPPLY:
        return slot->coils > 0 ? supply_V_per_V * coil_bus(&slot->coil[0], time_ps) : 0.0;
    case PIN_DRIVER_TEMPERATURE:
        return slot->coils == 0 ? 0.0
                                : look_at(&slot->thermistor[RIG_COILS],
                                          slot->driver_hot ? glowing_degC : slot->coil[0].config.ambient_degC);
    default:
        return 0.0;
    }
}

static void on_uart_out(void *context, unsigned uart, uint8_t byte, int64_t time_ps) {
    board_slot_t *const slot = context;
    (void)time_ps;
    if (uart == BOARD_SERIAL_PORT) {
        serial_line_received(&slot->serial, byte);
    }
}

static void keep_request(board_slot_t *slot, board_slot_request_t request) {
    slot->requests = array_reserve(slot->requests, &slot->request_capacity, slot->request_count + 1,
                                   sizeof *slot->requests);
    slot->requests[slot->request_count++] = request;
}

static void on_can_request(void *context, unsigned mailbox, const board_frame_t *frame, int64_t time_ps) {
    keep_request(context, (board_slot_request_t){.mailbox = mailbox, .frame = *frame, .time_ps = time_ps});
}

static void on_can_abort(void *context, unsigned mailbox, int64_t time_ps) {
    keep_request(context, (board_slot_request_t){.abort = true, .mailbox = mailbox, .time_ps = time_ps});
}

void board_slot_init(board_slot_t *slot, unsigned number, uint64_t seed, const rig_board_config_t *config,
                     coil_t *coil) {
    *slot = (board_slot_t){.number = number, .seed = seed, .coils = config->coils, .coil = coil};
    slot->edge = (board_edge_t){
        .context = slot,
        .pin_out = on_pin_out,
        .pin_release = on_pin_release,
        .analog_out = on_analog_out,
        .analog_in = on_analog_in,
        .uart_out = on_uart_out,
        .can_request = on_can_request,
        .can_abort = on_can_abort,
    };
    for (unsigned i = 0; i < config->coils; ++i) {
        coil_init(&coil[i], &config->coil[i]);
        slot->sense_stream[i] = noise_stream(seed, NOISE_CURRENT_SENSE, number, i);
    }
    board_slot_power_lost(slot, 0); /* As long as it has none. */
}

void board_slot_free(board_slot_t *slot) {
    if (slot->senses) {
        sensing_free(&slot->sensing);
    }
    serial_line_free(&slot->serial);
    free(slot->requests);
    free(slot->sync_changes);
    free(slot->changes);
}
