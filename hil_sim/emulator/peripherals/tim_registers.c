/* tim_registers.c: the timers' register tables and pins (RM0090 chapters 17 to 20; data sheet DS8626 table 9). */
#include "emulator/peripherals/tim.h"

#define COMMON_REGISTERS(cr1, dier, sr, egr, wide)                                                                                              \
    {"CR1", TIM_CR1, 0, cr1, ACCESS_RW}, {"DIER", TIM_DIER, 0, dier, ACCESS_RW}, {"SR", TIM_SR, 0, sr, ACCESS_RC_W0},                            \
    {"EGR", TIM_EGR, 0, egr, ACCESS_WO}, {"CNT", TIM_CNT, 0, wide, ACCESS_RW}, {"PSC", TIM_PSC, 0, 0xFFFF, ACCESS_RW}, {"ARR", TIM_ARR, wide, wide, ACCESS_RW}
#define FOUR_CHANNELS(wide)                                                                                                                     \
    {"CCMR1", TIM_CCMR1, 0, 0xFFFF, ACCESS_RW}, {"CCMR2", TIM_CCMR2, 0, 0xFFFF, ACCESS_RW}, {"CCR1", TIM_CCR1, 0, wide, ACCESS_RW},              \
    {"CCR2", TIM_CCR1 + 4, 0, wide, ACCESS_RW}, {"CCR3", TIM_CCR1 + 8, 0, wide, ACCESS_RW}, {"CCR4", TIM_CCR1 + 12, 0, wide, ACCESS_RW},         \
    {"DCR", TIM_DCR, 0, 0x1F1F, ACCESS_RW}, {"DMAR", TIM_DMAR, 0, 0xFFFF, ACCESS_RW}
#define GENERAL(wide)                                                                                                                           \
    COMMON_REGISTERS(0x3FF, 0x5F5F, 0x1E5F, 0x5F, wide), FOUR_CHANNELS(wide), {"CR2", TIM_CR2, 0, 0xF8, ACCESS_RW}, {"SMCR", TIM_SMCR, 0, 0xFFF7, ACCESS_RW}, \
    {"CCER", TIM_CCER, 0, 0xBBBB, ACCESS_RW}

static const register_layout_t advanced[] = {
    COMMON_REGISTERS(0x3FF, 0x7FFF, 0x1EFF, 0xFF, 0xFFFF), FOUR_CHANNELS(0xFFFF), {"CR2", TIM_CR2, 0, 0x7FFD, ACCESS_RW}, {"SMCR", TIM_SMCR, 0, 0xFFF7, ACCESS_RW},
    {"CCER", TIM_CCER, 0, 0x3FFF, ACCESS_RW}, {"RCR", TIM_RCR, 0, 0xFF, ACCESS_RW}, {"BDTR", TIM_BDTR, 0, 0xFFFF, ACCESS_RW},
};
static const register_layout_t general2[] = {GENERAL(0xFFFFFFFF), {"OR", TIM_OR, 0, 0xC00, ACCESS_RW}};
static const register_layout_t general34[] = {GENERAL(0xFFFF)};
static const register_layout_t general5[] = {GENERAL(0xFFFFFFFF), {"OR", TIM_OR, 0, 0xC0, ACCESS_RW}};
static const register_layout_t basic[] = {COMMON_REGISTERS(0x8F, 0x101, 0x1, 0x1, 0xFFFF), {"CR2", TIM_CR2, 0, 0x70, ACCESS_RW}};
static const register_layout_t two_channels[] = {
    COMMON_REGISTERS(0x38F, 0x47, 0x647, 0x47, 0xFFFF), {"SMCR", TIM_SMCR, 0, 0xF7, ACCESS_RW}, {"CCMR1", TIM_CCMR1, 0, 0xFFFF, ACCESS_RW},
    {"CCER", TIM_CCER, 0, 0xBB, ACCESS_RW}, {"CCR1", TIM_CCR1, 0, 0xFFFF, ACCESS_RW}, {"CCR2", TIM_CCR1 + 4, 0, 0xFFFF, ACCESS_RW},
};
#define ONE_CHANNEL \
    COMMON_REGISTERS(0x387, 0x3, 0x203, 0x3, 0xFFFF), {"CCMR1", TIM_CCMR1, 0, 0xFF, ACCESS_RW}, {"CCER", TIM_CCER, 0, 0xB, ACCESS_RW}, {"CCR1", TIM_CCR1, 0, 0xFFFF, ACCESS_RW}
