/* Start-up of the test programs, which run at address 0 on QEMU's mps2-an386 and on the emulator alike. main() fills
 * results[]. */
#include "runtime.h"

uint32_t results[RESULTS];
uint32_t result_count;
volatile uint32_t finished;

extern uint32_t data_load[], data_start[], data_end[], bss_start[], bss_end[];
int main(void);

/* The oracle puts a word here so that a program on QEMU writes its results to a file through semihosting. */
#define ON_QEMU (*(volatile uint32_t *)0x2001F000u)

static uint32_t semihost(uint32_t operation, const void *argument) {
    register uint32_t r0 __asm("r0") = operation;
    register const void *r1 __asm("r1") = argument;
    __asm volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

void note(uint32_t value) {
    if (result_count < RESULTS) {
        results[result_count++] = value;
    }
}

void finish(void) {
    if (ON_QEMU == 0x51454D55u) {
        static const char name[] = "results.bin";
        const uint32_t open[3] = {(uint32_t)name, 5 /* wb */, sizeof name - 1};
        const uint32_t file = semihost(1, open);
        const uint32_t write[3] = {file, (uint32_t)results, 4u * result_count};
        semihost(5, write);
        semihost(2, &file);
        semihost(0x18, (const void *)0x20026);
    }
    finished = 1;
    for (;;) {
        __asm volatile("wfi");
    }
}

void reset_handler(void) {
    for (uint32_t *to = data_start, *from = data_load; to < data_end; to++, from++) {
        *to = *from;
    }
    for (uint32_t *to = bss_start; to < bss_end; to++) {
        *to = 0;
    }
    __asm volatile("dsb\n isb");
    main();
    finish();
}

void unexpected_handler(void) {
    uint32_t number;
    __asm volatile("mrs %0, ipsr" : "=r"(number));
    note(0xDEAD0000u | number);
    finish();
}

#define HANDLER(name) void name(void) __attribute__((weak, alias("unexpected_handler")))
HANDLER(nmi_handler);
HANDLER(hard_fault_handler);
HANDLER(memory_fault_handler);
HANDLER(bus_fault_handler);
HANDLER(usage_fault_handler);
HANDLER(svcall_handler);
HANDLER(pendsv_handler);
HANDLER(systick_handler);
HANDLER(irq0_handler);
HANDLER(irq1_handler);
HANDLER(irq2_handler);
HANDLER(irq3_handler);

__attribute__((section(".vectors"), used)) void *const vectors[20] = {
    (void *)0x20018000u,
    reset_handler,
    nmi_handler,
    hard_fault_handler,
    memory_fault_handler,
    bus_fault_handler,
    usage_fault_handler,
    unexpected_handler,
    0,
    0,
    0,
    svcall_handler,
    unexpected_handler,
    0,
    pendsv_handler,
    systick_handler,
    irq0_handler,
    irq1_handler,
    irq2_handler,
    irq3_handler,
};
