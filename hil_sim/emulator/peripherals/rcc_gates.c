/* rcc_gates.c: the peripherals' clock enables and resets (see rcc.h). */
#include "emulator/peripherals/rcc.h"

/* Which enable bit, and reset bit at the same place 0x20 below, belongs to which model. The ADCs have three enables and
 * one reset (bit 8). */
static const struct {
    const char *name;
    uint16_t enable;
    uint8_t bit;
} gates[] = {
    {"GPIOA", 0x30, 0},  {"GPIOB", 0x30, 1},  {"GPIOC", 0x30, 2}, {"GPIOD", 0x30, 3},   {"GPIOE", 0x30, 4},
    {"GPIOF", 0x30, 5},  {"GPIOG", 0x30, 6},  {"GPIOH", 0x30, 7}, {"GPIOI", 0x30, 8},   {"CRC", 0x30, 12},
    {"DMA1", 0x30, 21},  {"DMA2", 0x30, 22},  {"RNG", 0x34, 6},   {"TIM2", 0x40, 0},    {"TIM3", 0x40, 1},
    {"TIM4", 0x40, 2},   {"TIM5", 0x40, 3},   {"TIM6", 0x40, 4},  {"TIM7", 0x40, 5},    {"TIM12", 0x40, 6},
    {"TIM13", 0x40, 7},  {"TIM14", 0x40, 8},  {"WWDG", 0x40, 11}, {"USART2", 0x40, 17}, {"USART3", 0x40, 18},
    {"UART4", 0x40, 19}, {"UART5", 0x40, 20}, {"CAN1", 0x40, 25}, {"CAN2", 0x40, 26},   {"PWR", 0x40, 28},
    {"DAC", 0x40, 29},   {"TIM1", 0x44, 0},   {"TIM8", 0x44, 1},  {"USART1", 0x44, 4},  {"USART6", 0x44, 5},
    {"ADC1", 0x44, 8},   {"ADC2", 0x44, 9},   {"ADC3", 0x44, 10}, {"SYSCFG", 0x44, 14}, {"TIM9", 0x44, 16},
    {"TIM10", 0x44, 17}, {"TIM11", 0x44, 18},
};

_Static_assert(sizeof gates / sizeof gates[0] == RCC_GATES, "one model a gate");

void rcc_write_enable(rcc_t *rcc, uint32_t offset, uint32_t value) {
    chip_t *const chip = rcc->model.chip;
    const clock_domain_t *const bus = offset == 0x40 ? &chip->pclk1 : offset == 0x44 ? &chip->pclk2 : &chip->hclk;
    /* ES0182 2.1.6: two AHB cycles, or one and the AHB-to-APB ratio. The access itself is not later than one
     * instruction after the write. */
    const double cycles = offset < 0x40 ? 2 : 1 + chip->hclk.hz / bus->hz;
    const int64_t settled = machine_now(chip->machine) + (int64_t)(cycles * chip->hclk.period_ps);
    rcc->model.value[offset / 4] = value;
    if (offset == AHB1ENR && (value & CCMDATARAMEN) == 0) {
        model_missing(&rcc->model, "the core-coupled memory's clock switched off (CCMDATARAMEN 0)");
    }
    for (unsigned i = 0; i < RCC_GATES; i++) {
        if (gates[i].enable == offset && rcc->gated[i] != NULL) {
            model_clock(rcc->gated[i], (value >> gates[i].bit & 1u) != 0, settled);
        }
    }
    if (offset == 0x44) {
        model_t *const common = chip_model(chip, "C_ADC");
        if (common != NULL) {
            model_clock(common, (value & 0x700u) != 0, settled);
        }
    }
    rcc_tell_clocks(chip);
}

void rcc_write_reset(rcc_t *rcc, uint32_t offset, uint32_t value) {
    const uint32_t changed = value ^ reg(&rcc->model, offset);
    rcc->model.value[offset / 4] = value;
    for (unsigned i = 0; i < RCC_GATES; i++) {
        const bool adc = gates[i].enable == 0x44 && gates[i].bit >= 8 && gates[i].bit <= 10;
        const unsigned bit = adc ? 8u : gates[i].bit;
        if (gates[i].enable != offset + 0x20 || rcc->gated[i] == NULL || (changed >> bit & 1u) == 0) {
            continue;
        }
        rcc->gated[i]->in_reset = (value >> bit & 1u) != 0;
        if (rcc->gated[i]->in_reset) {
            model_reset(rcc->gated[i]);
            if (adc && gates[i].bit == 8) {
                model_reset(chip_model(rcc->model.chip, "C_ADC"));
            }
        }
    }
}

void rcc_close_gates(rcc_t *rcc) {
    chip_t *const chip = rcc->model.chip;
    for (unsigned i = 0; i < RCC_GATES; i++) {
        rcc->gated[i] = chip_model(chip, gates[i].name);
        if (rcc->gated[i] != NULL) {
            rcc->gated[i]->clocked = rcc->gated[i]->in_reset = rcc->gated[i]->settling = false;
        }
    }
    model_t *const common = chip_model(chip, "C_ADC");
    if (common != NULL) {
        common->clocked = false;
    }
}
