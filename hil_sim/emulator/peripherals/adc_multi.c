/* adc_multi.c: which converters go together (MULTI), and the common data register with its DMA modes (RM0090 13.9).
 *
 *     MULTI        1, 0x11                5, 0x15          6, 0x16
 *     together     regular and injected   injected         regular (no injected group may run)
 *
 * Using what is not modelled is a violation: interleaved and alternate modes.
 */
#include "emulator/peripherals/adc.h"

static uint32_t multi(const adc_t *adc) {
    return reg(&adc->common, ADC_CCR) & 31u;
}

/* How many converters go together; 1: independent mode. */
static unsigned units_together(const adc_t *adc) {
    return multi(adc) == 0 ? 1 : (multi(adc) & 16u) != 0 ? 3 : 2;
}

static bool together(const adc_t *adc, activity_t group) {
    const uint32_t mode = multi(adc) & 15u;
    return mode == 1 || mode == (group == REGULAR ? 6u : 5u);
}

bool adc_follows(const unit_t *u, activity_t group) {
    return u->number > 0 && u->number < units_together(adc_of(u)) && together(adc_of(u), group);
}

unit_t *adc_leader(unit_t *u, activity_t group) {
    return adc_follows(u, group) ? &adc_of(u)->unit[0] : u;
}

unsigned adc_members(const unit_t *leader, activity_t group) {
    const adc_t *const adc = adc_of(leader);
    return leader->number == 0 && together(adc, group) ? units_together(adc) : 1;
}

/* ---- The common data register ---- */

static unsigned dma_mode(const adc_t *adc) {
    return field(reg(&adc->common, ADC_CCR), 14, 2);
}
static unsigned results_a_request(const adc_t *adc) {
    return dma_mode(adc) == 1 ? 1 : 2;
}
static bool wants_dma(const adc_t *adc) {
    return dma_mode(adc) != 0 && adc->queued >= results_a_request(adc);
}

bool adc_by_common(const unit_t *u) {
    const adc_t *const adc = adc_of(u);
    return dma_mode(adc) != 0 && together(adc, REGULAR) && u->number < units_together(adc);
}

bool adc_common_keep(adc_t *adc, uint32_t result) {
    if (adc->queued == sizeof adc->queue / sizeof adc->queue[0]) {
        return false;
    }
    adc->queue[adc->queued++] = (uint16_t)result;
    return true;
}

bool adc_common_request(adc_t *adc) {
    if (!wants_dma(adc) || adc->no_more_requests) {
        return true;
    }
    dma_line(adc->common.chip, DMA_ADC1, true);
    return !wants_dma(adc) || adc->no_more_requests || adc->common.chip->lines.stream[DMA_ADC1] != NULL;
}

uint32_t adc_common_read(adc_t *adc) {
    const unsigned mode = dma_mode(adc), take = results_a_request(adc);
    uint32_t value = reg(&adc->unit[0].model, ADC_DR) | reg(&adc->unit[1].model, ADC_DR) << 16;
    if (wants_dma(adc)) {
        value = mode == 1   ? adc->queue[0]
                : mode == 2 ? adc->queue[0] | (uint32_t)adc->queue[1] << 16
                            : (adc->queue[0] & 0xFFu) | (adc->queue[1] & 0xFFu) << 8;
        adc->queued -= take;
        for (unsigned i = 0; i < adc->queued; i++) {
            adc->queue[i] = adc->queue[i + take];
        }
    }
    for (unsigned i = 0; i < units_together(adc); i++) {
        adc->unit[i].unread = false;
        adc->unit[i].model.value[ADC_SR / 4] &= ~EOC;
        adc_interrupt(&adc->unit[i]);
    }
    if (!wants_dma(adc)) {
        dma_line(adc->common.chip, DMA_ADC1, false);
    }
    return value;
}

void adc_common_forget(adc_t *adc) {
    adc->queued = 0;
    adc->no_more_requests = adc->order_lost = false;
}

/* RM0090 13.9: after an overrun the EOC bit of one converter may stay set, as its data register holds a valid result.
 * Which one is not told: it follows the configuration's seed and the time. */
void adc_common_overrun(adc_t *adc) {
    adc->order_lost = true;
}

void adc_common_check_order(adc_t *adc) {
    if (!adc->order_lost) {
        return;
    }
    const machine_t *const machine = adc->common.machine;
    const uint64_t seed = adc->common.chip->config->memory_seed + (uint64_t)machine_now(machine) / 1000u;
    const unsigned left = (unsigned)((seed * 0x9E3779B97F4A7C15u) >> 33) % 3u;
    adc->order_lost = false;
    adc->queued = 0;
    for (unsigned i = 0; i < left; i++) {
        (void)adc_common_keep(adc, reg(&adc->unit[2u - i].model, ADC_DR));
    }
    machine_violation(
        adc->common.machine,
        "ADC1: converting after an overrun without starting the converters over (ADON, or DMA in ADC_CCR): "
        "the order of the results may be shifted, here by %u",
        left);
}

/* RM0090 13.8.1: without DDS no request follows the last transfer. */
void adc_last_transfer(chip_t *chip, dma_source_t source) {
    if (source < DMA_ADC1 || source > DMA_ADC3) {
        return;
    }
    adc_t *const adc = chip->adc;
    unit_t *const u = &adc->unit[source - DMA_ADC1];
    if (units_together(adc) > 1 && source == DMA_ADC1) {
        adc->no_more_requests = (reg(&adc->common, ADC_CCR) >> 13 & 1u) == 0;
    } else {
        u->no_more_requests = (reg(&u->model, ADC_CR2) & DDS) == 0;
    }
}
