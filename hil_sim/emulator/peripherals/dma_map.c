/* dma_map.c: which request lines reach which stream (RM0090 tables 42 and 43, F405/407), and the lines' names. */
#include "emulator/peripherals/dma.h"

#include <string.h>

static const dma_cell_t map[2][8][8] = {
    /* controller, channel, stream */
    {
        {{{DMA_OTHER}}, {{0}}, {{DMA_OTHER}}, {{DMA_OTHER}}, {{DMA_OTHER}}, {{DMA_OTHER}}, {{0}}, {{DMA_OTHER}}},
        {{{DMA_OTHER}}, {{0}}, {{DMA_TIM7_UP}}, {{0}}, {{DMA_TIM7_UP}}, {{DMA_OTHER}}, {{DMA_OTHER}}, {{DMA_OTHER}}},
        {{{DMA_TIM4_CH1}},
         {{0}},
         {{DMA_OTHER}},
         {{DMA_TIM4_CH2}},
         {{DMA_OTHER}},
         {{DMA_OTHER}},
         {{DMA_TIM4_UP}},
         {{DMA_TIM4_CH3}}},
        {{{DMA_OTHER}},
         {{DMA_TIM2_UP, DMA_TIM2_CH3}},
         {{DMA_OTHER}},
         {{DMA_OTHER}},
         {{DMA_OTHER}},
         {{DMA_TIM2_CH1}},
         {{DMA_TIM2_CH2, DMA_TIM2_CH4}},
         {{DMA_TIM2_UP, DMA_TIM2_CH4}}},
        {{{DMA_UART5_RX}},
         {{DMA_USART3_RX}},
         {{DMA_UART4_RX}},
         {{DMA_USART3_TX}},
         {{DMA_UART4_TX}},
         {{DMA_USART2_RX}},
         {{DMA_USART2_TX}},
         {{DMA_UART5_TX}}},
        {{{0}},
         {{0}},
         {{DMA_TIM3_CH4, DMA_TIM3_UP}},
         {{0}},
         {{DMA_TIM3_CH1, DMA_TIM3_TRIG}},
         {{DMA_TIM3_CH2}},
         {{0}},
         {{DMA_TIM3_CH3}}},
        {{{DMA_TIM5_CH3, DMA_TIM5_UP}},
         {{DMA_TIM5_CH4, DMA_TIM5_TRIG}},
         {{DMA_TIM5_CH1}},
         {{DMA_TIM5_CH4, DMA_TIM5_TRIG}},
         {{DMA_TIM5_CH2}},
         {{0}},
         {{DMA_TIM5_UP}},
         {{0}}},
        {{{0}},
         {{DMA_TIM6_UP}},
         {{DMA_OTHER}},
         {{DMA_OTHER}},
         {{DMA_USART3_TX}},
         {{DMA_DAC1}},
         {{DMA_DAC2}},
         {{DMA_OTHER}}},
    },
    {
        {{{DMA_ADC1}},
         {{0}},
         {{DMA_TIM8_CH1, DMA_TIM8_CH2, DMA_TIM8_CH3}},
         {{0}},
         {{DMA_ADC1}},
         {{0}},
         {{DMA_TIM1_CH1, DMA_TIM1_CH2, DMA_TIM1_CH3}},
         {{0}}},
        {{{0}}, {{DMA_OTHER}}, {{DMA_ADC2}}, {{DMA_ADC2}}, {{0}}, {{0}}, {{0}}, {{DMA_OTHER}}},
        {{{DMA_ADC3}}, {{DMA_ADC3}}, {{0}}, {{0}}, {{0}}, {{DMA_OTHER}}, {{DMA_OTHER}}, {{DMA_OTHER}}},
        {{{DMA_OTHER}}, {{0}}, {{DMA_OTHER}}, {{DMA_OTHER}}, {{0}}, {{DMA_OTHER}}, {{0}}, {{0}}},
        {{{0}}, {{0}}, {{DMA_USART1_RX}}, {{DMA_OTHER}}, {{0}}, {{DMA_USART1_RX}}, {{DMA_OTHER}}, {{DMA_USART1_TX}}},
        {{{0}}, {{DMA_USART6_RX}}, {{DMA_USART6_RX}}, {{0}}, {{0}}, {{0}}, {{DMA_USART6_TX}}, {{DMA_USART6_TX}}},
        {{{DMA_TIM1_TRIG}},
         {{DMA_TIM1_CH1}},
         {{DMA_TIM1_CH2}},
         {{DMA_TIM1_CH1}},
         {{DMA_TIM1_CH4, DMA_TIM1_TRIG, DMA_TIM1_COM}},
         {{DMA_TIM1_UP}},
         {{DMA_TIM1_CH3}},
         {{0}}},
        {{{0}},
         {{DMA_TIM8_UP}},
         {{DMA_TIM8_CH1}},
         {{DMA_TIM8_CH2}},
         {{DMA_TIM8_CH3}},
         {{0}},
         {{0}},
         {{DMA_TIM8_CH4, DMA_TIM8_TRIG, DMA_TIM8_COM}}},
    },
};

const dma_cell_t *dma_cell(unsigned controller, unsigned channel, unsigned stream) {
    return &map[controller][channel][stream];
}

dma_source_t dma_source(const char *name) {
    static const char *const names[DMA_SOURCES] = {
        "",          "ADC1",     "ADC2",      "ADC3",      "DAC1",      "DAC2",      "TIM1_UP",   "TIM1_CH1",
        "TIM1_CH2",  "TIM1_CH3", "TIM1_CH4",  "TIM1_TRIG", "TIM1_COM",  "TIM8_UP",   "TIM8_CH1",  "TIM8_CH2",
        "TIM8_CH3",  "TIM8_CH4", "TIM8_TRIG", "TIM8_COM",  "TIM2_UP",   "TIM2_CH1",  "TIM2_CH2",  "TIM2_CH3",
        "TIM2_CH4",  "TIM3_UP",  "TIM3_CH1",  "TIM3_CH2",  "TIM3_CH3",  "TIM3_CH4",  "TIM3_TRIG", "TIM4_UP",
        "TIM4_CH1",  "TIM4_CH2", "TIM4_CH3",  "TIM5_UP",   "TIM5_CH1",  "TIM5_CH2",  "TIM5_CH3",  "TIM5_CH4",
        "TIM5_TRIG", "TIM6_UP",  "TIM7_UP",   "USART1_RX", "USART1_TX", "USART2_RX", "USART2_TX", "USART3_RX",
        "USART3_TX", "UART4_RX", "UART4_TX",  "UART5_RX",  "UART5_TX",  "USART6_RX", "USART6_TX", "",
    };
    for (unsigned i = 1; i < DMA_OTHER; i++) {
        if (strcmp(names[i], name) == 0) {
            return (dma_source_t)i;
        }
    }
    return DMA_NONE;
}
