/* adc.c: the three converters and their common part (RM0090 chapter 13; data sheet DS8626 5.3.21).
 *
 * One event per conversion; converters in simultaneous mode share the master's event. The analog value is asked for when a conversion starts, with the time at which
 * the sampling switch opens; the result is there when the conversion ends. Clock: PCLK2 divided by ADCPRE; a trigger takes effect two converter clocks (regular) or three
 * (injected) after the next edge of that clock. A result is round(volts / 3.3 * 4096), clamped.
 * Not there, and loud: interleaved and alternate modes.
 */
#include "model.h"

#include <math.h>

enum { SR = 0x00, CR1 = 0x04, CR2 = 0x08, SMPR1 = 0x0C, SMPR2 = 0x10, JOFR1 = 0x14, HTR = 0x24, LTR = 0x28, SQR1 = 0x2C, SQR2 = 0x30, SQR3 = 0x34, JSQR = 0x38, JDR1 = 0x3C, DR = 0x4C };
enum { CSR = 0x00, CCR = 0x04, CDR = 0x08 };
#define AWD 1u
#define EOC 2u
#define JEOC 4u
#define JSTRT 8u
#define STRT 16u
#define OVR 32u
#define SCAN 0x100u
#define ADON 1u
#define CONT 2u
#define DMA 0x100u
#define DDS 0x200u
#define EOCS 0x400u
#define JSWSTART (1u << 22)
#define SWSTART (1u << 30)
#define STABILISATION_PS 3000000
#define INTERNAL_SAMPLING_PS 10e6
#define REFERENCE_V 3.3
#define ADC_LIMIT_HZ 36e6

static const register_layout_t registers[] = {
    {"SR", SR, 0, 0x3F, ACCESS_RC_W0},       {"CR1", CR1, 0, 0x07C0FFFF, ACCESS_RW},      {"CR2", CR2, 0, 0x7F7F0F03, ACCESS_RW},   {"SMPR1", SMPR1, 0, 0x07FFFFFF, ACCESS_RW},
    {"SMPR2", SMPR2, 0, 0x3FFFFFFF, ACCESS_RW}, {"JOFR1", 0x14, 0, 0xFFF, ACCESS_RW},     {"JOFR2", 0x18, 0, 0xFFF, ACCESS_RW},     {"JOFR3", 0x1C, 0, 0xFFF, ACCESS_RW},
    {"JOFR4", 0x20, 0, 0xFFF, ACCESS_RW},    {"HTR", HTR, 0xFFF, 0xFFF, ACCESS_RW},       {"LTR", LTR, 0, 0xFFF, ACCESS_RW},        {"SQR1", SQR1, 0, 0x00FFFFFF, ACCESS_RW},
    {"SQR2", SQR2, 0, 0x3FFFFFFF, ACCESS_RW}, {"SQR3", SQR3, 0, 0x3FFFFFFF, ACCESS_RW},   {"JSQR", JSQR, 0, 0x003FFFFF, ACCESS_RW}, {"JDR1", 0x3C, 0, 0xFFFF, ACCESS_RO},
    {"JDR2", 0x40, 0, 0xFFFF, ACCESS_RO},    {"JDR3", 0x44, 0, 0xFFFF, ACCESS_RO},        {"JDR4", 0x48, 0, 0xFFFF, ACCESS_RO},     {"DR", DR, 0, 0xFFFF, ACCESS_RO},
};
static const register_layout_t common_registers[] = {
    {"CSR", CSR, 0, 0x003F3F3F, ACCESS_RO}, {"CCR", CCR, 0, 0x00C3EF1F, ACCESS_RW}, {"CDR", CDR, 0, 0xFFFFFFFF, ACCESS_RO},
};