static const register_layout_t one_channel[] = {ONE_CHANNEL};
static const register_layout_t one_channel11[] = {ONE_CHANNEL, {"OR", TIM_OR, 0, 0x3, ACCESS_RW}};

#define TABLE(t) t, sizeof t / sizeof t[0]
#define NO_ITR {0, 0, 0, 0}
/* base, bus, registers, channels, advanced, wide; interrupt of update, of the channels, of the trigger; request lines of update, channels, trigger; first trigger and TRGO; masters of ITR0..3 */
const tim_description_t tim_descriptions[TIM_COUNT] = {
    {"TIM1", 0x40010000, BUS_APB2, TABLE(advanced), 4, true, false, 25, 27, 26, DMA_TIM1_UP, {DMA_TIM1_CH1, DMA_TIM1_CH2, DMA_TIM1_CH3, DMA_TIM1_CH4}, DMA_TIM1_TRIG, TRIGGER_TIM1_CC1, TRIGGER_TIM1_TRGO, {5, 2, 3, 4}},
    {"TIM2", 0x40000000, BUS_APB1, TABLE(general2), 4, false, true, 28, 28, 28, DMA_TIM2_UP, {DMA_TIM2_CH1, DMA_TIM2_CH2, DMA_TIM2_CH3, DMA_TIM2_CH4}, DMA_NONE, TRIGGER_TIM2_CC1, TRIGGER_TIM2_TRGO, {1, 8, 3, 4}},
    {"TIM3", 0x40000400, BUS_APB1, TABLE(general34), 4, false, false, 29, 29, 29, DMA_TIM3_UP, {DMA_TIM3_CH1, DMA_TIM3_CH2, DMA_TIM3_CH3, DMA_TIM3_CH4}, DMA_TIM3_TRIG, TRIGGER_TIM3_CC1, TRIGGER_TIM3_TRGO, {1, 2, 5, 4}},
    {"TIM4", 0x40000800, BUS_APB1, TABLE(general34), 4, false, false, 30, 30, 30, DMA_TIM4_UP, {DMA_TIM4_CH1, DMA_TIM4_CH2, DMA_TIM4_CH3, DMA_NONE}, DMA_NONE, TRIGGER_TIM4_CC1, TRIGGER_TIM4_TRGO, {1, 2, 3, 8}},
    {"TIM5", 0x40000C00, BUS_APB1, TABLE(general5), 4, false, true, 50, 50, 50, DMA_TIM5_UP, {DMA_TIM5_CH1, DMA_TIM5_CH2, DMA_TIM5_CH3, DMA_TIM5_CH4}, DMA_TIM5_TRIG, TRIGGER_TIM5_CC1, TRIGGER_TIM5_TRGO, {2, 3, 4, 8}},
    {"TIM6", 0x40001000, BUS_APB1, TABLE(basic), 0, false, false, 54, 54, 54, DMA_TIM6_UP, {0, 0, 0, 0}, DMA_NONE, TRIGGER_NONE, TRIGGER_TIM6_TRGO, NO_ITR},
    {"TIM7", 0x40001400, BUS_APB1, TABLE(basic), 0, false, false, 55, 55, 55, DMA_TIM7_UP, {0, 0, 0, 0}, DMA_NONE, TRIGGER_NONE, TRIGGER_TIM7_TRGO, NO_ITR},
    {"TIM8", 0x40010400, BUS_APB2, TABLE(advanced), 4, true, false, 44, 46, 45, DMA_TIM8_UP, {DMA_TIM8_CH1, DMA_TIM8_CH2, DMA_TIM8_CH3, DMA_TIM8_CH4}, DMA_TIM8_TRIG, TRIGGER_TIM8_CC1, TRIGGER_TIM8_TRGO, {1, 2, 4, 5}},
    {"TIM9", 0x40014000, BUS_APB2, TABLE(two_channels), 2, false, false, 24, 24, 24, DMA_NONE, {0, 0, 0, 0}, DMA_NONE, TRIGGER_NONE, TRIGGER_NONE, {2, 3, 0, 0}},
    {"TIM10", 0x40014400, BUS_APB2, TABLE(one_channel), 1, false, false, 25, 25, 25, DMA_NONE, {0, 0, 0, 0}, DMA_NONE, TRIGGER_NONE, TRIGGER_NONE, NO_ITR},
    {"TIM11", 0x40014800, BUS_APB2, TABLE(one_channel11), 1, false, false, 26, 26, 26, DMA_NONE, {0, 0, 0, 0}, DMA_NONE, TRIGGER_NONE, TRIGGER_NONE, NO_ITR},
    {"TIM12", 0x40001800, BUS_APB1, TABLE(two_channels), 2, false, false, 43, 43, 43, DMA_NONE, {0, 0, 0, 0}, DMA_NONE, TRIGGER_NONE, TRIGGER_NONE, {4, 5, 0, 0}},
    {"TIM13", 0x40001C00, BUS_APB1, TABLE(one_channel), 1, false, false, 44, 44, 44, DMA_NONE, {0, 0, 0, 0}, DMA_NONE, TRIGGER_NONE, TRIGGER_NONE, NO_ITR},
    {"TIM14", 0x40002000, BUS_APB1, TABLE(one_channel), 1, false, false, 45, 45, 45, DMA_NONE, {0, 0, 0, 0}, DMA_NONE, TRIGGER_NONE, TRIGGER_NONE, NO_ITR},
};

