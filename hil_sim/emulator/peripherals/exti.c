/* exti.c: system configuration (RM0090 9.2) and external interrupts (RM0090 12.3). */
#include "emulator/peripherals/model.h"

enum { MEMRM = 0x00, PMC = 0x04, EXTICR1 = 0x08, EXTICR4 = 0x14, CMPCR = 0x20 };
enum { IMR = 0x00, EMR = 0x04, RTSR = 0x08, FTSR = 0x0C, SWIER = 0x10, PR = 0x14 };
#define LINES 0x007FFFFFu

static const register_layout_t syscfg_registers[] = {
    {"MEMRM", MEMRM, 0, 0x00000003, ACCESS_RW}, {"PMC", PMC, 0, 0x00800000, ACCESS_RW},
    {"EXTICR1", 0x08, 0, 0xFFFF, ACCESS_RW},    {"EXTICR2", 0x0C, 0, 0xFFFF, ACCESS_RW},
    {"EXTICR3", 0x10, 0, 0xFFFF, ACCESS_RW},    {"EXTICR4", EXTICR4, 0, 0xFFFF, ACCESS_RW},
    {"CMPCR", CMPCR, 0, 0x00000101, ACCESS_RW},
};
static const register_layout_t exti_registers[] = {
    {"IMR", IMR, 0, LINES, ACCESS_RW},   {"EMR", EMR, 0, LINES, ACCESS_RW},     {"RTSR", RTSR, 0, LINES, ACCESS_RW},
    {"FTSR", FTSR, 0, LINES, ACCESS_RW}, {"SWIER", SWIER, 0, LINES, ACCESS_RW}, {"PR", PR, 0, LINES, ACCESS_RW},
};

struct exti {
    model_t syscfg, exti;
};

static void interrupts(exti_t *exti) {
    machine_t *const machine = exti->exti.machine;
    const uint32_t active = reg(&exti->exti, PR) & reg(&exti->exti, IMR);
    for (unsigned line = 0; line < 5; line++) {
        machine_irq(machine, 6 + line, (active >> line & 1u) != 0);
    }
    machine_irq(machine, 1, (active >> 16 & 1u) != 0); /* The voltage detector. */
    machine_irq(machine, 23, (active & 0x03E0u) != 0);
    machine_irq(machine, 40, (active & 0xFC00u) != 0);
}

static void edge(exti_t *exti, unsigned line, int64_t time_ps) {
    const uint32_t bit = 1u << line;
    if (((reg(&exti->exti, IMR) | reg(&exti->exti, EMR)) & bit) == 0) {
        return;
    }
    const trigger_t trigger = line == 9    ? TRIGGER_EXTI9
                              : line == 11 ? TRIGGER_EXTI11
                              : line == 15 ? TRIGGER_EXTI15
                                           : TRIGGER_NONE;
    if (trigger != TRIGGER_NONE) {
        exti->exti.chip->signals.convert(exti->exti.chip, trigger, true, time_ps);
        exti->exti.chip->signals.output(exti->exti.chip, trigger, time_ps);
    }
    if (reg(&exti->exti, IMR) & bit) {
        exti->exti.value[PR / 4] |= bit;
        interrupts(exti);
    }
}

static void pin_edge(chip_t *chip, unsigned pin, bool level, int64_t time_ps) {
    exti_t *const exti = chip->exti;
    const unsigned line = pin % 16;
    const uint32_t selected = reg(&exti->exti, level ? RTSR : FTSR);
    if ((selected >> line & 1u) != 0 &&
        field(reg(&exti->syscfg, EXTICR1 + 4 * (line / 4)), 4 * (line % 4), 4) == pin / 16) {
        edge(exti, line, time_ps);
    }
}

void exti_line(chip_t *chip, unsigned line, bool rising, int64_t time_ps) {
    if ((reg(&chip->exti->exti, rising ? RTSR : FTSR) >> line & 1u) != 0) {
        edge(chip->exti, line, time_ps);
    }
}

static void exti_set(model_t *model, uint32_t offset, uint32_t value) {
    exti_t *const exti = model->chip->exti;
    const uint32_t old = reg(model, offset);
    switch (offset) {
    case PR: /* Written 1 clears, the software request with it. */
        model->value[PR / 4] &= ~value;
        model->value[SWIER / 4] &= ~value;
        break;
    case SWIER:
        model->value[SWIER / 4] |= value;
        for (unsigned line = 0; line < 23; line++) {
            if ((value & ~old) >> line & 1u) {
                edge(exti, line, machine_now(model->machine));
            }
        }
        break;
    default:
        model->value[offset / 4] = value;
        break;
    }
    interrupts(exti);
}

static void syscfg_set(model_t *model, uint32_t offset, uint32_t value) {
    if (offset >= EXTICR1 && offset <= EXTICR4) {
        for (unsigned i = 0; i < 4; i++) {
            if (field(value, 4 * i, 4) > 8) {
                machine_violation(model->machine, "SYSCFG_%s: 0x%X is no port",
                                  offset == EXTICR1 ? "EXTICR1" : "EXTICR2..4", field(value, 4 * i, 4));
            }
        }
    } else if (value != 0) {
        model_missing(model, "memory remapping, PHY selection and the compensation cell");
        return;
    }
    model->value[offset / 4] = value;
}

static void exti_restart(model_t *model) {
    interrupts(model->chip->exti);
}

void exti_create(chip_t *chip) {
    static const model_description_t syscfg = {.name = "SYSCFG",
                                               .base = 0x40013800,
                                               .size = 0x400,
                                               .bus = BUS_APB2,
                                               .read_widths = WIDTH_ANY,
                                               .write_widths = WIDTH_ANY,
                                               .registers = syscfg_registers,
                                               .register_count = sizeof syscfg_registers / sizeof syscfg_registers[0],
                                               .set = syscfg_set};
    static const model_description_t description = {.name = "EXTI",
                                                    .base = 0x40013C00,
                                                    .size = 0x400,
                                                    .bus = BUS_APB2,
                                                    .read_widths = WIDTH_32,
                                                    .write_widths = WIDTH_32,
                                                    .registers = exti_registers,
                                                    .register_count = sizeof exti_registers / sizeof exti_registers[0],
                                                    .set = exti_set,
                                                    .restart = exti_restart};
    chip->exti = chip_allocate(chip, sizeof *chip->exti);
    chip_listen_to_pins(chip, pin_edge);
    model_attach(chip, &chip->exti->syscfg, &syscfg);
    model_attach(chip, &chip->exti->exti, &description);
}
