/* nvic.h: which exception is pending, enabled, active, and which comes first (ARMv7-M architecture reference manual,
 * B1.5 and B3.4). Plain state: nvic_reset() first, then any call; nvic_t.candidate is always up to date.
 *
 * Exceptions are numbered as in IPSR: 2 NMI, 3 HardFault, 4 MemManage, 5 BusFault, 6 UsageFault, 11 SVCall, 14 PendSV,
 * 15 SysTick, 16 + n interrupt n. A priority is 0..255 with 4 bits implemented; lower goes first; HardFault is -1, NMI
 * -2, nothing active 256.
 */
#ifndef GOLDFIELD_NVIC_H
#define GOLDFIELD_NVIC_H

#include <stdbool.h>
#include <stdint.h>

#define NVIC_EXCEPTIONS    98u /* 16 and the STM32F405's 82 interrupts. */
#define NVIC_IDLE_PRIORITY 256
enum {
    EXCEPTION_NMI = 2,
    EXCEPTION_HARD_FAULT,
    EXCEPTION_MEMORY_FAULT,
    EXCEPTION_BUS_FAULT,
    EXCEPTION_USAGE_FAULT,
    EXCEPTION_SVCALL = 11,
    EXCEPTION_PENDSV = 14,
    EXCEPTION_SYSTICK = 15,
    EXCEPTION_INTERRUPT = 16
};

typedef struct {
    uint32_t pending[4], active[4], enabled[4], line[4]; /* Bit n of word w: exception 32 w + n. */
    uint8_t priority[NVIC_EXCEPTIONS + 2u];
    unsigned priority_group; /* AIRCR.PRIGROUP, 0..7. */
    /* Kept up to date by every function: the pending exception that goes first (0: none), its group priority, and
     * the group priority of what is active. */
    unsigned candidate;
    int candidate_priority, active_priority;
} nvic_t;

/* Nothing is pending or active; the core's own exceptions are enabled, interrupts are not. */
void nvic_reset(nvic_t *nvic);

/* The level of a peripheral's request line; interrupt counts from 0. A rising edge makes the interrupt pending. */
void nvic_line(nvic_t *nvic, unsigned interrupt, bool level);

/* Make an exception pending by software, or take that back; an interrupt whose line is high stays pending. */
void nvic_pend(nvic_t *nvic, unsigned exception);
void nvic_unpend(nvic_t *nvic, unsigned exception);

/* The exception's handler begins: it is active and no longer pending. */
void nvic_activate(nvic_t *nvic, unsigned exception);
/* The handler has returned. A line that is still high makes its interrupt pending again. */
void nvic_deactivate(nvic_t *nvic, unsigned exception);

bool nvic_is_pending(const nvic_t *nvic, unsigned exception);
bool nvic_is_active(const nvic_t *nvic, unsigned exception);
unsigned nvic_active_count(const nvic_t *nvic);
void nvic_set_priority_group(nvic_t *nvic, unsigned group);
void nvic_set_priority(nvic_t *nvic, unsigned exception, uint8_t priority);

/* Returns the part of a priority that decides on preemption. */
int nvic_group_priority(const nvic_t *nvic, int priority);

/* Returns the priority of an exception: fixed, or as set. */
int nvic_priority(const nvic_t *nvic, unsigned exception);

/* Registers at 0xE000E100..0xE000E4EF and STIR 0xE000EF00; width is 1, 2 or 4 (bytes only for the priorities). Return
 * false if there is no such register. */
bool nvic_read(const nvic_t *nvic, uint32_t address, unsigned width, uint32_t *value);
bool nvic_write(nvic_t *nvic, uint32_t address, unsigned width, uint32_t value);

#endif
