/* tim.c: timers 1 to 14, counting up (RM0090 chapters 17 to 20): registers, interrupts, DMA requests (see tim.h). Using
 * what is not modelled is a violation: counting down and centre-aligned, encoder, gated and external-clock modes, ETR.
 */
#include "emulator/peripherals/tim.h"

/* The break's line is the one before the update's, the commutation's request the one behind the trigger's. */
#define BREAK_IRQ(t)   ((t)->what->irq_update - 1)
#define COM_REQUEST(t) ((t)->what->advanced ? (dma_source_t)((t)->what->dma_trigger + 1) : DMA_NONE)

void tim_interrupt(tim_t *t) {
    const uint32_t active = t->model.value[TIM_SR / 4] & t->model.value[TIM_DIER / 4];
    const bool separate = t->what->irq_update != t->what->irq_channels;
    chip_irq_shared(t->model.chip, t->what->irq_update, &t->update_line,
                    separate ? (active & UIF) != 0 : (active & 0x5Fu) != 0);
    if (separate) {
        chip_irq_shared(t->model.chip, BREAK_IRQ(t), &t->break_line, (active & BIF) != 0);
        chip_irq_shared(t->model.chip, t->what->irq_channels, &t->channel_line, (active & 0x1Eu) != 0);
        chip_irq_shared(t->model.chip, t->what->irq_trigger, &t->trigger_line, (active & (TIF | COMIF)) != 0);
    }
}

void tim_pulse_dma(tim_t *t, unsigned enable_bit, dma_source_t source) {
    if ((t->model.value[TIM_DIER / 4] >> enable_bit & 1u) != 0 && source != DMA_NONE) {
        if (source == t->burst_source) {
            t->burst_index = 0; /* A new event begins a new burst. */
        }
        dma_line_pulse(t->model.chip, source);
    }
}

bool tim_asks_at_update(const tim_t *t) {
    return (t->model.value[TIM_CR2 / 4] & CCDS) != 0;
}

void tim_channel_dma(tim_t *t, unsigned channel) {
    if (!tim_asks_at_update(t)) {
        tim_pulse_dma(t, 9 + channel, t->what->dma_channel[channel]);
    }
}

/* ---- Registers ---- */

static void check_modes(tim_t *t, uint32_t offset, uint32_t value) {
    const char *missing = NULL;
    if (offset == TIM_CR1 && (value & 0x70u) != 0) {
        missing = "counting down or centre-aligned";
    } else if (offset == TIM_CR2 && (value & 0x80u) != 0) {
        missing = "the exclusive-or input";
    } else if (offset == TIM_SMCR &&
               ((value & 0xFF00u) != 0 || ((value & 7u) != 0 && (value & 7u) != 4 && (value & 7u) != 6) ||
                ((value & 7u) != 0 && (value & 0x70u) == 0x70u))) {
        missing = "slave modes other than reset and trigger, and the external trigger";
    } else if ((offset == TIM_CCMR1 || offset == TIM_CCMR2) && ((value & 3u) == 3 || (value & 0x300u) == 0x300u)) {
        missing = "capture from TRC";
    } else if (offset == TIM_OR && value != 0) {
        missing = "remapped inputs";
    }
    if (missing != NULL) {
        model_missing(&t->model, missing);
    }
}

void tim_commutate(tim_t *t) {
    tim_take_modes(t, true);
    t->model.value[TIM_SR / 4] |= COMIF;
    tim_interrupt(t);
    tim_pulse_dma(t, 13, COM_REQUEST(t));
}

static void generate(tim_t *t, uint32_t value, int64_t tick) {
    if (value & COMIF) { /* The events have the places of their flags. */
        tim_commutate(t);
    }
    if (value & BIF) {
        tim_break(t, machine_now(t->model.machine));
    }
    if (value & 1u) {
        tim_restart_counter(t, tick);
    }
    for (unsigned i = 0; i < t->what->channels; i++) {
        if ((value & 2u << i) == 0) {
            continue;
        }
        if (tim_is_capture(t, i)) {
            tim_capture(t, i, machine_now(t->model.machine));
        } else {
            tim_compare_match(t, i, tick);
        }
    }
    if (value & TIF) {
        t->model.value[TIM_SR / 4] |= TIF;
        tim_interrupt(t);
        tim_pulse_dma(t, 14, t->what->dma_trigger);
    }
}