static const uint8_t regular_triggers[16] = {
    TRIGGER_TIM1_CC1, TRIGGER_TIM1_CC2, TRIGGER_TIM1_CC3, TRIGGER_TIM2_CC2, TRIGGER_TIM2_CC3, TRIGGER_TIM2_CC4, TRIGGER_TIM2_TRGO, TRIGGER_TIM3_CC1,
    TRIGGER_TIM3_TRGO, TRIGGER_TIM4_CC4, TRIGGER_TIM5_CC1, TRIGGER_TIM5_CC2, TRIGGER_TIM5_CC3, TRIGGER_TIM8_CC1, TRIGGER_TIM8_TRGO, TRIGGER_EXTI11};
static const uint8_t injected_triggers[16] = {
    TRIGGER_TIM1_CC4, TRIGGER_TIM1_TRGO, TRIGGER_TIM2_CC1, TRIGGER_TIM2_TRGO, TRIGGER_TIM3_CC2, TRIGGER_TIM3_CC4, TRIGGER_TIM4_CC1, TRIGGER_TIM4_CC2,
    TRIGGER_TIM4_CC3, TRIGGER_TIM4_TRGO, TRIGGER_TIM5_CC4, TRIGGER_TIM5_TRGO, TRIGGER_TIM8_CC2, TRIGGER_TIM8_CC3, TRIGGER_TIM8_CC4, TRIGGER_EXTI15};

typedef enum { IDLE, REGULAR, INJECTED } activity_t;

typedef struct {
    model_t model;
    unsigned number; /* 0: ADC1 */
    dma_source_t request;
    activity_t activity;
    bool regular_waits;             /* A regular sequence was interrupted by an injected one. */
    unsigned index, injected_index; /* Place in the sequence. */
    uint32_t result;                /* Of the running conversion, 12 bits. */
    bool unread, no_more_requests, irq;
    int64_t stable_ps;
    machine_event_t done;
} unit_t;

struct adc {
    unit_t unit[3];
    model_t common;
    uint16_t queue[8]; /* Results that wait for the common data register. */
    unsigned queued;
    bool no_more_requests;
};

static adc_t *adc_of(const unit_t *u) { return u->model.chip->adc; }
static uint32_t common(const unit_t *u) { return adc_of(u)->common.value[CCR / 4]; }

/* How many converters take part, and in which groups they go together. */
static unsigned multi_units(const adc_t *adc)
{
    const unsigned multi = reg(&adc->common, CCR) & 31u;
    return multi == 0 ? 1 : multi & 16u ? 3 : 2;
}
static bool regular_together(const adc_t *adc) { const unsigned m = reg(&adc->common, CCR) & 15u; return m == 1 || m == 2 || m == 6; }
static bool injected_together(const adc_t *adc) { const unsigned m = reg(&adc->common, CCR) & 15u; return m == 1 || m == 5; }

static int64_t divider(const unit_t *u) { return 2 * ((int64_t)field(common(u), 16, 2) + 1); }
static unsigned resolution(const unit_t *u) { return 12 - 2 * field(reg(&u->model, CR1), 24, 2); }
static unsigned regular_length(const unit_t *u) { return reg(&u->model, CR1) & SCAN ? field(reg(&u->model, SQR1), 20, 4) + 1 : 1; }
static unsigned injected_length(const unit_t *u) { return reg(&u->model, CR1) & SCAN ? field(reg(&u->model, JSQR), 20, 2) + 1 : 1; }

static unsigned regular_channel(const unit_t *u, unsigned index)
{
    static const uint8_t offsets[3] = {SQR3, SQR2, SQR1};
    return field(reg(&u->model, offsets[index / 6 % 3]), 5 * (index % 6), 5); /* At most 16 ranks. */
}

static unsigned injected_channel(const unit_t *u, unsigned index)
{
    return field(reg(&u->model, JSQR), 5 * (index + 3 - field(reg(&u->model, JSQR), 20, 2)), 5);
}

