#include "fake_board.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { INPUTS = 256 };
typedef enum { INPUT_SYNC, INPUT_BYTE, INPUT_FRAME, INPUT_SENT } kind_t;

typedef struct {
    int64_t time_ps;
    kind_t kind;
    unsigned value;
    board_frame_t frame;
} input_t;

struct board {
    fake_config_t config;
    board_edge_t edge;
    int64_t now_ps, power_on_ps, chip_ps, chip_start_ps;
    unsigned event; /* 0: start of the chip; then conversions. */
    uint64_t chip;
    uint32_t lfsr;
    bool positive;
    input_t inputs[INPUTS];
    size_t input_count;
    fake_sample_t *samples;
    size_t sample_count, sample_capacity;
    char report[64];
};

static void say(board_t *board, const void *bytes, size_t count) {
    for (size_t i = 0; i < count; ++i) {
        board->edge.uart_out(board->edge.context, 3, ((const uint8_t *)bytes)[i], board->now_ps);
    }
}

static void drive_chip(board_t *board) {
    const board_edge_t *const edge = &board->edge;
    if (board->chip == 0) {
        edge->analog_out(edge->context, 1, 10.0 / 16.0 * 3.3, board->now_ps);
    }
    board->lfsr = (board->lfsr >> 1) ^ ((board->lfsr & 1u) != 0 ? 0xB400u : 0u);
    const bool positive = board->config.still || (board->lfsr & 1u) != 0;
    if (board->chip == 0 || positive != board->positive) {
        edge->pin_out(edge->context, 29, positive, board->now_ps);
        edge->pin_out(edge->context, 30, !positive, board->now_ps);
        board->positive = positive;
    }
}

static void turn_chip(const board_t *board) {
    static const unsigned bridge[2] = {29, 16};
    const board_edge_t *const edge = &board->edge;
    const double angle = 2.0 * 3.14159265358979323846 * board->config.periods * (double)(board->chip % FAKE_CYCLE) /
                         FAKE_CYCLE;
    const double current_A[2] = {10.0 * cos(angle), 10.0 * sin(angle)};
    for (unsigned i = 0; i < 2; ++i) {
        edge->pin_out(edge->context, bridge[i], current_A[i] > 0.0, board->now_ps);
        edge->pin_out(edge->context, bridge[i] + 1, current_A[i] < 0.0, board->now_ps);
        edge->analog_out(edge->context, 1 + i, fabs(current_A[i]) / 16.0 * 3.3, board->now_ps);
    }
}

static void start_chip(board_t *board) {
    const board_edge_t *const edge = &board->edge;
    if (!board->config.drives) {
        return;
    }
    if (board->chip == 0) {
        edge->pin_out(edge->context, 31, true, board->now_ps);
    }
    if (board->config.periods > 0) {
        turn_chip(board);
    } else {
        drive_chip(board);
    }
    if (board->chip % FAKE_CYCLE <= 1) {
        edge->pin_out(edge->context, 7, board->chip % FAKE_CYCLE == 0, board->now_ps);
    }
    if (board->chip % FAKE_CYCLE == 5) {
        board_frame_t frame = {.id = board->config.can_id, .extended = true, .length = 8};
        memcpy(frame.data, &board->chip, 8);
        edge->can_request(edge->context, 0, &frame, board->now_ps);
    }
}

static int64_t event_time(const board_t *board) {
    if (board->event == 0) {
        return board->chip_start_ps;
    }
    const int64_t last = board->config.senses ? FAKE_BURST : 1;
    return board->chip_start_ps + board->chip_ps - 1000000 - (last + 1 - (int64_t)board->event) * 1500000;
}

static void take_event(board_t *board) {
    const board_edge_t *const edge = &board->edge;
    const unsigned last = board->config.senses ? FAKE_BURST : 1;
    if (board->event == 0) {
        start_chip(board);
    } else {
        if (board->sample_count == board->sample_capacity) {
            board->sample_capacity = 2 * board->sample_capacity + 1024;
            board->samples = realloc(board->samples, board->sample_capacity * sizeof *board->samples);
        }
        fake_sample_t *const sample = &board->samples[board->sample_count++];
        *sample = (fake_sample_t){.time_ps = board->now_ps};
        for (unsigned i = 0; i < (board->config.senses ? 3u : 2u); ++i) {
            sample->volts[i] = edge->analog_in(edge->context, board->config.senses ? 1 + i : 36 * i, board->now_ps);
        }
    }
    if (board->event++ == last) {
        board->event = 0;
        ++board->chip;
        board->chip_start_ps += board->chip_ps;
    }
}

