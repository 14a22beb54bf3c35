/* dac.c: the two-channel digital-to-analog converter (RM0090 chapter 14).
 *
 * What is in the holding register goes to the output one APB1 cycle after it was written (TEN 0), three after a
 * timer or pin trigger, one after a software trigger. A hardware
 * trigger takes what both channels hold and then asks for DMA, so what DMA brings is for the next trigger. A trigger
 * that finds the request before still waiting is an underrun: requests stop until DMAUDR is cleared. Using what is not
 * modelled is a violation: noise and triangle waves.
 *
 * Where the configuration states a load (data sheet DS8626, 5.3.24): without its buffer the output is a source of 15
 * kOhm; with it the output reaches from 0.2 V to 0.2 V below the supply, and a load below 5 kOhm is a violation. The
 * outside sees a new value in three steps, 1, 2 and 3 us after the update: those of an exponential that comes within 4
 * counts of a full change in 3 us. A value meanwhile starts from the step before it. */
#include "emulator/peripherals/model.h"

enum {
    CR = 0x00,
    SWTRIGR = 0x04,
    DHR12R1 = 0x08,
    DHR12L1 = 0x0C,
    DHR8R1 = 0x10,
    DHR12R2 = 0x14,
    DHR12L2 = 0x18,
    DHR8R2 = 0x1C,
    DHR12RD = 0x20,
    DHR12LD = 0x24,
    DHR8RD = 0x28,
    DOR1 = 0x2C,
    SR = 0x34
};
#define EN                 1u
#define BOFF               2u /* The output buffer is off. */
#define TEN                4u
#define TSEL               0x38u
#define DMAEN              0x1000u
#define UNDERRUN_INTERRUPT 0x2000u
#define UNDERRUN           0x2000u

static const register_layout_t registers[] = {
    {"CR", CR, 0, 0x3FFF3FFF, ACCESS_RW},
    {"SWTRIGR", SWTRIGR, 0, 0x3, ACCESS_WO},
    {"DHR12R1", DHR12R1, 0, 0xFFF, ACCESS_RW},
    {"DHR12L1", DHR12L1, 0, 0xFFF0, ACCESS_RW},
    {"DHR8R1", DHR8R1, 0, 0xFF, ACCESS_RW},
    {"DHR12R2", DHR12R2, 0, 0xFFF, ACCESS_RW},
    {"DHR12L2", DHR12L2, 0, 0xFFF0, ACCESS_RW},
    {"DHR8R2", DHR8R2, 0, 0xFF, ACCESS_RW},
    {"DHR12RD", DHR12RD, 0, 0x0FFF0FFF, ACCESS_RW},
    {"DHR12LD", DHR12LD, 0, 0xFFF0FFF0, ACCESS_RW},
    {"DHR8RD", DHR8RD, 0, 0xFFFF, ACCESS_RW},
    {"DOR1", DOR1, 0, 0xFFF, ACCESS_RO},
    {"DOR2", 0x30, 0, 0xFFF, ACCESS_RO},
    {"SR", SR, 0, 0x20002000, ACCESS_RW},
};

#define SOURCE_OHM     15e3
#define BUFFER_V       0.2
#define SMALLEST_OHM   5e3
#define STEP_PS        1000000
#define SETTLING_STEPS 3
#define STEP_REMAINS   0.0992 /* (4 / 4096)^(1/3): what a step leaves of the difference. */

typedef struct {
    struct dac *dac;
    unsigned number;        /* 0: channel 1 */
    uint32_t holding, next; /* next: what the update brings to the output. */
    bool reported, complained;
    bool irq;
    machine_event_t update, settle;
    double volts, target; /* What the outside was told, and where it goes. */
    unsigned steps;       /* Steps to the target that are left. */
} channel_t;

typedef struct dac {
    model_t model;
    channel_t channel[2];
} dac_t;

static uint32_t control(const channel_t *c) {
    return reg(&c->dac->model, CR) >> (16 * c->number) & 0xFFFFu;
}

static dma_source_t request_line(const channel_t *c) {
    return c->number == 0 ? DMA_DAC1 : DMA_DAC2;
}
static bool underrun(const channel_t *c) {
    return (reg(&c->dac->model, SR) >> (16 * c->number) & UNDERRUN) != 0;
}

/* What a voltage of the converter becomes at its pin. */
static double loaded(channel_t *c, double volts) {
    const chip_t *const chip = c->dac->model.chip;
    const double load = chip->config->dac_load_Ohm, highest = chip->supply_V - BUFFER_V;
    if ((control(c) & BOFF) != 0) {
        return volts * load / (load + SOURCE_OHM);
    }
    if (load < SMALLEST_OHM && !c->complained) {
        c->complained = true;
        machine_violation(chip->machine, "DAC: channel %u drives %.0f Ohm with its buffer, which needs 5 kOhm or more",
                          c->number + 1, load);
    }
    return volts < BUFFER_V ? BUFFER_V : volts > highest ? highest : volts;
}