#define PIN(port, number) (uint8_t)((port - 'A') * 16 + number)
const tim_pin_t tim_pins[] = {
    {PIN('A', 8), 1, 1, 0},  {PIN('E', 9), 1, 1, 0},   {PIN('A', 9), 1, 1, 1},  {PIN('E', 11), 1, 1, 1}, {PIN('A', 10), 1, 1, 2}, {PIN('E', 13), 1, 1, 2},
    {PIN('A', 11), 1, 1, 3}, {PIN('E', 14), 1, 1, 3},  {PIN('A', 0), 2, 1, 0},  {PIN('A', 5), 2, 1, 0},  {PIN('A', 15), 2, 1, 0}, {PIN('A', 1), 2, 1, 1},
    {PIN('B', 3), 2, 1, 1},  {PIN('A', 2), 2, 1, 2},   {PIN('B', 10), 2, 1, 2}, {PIN('A', 3), 2, 1, 3},  {PIN('B', 11), 2, 1, 3}, {PIN('A', 6), 3, 2, 0},
    {PIN('B', 4), 3, 2, 0},  {PIN('C', 6), 3, 2, 0},   {PIN('A', 7), 3, 2, 1},  {PIN('B', 5), 3, 2, 1},  {PIN('C', 7), 3, 2, 1},  {PIN('B', 0), 3, 2, 2},
    {PIN('C', 8), 3, 2, 2},  {PIN('B', 1), 3, 2, 3},   {PIN('C', 9), 3, 2, 3},  {PIN('B', 6), 4, 2, 0},  {PIN('D', 12), 4, 2, 0}, {PIN('B', 7), 4, 2, 1},
    {PIN('D', 13), 4, 2, 1}, {PIN('B', 8), 4, 2, 2},   {PIN('D', 14), 4, 2, 2}, {PIN('B', 9), 4, 2, 3},  {PIN('D', 15), 4, 2, 3}, {PIN('A', 0), 5, 2, 0},
    {PIN('H', 10), 5, 2, 0}, {PIN('A', 1), 5, 2, 1},   {PIN('H', 11), 5, 2, 1}, {PIN('A', 2), 5, 2, 2},  {PIN('H', 12), 5, 2, 2}, {PIN('A', 3), 5, 2, 3},
    {PIN('I', 0), 5, 2, 3},  {PIN('C', 6), 8, 3, 0},   {PIN('I', 5), 8, 3, 0},  {PIN('C', 7), 8, 3, 1},  {PIN('I', 6), 8, 3, 1},  {PIN('C', 8), 8, 3, 2},
    {PIN('I', 7), 8, 3, 2},  {PIN('C', 9), 8, 3, 3},   {PIN('I', 2), 8, 3, 3},  {PIN('A', 2), 9, 3, 0},  {PIN('E', 5), 9, 3, 0},  {PIN('A', 3), 9, 3, 1},
    {PIN('E', 6), 9, 3, 1},  {PIN('B', 8), 10, 3, 0},  {PIN('F', 6), 10, 3, 0}, {PIN('B', 9), 11, 3, 0}, {PIN('F', 7), 11, 3, 0}, {PIN('B', 14), 12, 9, 0},
    {PIN('H', 6), 12, 9, 0}, {PIN('B', 15), 12, 9, 1}, {PIN('H', 9), 12, 9, 1}, {PIN('A', 6), 13, 9, 0}, {PIN('F', 8), 13, 9, 0}, {PIN('A', 7), 14, 9, 0},
    {PIN('F', 9), 14, 9, 0},
};
const unsigned tim_pin_count = sizeof tim_pins / sizeof tim_pins[0];