static void take_input(board_t *board) {
    const input_t input = board->inputs[0];
    --board->input_count;
    memmove(board->inputs, board->inputs + 1, board->input_count * sizeof input);
    char text[64];
    switch (input.kind) {
    case INPUT_SYNC:
        (void)snprintf(text, sizeof text, "<sync %u %" PRId64 ">", input.value, input.time_ps);
        break;
    case INPUT_BYTE:
        (void)snprintf(text, sizeof text, "<byte %02x %" PRId64 ">", input.value, input.time_ps);
        break;
    case INPUT_FRAME:
        (void)snprintf(text, sizeof text, "<frame %x %" PRId64 ">", input.frame.id, input.time_ps);
        break;
    default:
        (void)snprintf(text, sizeof text, "<sent %u %" PRId64 ">", input.value, input.time_ps);
        break;
    }
    say(board, text, strlen(text));
}

static board_status_t run(board_t *board, int64_t until_ps) {
    for (;;) {
        int64_t next_ps = event_time(board);
        const bool input = board->input_count > 0 && board->inputs[0].time_ps <= next_ps;
        next_ps = input ? board->inputs[0].time_ps : next_ps;
        if (next_ps >= until_ps) {
            board->now_ps = until_ps;
            return BOARD_OK;
        }
        board->now_ps = next_ps > board->now_ps ? next_ps : board->now_ps;
        if (board->config.stops_at_ps > 0 && board->now_ps >= board->config.stops_at_ps) {
            (void)snprintf(board->report, sizeof board->report, "asked to stop at %" PRId64, board->config.stops_at_ps);
            return BOARD_FAULT;
        }
        if (input) {
            take_input(board);
        } else {
            take_event(board);
        }
    }
}

static int64_t now(const board_t *board) {
    return board->now_ps;
}

static void add(board_t *board, input_t input) {
    if (board->input_count == INPUTS || input.time_ps < board->now_ps) {
        abort(); /* The rig promised neither to flood a board nor to reach into its past. */
    }
    size_t at = board->input_count++;
    for (; at > 0 && board->inputs[at - 1].time_ps > input.time_ps; --at) {
        board->inputs[at] = board->inputs[at - 1];
    }
    board->inputs[at] = input;
}

static void pin_in(board_t *board, unsigned pin, bool level, int64_t time_ps) {
    if (pin == 38 && time_ps > 0) {
        add(board, (input_t){.time_ps = time_ps, .kind = INPUT_SYNC, .value = level});
    } else if (pin == 28 && !level) {
        board->edge.pin_out(board->edge.context, 31, false, time_ps);
    }
}

static void uart_in(board_t *board, unsigned uart, uint8_t byte, uint32_t baud, int64_t time_ps) {
    (void)uart;
    (void)baud;
    add(board, (input_t){.time_ps = time_ps, .kind = INPUT_BYTE, .value = byte});
}

static void can_in(board_t *board, const board_frame_t *frame, int64_t time_ps) {
    add(board, (input_t){.time_ps = time_ps, .kind = INPUT_FRAME, .frame = *frame});
}

static void can_sent(board_t *board, unsigned mailbox, bool ok, int64_t time_ps) {
    (void)mailbox;
    add(board, (input_t){.time_ps = time_ps, .kind = INPUT_SENT, .value = ok});
}

static const char *report(const board_t *board) {
    return board->report;
}

static void destroy(board_t *board) {
    free(board->samples);
    free(board);
}

size_t fake_samples(const board_t *board, const fake_sample_t **samples) {
    *samples = board->samples;
    return board->sample_count;
}

board_t *fake_create(const fake_config_t *config, const board_edge_t *edge, int64_t power_on_ps) {
    board_t *const board = calloc(1, sizeof *board);
    if (board != NULL) {
        board->config = *config;
        board->edge = *edge;
        board->power_on_ps = power_on_ps;
        board->chip_start_ps = power_on_ps + 1000000;
        board->chip_ps = (int64_t)(97750000.0 / (1.0 + config->ppm * 1e-6));
        board->lfsr = 0xACE1u ^ config->can_id;
    }
    return board;
}

const board_operations_t fake_operations = {.run = run,
                                            .now = now,
                                            .pin_in = pin_in,
                                            .uart_in = uart_in,
                                            .can_in = can_in,
                                            .can_sent = can_sent,
                                            .report = report,
                                            .destroy = destroy};
