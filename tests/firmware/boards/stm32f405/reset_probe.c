/* An image that ends its first runs as the parameter page tells, a byte a run, and leaves in RAM what the board told
 * it about the run before. */

#include "boards/board.h"

enum {
    REST = 0,
    HANG = 1,
    RESTART = 2,
    BUS_FAULT = 3,
    NO_INSTRUCTION = 4,
    DIVISION = 5,
    OVERFLOW = 6,
    NULL_READ = 7,
    FLASH_WRITE = 8,
    RAM_CODE = 9
};

#ifndef RUN_US
#define RUN_US 1100000u /* How long a run lasts before it ends. */
#endif
#ifndef HOW
#define HOW hal_parameter_page(hal)[probe.run]
#endif
#define WORD 5u

struct {
    hal_reset_t last;
    uint32_t word, run;
} probe;

static void wait_until(hal_t *hal, uint64_t end_us) {
    while (hal_microseconds(hal) < end_us) {
        hal_watchdog_kick(hal);
        hal_wait(hal);
    }
}

#pragma GCC diagnostic ignored "-Winfinite-recursion"
__attribute__((noinline)) uint32_t overflow(volatile uint32_t *above) {
    volatile uint32_t frame[16];
    for (unsigned i = 0; i < 16; i++)
        frame[i] = above[0] + i;
    return overflow(frame) + frame[3];
}

__attribute__((noinline)) void fail(uint32_t how) {
    volatile uint32_t zero = 0;
    uint32_t code[2] = {0x47704770u, 0x47704770u}; /* bx lr */
    switch (how) {
    case BUS_FAULT:
        (void)*(volatile uint32_t *)0x30000000u;
        break;
    case NO_INSTRUCTION:
        __asm volatile("udf #7");
        break;
    case OVERFLOW:
        (void)overflow(&zero);
        break;
    case NULL_READ:
        (void)*(volatile uint32_t *)(zero + 8u);
        break;
    case FLASH_WRITE:
        *(volatile uint32_t *)(zero + 0x08010000u) = 1u;
        break;
    case RAM_CODE:
        ((void (*)(void))((uint32_t)code | 1u))();
        break;
    default:
        break;
    }
}

int main(void) {
    hal_t *hal = board_start();
    probe.last = *hal_last_reset(hal);
    uint32_t *words = hal_retained(hal);
    probe.run = words[0]++;
    probe.word = words[WORD];
    words[WORD] = 0x600D0000u + probe.run;
    const uint32_t how = HOW;
    wait_until(hal, RUN_US);
    hal_note_stalled(hal, how == HANG ? 5u : 0u);
    if (how == HANG) {
        for (;;) {
        }
    }
    if (how == RESTART)
        hal_reset(hal);
    if (how != REST)
        fail(how);
    for (;;)
        wait_until(hal, UINT64_MAX);
}