static unsigned sampling(const unit_t *u, unsigned channel)
{
    static const uint16_t cycles[8] = {3, 15, 28, 56, 84, 112, 144, 480};
    return cycles[channel < 10 ? field(reg(&u->model, SMPR2), 3 * channel, 3) : field(reg(&u->model, SMPR1), 3 * (channel - 10), 3)];
}

static void interrupt(unit_t *u)
{
    const uint32_t cr1 = reg(&u->model, CR1), sr = reg(&u->model, SR);
    const bool level = ((cr1 & 0x20u) && (sr & EOC)) || ((cr1 & 0x40u) && (sr & AWD)) || ((cr1 & 0x80u) && (sr & JEOC)) || ((cr1 & 1u << 26) && (sr & OVR));
    chip_irq_shared(u->model.chip, 18, &u->irq, level);
}

/* ---- The analog side ---- */

static unsigned pin_of(unsigned unit, unsigned channel)
{
    static const uint8_t first[16] = {0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 32, 33, 34, 35, 36, 37};            /* PA0..7, PB0, PB1, PC0..5 */
    static const uint8_t third[16] = {0, 1, 2, 3, 86, 87, 88, 89, 90, 83, 32, 33, 34, 35, 84, 85};        /* PF6..10, PF3, PF4, PF5 */
    return unit == 2 ? third[channel] : first[channel];
}

static double internal_volts(unit_t *u, unsigned channel, double sampling_ps)
{
    const bool battery = channel == 18;
    if (u->number != 0 || (common(u) >> (battery ? 22 : 23) & 1u) == 0) {
        machine_violation(u->model.machine, "%s: channel %u converted, but %s", model_name(&u->model), channel, u->number != 0 ? "only ADC1 has it" : "ADC_CCR does not enable it");
        return 0;
    }
    if (sampling_ps < INTERNAL_SAMPLING_PS && !battery) {
        machine_violation(u->model.machine, "ADC1: channel %u needs 10 us of sampling, got %.3f us", channel, sampling_ps * 1e-6);
    }
    return battery ? 1.65 : channel == 17 ? 1.21 : 0.76 + 0.0025 * (u->model.chip->config->temperature_degc - 25);
}

static uint32_t sample(unit_t *u, unsigned channel, int64_t time_ps, double sampling_ps)
{
    chip_t *const chip = u->model.chip;
    double volts = 0;
    if (channel > 18) {
        machine_violation(chip->machine, "%s: there is no channel %u", model_name(&u->model), channel);
    } else if (channel > 15) {
        volts = internal_volts(u, channel, sampling_ps);
    } else {
        const unsigned pin = pin_of(u->number, channel);
        if (!chip_pin_is_analog(chip, pin)) {
            machine_violation(chip->machine, "%s: channel %u converted, but its pin P%c%u is not in analog mode", model_name(&u->model), channel, (char)('A' + pin / 16), pin % 16);
        }
        volts = chip->edge->analog_in ? chip->edge->analog_in(chip->edge->context, pin, time_ps) : 0;
    }
    const double code = floor(volts / REFERENCE_V * 4096 + 0.5);
    return code < 0 || isnan(code) ? 0 : code > 4095 ? 4095 : (uint32_t)code;
}

static uint32_t aligned(const unit_t *u, int32_t value)
{
    const unsigned bits = resolution(u);
    if ((reg(&u->model, CR2) & 0x800u) == 0) {
        return (uint32_t)value & 0xFFFFu;
    }
    return ((uint32_t)value << (bits == 6 ? 2 : 16 - bits)) & 0xFFFFu;
}

static void watchdog(unit_t *u, unsigned channel, uint32_t value, bool injected)
{
    const uint32_t cr1 = reg(&u->model, CR1);
    if ((cr1 >> (injected ? 22 : 23) & 1u) == 0 || ((cr1 & 0x200u) && (cr1 & 31u) != channel)) {
        return;
    }
    const uint32_t full = value << (12 - resolution(u));
    if (full > reg(&u->model, HTR) || full < reg(&u->model, LTR)) {
        u->model.value[SR / 4] |= AWD;
    }
}