static uint32_t burst_register(tim_t *t) {
    t->burst_source = t->model.chip->lines.served;
    const uint32_t dcr = t->model.value[TIM_DCR / 4];
    const uint32_t offset = 4 * (field(dcr, 0, 5) + t->burst_index);
    t->burst_index = t->burst_index == field(dcr, 8, 5) ? 0 : t->burst_index + 1;
    return offset;
}

static void set(model_t *model, uint32_t offset, uint32_t value);

static void burst_write(tim_t *t, uint32_t value) {
    const uint32_t offset = burst_register(t);
    if (offset >= TIM_DCR || t->model.slot[offset / 4] == 0) {
        machine_violation(t->model.machine, "%s_DMAR: the burst reaches offset 0x%02X, where no register is",
                          model_name(&t->model), (unsigned)offset);
    } else {
        set(&t->model, offset, value);
    }
    if (t->burst_index != 0 && t->burst_source != DMA_NONE) {
        dma_line_pulse(t->model.chip, t->burst_source);
    }
}

static void write_cr1(tim_t *t, uint32_t value, int64_t tick) {
    t->model.value[TIM_CR1 / 4] = value;
    if ((value & ARPE) == 0) {
        t->reload = t->model.value[TIM_ARR / 4];
    }
    if ((value & CEN) != 0 && !t->running) {
        tim_start(t, tick + 1); /* The counter starts one clock after CEN. */
        if (tim_master_mode(t) == 1) {
            tim_trgo(t, true, false, machine_now(t->model.machine));
        }
    } else if ((value & CEN) == 0 && t->running) {
        t->base_count = tim_position(t, tick);
        t->running = false;
        if (tim_master_mode(t) == 1) {
            tim_trgo(t, false, false, machine_now(t->model.machine));
        }
    }
}

static void write_dier(tim_t *t, uint32_t value) {
    const uint32_t gone = t->model.value[TIM_DIER / 4] & ~value;
    t->model.value[TIM_DIER / 4] = value;
    for (unsigned i = 0; i < 7; i++) { /* A request that waits falls with its enable bit. */
        const dma_source_t source = i == 0   ? t->what->dma_update
                                    : i < 5  ? t->what->dma_channel[i - 1]
                                    : i == 5 ? COM_REQUEST(t)
                                             : t->what->dma_trigger;
        if ((gone >> (8 + i) & 1u) != 0 && source != DMA_NONE) {
            dma_line(t->model.chip, source, false);
        }
    }
    tim_interrupt(t);
}

static void write_smcr(tim_t *t, uint32_t value) {
    tim_before_change(t->model.chip); /* Masters that nobody listened to have made no events. */
    t->model.value[TIM_SMCR / 4] = value;
    tim_connect_slaves(t->model.chip);
    tim_after_change(t->model.chip);
}

static void write_arr(tim_t *t, uint32_t value, int64_t tick) {
    t->model.value[TIM_ARR / 4] = value;
    if ((t->model.value[TIM_CR1 / 4] & ARPE) == 0) {
        tim_rebase(t, tick);
        if (t->running && t->reload == 0) {
            t->base_tick = tick;
        }
        t->reload = value;
    }
}

static void write_ccr(tim_t *t, unsigned channel, uint32_t value, int64_t tick) {
    if (tim_is_capture(t, channel)) {
        machine_violation(t->model.machine, "%s: CCR%u written, but it is read-only while the channel captures",
                          model_name(&t->model), channel + 1);
        return;
    }
    t->model.value[TIM_CCR1 / 4 + channel] = value;
    if ((tim_mode_bits(t, channel) & 8u) == 0) {
        t->compare[channel] = value;
        tim_evaluate_reference(t, channel, false, tim_position(t, tick), machine_now(t->model.machine));
    }
}

