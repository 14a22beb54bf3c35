/* adc.c: the three converters and their common part: registers and triggers (see adc.h).
 * Using what is not modelled is a violation: interleaved and alternate modes, sequences of unequal conversions in
 * simultaneous modes.
 */
#include "emulator/peripherals/adc.h"

#define STABILISATION_PS 3000000

static const register_layout_t registers[] = {
    {"SR", ADC_SR, 0, 0x3F, ACCESS_RC_W0},          {"CR1", ADC_CR1, 0, 0x07C0FFFF, ACCESS_RW},
    {"CR2", ADC_CR2, 0, 0x7F7F0F03, ACCESS_RW},     {"SMPR1", ADC_SMPR1, 0, 0x07FFFFFF, ACCESS_RW},
    {"SMPR2", ADC_SMPR2, 0, 0x3FFFFFFF, ACCESS_RW}, {"JOFR1", 0x14, 0, 0xFFF, ACCESS_RW},
    {"JOFR2", 0x18, 0, 0xFFF, ACCESS_RW},           {"JOFR3", 0x1C, 0, 0xFFF, ACCESS_RW},
    {"JOFR4", 0x20, 0, 0xFFF, ACCESS_RW},           {"HTR", ADC_HTR, 0xFFF, 0xFFF, ACCESS_RW},
    {"LTR", ADC_LTR, 0, 0xFFF, ACCESS_RW},          {"SQR1", ADC_SQR1, 0, 0x00FFFFFF, ACCESS_RW},
    {"SQR2", ADC_SQR2, 0, 0x3FFFFFFF, ACCESS_RW},   {"SQR3", ADC_SQR3, 0, 0x3FFFFFFF, ACCESS_RW},
    {"JSQR", ADC_JSQR, 0, 0x003FFFFF, ACCESS_RW},   {"JDR1", 0x3C, 0, 0xFFFF, ACCESS_RO},
    {"JDR2", 0x40, 0, 0xFFFF, ACCESS_RO},           {"JDR3", 0x44, 0, 0xFFFF, ACCESS_RO},
    {"JDR4", 0x48, 0, 0xFFFF, ACCESS_RO},           {"DR", ADC_DR, 0, 0xFFFF, ACCESS_RO},
};
static const register_layout_t common_registers[] = {
    {"CSR", ADC_CSR, 0, 0x003F3F3F, ACCESS_RO},
    {"CCR", ADC_CCR, 0, 0x00C3EF1F, ACCESS_RW},
    {"CDR", ADC_CDR, 0, 0xFFFFFFFF, ACCESS_RO},
};

static const uint8_t regular_triggers[16] = {TRIGGER_TIM1_CC1,  TRIGGER_TIM1_CC2, TRIGGER_TIM1_CC3,  TRIGGER_TIM2_CC2,
                                             TRIGGER_TIM2_CC3,  TRIGGER_TIM2_CC4, TRIGGER_TIM2_TRGO, TRIGGER_TIM3_CC1,
                                             TRIGGER_TIM3_TRGO, TRIGGER_TIM4_CC4, TRIGGER_TIM5_CC1,  TRIGGER_TIM5_CC2,
                                             TRIGGER_TIM5_CC3,  TRIGGER_TIM8_CC1, TRIGGER_TIM8_TRGO, TRIGGER_EXTI11};
static const uint8_t injected_triggers[16] = {TRIGGER_TIM1_CC4, TRIGGER_TIM1_TRGO, TRIGGER_TIM2_CC1, TRIGGER_TIM2_TRGO,
                                              TRIGGER_TIM3_CC2, TRIGGER_TIM3_CC4,  TRIGGER_TIM4_CC1, TRIGGER_TIM4_CC2,
                                              TRIGGER_TIM4_CC3, TRIGGER_TIM4_TRGO, TRIGGER_TIM5_CC4, TRIGGER_TIM5_TRGO,
                                              TRIGGER_TIM8_CC2, TRIGGER_TIM8_CC3,  TRIGGER_TIM8_CC4, TRIGGER_EXTI15};