/* ---- Conversions ---- */

/* The group's members: the unit alone, or master and slaves. */
static unsigned members(const unit_t *u, activity_t activity)
{
    const adc_t *const adc = adc_of(u);
    return u->number == 0 && (activity == REGULAR ? regular_together(adc) : injected_together(adc)) ? multi_units(adc) : 1;
}

static unsigned current_channel(const unit_t *u, activity_t activity) { return activity == REGULAR ? regular_channel(u, u->index) : injected_channel(u, u->injected_index); }

static void begin(unit_t *master, activity_t activity, int64_t tick)
{
    chip_t *const chip = master->model.chip;
    const int64_t div = divider(master);
    const unsigned count = members(master, activity);
    const unsigned cycles = sampling(master, current_channel(master, activity)), bits = resolution(master);
    const int64_t opens = clock_time(&chip->pclk2, tick + cycles * div);
    const double sampling_ps = (double)(cycles * div) * chip->pclk2.period_ps;
    for (unsigned i = 0; i < count; i++) {
        unit_t *const u = count == 1 ? master : &chip->adc->unit[i];
        u->activity = activity;
        if (u != master) {
            u->index = master->index;
            u->injected_index = master->injected_index;
            if (sampling(u, current_channel(u, activity)) != cycles || resolution(u) != bits) {
                machine_violation(chip->machine, "%s: sampling time or resolution differs from the master's in simultaneous mode", model_name(&u->model));
            }
        }
        u->result = sample(u, current_channel(u, activity), opens, sampling_ps);
    }
    machine_schedule(chip->machine, &master->done, clock_time(&chip->pclk2, tick + (cycles + bits) * div));
}

static bool ready(unit_t *u, const char *what)
{
    chip_t *const chip = u->model.chip;
    const char *wrong = NULL;
    if ((reg(&u->model, CR2) & ADON) == 0 || !u->model.clocked) {
        wrong = "while ADON is 0 or its clock is off";
    } else if (machine_now(chip->machine) < u->stable_ps) {
        wrong = "less than 3 us after ADON was set";
    } else if (chip->pclk2.nominal_hz / (double)divider(u) > ADC_LIMIT_HZ + 1) {
        wrong = "with a converter clock above 36 MHz (ADCPRE)";
    }
    if (wrong != NULL) {
        machine_violation(chip->machine, "%s: %s %s", model_name(&u->model), what, wrong);
    }
    return wrong == NULL;
}

/* First converter clock edge at or after time, plus the latency. */
static int64_t start_tick(const unit_t *u, int64_t time_ps, int64_t latency)
{
    const int64_t div = divider(u), tick = clock_tick(&u->model.chip->pclk2, time_ps);
    return (tick + div - 1) / div * div + latency * div;
}

static void start_regular(unit_t *u, int64_t time_ps)
{
    const unsigned count = members(u, REGULAR);
    for (unsigned i = 0; i < count; i++) {
        unit_t *const member = count == 1 ? u : &adc_of(u)->unit[i];
        if (!ready(member, "regular conversion started")) {
            return;
        }
        if (regular_length(member) != regular_length(u)) {
            machine_violation(u->model.machine, "%s: sequence length differs from the master's in simultaneous mode", model_name(&member->model));
        }
    }
    if (reg(&u->model, SR) & OVR) {
        return; /* No conversion until OVR is cleared. */
    }
    if (u->activity == REGULAR || u->regular_waits) {
        machine_violation(u->model.machine, "%s: a trigger came while the sequence was still being converted, and was lost", model_name(&u->model));
        return;
    }
    if ((reg(&u->model, CR1) & 0x800u) == 0) { /* Not discontinuous: from the start. */
        u->index = 0;
    }
    for (unsigned i = 0; i < count; i++) {
        (count == 1 ? u : &adc_of(u)->unit[i])->model.value[SR / 4] |= STRT;
    }
    if (u->activity == INJECTED) {
        u->regular_waits = true;
    } else {
        begin(u, REGULAR, start_tick(u, time_ps, 2));
    }
}

