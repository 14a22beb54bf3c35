/* What of the STM32F405 QEMU has models of, netduinoplus2: USARTs, timers and the numbers of their interrupts. Each
 * step notes what the registers and the interrupts tell. Written from RM0090.
 *
 * Who runs it sends a byte on USART1 for each 'R' that it sends. */
#include "runtime.h"

#define R(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define RCC_AHB1   R(0x40023830u)
#define RCC_APB1   R(0x40023840u)
#define RCC_APB2   R(0x40023844u)
#define GPIOA      0x40020000u
#define VTOR       R(0xE000ED08u)
#define ENABLED(n) R(0xE000E100u + 4u * ((n) / 32u))
#define DISABLE(n) R(0xE000E180u + 4u * ((n) / 32u))
#define PENDING(n) R(0xE000E200u + 4u * ((n) / 32u))
#define FORGET(n)  R(0xE000E280u + 4u * ((n) / 32u))
#define BIT(n)     (1u << ((n) % 32u))

#define SR(usart)  R((usart) + 0x00u)
#define DR(usart)  R((usart) + 0x04u)
#define BRR(usart) R((usart) + 0x08u)
#define CR1(usart) R((usart) + 0x0Cu)
#define RXNE       (1u << 5)
#define TC         (1u << 6)
#define TXE        (1u << 7)
#define ON         (1u << 13 | 1u << 3 | 1u << 2) /* UE, TE, RE. */

#define USART1     0x40011000u
#define USART1_IRQ 37u

static void (*volatile answer)(void); /* What the interrupt does to what raised it. */
static volatile uint32_t count;

/* Each interrupt: which it was, and how often; it goes off for good if nothing lowers it. */
static void raised(void) {
    uint32_t number;
    __asm volatile("mrs %0, ipsr" : "=r"(number));
    number = (number & 0x1FFu) - 16u;
    note(0x1A000000u | number);
    if (answer != 0)
        answer();
    if (++count > 3u)
        DISABLE(number) = BIT(number);
}

static void (*table[128])(void) __attribute__((aligned(512)));

static void take_interrupts(void) {
    const uint32_t *const first = (const uint32_t *)VTOR;
    for (uint32_t i = 0; i < 128u; i++)
        table[i] = i < 16u ? (void (*)(void))(uintptr_t)first[i] : raised;
    VTOR = (uint32_t)(uintptr_t)table;
    BARRIER();
}

static void wait_a_little(void) {
    for (volatile uint32_t i = 0; i < 200u; i++) {
    }
}

/* Let an interrupt through, and take it back. Notes how often it came. */
static void with_interrupt(uint32_t number, void (*then)(void)) {
    answer = then;
    count = 0;
    ENABLED(number) = BIT(number);
    wait_a_little();
    DISABLE(number) = BIT(number);
    FORGET(number) = BIT(number);
    note(0xC0000000u | count);
}

static void fetched(void) {
    note(DR(USART1));
}

static void send(uint8_t byte) {
    while ((SR(USART1) & TXE) == 0) {
    }
    DR(USART1) = byte;
    while ((SR(USART1) & TC) == 0) {
    }
}

static void ask(void) {
    send('R');
    while ((SR(USART1) & RXNE) == 0) {
    }
}

static void sending(void) {
    note(SR(USART1));
    note(CR1(USART1));
    BRR(USART1) = 0x8B;
    note(BRR(USART1));
    CR1(USART1) = ON;
    wait_a_little();
    note(SR(USART1) & (TXE | TC | RXNE));
    for (uint8_t byte = 'a'; byte < 'f'; byte++)
        send(byte);
    note(SR(USART1) & (TXE | TC));

    SR(USART1) = ~TC; /* Clearing by writing 0; TXE cannot be. */
    note(SR(USART1) & (TXE | TC));
    send('x');
    note(SR(USART1) & (TXE | TC));

    with_interrupt(USART1_IRQ, 0); /* Flags without their enable bits raise nothing. */
}

static void receiving(void) {
    ask();
    note(SR(USART1) & RXNE);
    note(DR(USART1));
    note(SR(USART1) & RXNE);

    ask();
    with_interrupt(USART1_IRQ, fetched); /* RXNE without RXNEIE. */
    CR1(USART1) |= RXNE;
    note(PENDING(USART1_IRQ) & BIT(USART1_IRQ) ? 1u : 0u);
    with_interrupt(USART1_IRQ, fetched);
    note(SR(USART1) & RXNE);
    CR1(USART1) &= ~RXNE;

    ask();
    SR(USART1) = ~RXNE; /* RXNE is cleared by writing 0, too. */
    note(SR(USART1) & RXNE);
    ask();
    note(DR(USART1));
}

static volatile uint32_t timer;
static void update_cleared(void) {
    note(R(timer + 0x10u) & 1u);
    R(timer + 0x10u) = ~1u;
    R(timer) &= ~1u;
    note(R(timer + 0x10u) & 1u);
}

static void counting(uint32_t base, uint32_t number) {
    timer = base;
    note(R(base));
    note(R(base + 0x0Cu));
    note(R(base + 0x10u));
    R(base + 0x28u) = 7u;
    R(base + 0x2Cu) = 999u;
    note(R(base + 0x28u));
    note(R(base + 0x2Cu));
    R(base + 0x14u) = 1u; /* UG: it takes the prescaler and begins at nought. */
    R(base + 0x10u) = 0u;
    note(R(base + 0x10u) & 1u);
    R(base + 0x0Cu) = 1u; /* UIE */
    answer = update_cleared;
    count = 0;
    ENABLED(number) = BIT(number);
    R(base) = 1u;
    while (count == 0) {
    }
    DISABLE(number) = BIT(number);
    wait_a_little();
    note(0xC0000000u | count);
    note(R(base) & 1u);
}

static void clocks_and_pins(void) {
    RCC_AHB1 |= 1u;
    RCC_APB1 |= 15u;
    RCC_APB2 |= 1u << 4;
    (void)RCC_APB2;
    R(GPIOA + 0x24u) |= 7u << 4 | 7u << 8; /* PA9 and PA10 in their alternate function 7. */
    R(GPIOA) |= 2u << 18 | 2u << 20;
}

int main(void) {
    clocks_and_pins();
    take_interrupts();
    sending();
    receiving();
    counting(0x40000000u, 28u);
    counting(0x40000400u, 29u);
    counting(0x40000800u, 30u);
    counting(0x40000C00u, 50u);
    send('E');
    return 0;
}