void adc_interrupt(unit_t *u) {
    const uint32_t cr1 = reg(&u->model, ADC_CR1), sr = reg(&u->model, ADC_SR);
    const bool level = ((cr1 & 0x20u) && (sr & EOC)) || ((cr1 & 0x40u) && (sr & AWD)) ||
                       ((cr1 & 0x80u) && (sr & JEOC)) || ((cr1 & 1u << 26) && (sr & OVR));
    chip_irq_shared(u->model.chip, 18, &u->irq, level);
}

/* ---- Triggers ---- */

static bool edge_selected(unsigned enable, bool rising) {
    return enable == 3 || enable == (rising ? 1u : 2u);
}

static void trigger_edge(chip_t *chip, trigger_t trigger, bool rising, int64_t time_ps) {
    if (!chip->trigger_heard[trigger]) {
        return;
    }
    for (unsigned i = 0; i < 3; i++) {
        unit_t *const u = &chip->adc->unit[i];
        const uint32_t cr2 = reg(&u->model, ADC_CR2);
        if ((cr2 & ADON) == 0) {
            continue;
        }
        if (edge_selected(field(cr2, 20, 2), rising) && injected_triggers[field(cr2, 16, 4)] == trigger &&
            !adc_follows(u, INJECTED)) {
            adc_start_injected(u, time_ps);
        }
        if (edge_selected(field(cr2, 28, 2), rising) && regular_triggers[field(cr2, 24, 4)] == trigger &&
            !adc_follows(u, REGULAR)) {
            adc_start_regular(u, time_ps);
        }
    }
}

static void listen(adc_t *adc) {
    chip_t *const chip = adc->common.chip;
    bool heard[TRIGGER_COUNT] = {false};
    bool changed = false;
    for (unsigned i = 0; i < 3; i++) {
        const uint32_t cr2 = reg(&adc->unit[i].model, ADC_CR2);
        if ((cr2 & ADON) == 0) {
            continue;
        }
        if (field(cr2, 28, 2) != 0) {
            heard[regular_triggers[field(cr2, 24, 4)]] = true;
        }
        if (field(cr2, 20, 2) != 0) {
            heard[injected_triggers[field(cr2, 16, 4)]] = true;
        }
    }
    for (unsigned i = 0; i < TRIGGER_COUNT; i++) {
        changed = changed || heard[i] != chip->trigger_heard[i];
    }
    if (changed) {
        tim_before_change(chip); /* Up to now they were not heard. */
        for (unsigned i = 0; i < TRIGGER_COUNT; i++) {
            chip->trigger_heard[i] = heard[i];
        }
        tim_after_change(chip);
    }
}

/* ---- Registers ---- */

static bool any_on(const adc_t *adc) {
    return ((reg(&adc->unit[0].model, ADC_CR2) | reg(&adc->unit[1].model, ADC_CR2) |
             reg(&adc->unit[2].model, ADC_CR2)) &
            ADON) != 0;
}

static void write_cr2(unit_t *u, uint32_t value) {
    machine_t *const machine = u->model.machine;
    const uint32_t old = reg(&u->model, ADC_CR2);
    u->model.value[ADC_CR2 / 4] = value & ~(SWSTART | JSWSTART);
    if ((value & ADON) && !(old & ADON)) {
        u->stable_ps = machine_now(machine) + STABILISATION_PS;
    } else if (!(value & ADON) && (old & ADON)) {
        adc_stop(u);
        if (!any_on(adc_of(u))) {
            adc_common_forget(adc_of(u));
        }
    }
    if ((value & DMA) == 0) {
        dma_line(u->model.chip, u->request, false);
        u->no_more_requests = false;
    }
    listen(adc_of(u));
    if ((value & JSWSTART) && field(value, 20, 2) != 0) {
        machine_violation(machine,
                          "%s: JSWSTART while an external trigger of the injected group is armed (JEXTEN): the next "
                          "trigger may convert another channel",
                          model_name(&u->model));
    }
    if ((value & JSWSTART) && !adc_follows(u, INJECTED)) {
        adc_start_injected(u, machine_now(machine));
    }
    if ((value & SWSTART) && !adc_follows(u, REGULAR)) {
        adc_start_regular(u, machine_now(machine));
    }
}

