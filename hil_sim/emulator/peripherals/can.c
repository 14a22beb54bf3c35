/* can.c: bxCAN: registers, modes, bit timing, errors (see can.h). A controller that is off the network's bit rate by
 * more than 0.5 % hears errors only. Using what is not modelled is a violation: time-triggered mode, and what waits for
 * the end of a frame that has begun, as the network does not tell when one does.
 */
#include "emulator/peripherals/can.h"

#include "emulator/peripherals/outside.h"

#include <math.h>

#define RATE_TOLERANCE 0.005
#define FASTEST_HZ     1.0001e6 /* RM0090, 32.2. */

#define MAILBOX(n)                                                                                                     \
    {"TI" #n "R", TI0R + 16 * n, 0, 0xFFFFFFFF, ACCESS_RW},                                                            \
        {"TDT" #n "R", TI0R + 16 * n + 4, 0, 0xFFFF010F, ACCESS_RW},                                                   \
        {"TDL" #n "R", TI0R + 16 * n + 8, 0, 0xFFFFFFFF, ACCESS_RW}, {                                                 \
        "TDH" #n "R", TI0R + 16 * n + 12, 0, 0xFFFFFFFF, ACCESS_RW                                                     \
    }
#define FIFO(n)                                                                                                        \
    {"RI" #n "R", RI0R + 16 * n, 0, 0xFFFFFFFE, ACCESS_RO},                                                            \
        {"RDT" #n "R", RI0R + 16 * n + 4, 0, 0xFFFFFF0F, ACCESS_RO},                                                   \
        {"RDL" #n "R", RI0R + 16 * n + 8, 0, 0xFFFFFFFF, ACCESS_RO}, {                                                 \
        "RDH" #n "R", RI0R + 16 * n + 12, 0, 0xFFFFFFFF, ACCESS_RO                                                     \
    }
#define BANK(n)                                                                                                        \
    {"F" #n "R1", F0R1 + 8 * n, 0, 0xFFFFFFFF, ACCESS_RW}, {                                                           \
        "F" #n "R2", F0R1 + 8 * n + 4, 0, 0xFFFFFFFF, ACCESS_RW                                                        \
    }
#define CONTROL_REGISTERS                                                                                              \
    {"MCR", MCR, 0x00010002, 0x000180FF, ACCESS_RW}, {"MSR", MSR, 0x00000C02, 0x00000F1F, ACCESS_RW},                  \
        {"TSR", TSR, 0x1C000000, 0xFF8F8F8F, ACCESS_RW}, {"RF0R", RF0R, 0, 0x3B, ACCESS_RW},                           \
        {"RF1R", RF1R, 0, 0x3B, ACCESS_RW}, {"IER", IER, 0, 0x00038F7F, ACCESS_RW},                                    \
        {"ESR", ESR, 0, 0xFFFF0077, ACCESS_RW}, {"BTR", BTR, 0x01230000, 0xC37F03FF, ACCESS_RW}, MAILBOX(0),           \
        MAILBOX(1), MAILBOX(2), FIFO(0), FIFO(1)
static const register_layout_t registers[] = {
    CONTROL_REGISTERS,
    {"FMR", FMR, 0x2A1C0E01, 0x00003F01, ACCESS_RW},
    {"FM1R", FM1R, 0, 0x0FFFFFFF, ACCESS_RW},
    {"FS1R", FS1R, 0, 0x0FFFFFFF, ACCESS_RW},
    {"FFA1R", FFA1R, 0, 0x0FFFFFFF, ACCESS_RW},
    {"FA1R", FA1R, 0, 0x0FFFFFFF, ACCESS_RW},
    BANK(0),
    BANK(1),
    BANK(2),
    BANK(3),
    BANK(4),
    BANK(5),
    BANK(6),
    BANK(7),
    BANK(8),
    BANK(9),
    BANK(10),
    BANK(11),
    BANK(12),
    BANK(13),
    BANK(14),
    BANK(15),
    BANK(16),
    BANK(17),
    BANK(18),
    BANK(19),
    BANK(20),
    BANK(21),
    BANK(22),
    BANK(23),
    BANK(24),
    BANK(25),
    BANK(26),
    BANK(27),
};
static const register_layout_t registers2[] = {CONTROL_REGISTERS};

double can_bit_rate(const can_t *c, bool nominal) {
    const uint32_t btr = reg(&c->model, BTR);
    const clock_domain_t *const clock = &c->model.chip->pclk1;
    return (nominal ? clock->nominal_hz : clock->hz) /
           ((field(btr, 0, 10) + 1) * (3 + field(btr, 16, 4) + field(btr, 20, 3)));
}

bool can_rate_fits(const can_t *c) {
    return fabs(can_bit_rate(c, false) / c->network_hz - 1) <= RATE_TOLERANCE;
}

bool can_has_pin(const can_t *c, bool transmit) {
    static const uint8_t pins[2][2][4] = {
        {{11, 24, 48, 137}, {21, 28, 21, 28}},  /* RX: PA11, PB8, PD0, PI9; PB5, PB12 */
        {{12, 25, 49, 125}, {22, 29, 22, 29}}}; /* TX: PA12, PB9, PD1, PH13; PB6, PB13 */
    for (unsigned i = 0; i < 4; i++) {
        if (chip_pin_is_alternate(c->model.chip, pins[transmit][c->number][i], 9)) {
            return true;
        }
    }
    return false;
}

void can_interrupts(can_t *c) {
    static const uint8_t lines[2][4] = {{19, 20, 21, 22}, {63, 64, 65, 66}};
    const uint32_t ier = reg(&c->model, IER), tsr = reg(&c->model, TSR), msr = reg(&c->model, MSR);
    machine_t *const machine = c->model.machine;
    machine_irq(machine, lines[c->number][0], (ier & 1u) != 0 && (tsr & 0x010101u) != 0);
    for (unsigned f = 0; f < 2; f++) {
        const uint32_t rf = reg(&c->model, RF0R + 4 * f), enable = ier >> (1 + 3 * f);
        machine_irq(machine, lines[c->number][1 + f],
                    ((enable & 1u) && (rf & 3u)) || ((enable & 2u) && (rf & 8u)) || ((enable & 4u) && (rf & 0x10u)));
    }
    machine_irq(machine, lines[c->number][3],
                ((ier & 0x8000u) && (msr & ERRI)) || ((ier & 0x10000u) && (msr & WKUI)) ||
                    ((ier & 0x20000u) && (msr & SLAKI)));
}

/* ---- Errors ---- */

enum { WARNING = 96, PASSIVE = 128, BUS_OFF = 256 };
#define RECOVERY_BITS (128 * 11)

void can_errors(can_t *c, unsigned code) {
    uint32_t *const esr = can_value(c, ESR);
    const uint32_t old = *esr;
    const unsigned worst = c->transmit_errors > c->receive_errors ? c->transmit_errors : c->receive_errors;
    *esr = (c->receive_errors & 0xFFu) << 24 | (c->transmit_errors & 0xFFu) << 16 | code << 4 |
           (worst >= WARNING ? 1u : 0) | (worst >= PASSIVE ? 2u : 0) | (c->bus_off ? BOFF : 0);
    const uint32_t ier = reg(&c->model, IER), risen = *esr & ~old;
    if (((ier & 0x100u) && (risen & 1u)) || ((ier & 0x200u) && (risen & 2u)) || ((ier & 0x400u) && (risen & BOFF)) ||
        ((ier & 0x800u) && code != 0)) {
        *can_value(c, MSR) |= ERRI;
    }
}

/* Off the bus for 128 times 11 recessive bits: of an idle bus, as frames meanwhile are not looked at. With ABOM the
 * count begins now, else when the program leaves initialisation mode. */
static void go_off(can_t *c) {
    machine_t *const machine = c->model.machine;
    c->bus_off = true;
    can_leave_bus(c, machine_now(machine));
    if ((reg(&c->model, MCR) & ABOM) != 0) {
        machine_schedule(machine, &c->recover,
                         machine_now(machine) + llround(RECOVERY_BITS * 1e12 / can_bit_rate(c, false)));
    }
}

static void come_back(can_t *c) {
    c->bus_off = false;
    c->transmit_errors = c->receive_errors = 0;
    can_errors(c, 0);
}

static void recovered(void *context, int64_t time_ps) {
    can_t *const c = context;
    come_back(c);
    can_submit(c, time_ps);
    can_interrupts(c);
}

void can_transmit_failed(can_t *c, bool acknowledge_missing) {
    if (!acknowledge_missing || c->transmit_errors < PASSIVE) {
        c->transmit_errors += 8;
    }
    if (c->transmit_errors >= BUS_OFF && !c->bus_off) {
        go_off(c);
    }
}

void can_transmit_succeeded(can_t *c) {
    c->transmit_errors -= c->transmit_errors > 0 ? 1u : 0;
}

void can_receive_failed(can_t *c) {
    c->receive_errors += c->receive_errors < PASSIVE ? 1u : 0;
}

/* RM0090 32.9.2: a receiver that was error passive goes back to 120. */
void can_receive_succeeded(can_t *c) {
    c->receive_errors = c->receive_errors >= PASSIVE ? 120u : c->receive_errors - (c->receive_errors > 0 ? 1u : 0);
}

/* ---- Modes ---- */

static void check_timing(can_t *c) {
    const uint32_t btr = reg(&c->model, BTR);
    const unsigned quanta = 3 + field(btr, 16, 4) + field(btr, 20, 3);
    if (quanta < 8 || quanta > 25 || field(btr, 24, 2) > field(btr, 20, 3)) {
        machine_violation(c->model.machine,
                          "%s_BTR: 0x%08X makes %u quanta a bit (8 to 25), or SJW is longer than segment 2",
                          model_name(&c->model), (unsigned)btr, quanta);
    }
    if (can_bit_rate(c, true) > FASTEST_HZ) {
        machine_violation(c->model.machine, "%s_BTR: 0x%08X makes %.0f bit/s, above 1 Mbit/s", model_name(&c->model),
                          (unsigned)btr, can_bit_rate(c, true));
    }
}

/* The acknowledge of what MCR asks for is due. */
static void mode_reached(void *context, int64_t time_ps) {
    can_t *const c = context;
    uint32_t *const msr = can_value(c, MSR);
    const uint32_t mcr = reg(&c->model, MCR), old = *msr;
    *msr &= ~(INAK | SLAK);
    if ((mcr & (INRQ | SLEEP)) == 0 && c->bus_off) {
        machine_cancel(c->model.machine, &c->recover);
        come_back(c);
    }
    *msr |= mcr & INRQ ? INAK : mcr & SLEEP ? SLAK : 0;
    if ((*msr & ~old & SLAK) != 0 && (reg(&c->model, IER) & 0x20000u)) {
        *msr |= SLAKI;
    }
    can_submit(c, time_ps);
    can_interrupts(c);
}

static void write_control(can_t *c, uint32_t word) {
    machine_t *const machine = c->model.machine;
    const int64_t now = machine_now(machine);
    const uint32_t old = reg(&c->model, MCR);
    if (word & MASTER_RESET) {
        model_reset(&c->model);
        return;
    }
    if (word & TTCM) {
        model_missing(&c->model, "time-triggered mode");
    }
    *can_value(c, MCR) = word;
    if (((old ^ word) & (INRQ | SLEEP)) == 0) {
        return;
    }
    if ((word & ~old & (INRQ | SLEEP)) != 0) {
        can_check_idle(c, "initialisation or sleep asked for", 0, 2);
    }
    int64_t wait = 4 * (int64_t)c->model.chip->pclk1.period_ps;
    if ((word & (INRQ | SLEEP)) == 0) { /* To normal mode: after 11 recessive bits. */
        machine_cancel(machine, &c->mode);
        if ((reg(&c->model, BTR) & LBKM) == 0 && !can_has_pin(c, false)) {
            machine_violation(machine,
                              "%s: normal mode asked for, but no pin is in the receiver's alternate function 9: it "
                              "never synchronises",
                              model_name(&c->model));
            return;
        }
        if (c->number == 1) {
            model_missing(&c->model, "a network on CAN2");
        }
        check_timing(c);
        wait = llround((c->bus_off ? RECOVERY_BITS : 11) * 1e12 / can_bit_rate(c, false));
    }
    machine_schedule(machine, &c->mode, now + wait);
}

/* ---- Registers ---- */

static void write_filter(can_t *c, uint32_t offset, uint32_t word) {
    const bool initialising = (reg(&c->model, FMR) & 1u) != 0;
    const bool layout = offset == FM1R || offset == FS1R || offset == FFA1R;
    const bool busy_bank = offset >= F0R1 && (reg(&c->model, FA1R) >> (offset - F0R1) / 8 & 1u) != 0;
    if (!initialising && (layout || busy_bank)) {
        machine_violation(c->model.machine,
                          "%s: filter register 0x%03X written outside filter initialisation (FINIT)%s",
                          model_name(&c->model), (unsigned)offset, busy_bank ? " while its bank is active" : "");
        return;
    }
    *can_value(c, offset) = word;
}

static void set(model_t *model, uint32_t offset, uint32_t word) {
    can_t *const c = (can_t *)model;
    switch (offset) {
    case MCR:
        write_control(c, word);
        break;
    case MSR:
        *can_value(c, MSR) &= ~(word & (ERRI | WKUI | SLAKI));
        break;
    case TSR:
        for (unsigned n = 0; n < 3; n++) {
            /* RQCP takes the other three with it. */
            *can_value(c, TSR) &= ~((word >> (8 * n) & 1u ? 0xFu : word >> (8 * n) & 0xEu) << (8 * n));
            if (word >> (8 * n) & 0x80u) {
                can_withdraw(c, n, machine_now(model->machine));
            }
        }
        can_submit(c, machine_now(model->machine));
        break;
    case RF0R:
        can_release(c, 0, word);
        break;
    case RF1R:
        can_release(c, 1, word);
        break;
    case ESR:
        *can_value(c, ESR) = (reg(model, ESR) & ~0x70u) | (word & 0x70u);
        break;
    case BTR:
        if ((reg(model, MSR) & INAK) == 0) {
            machine_violation(model->machine, "%s_BTR: written outside initialisation mode (INAK)", model_name(model));
            break;
        }
        *can_value(c, BTR) = word;
        break;
    case IER:
        *can_value(c, IER) = word;
        break;
    default:
        if (offset >= FMR) {
            write_filter(c, offset, word);
        } else {
            can_write_mailbox(c, offset, word);
        }
        break;
    }
    can_interrupts(c);
}

static uint32_t get(model_t *model, uint32_t offset) {
    return offset == TSR ? can_transmit_status((can_t *)model) : reg(model, offset);
}

static void restart(model_t *model) {
    can_t *const c = (can_t *)model;
    machine_cancel(model->machine, &c->mode);
    machine_cancel(model->machine, &c->recover);
    c->bus_off = false;
    c->transmit_errors = c->receive_errors = 0;
    can_transmit_restart(c);
    can_receive_restart(c);
    can_interrupts(c);
}

void can_network_in(machine_t *machine, uint32_t bit_s) {
    chip_of(machine)->can[0]->network_hz = bit_s;
}

void can_create(chip_t *chip) {
    static const model_description_t descriptions[2] = {
        {.name = "CAN1",
         .base = 0x40006400,
         .size = 0x400,
         .bus = BUS_APB1,
         .read_widths = WIDTH_32,
         .write_widths = WIDTH_32,
         .registers = registers,
         .register_count = sizeof registers / sizeof registers[0],
         .get = get,
         .set = set,
         .restart = restart},
        {.name = "CAN2",
         .base = 0x40006800,
         .size = 0x400,
         .bus = BUS_APB1,
         .read_widths = WIDTH_32,
         .write_widths = WIDTH_32,
         .registers = registers2,
         .register_count = sizeof registers2 / sizeof registers2[0],
         .get = get,
         .set = set,
         .restart = restart},
    };
    for (unsigned i = 0; i < 2; i++) {
        can_t *const c = chip_allocate(chip, sizeof *c);
        chip->can[i] = c;
        c->number = i;
        c->network_hz = BOARD_CAN_BIT_S;
        machine_event_init(&c->mode, mode_reached, c);
        machine_event_init(&c->recover, recovered, c);
        can_transmit_init(c);
        can_receive_init(c);
        model_attach(chip, &c->model, &descriptions[i]);
    }
}
