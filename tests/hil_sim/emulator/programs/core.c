/* Sleep, cycle counter, masks and a loop of known length. The argument at 0xE0000 chooses what to do. */
#include "runtime.h"

#define ARGUMENT    REGISTER(0x000E0000u)
#define DEMCR       REGISTER(0xE000EDFCu)
#define DWT_CONTROL REGISTER(0xE0001000u)
#define CYCLES      REGISTER(0xE0001004u)

volatile uint32_t ticks;

void unexpected_handler(void);

/* With argument 13 it fails itself: the processor locks up. */
void hard_fault_handler(void) {
    if (ARGUMENT == 13) {
        __asm volatile("udf #1");
    }
    unexpected_handler();
}

void systick_handler(void) {
    ticks++;
}

/* 3 n + 2 instructions, n at least 1. */
__attribute__((naked, noinline, used)) void known_loop(uint32_t n) {
    __asm volatile("movs r1, #0\n 1: adds r1, #1\n subs r0, #1\n bne 1b\n bx lr");
}

static void start_systick(uint32_t period) {
    SYSTICK_RELOAD = period - 1u;
    SYSTICK_COUNT = 0;
    SYSTICK_CONTROL = 7;
}

static void sleeping(void) /* 100 ticks of 16,000 cycles: 1 ms each. */
{
    start_systick(16000);
    while (ticks < 100) {
        __asm volatile("wfi");
    }
    note(ticks);
}

static void sleeping_masked(void) /* WFI wakes for an interrupt that PRIMASK holds back. */
{
    start_systick(16000);
    __asm volatile("cpsid i\n wfi");
    note(ticks);
    note(ICSR >> 26 & 1u);
    __asm volatile("cpsie i\n isb");
    note(ticks);
}

static void counting(void) {
    DEMCR |= 1u << 24;
    CYCLES = 0;
    DWT_CONTROL |= 1u;
    uint32_t first, second;
    __asm volatile("ldr %0, [%2]\n nop\n nop\n nop\n nop\n nop\n ldr %1, [%2]"
                   : "=&r"(first), "=&r"(second)
                   : "r"(&CYCLES));
    note(second - first);
    SYSTICK_RELOAD = 999;
    SYSTICK_COUNT = 0;
    SYSTICK_CONTROL = 5;
    __asm volatile("ldr %0, [%2]\n nop\n nop\n nop\n nop\n nop\n ldr %1, [%2]"
                   : "=&r"(first), "=&r"(second)
                   : "r"(&SYSTICK_COUNT));
    note(first - second);
    first = CYCLES;
    known_loop(1000);
    note(CYCLES - first);
}

static void working(void) /* For slices: interrupts, IT blocks and sleep in a mixture. */
{
    start_systick(777);
    for (uint32_t i = 0, x = 1; i < 3000; i++) {
        __asm volatile("tst %0, #5\n itete eq\n addeq %0, #7\n subne %0, #3\n lsleq %0, #1\n rorne %0, %0, #3"
                       : "+r"(x)
                       :
                       : "cc");
        if (i % 16u == 0) {
            __asm volatile("wfi");
            note(x + ticks + SYSTICK_COUNT);
        }
    }
}

static void core_coupled(void) /* Both ends of the 64 KB at 0x10000000: words, bytes, a pair of words. */
{
    REGISTER(0x10000000u) = 0x11223344u;
    REGISTER(0x1000FFFCu) = 0;
    *(volatile uint8_t *)0x1000FFFFu = 0xA5;
    __asm volatile("strd %0, %1, [%2]" ::"r"(7), "r"(8), "r"(0x10008000u) : "memory");
    note(REGISTER(0x10000000u));
    note(REGISTER(0x1000FFFCu));
    note(REGISTER(0x10008004u));
}

int main(void) {
    switch (ARGUMENT) {
    case 1:
        sleeping();
        break;
    case 2:
        sleeping_masked();
        break;
    case 3:
        counting();
        break;
    case 4:
        working();
        break;
    case 5:
        known_loop(10);
        known_loop(1000);
        known_loop(1);
        break;
    case 6:
        REGISTER(0x40018000u) = 1;
        break; /* Nothing is there. */
    case 7:
        REGISTER(0x60000000u) = 1;
        break; /* No external memory. */
    case 8:
        for (uint32_t *word = (uint32_t *)0x20018000u; word < (uint32_t *)0x20020000u; word++) {
            *word = 0;
        }
        ((void (*)(void))0x20018001u)();
        break; /* Zeros: MOVS r0, r0 until the end of RAM. */
    case 9:
        __asm volatile("cpsid i\n udf #0");
        break;
    case 10:
        __asm volatile("ldr r0, =0x40023801\n ldr r0, [r0]" ::: "r0");
        break; /* RCC_CR, not aligned. */
    case 11:
        AIRCR = 0x05FA0004u;
        break; /* Reset, for ever. */
    case 12:
        __asm volatile("wfe\n wfe");
        break;
    case 13:
        __asm volatile("mov sp, %0\n udf #0" ::"r"(0x08000000u));
        break;
    case 14:
        core_coupled();
        break;
    case 15:
        REGISTER(0x10010000u) = 1;
        break; /* Behind its end. */
    case 16:
        ((void (*)(void))0x10000001u)();
        break; /* Not on the instruction bus. */
    default:
        break;
    }
    return 0;
}