static void settle(void *context, int64_t time_ps) {
    channel_t *const c = context;
    const board_edge_t *const edge = c->dac->model.chip->edge;
    c->steps--;
    c->volts = c->steps == 0 ? c->target : c->target + (c->volts - c->target) * STEP_REMAINS;
    if (edge->analog_out) {
        edge->analog_out(edge->context, c->number + 1, c->volts, time_ps);
    }
    if (c->steps != 0) {
        machine_schedule(c->dac->model.machine, &c->settle, time_ps + STEP_PS);
    }
}

static void report(channel_t *c, int64_t time_ps) {
    model_t *const model = &c->dac->model;
    const board_edge_t *const edge = model->chip->edge;
    c->reported = true;
    if (!chip_pin_is_analog(model->chip, 4 + c->number)) {
        machine_violation(model->machine, "DAC: channel %u drives PA%u, which is not in analog mode", c->number + 1,
                          4 + c->number);
    }
    const double volts = model->chip->supply_V * reg(model, DOR1 + 4 * c->number) / 4096;
    if (model->chip->config->dac_load_Ohm > 0) {
        c->target = loaded(c, volts);
        c->steps = SETTLING_STEPS;
        machine_schedule(model->machine, &c->settle, time_ps + STEP_PS);
    } else if (edge->analog_out) {
        edge->analog_out(edge->context, c->number + 1, volts, time_ps);
    }
}

static void update(void *context, int64_t time_ps) {
    channel_t *const c = context;
    uint32_t *const output = &c->dac->model.value[DOR1 / 4 + c->number];
    const bool changed = *output != c->next;
    *output = c->next;
    if ((control(c) & EN) != 0 && (changed || !c->reported)) {
        report(c, time_ps);
    }
}

/* A disabled channel leaves its pin alone; the outside is told 0 V, as a load to ground makes it. */
static void release(channel_t *c) {
    const board_edge_t *const edge = c->dac->model.chip->edge;
    if (c->reported && edge->analog_out) {
        edge->analog_out(edge->context, c->number + 1, 0, machine_now(c->dac->model.machine));
    }
    c->reported = false;
    c->volts = 0;
    machine_cancel(c->dac->model.machine, &c->settle);
}

static void schedule(channel_t *c, int64_t time_ps, unsigned cycles, uint32_t next) {
    const clock_domain_t *const clock = &c->dac->model.chip->pclk1;
    c->next = next;
    machine_schedule(c->dac->model.machine, &c->update, clock_time(clock, clock_tick(clock, time_ps) + cycles));
}

static void hold(channel_t *c, uint32_t value) {
    c->holding = value & 0xFFFu;
    if ((control(c) & TEN) == 0) {
        schedule(c, machine_now(c->dac->model.machine), 1, c->holding);
    }
}

static void interrupts(dac_t *dac) {
    for (unsigned i = 0; i < 2; i++) {
        const bool level = underrun(&dac->channel[i]) && (control(&dac->channel[i]) & UNDERRUN_INTERRUPT) != 0;
        chip_irq_shared(dac->model.chip, 54, &dac->channel[i].irq, level);
    }
}

static void ask_for_next(channel_t *c) {
    chip_t *const chip = c->dac->model.chip;
    if ((control(c) & DMAEN) == 0 || underrun(c)) {
        return;
    }
    if (!chip->lines.high[request_line(c)]) {
        dma_line_pulse(chip, request_line(c));
        return;
    }
    machine_violation(chip->machine, "DAC: channel %u triggered before its DMA request was served (underrun)",
                      c->number + 1);
    c->dac->model.value[SR / 4] |= UNDERRUN << (16 * c->number);
    dma_line(chip, request_line(c), false);
    interrupts(c->dac);
}

/* TSEL 0 to 6. */
static const uint8_t triggers[7] = {TRIGGER_TIM6_TRGO, TRIGGER_TIM8_TRGO, TRIGGER_TIM7_TRGO, TRIGGER_TIM5_TRGO,
                                    TRIGGER_TIM2_TRGO, TRIGGER_TIM4_TRGO, TRIGGER_EXTI9};
enum { SOFTWARE = 7 };

static trigger_t awaited(const channel_t *c) {
    const uint32_t source = field(control(c), 3, 3);
    return (control(c) & (EN | TEN)) == (EN | TEN) && source != SOFTWARE ? (trigger_t)triggers[source] : TRIGGER_NONE;
}

static void trigger_edge(chip_t *chip, trigger_t source, int64_t time_ps) {
    dac_t *const dac = (dac_t *)chip->dac;
    for (unsigned i = 0; i < 2; i++) {
        if (awaited(&dac->channel[i]) == source) {
            schedule(&dac->channel[i], time_ps, 3, dac->channel[i].holding);
        }
    }
    for (unsigned i = 0; i < 2; i++) {
        if (awaited(&dac->channel[i]) == source) {
            ask_for_next(&dac->channel[i]);
        }
    }
}