static void start_injected(unit_t *u, int64_t time_ps)
{
    if (!ready(u, "injected conversion started")) {
        return;
    }
    if (u->activity == INJECTED) {
        machine_violation(u->model.machine, "%s: an injected trigger came while the injected group was still being converted, and was lost", model_name(&u->model));
        return;
    }
    u->regular_waits = u->activity == REGULAR;
    if ((reg(&u->model, CR1) & 0x1000u) == 0) {
        u->injected_index = 0;
    }
    const unsigned count = members(u, INJECTED);
    for (unsigned i = 0; i < count; i++) {
        (count == 1 ? u : &adc_of(u)->unit[i])->model.value[SR / 4] |= JSTRT;
    }
    begin(u, INJECTED, start_tick(u, time_ps, 3));
}

static void overrun(unit_t *u)
{
    machine_violation(u->model.machine, "%s: overrun, a result was lost (OVR)", model_name(&u->model));
    u->model.value[SR / 4] |= OVR;
    dma_line(u->model.chip, u->request, false);
}

static bool common_request(const adc_t *adc)
{
    const unsigned mode = field(reg(&adc->common, CCR), 14, 2);
    return mode != 0 && adc->queued >= (mode == 1 ? 1u : 2u);
}

static void store_regular(unit_t *u, bool last)
{
    const unsigned bits = resolution(u);
    const uint32_t cr2 = reg(&u->model, CR2), value = u->result >> (12 - bits);
    const bool by_common = field(common(u), 14, 2) != 0 && multi_units(adc_of(u)) > 1;
    watchdog(u, regular_channel(u, u->index), value, false);
    if (u->unread && !by_common && (cr2 & (DMA | EOCS)) != 0 && !u->no_more_requests) {
        overrun(u);
        return;
    }
    u->model.value[DR / 4] = aligned(u, (int32_t)value);
    u->unread = true;
    if (last || (cr2 & EOCS) != 0) {
        u->model.value[SR / 4] |= EOC;
    }
    if (by_common) {
        adc_t *const adc = adc_of(u);
        if (adc->queued == sizeof adc->queue / sizeof adc->queue[0]) {
            overrun(u);
            return;
        }
        adc->queue[adc->queued++] = (uint16_t)u->model.value[DR / 4];
    } else if ((cr2 & DMA) != 0 && !u->no_more_requests) {
        dma_line(u->model.chip, u->request, true);
    }
}

static void store_injected(unit_t *u)
{
    const uint32_t value = u->result >> (12 - resolution(u));
    watchdog(u, injected_channel(u, u->injected_index), value, true);
    u->model.value[JDR1 / 4 + u->injected_index] = aligned(u, (int32_t)value - (int32_t)reg(&u->model, JOFR1 + 4 * u->injected_index));
}

/* After a group: what runs next. */
static void next_injected(unit_t *u, unsigned count, int64_t tick)
{
    const bool last = ++u->injected_index >= injected_length(u);
    for (unsigned i = 0; i < count && last; i++) {
        (count == 1 ? u : &adc_of(u)->unit[i])->model.value[SR / 4] |= JEOC;
    }
    if (!last && (reg(&u->model, CR1) & 0x1000u) == 0) {
        begin(u, INJECTED, tick);
        return;
    }
    if (last) {
        u->injected_index = 0;
    }
    if (u->regular_waits) {
        u->regular_waits = false;
        begin(u, REGULAR, tick);
    }
}