static void set(model_t *model, uint32_t offset, uint32_t value) {
    unit_t *const u = (unit_t *)model;
    switch (offset) {
    case ADC_SR:
        if ((reg(model, ADC_SR) & ~value & OVR) != 0) { /* Recovery: the sequence starts over. */
            adc_stop(u);
            u->no_more_requests = false;
        }
        model->value[ADC_SR / 4] &= value;
        break;
    case ADC_CR2:
        write_cr2(u, value);
        break;
    default:
        if (u->activity != IDLE && offset >= ADC_SQR1 && offset <= ADC_JSQR && value != reg(model, offset)) {
            machine_violation(model->machine,
                              "%s: a sequence register (SQRx, JSQR) changed during a conversion, which would start "
                              "over (RM0090 13.3.4)",
                              model_name(model));
        }
        model->value[offset / 4] = value;
        break;
    }
    adc_interrupt(u);
}

static uint32_t get(model_t *model, uint32_t offset) {
    unit_t *const u = (unit_t *)model;
    if (offset == ADC_DR) {
        u->unread = false;
        model->value[ADC_SR / 4] &= ~EOC;
        dma_line(model->chip, u->request, false);
        adc_interrupt(u);
    }
    return reg(model, offset);
}

static uint32_t common_get(model_t *model, uint32_t offset) {
    adc_t *const adc = model->chip->adc;
    if (offset == ADC_CSR) {
        return reg(&adc->unit[0].model, ADC_SR) | reg(&adc->unit[1].model, ADC_SR) << 8 |
               reg(&adc->unit[2].model, ADC_SR) << 16;
    }
    return offset == ADC_CDR ? adc_common_read(adc) : reg(model, offset);
}

static void common_set(model_t *model, uint32_t offset, uint32_t value) {
    const uint32_t old = reg(model, ADC_CCR);
    const unsigned multi = value & 31u;
    if (multi != 0 && multi != 0x01 && multi != 0x11 && multi != 0x05 && multi != 0x15 && multi != 0x06 &&
        multi != 0x16) {
        model_missing(model, "this value of MULTI (interleaved, alternate or reserved)");
    }
    if (((old ^ value) & 31u) != 0 && (old & 31u) != 0 && multi != 0) {
        machine_violation(model->machine, "ADC_CCR: MULTI must pass through independent mode when it changes");
    }
    model->value[offset / 4] = value;
    if (((old ^ value) & 0xE01Fu) != 0) {
        adc_common_forget(model->chip->adc);
    }
}

static void restart(model_t *model) {
    unit_t *const u = (unit_t *)model;
    adc_stop(u);
    u->no_more_requests = false;
    adc_interrupt(u);
    listen(model->chip->adc);
}

static void common_restart(model_t *model) {
    adc_common_forget(model->chip->adc);
}

void adc_create(chip_t *chip) {
    static const model_description_t common_description = {.name = "C_ADC",
                                                           .base = 0x40012300,
                                                           .size = 0x100,
                                                           .bus = BUS_APB2,
                                                           .read_widths = WIDTH_ANY,
                                                           .write_widths = WIDTH_32,
                                                           .registers = common_registers,
                                                           .register_count = 3,
                                                           .get = common_get,
                                                           .set = common_set,
                                                           .restart = common_restart};
    static const char *const names[3] = {"ADC1", "ADC2", "ADC3"};
    struct storage {
        adc_t adc;
        model_description_t description[3];
    } *const storage = chip_allocate(chip, sizeof *storage);
    chip->adc = &storage->adc;
    chip->signals.convert = trigger_edge;
    chip->signals.last_transfer = adc_last_transfer;
    for (unsigned i = 0; i < 3; i++) {
        unit_t *const u = &chip->adc->unit[i];
        u->number = i;
        u->request = (dma_source_t)(DMA_ADC1 + i);
        adc_group_init(u);
        storage->description[i] = (model_description_t){.name = names[i],
                                                        .base = 0x40012000u + 0x100u * i,
                                                        .size = 0x100,
                                                        .bus = BUS_APB2,
                                                        .read_widths = WIDTH_ANY,
                                                        .write_widths = WIDTH_32,
                                                        .registers = registers,
                                                        .register_count = sizeof registers / sizeof registers[0],
                                                        .get = get,
                                                        .set = set,
                                                        .restart = restart};
        model_attach(chip, &u->model, &storage->description[i]);
    }
    model_attach(chip, &chip->adc->common, &common_description);
}
