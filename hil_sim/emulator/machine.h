/* machine.h: the chip's processor side as the peripheral models see it, and what a model looks like.
 *
 * A model attaches itself to the bus (machine_attach), and from then on gets the accesses in its address range; it asks
 * for the time, schedules events, drives interrupt lines, reads and writes memory as a bus master, and tells of
 * violations.
 *
 * A model is a file named after the peripheral, or a few whose names begin with it and a header that tells them apart.
 * It is written from the vendor's register description (RM0090, the SVD), never from the driver. It holds its state in
 * its own struct, allocated by its create function; no globals.
 *
 * Strictness. What the reference manual forbids or leaves undefined is a violation: access to a peripheral whose clock
 * is off in RCC, a reserved bit written 1 (or a must-be-kept bit changed), a wrong order of enabling, an access of
 * unsupported width, an unmapped address, an overrun that loses data (ADC OVR, USART ORE, CAN FOVR: these set their
 * flags as well). machine_violation() records it, and under emulator_config_t.strict stops the board.
 */
#ifndef GOLDFIELD_MACHINE_H
#define GOLDFIELD_MACHINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "boards/board_edge.h"
#include "emulator/config.h"

typedef struct machine machine_t; /* One chip: processor, buses, peripherals. A board_t is a machine_t. */

/* ---- A peripheral ---- */

typedef struct peripheral peripheral_t;
struct peripheral {
    const char *name;    /* Name as in the SVD: "TIM1", "DMA2". */
    uint32_t base, size; /* Address range; size is a multiple of 4. */
    machine_t *machine;  /* Set by machine_attach(). */
    void *state;         /* The model's own. */
    /* Accesses: width is 1, 2 or 4 bytes; offset is from base and aligned to width. */
    uint32_t (*read)(peripheral_t *self, uint32_t offset, unsigned width);
    void (*write)(peripheral_t *self, uint32_t offset, uint32_t value, unsigned width);
    void (*reset)(peripheral_t *self);   /* Power-on or system reset. May be NULL. */
    void (*destroy)(peripheral_t *self); /* May be NULL. */
};

/* Add a model to the bus. The peripheral must live as long as the machine. Limit: 64; one more, or an address outside
 * of the peripheral areas, is a violation and nothing is attached. */
void machine_attach(machine_t *machine, peripheral_t *peripheral);

/* The peripheral of a name. Returns NULL if there is none. */
peripheral_t *machine_peripheral(machine_t *machine, const char *name);

const emulator_config_t *machine_config(const machine_t *machine);
const board_edge_t *machine_edge(const machine_t *machine);

/* ---- Time ---- */

/* The present, picoseconds; inside an access it is the time of that instruction. */
int64_t machine_now(const machine_t *machine);

/* The core runs at hz from now on, crystal error included. All clocks derive from RCC, which calls this when the system
 * clock changes. */
void machine_set_core_clock(machine_t *machine, double hz);

/* The flash is read with the wait states, prefetch and caches of this value of FLASH_ACR from now on. */
void machine_set_flash_access(machine_t *machine, uint32_t acr);

/* A callback at an exact time. Events fire in order of time, those of equal times in order of scheduling, each before
 * the first instruction that starts at or after its time. The struct belongs to the model and must stay where it is
 * while it is pending. */
typedef struct machine_event machine_event_t;
struct machine_event {
    void (*fire)(void *context, int64_t time_ps);
    void *context;
    int64_t time_ps;    /* When it fires; models only read it. */
    uint64_t order;     /* The machine's own, as is the next. */
    int32_t heap_index; /* -1: not pending. */
};

/* Prepare an event that is not pending. */
void machine_event_init(machine_event_t *event, void (*fire)(void *context, int64_t time_ps), void *context);
/* Let it fire at time_ps; an event that is pending moves. */
void machine_schedule(machine_t *machine, machine_event_t *event, int64_t time_ps);
/* Let it not fire; an event that is not pending stays so. */
void machine_cancel(machine_t *machine, machine_event_t *event);