/* Timers make an event of a trigger only while somebody waits for it. */
static void listen(dac_t *dac) {
    chip_t *const chip = dac->model.chip;
    tim_before_change(chip);
    for (unsigned i = 0; i < TRIGGER_COUNT; i++) {
        chip->trigger_wanted[i] = awaited(&dac->channel[0]) == i || awaited(&dac->channel[1]) == i;
    }
    tim_after_change(chip);
}

static void write_control(dac_t *dac, uint32_t value) {
    chip_t *const chip = dac->model.chip;
    if (value & 0x00C000C0u) {
        model_missing(&dac->model, "noise and triangle waves");
    }
    const uint32_t old = reg(&dac->model, CR);
    dac->model.value[CR / 4] = value;
    for (unsigned i = 0; i < 2; i++) {
        channel_t *const c = &dac->channel[i];
        const uint32_t before = old >> (16 * i);
        if ((before & control(c) & EN) != 0 && ((before ^ control(c)) & TSEL) != 0) {
            machine_violation(chip->machine, "DAC_CR: TSEL%u changed while EN%u is 1", i + 1, i + 1);
        }
        if ((control(c) & EN) != 0 && (before & EN) == 0) {
            c->reported = false;
            schedule(c, machine_now(chip->machine), 1,
                     (control(c) & TEN) == 0 ? c->holding : reg(&dac->model, DOR1 + 4 * i));
        }
        if ((control(c) & EN) == 0) {
            release(c);
        }
        if ((control(c) & DMAEN) == 0) {
            dma_line(chip, request_line(c), false);
        }
    }
    listen(dac);
    interrupts(dac);
}

static void software_trigger(dac_t *dac, uint32_t value) {
    for (unsigned i = 0; i < 2; i++) {
        channel_t *const c = &dac->channel[i];
        if ((value >> i & 1u) == 0) {
            continue;
        }
        if ((control(c) & (TEN | TSEL)) != (TEN | TSEL)) {
            machine_violation(dac->model.machine, "DAC_SWTRIGR: channel %u is not set to the software trigger", i + 1);
        } else {
            schedule(c, machine_now(dac->model.machine), 1, c->holding);
        }
    }
}

static void set(model_t *model, uint32_t offset, uint32_t value) {
    dac_t *const dac = (dac_t *)model;
    channel_t *const c = dac->channel;
    switch (offset) {
    case CR:
        write_control(dac, value);
        return;
    case SWTRIGR:
        software_trigger(dac, value);
        return;
    case SR: /* Written 1 clears. */
        model->value[SR / 4] &= ~value;
        interrupts(dac);
        return;
    default:
        break;
    }
    model->value[offset / 4] = value;
    switch (offset) {
    case DHR12R1:
        hold(&c[0], value);
        break;
    case DHR12L1:
        hold(&c[0], value >> 4);
        break;
    case DHR8R1:
        hold(&c[0], value << 4);
        break;
    case DHR12R2:
        hold(&c[1], value);
        break;
    case DHR12L2:
        hold(&c[1], value >> 4);
        break;
    case DHR8R2:
        hold(&c[1], value << 4);
        break;
    case DHR12RD:
        hold(&c[0], value);
        hold(&c[1], value >> 16);
        break;
    case DHR12LD:
        hold(&c[0], value >> 4);
        hold(&c[1], value >> 20);
        break;
    default:
        hold(&c[0], (value & 0xFFu) << 4);
        hold(&c[1], (value >> 8 & 0xFFu) << 4);
        break;
    }
}

static void restart(model_t *model) {
    dac_t *const dac = (dac_t *)model;
    for (unsigned i = 0; i < 2; i++) {
        machine_cancel(model->machine, &dac->channel[i].update);
        dac->channel[i].holding = 0;
        release(&dac->channel[i]);
    }
    listen(dac);
    interrupts(dac);
}

void dac_create(chip_t *chip) {
    static const model_description_t description = {.name = "DAC",
                                                    .base = 0x40007400,
                                                    .size = 0x400,
                                                    .bus = BUS_APB1,
                                                    .read_widths = WIDTH_32,
                                                    .write_widths = WIDTH_32,
                                                    .registers = registers,
                                                    .register_count = sizeof registers / sizeof registers[0],
                                                    .set = set,
                                                    .restart = restart};
    dac_t *const dac = chip_allocate(chip, sizeof *dac);
    chip->dac = &dac->model;
    chip->signals.output = trigger_edge;
    for (unsigned i = 0; i < 2; i++) {
        dac->channel[i].dac = dac;
        dac->channel[i].number = i;
        machine_event_init(&dac->channel[i].update, update, &dac->channel[i]);
        machine_event_init(&dac->channel[i].settle, settle, &dac->channel[i]);
    }
    model_attach(chip, &dac->model, &description);
}
