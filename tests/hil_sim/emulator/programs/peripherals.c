/* A chip's whole way in one bare program: crystal and PLL, a timer that triggers three converters, DMA of their
 * results with its interrupt, a serial port fed by DMA, a pin toggled by a timer's compare interrupt, and the
 * independent watchdog at the end. Written from RM0090, for the test of the models with the processor. */
#include <stdint.h>

#define R(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define RCC        0x40023800u
#define GPIOA      0x40020000u
#define GPIOB      0x40020400u
#define GPIOC      0x40020800u
#define DMA2       0x40026400u
#define ADC        0x40012000u
#define TIM2       0x40000000u
#define TIM3       0x40000400u
#define USART1     0x40011000u
#define IWDG       0x40003000u

static volatile uint32_t transfers, matches;
static uint16_t samples[24];
static uint8_t message[24];

void reset_handler(void);
static void stuck(void) {
    for (;;) {
    }
}

static void adc_transfer_complete(void) {
    R(DMA2 + 0x08) = 0x3D;
    transfers++;
}

static void timer3(void) {
    R(TIM3 + 0x10) = ~2u;
    (void)R(TIM3 + 0x10);
    R(GPIOC + 0x18) = ++matches & 1 ? 1u << 12 : 1u << 28;
}

__attribute__((section(".vectors"), used)) static void (*const vectors[16 + 82])(void) = {
    [0] = (void (*)(void))0x20018000u, [1] = reset_handler, [2] = stuck, [3] = stuck, [16 + 29] = timer3,
    [16 + 56] = adc_transfer_complete};

static void clocks(void) {
    R(0x40023C00) = 0x705;
    R(RCC) |= 1u << 16;
    while (!(R(RCC) & 1u << 17)) {
    }
    R(RCC + 4) = 0x20000000u | 7u << 24 | 1u << 22 | 336u << 6 | 12u;
    R(RCC) |= 1u << 24;
    while (!(R(RCC) & 1u << 25)) {
    }
    R(RCC + 8) = 5u << 10 | 4u << 13 | 2u;
    while ((R(RCC + 8) & 12u) != 8) {
    }
    R(RCC + 0x30) |= 7u | 1u << 22;
    R(RCC + 0x40) |= 3u;
    R(RCC + 0x44) |= 1u << 4 | 7u << 8;
    (void)R(RCC + 0x44);
}

static void converters(void) {
    R(GPIOA) |= 3u << 2 | 3u << 4 | 3u << 6;
    R(ADC + 0x304) = 1u << 16 | 1u << 14 | 1u << 13 | 0x16u;
    for (uint32_t i = 0; i < 3; i++) {
        const uint32_t a = ADC + 0x100 * i, channel = i + 1;
        R(a + 0x04) = 1u << 8;
        R(a + 0x2C) = 7u << 20 | channel << 5 | channel;
        R(a + 0x30) = channel * 0x02108421u;
        R(a + 0x34) = channel * 0x02108421u;
        R(a + 0x08) = 1u | (i == 0 ? 1u << 28 | 6u << 24 : 0);
    }
    R(DMA2 + 0x14) = 24;
    R(DMA2 + 0x18) = ADC + 0x308;
    R(DMA2 + 0x1C) = (uint32_t)(uintptr_t)samples;
    R(DMA2 + 0x10) = 1u << 13 | 1u << 11 | 1u << 10 | 1u << 8 | 1u << 4 | 1u;
    R(0xE000E104) = 1u << (56 - 32);
    R(TIM2 + 0x2C) = 8210;
    R(TIM2 + 0x04) = 2u << 4;
    for (volatile uint32_t i = 0; i < 1000; i++) { /* Converters need 3 us. */
    }
    R(TIM2) = 1;
}

void reset_handler(void) {
    transfers = matches = 0;
    if (R(RCC + 0x74) & 1u << 29) { /* The watchdog did it: say so, and rest. */
        R(RCC + 0x30) |= 4u;
        (void)R(RCC + 0x30);
        R(GPIOC) = 1u << 26;
        R(GPIOC + 0x18) = 1u << 13;
        for (;;) {
            __asm volatile("wfi");
        }
    }
    clocks();
    converters();
    R(GPIOC) = 1u << 24;
    R(TIM3 + 0x2C) = 8399;
    R(TIM3 + 0x34) = 4200;
    R(TIM3 + 0x0C) = 2;
    R(TIM3) = 1;
    R(0xE000E100) = 1u << 29;
    while (transfers < 3) {
        __asm volatile("wfi");
    }
    for (uint32_t i = 0; i < sizeof message; i++) {
        message[i] = (uint8_t)(samples[i] >> 4);
    }
    R(GPIOB + 0x20) = 7u << 24;
    R(GPIOB) = (R(GPIOB) & ~(3u << 12)) | 2u << 12;
    R(USART1 + 0x08) = 42;
    R(USART1 + 0x0C) = 1u << 13 | 1u << 3;
    R(USART1 + 0x14) = 1u << 7;
    R(DMA2 + 0x10 + 7 * 0x18 + 0x04) = sizeof message;
    R(DMA2 + 0x10 + 7 * 0x18 + 0x08) = USART1 + 4;
    R(DMA2 + 0x10 + 7 * 0x18 + 0x0C) = (uint32_t)(uintptr_t)message;
    R(DMA2 + 0x10 + 7 * 0x18) = 4u << 25 | 1u << 10 | 1u << 6 | 1u;
    R(IWDG) = 0x5555;
    R(IWDG + 8) = 79; /* 80 * 4 / 32 kHz = 10 ms. */
    while (R(IWDG + 0x0C)) {
    }
    R(IWDG) = 0xCCCC;
    for (;;) {
        __asm volatile("wfi");
    }
}