/* ---- Interrupts and resets ---- */

/* The level of the request line to the NMI. The handler is entered again as long as it is high. */
void machine_nmi(machine_t *machine, bool level);

/* The level of a peripheral's request line to the NVIC; position as in RM0090 table 62, 0 being WWDG. */
void machine_irq(machine_t *machine, unsigned position, bool level);

/* A watchdog or the core asks for a system reset, which happens before the next instruction. csr_flags are the bits to
 * set in RCC_CSR. */
void machine_reset_request(machine_t *machine, uint32_t csr_flags);

/* The supply is too low: the chip stays in reset, from now on until it is released with the flags for RCC_CSR. */
void machine_hold_in_reset(machine_t *machine);
void machine_release_reset(machine_t *machine, uint32_t csr_flags);

/* A debugger stops the core, or lets it go on. Everything else goes on, unless DBGMCU freezes it. */
void machine_debug_halt(machine_t *machine, bool halted);

/* Returns whether the core is stopped and a bit of DBGMCU_APB1_FZ (bus 1) or DBGMCU_APB2_FZ (bus 2) is set. */
bool machine_debug_frozen(const machine_t *machine, unsigned bus, unsigned bit);

/* SRAM and core-coupled memory lose what they held: they read as random words, which the configuration's memory_seed,
 * the unique id and the time decide. Without a seed they keep it. */
void machine_forget_memories(machine_t *machine);

/* Returns the flags of the requests that led to this reset, 0 at power-on. RCC asks, inside its reset function. */
uint32_t machine_reset_flags(const machine_t *machine);

/* ---- Memory and registers, as a bus master (DMA) reaches them ---- */

/* width is 1, 2 or 4 bytes. Returns false upon a bus error (nothing is there, or it is read-only), which is a violation
 * as well. */
bool machine_bus_read(machine_t *machine, uint32_t address, unsigned width, uint32_t *value);
bool machine_bus_write(machine_t *machine, uint32_t address, unsigned width, uint32_t value);

/* ---- The flash, as its controller has it ---- */

enum { MACHINE_FLASH_SIZE = 0x100000 };

/* What the controller does with accesses of the core; offset is from the start of the flash. */
typedef struct {
    /* A store of 1, 2 or 4 bytes, aligned or not. */
    void (*store)(void *context, uint32_t offset, uint32_t value, unsigned width);
    /* A load, or a fetch, from one of the 16 KB pieces that machine_flash_watch() named. */
    void (*watched)(void *context, uint32_t offset, unsigned width, bool fetch);
    void *context;
} flash_controller_t;
void machine_flash_controller(machine_t *machine, const flash_controller_t *controller);

/* Returns the content: MACHINE_FLASH_SIZE bytes. machine_flash_changed() must tell of what is changed there. */
uint8_t *machine_flash(machine_t *machine);
void machine_flash_changed(machine_t *machine, uint32_t offset, uint32_t count);

/* While the flash is busy the core waits with any load or fetch from it; a bus master's read is a violation. */
void machine_flash_busy(machine_t *machine, bool busy);

/* Tell the controller of loads, and of fetches, from these pieces of 16 KB: bit n is the one at n times 16 KB. */
void machine_flash_watch(machine_t *machine, uint64_t loads, uint64_t fetches);

/* The write that the model has been given meets a bus error: the core faults. The sentence is for the report. */
void machine_bus_error(machine_t *machine, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* The next of a sequence of random words (SplitMix64). */
uint64_t machine_random(uint64_t *state);

/* ---- Violations and faults ---- */

/* Record a sentence, with the time, the program counter and the last peripheral access. */
void machine_violation(machine_t *machine, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* The same for what the processor answers with one of its fault exceptions. It stops the board only under
 * emulator_config_t.stop_at_fault: the program's handler is to be seen at work. */
void machine_fault(machine_t *machine, const char *format, ...) __attribute__((format(printf, 2, 3)));

#endif
