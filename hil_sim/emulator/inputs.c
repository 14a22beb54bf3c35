#include "emulator/inputs.h"

#include <stdlib.h>

#include "emulator/machine_internal.h"
#include "emulator/peripherals/outside.h"

typedef enum {
    INPUT_PIN,
    INPUT_UART,
    INPUT_CAN,
    INPUT_CAN_SENT,
    INPUT_CAN_ERROR,
    INPUT_CRYSTAL,
    INPUT_NOISE,
    INPUT_SUPPLY,
    INPUT_HALT
} input_kind_t;

struct machine_input {
    machine_event_t event;
    machine_t *machine;
    machine_input_t *next_free, *next;
    input_kind_t kind;
    unsigned number; /* Pin, serial port or mailbox. */
    bool flag;       /* Level, sent, or alive. */
    double volts;
    uint8_t byte;
    uint32_t baud;
    board_frame_t frame;
};

static void arrive(void *context, int64_t time_ps) {
    machine_input_t *const input = context;
    machine_t *const machine = input->machine;
    input->next_free = machine->free_inputs;
    machine->free_inputs = input;
    const machine_input_t copy = *input; /* The model may cause another input, which may take this one's place. */
    switch (copy.kind) {
    case INPUT_PIN:
        gpio_pin_in(machine, copy.number, copy.flag, time_ps);
        break;
    case INPUT_UART:
        usart_byte_in(machine, copy.number, copy.byte, copy.baud, time_ps);
        break;
    case INPUT_CAN:
        can_frame_in(machine, &copy.frame, time_ps);
        break;
    case INPUT_CAN_SENT:
        can_frame_sent(machine, copy.number, copy.flag, time_ps);
        break;
    case INPUT_CAN_ERROR:
        can_error_in(machine, copy.number, time_ps);
        break;
    case INPUT_CRYSTAL:
        rcc_crystal_in(machine, copy.flag);
        break;
    case INPUT_NOISE:
        rng_noise_in(machine, copy.flag);
        break;
    case INPUT_SUPPLY:
        pwr_supply_in(machine, copy.volts);
        break;
    case INPUT_HALT:
        debug_halt_in(machine, copy.flag);
        break;
    }
}

/* An input from the pool, due at time_ps. Freed inputs are used again, so a run needs as many as ever waited
 * together. */
static void post(board_t *board, const machine_input_t *content, int64_t time_ps) {
    machine_t *const machine = (machine_t *)board;
    machine_input_t *input = machine->free_inputs;
    machine_input_t *next = NULL;
    if (input != NULL) {
        machine->free_inputs = input->next_free;
        next = input->next;
    } else {
        input = malloc(sizeof *input);
        if (input == NULL) {
            abort(); /* A lost input would make the run wrong without a sign. */
        }
        next = machine->all_inputs;
        machine->all_inputs = input;
    }
    *input = *content;
    input->next = next;
    input->machine = machine;
    machine_event_init(&input->event, arrive, input);
    machine_schedule(machine, &input->event, time_ps > machine->now_ps ? time_ps : machine->now_ps);
}

void inputs_pin(board_t *board, unsigned pin, bool level, int64_t time_ps) {
    post(board, &(machine_input_t){.kind = INPUT_PIN, .number = pin, .flag = level}, time_ps);
}

void inputs_uart(board_t *board, unsigned uart, uint8_t byte, uint32_t baud, int64_t time_ps) {
    post(board, &(machine_input_t){.kind = INPUT_UART, .number = uart, .byte = byte, .baud = baud}, time_ps);
}

void inputs_can(board_t *board, const board_frame_t *frame, int64_t time_ps) {
    post(board, &(machine_input_t){.kind = INPUT_CAN, .frame = *frame}, time_ps);
}

void inputs_can_rate(board_t *board, uint32_t bit_s) {
    can_network_in((machine_t *)board, bit_s);
}

void inputs_can_sent(board_t *board, unsigned mailbox, bool ok, int64_t time_ps) {
    post(board, &(machine_input_t){.kind = INPUT_CAN_SENT, .number = mailbox, .flag = ok}, time_ps);
}

void inputs_can_error(board_t *board, unsigned mailbox, int64_t time_ps) {
    post(board, &(machine_input_t){.kind = INPUT_CAN_ERROR, .number = mailbox}, time_ps);
}

void inputs_crystal(board_t *board, bool alive, int64_t time_ps) {
    post(board, &(machine_input_t){.kind = INPUT_CRYSTAL, .flag = alive}, time_ps);
}

void inputs_noise(board_t *board, bool alive, int64_t time_ps) {
    post(board, &(machine_input_t){.kind = INPUT_NOISE, .flag = alive}, time_ps);
}

void inputs_supply(board_t *board, double volts, int64_t time_ps) {
    post(board, &(machine_input_t){.kind = INPUT_SUPPLY, .volts = volts}, time_ps);
}

void inputs_halt(board_t *board, bool halted, int64_t time_ps) {
    post(board, &(machine_input_t){.kind = INPUT_HALT, .flag = halted}, time_ps);
}

void inputs_destroy(machine_t *machine) {
    while (machine->all_inputs != NULL) {
        machine_input_t *const input = machine->all_inputs;
        machine->all_inputs = input->next;
        free(input);
    }
}