static void next_regular(unit_t *u, bool last, int64_t tick)
{
    const uint32_t cr1 = reg(&u->model, CR1);
    u->index = last ? 0 : u->index + 1;
    if (reg(&u->model, SR) & OVR) {
        return;
    }
    const bool pause = (cr1 & 0x800u) != 0 && (u->index % (field(cr1, 13, 3) + 1)) == 0;
    if (last && (cr1 & 0x400u) != 0) { /* JAUTO */
        u->regular_waits = (reg(&u->model, CR2) & CONT) != 0;
        u->injected_index = 0;
        begin(u, INJECTED, tick);
    } else if (last ? (reg(&u->model, CR2) & CONT) != 0 : !pause) {
        begin(u, REGULAR, tick);
    }
}

static void conversion_done(void *context, int64_t time_ps)
{
    unit_t *const master = context;
    adc_t *const adc = adc_of(master);
    const activity_t activity = master->activity;
    const unsigned count = members(master, activity);
    const int64_t tick = clock_tick(&master->model.chip->pclk2, time_ps);
    const bool last = master->index + 1 >= regular_length(master);
    for (unsigned i = 0; i < count; i++) {
        unit_t *const u = count == 1 ? master : &adc->unit[i];
        u->activity = IDLE;
        if (activity == REGULAR) {
            store_regular(u, last);
        } else {
            store_injected(u);
        }
    }
    if (activity == REGULAR) {
        next_regular(master, last, tick);
        if (common_request(adc) && !adc->no_more_requests) {
            dma_line(master->model.chip, DMA_ADC1, true);
            if (count > 1 && common_request(adc) && !adc->no_more_requests) {
                overrun(master); /* Nobody fetched them. */
            }
        }
    } else {
        next_injected(master, count, tick);
    }
    for (unsigned i = 0; i < count; i++) {
        interrupt(count == 1 ? master : &adc->unit[i]);
    }
}

void adc_last_transfer(chip_t *chip, dma_source_t source)
{
    if (source < DMA_ADC1 || source > DMA_ADC3) {
        return;
    }
    unit_t *const u = &chip->adc->unit[source - DMA_ADC1];
    if (multi_units(chip->adc) > 1 && source == DMA_ADC1) {
        chip->adc->no_more_requests = (reg(&chip->adc->common, CCR) >> 13 & 1u) == 0;
    } else {
        u->no_more_requests = (reg(&u->model, CR2) & DDS) == 0;
    }
}

/* ---- Triggers ---- */

static bool edge_selected(unsigned enable, bool rising) { return enable == 3 || enable == (rising ? 1u : 2u); }

void adc_trigger_edge(chip_t *chip, trigger_t trigger, bool rising, int64_t time_ps)
{
    if (!chip->trigger_heard[trigger]) {
        return;
    }
    adc_t *const adc = chip->adc;
    for (unsigned i = 0; i < 3; i++) {
        unit_t *const u = &adc->unit[i];
        const uint32_t cr2 = reg(&u->model, CR2);
        if ((cr2 & ADON) == 0) {
            continue;
        }
        const bool slave = i > 0 && i < multi_units(adc);
        if (edge_selected(field(cr2, 20, 2), rising) && injected_triggers[field(cr2, 16, 4)] == trigger && !(slave && injected_together(adc))) {
            start_injected(u, time_ps);
        }
        if (edge_selected(field(cr2, 28, 2), rising) && regular_triggers[field(cr2, 24, 4)] == trigger && !(slave && regular_together(adc))) {
            start_regular(u, time_ps);
        }
    }
}