static void set(model_t *model, uint32_t offset, uint32_t value) {
    tim_t *const t = (tim_t *)model;
    const int64_t tick = tim_now_tick(t);
    tim_advance(t, tick);
    check_modes(t, offset, value);
    t->silent_trigger = false;
    switch (offset) {
    case TIM_CR1:
        write_cr1(t, value, tick);
        break;
    case TIM_SR:
        model->value[TIM_SR / 4] &= value | (t->breaking ? BIF : 0);
        tim_interrupt(t);
        break;
    case TIM_EGR:
        generate(t, value, tick);
        break;
    case TIM_DIER:
        write_dier(t, value);
        break;
    case TIM_CCMR1:
    case TIM_CCMR2:
        tim_write_channel_mode(t, offset, value);
        break;
    case TIM_CCER:
    case TIM_CR2:
        model->value[offset / 4] = tim_unlocked(t, offset, value);
        tim_take_modes(t, false);
        break;
    case TIM_BDTR:
        tim_write_bdtr(t, value, machine_now(model->machine));
        break;
    case TIM_CNT:
        t->base_count = value;
        t->base_tick = tick;
        t->marked = (int64_t)value - 1;
        break;
    case TIM_ARR:
        write_arr(t, value, tick);
        break;
    case TIM_SMCR:
        write_smcr(t, value);
        break;
    case TIM_DMAR:
        burst_write(t, value);
        break;
    case TIM_DCR:
        t->burst_index = 0;
        model->value[offset / 4] = value;
        break;
    default:
        if (offset >= TIM_CCR1 && offset < TIM_CCR1 + 16) {
            write_ccr(t, (offset - TIM_CCR1) / 4, value, tick);
        } else {
            model->value[offset / 4] = value;
        }
        break;
    }
    tim_plan(t);
}

static uint32_t get(model_t *model, uint32_t offset) {
    tim_t *const t = (tim_t *)model;
    if (offset == TIM_SR || offset == TIM_CNT || offset == TIM_CR1 || offset == TIM_DMAR) {
        tim_advance(t, tim_now_tick(t));
    }
    if (offset == TIM_CNT) {
        return (uint32_t)tim_position(t, tim_now_tick(t));
    }
    if (offset == TIM_DMAR) {
        const uint32_t target = burst_register(t);
        const uint32_t value = target < TIM_DCR ? get(model, target) : 0;
        if (t->burst_index != 0 && t->burst_source != DMA_NONE) {
            dma_line_pulse(model->chip, t->burst_source);
        }
        return value;
    }
    if (offset >= TIM_CCR1 && offset < TIM_CCR1 + 16 && tim_is_capture(t, (offset - TIM_CCR1) / 4)) {
        model->value[TIM_SR / 4] &= ~(2u << (offset - TIM_CCR1) / 4); /* Reading the capture clears its flag. */
        tim_interrupt(t);
    }
    return offset == TIM_EGR ? 0 : reg(model, offset);
}

static void restart(model_t *model) {
    tim_t *const t = (tim_t *)model;
    machine_cancel(model->machine, &t->event);
    t->running = false;
    t->base_count = 0;
    t->marked = -1;
    t->silent_trigger = false;
    t->burst_index = 0;
    tim_load(t);
    t->repetition = 0;
    tim_channels_restart(t);
    tim_outputs_restart(t);
    tim_connect_slaves(model->chip);
    tim_interrupt(t);
}

void tim_before_change(chip_t *chip) {
    for (unsigned i = 0; i < TIM_COUNT; i++) {
        if (chip->tim[i]->running) {
            tim_advance(chip->tim[i], tim_now_tick(chip->tim[i]));
        }
    }
}

void tim_after_change(chip_t *chip) {
    for (unsigned i = 0; i < TIM_COUNT; i++) {
        tim_plan(chip->tim[i]);
    }
}

/* Only the advanced timers have a break. */
static void clock_failed(chip_t *chip) {
    tim_clock_failed(chip->tim[0]);
    tim_clock_failed(chip->tim[7]);
}

void tim_create(chip_t *chip) {
    struct storage {
        tim_t tim[TIM_COUNT];
        model_description_t description[TIM_COUNT];
    } *const storage = chip_allocate(chip, sizeof *storage);
    chip_listen_to_pins(chip, tim_pin_edge);
    chip->signals.pin_output = tim_pin_output;
    chip->signals.pin_routing = tim_pin_routing;
    chip->signals.clock_failed = clock_failed;
    for (unsigned i = 0; i < TIM_COUNT; i++) {
        tim_t *const t = &storage->tim[i];
        const tim_description_t *const what = &tim_descriptions[i];
        chip->tim[i] = t;
        t->what = what;
        t->clock = what->bus == BUS_APB2 ? &chip->timer2 : &chip->timer1;
        tim_counter_init(t);
        tim_channels_init(t);
        tim_outputs_init(t);
        storage->description[i] = (model_description_t){.name = what->name,
                                                        .base = what->base,
                                                        .size = 0x400,
                                                        .bus = what->bus,
                                                        .read_widths = WIDTH_ANY,
                                                        .write_widths = WIDTH_16 | WIDTH_32,
                                                        .registers = what->registers,
                                                        .register_count = what->register_count,
                                                        .get = get,
                                                        .set = set,
                                                        .restart = restart};
        model_attach(chip, &t->model, &storage->description[i]);
    }
}
