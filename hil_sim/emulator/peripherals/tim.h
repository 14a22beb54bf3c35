/* tim.h: between tim.c and the timers' tables. */
#ifndef GOLDFIELD_TIM_H
#define GOLDFIELD_TIM_H

#include "model.h"

enum {
    TIM_CR1 = 0x00, TIM_CR2 = 0x04, TIM_SMCR = 0x08, TIM_DIER = 0x0C, TIM_SR = 0x10, TIM_EGR = 0x14, TIM_CCMR1 = 0x18, TIM_CCMR2 = 0x1C, TIM_CCER = 0x20,
    TIM_CNT = 0x24, TIM_PSC = 0x28, TIM_ARR = 0x2C, TIM_RCR = 0x30, TIM_CCR1 = 0x34, TIM_BDTR = 0x44, TIM_DCR = 0x48, TIM_DMAR = 0x4C, TIM_OR = 0x50
};

typedef struct {
    const char *name;
    uint32_t base;
    bus_t bus;
    const register_layout_t *registers;
    unsigned register_count, channels;
    bool advanced, wide;
    unsigned irq_update, irq_channels, irq_trigger; /* The last only of the advanced timers, whose lines are separate. */
    dma_source_t dma_update, dma_channel[4], dma_trigger;
    trigger_t first_channel_trigger, trgo;
    uint8_t master[4]; /* Timer number behind ITR0..3; 0: none. */
} tim_description_t;

typedef struct {
    uint8_t pin, timer, alternate, channel; /* Channel from 0. */
} tim_pin_t;

extern const tim_description_t tim_descriptions[TIM_COUNT];
extern const tim_pin_t tim_pins[];
extern const unsigned tim_pin_count;

#endif