static void listen(adc_t *adc)
{
    chip_t *const chip = adc->common.chip;
    bool heard[TRIGGER_COUNT] = {false};
    bool changed = false;
    for (unsigned i = 0; i < 3; i++) {
        const uint32_t cr2 = reg(&adc->unit[i].model, CR2);
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

static void stop(unit_t *u)
{
    machine_cancel(u->model.machine, &u->done);
    u->activity = IDLE;
    u->regular_waits = u->unread = false;
    u->index = u->injected_index = 0;
}

static void write_cr2(unit_t *u, uint32_t value)
{
    machine_t *const machine = u->model.machine;
    const uint32_t old = reg(&u->model, CR2);
    u->model.value[CR2 / 4] = value & ~(SWSTART | JSWSTART);
    if ((value & ADON) && !(old & ADON)) {
        u->stable_ps = machine_now(machine) + STABILISATION_PS;
    } else if (!(value & ADON) && (old & ADON)) {
        stop(u);
    }
    if ((value & DMA) == 0) {
        dma_line(u->model.chip, u->request, false);
        u->no_more_requests = false;
    }
    listen(adc_of(u));
    if ((value & JSWSTART) && !(u->number > 0 && u->number < multi_units(adc_of(u)) && injected_together(adc_of(u)))) {
        start_injected(u, machine_now(machine));
    }
    if ((value & SWSTART) && !(u->number > 0 && u->number < multi_units(adc_of(u)) && regular_together(adc_of(u)))) {
        start_regular(u, machine_now(machine));
    }
}

static void set(model_t *model, uint32_t offset, uint32_t value)
{
    unit_t *const u = (unit_t *)model;
    switch (offset) {
    case SR:
        if ((reg(model, SR) & ~value & OVR) != 0) { /* Recovery: the sequence starts over. */
            stop(u);
            u->no_more_requests = false;
        }
        model->value[SR / 4] &= value;
        break;
    case CR2: write_cr2(u, value); break;
    default:
        if (u->activity == REGULAR && (offset == SQR1 || offset == SQR2 || offset == SQR3)) {
            machine_violation(model->machine, "%s: regular sequence changed while it is being converted", model_name(model));
        }
        model->value[offset / 4] = value;
        break;
    }
    interrupt(u);
}

static uint32_t get(model_t *model, uint32_t offset)
{
    unit_t *const u = (unit_t *)model;
    if (offset == DR) {
        u->unread = false;
        model->value[SR / 4] &= ~EOC;
        dma_line(model->chip, u->request, false);
        interrupt(u);
    }
    return reg(model, offset);
}

static uint32_t read_common_data(adc_t *adc)
{
    const unsigned mode = field(reg(&adc->common, CCR), 14, 2), take = mode == 1 ? 1 : 2;
    uint32_t value = adc->unit[0].model.value[DR / 4] | adc->unit[1].model.value[DR / 4] << 16;
    if (mode != 0 && adc->queued >= take) {
        value = mode == 1 ? adc->queue[0] : mode == 2 ? adc->queue[0] | (uint32_t)adc->queue[1] << 16 : (adc->queue[0] & 0xFFu) | (adc->queue[1] & 0xFFu) << 8;
        adc->queued -= take;
        for (unsigned i = 0; i < adc->queued; i++) {
            adc->queue[i] = adc->queue[i + take];
        }
    }
    for (unsigned i = 0; i < multi_units(adc); i++) {
        adc->unit[i].unread = false;
        adc->unit[i].model.value[SR / 4] &= ~EOC;
        interrupt(&adc->unit[i]);
    }
    if (!common_request(adc)) {
        dma_line(adc->common.chip, DMA_ADC1, false);
    }
    return value;
}

static uint32_t common_get(model_t *model, uint32_t offset)
{
    adc_t *const adc = model->chip->adc;
    if (offset == CSR) {
        return reg(&adc->unit[0].model, SR) | reg(&adc->unit[1].model, SR) << 8 | reg(&adc->unit[2].model, SR) << 16;
    }
    return offset == CDR ? read_common_data(adc) : reg(model, offset);
}

static void common_set(model_t *model, uint32_t offset, uint32_t value)
{
    adc_t *const adc = model->chip->adc;
    const uint32_t old = reg(model, CCR);
    const unsigned multi = value & 31u;
    if (multi != 0 && multi != 0x01 && multi != 0x11 && multi != 0x05 && multi != 0x15 && multi != 0x06 && multi != 0x16) {
        model_missing(model, "this value of MULTI (interleaved, alternate or reserved)");
    }
    if (((old ^ value) & 31u) != 0 && (old & 31u) != 0 && multi != 0) {
        machine_violation(model->machine, "ADC_CCR: MULTI must pass through independent mode when it changes");
    }
    model->value[offset / 4] = value;
    if (((old ^ value) & 0xE01Fu) != 0) {
        adc->queued = 0;
        adc->no_more_requests = false;
    }
}

static void restart(model_t *model)
{
    unit_t *const u = (unit_t *)model;
    stop(u);
    u->no_more_requests = false;
    interrupt(u);
    listen(model->chip->adc);
}

static void common_restart(model_t *model)
{
    model->chip->adc->queued = 0;
    model->chip->adc->no_more_requests = false;
}

void adc_create(chip_t *chip)
{
    static const model_description_t common_description = {.name = "C_ADC", .base = 0x40012300, .size = 0x100, .bus = BUS_APB2, .read_widths = WIDTH_ANY, .write_widths = WIDTH_32,
        .registers = common_registers, .register_count = 3, .get = common_get, .set = common_set, .restart = common_restart};
    static const char *const names[3] = {"ADC1", "ADC2", "ADC3"};
    struct storage {
        adc_t adc;
        model_description_t description[3];
    } *const storage = chip_allocate(chip, sizeof *storage);
    chip->adc = &storage->adc;
    for (unsigned i = 0; i < 3; i++) {
        unit_t *const u = &chip->adc->unit[i];
        u->number = i;
        u->request = (dma_source_t)(DMA_ADC1 + i);
        machine_event_init(&u->done, conversion_done, u);
        storage->description[i] = (model_description_t){.name = names[i], .base = 0x40012000u + 0x100u * i, .size = 0x100, .bus = BUS_APB2, .read_widths = WIDTH_ANY,
            .write_widths = WIDTH_32, .registers = registers, .register_count = sizeof registers / sizeof registers[0], .get = get, .set = set, .restart = restart};
        model_attach(chip, &u->model, &storage->description[i]);
    }
    model_attach(chip, &chip->adc->common, &common_description);
}

/* ---- machine.h ---- */

void adc_trigger(machine_t *machine, const char *source, int64_t time_ps)
{
    chip_t *const chip = chip_of(machine);
    static const char *const names[TRIGGER_COUNT] = {
        "TIM1_CC1", "TIM1_CC2", "TIM1_CC3", "TIM1_CC4", "TIM1_TRGO", "TIM2_CC1", "TIM2_CC2", "TIM2_CC3", "TIM2_CC4", "TIM2_TRGO", "TIM3_CC1", "TIM3_CC2",
        "TIM3_CC3", "TIM3_CC4", "TIM3_TRGO", "TIM4_CC1", "TIM4_CC2", "TIM4_CC3", "TIM4_CC4", "TIM4_TRGO", "TIM5_CC1", "TIM5_CC2", "TIM5_CC3", "TIM5_CC4",
        "TIM5_TRGO", "TIM8_CC1", "TIM8_CC2", "TIM8_CC3", "TIM8_CC4", "TIM8_TRGO", "TIM6_TRGO", "TIM7_TRGO", "EXTI9", "EXTI11", "EXTI15"};
    for (unsigned i = 0; i < TRIGGER_COUNT; i++) {
        const char *a = names[i], *b = source;
        while (*a != '\0' && *a == *b) {
            a++;
            b++;
        }
        if (*a == *b) {
            adc_trigger_edge(chip, (trigger_t)i, true, time_ps);
            adc_trigger_edge(chip, (trigger_t)i, false, time_ps);
            return;
        }
    }
    machine_violation(machine, "ADC: there is no trigger %s", source);
}
