/* machine_internal.h: the machine's own state, for the files that make it up, the inputs, the bench and the processor;
 * peripheral models use machine.h.
 *
 * machine_create() makes a machine without a processor, which is complete: memory, bus, events, violations. A processor
 * registers itself as a table (machine_t.processor). Whoever lets the machine live calls machine_fire() for time to
 * pass, machine_core_read() and machine_core_write() for the core's accesses, and machine_reset_peripherals() upon a
 * reset.
 *
 *     machine.c         life, reset, interrupt lines, violations
 *     machine_events.c  time and the heap of events
 *     machine_bus.c     memories and peripherals by address
 *     machine_flash.c   between the flash's controller, the processor and the bus
 */
#ifndef GOLDFIELD_MACHINE_INTERNAL_H
#define GOLDFIELD_MACHINE_INTERNAL_H

#include "emulator/machine.h"

#define FLASH_BASE         0x08000000u
#define FLASH_SIZE         0x00100000u
#define FLASH_PIECE        0x00004000u /* The least sector. */
#define SRAM_BASE          0x20000000u /* 112 KB and 16 KB, contiguous. */
#define SRAM_SIZE          0x00020000u
#define CCM_BASE           0x10000000u /* On the core's data bus only: no bus master but the core reaches it. */
#define CCM_SIZE           0x00010000u
#define SYSTEM_MEMORY_BASE 0x1FFF0000u /* Boot loader (erased here), one-time area, unique id, calibration. */
#define SYSTEM_MEMORY_SIZE 0x00008000u
#define PERIPHERAL_BASE    0x40000000u
#define PERIPHERAL_SIZE    0x00080000u
#define PERIPHERAL2_BASE   0x50000000u
#define PERIPHERAL2_SIZE   0x00061000u

#define MACHINE_PERIPHERALS       64u
#define MACHINE_IRQ_LINES         82u /* RM0090 table 62: positions 0..81. */
#define MACHINE_REPORT_SIZE       16384u
#define MACHINE_NEVER             INT64_MAX
#define MACHINE_DIRECTORY_GRANULE 256u
#define MACHINE_DIRECTORY_SIZE    ((PERIPHERAL_SIZE + PERIPHERAL2_SIZE) / MACHINE_DIRECTORY_GRANULE)

/* What the machine asks of a processor. Every call may come from inside an access or an event. */
typedef struct {
    void (*irq)(void *processor, unsigned position, bool level);
    void (*nmi)(void *processor);
    void (*clock)(void *processor, double hz);
    void (*flash_access)(void *processor, uint32_t acr);
    /* These bytes of the flash are others now. */
    void (*flash_changed)(void *processor, uint32_t offset, uint32_t count);
    /* flash_busy or flash_watched is another now. */
    void (*flash_rules)(void *processor);
    /* The next event became earlier, or stop_requested or reset_requested was set. */
    void (*attention)(void *processor);
    uint32_t (*program_counter)(const void *processor);
    void *processor; /* NULL: there is none. */
} machine_processor_t;

typedef struct {
    uint32_t address, value;
    unsigned width; /* Bytes; 0: there was none yet. */
    bool write;
    int64_t time_ps;
} machine_access_t;

typedef struct machine_input machine_input_t; /* inputs.c */

struct machine {
    emulator_config_t config;
    board_edge_t edge;

    int64_t now_ps;
    double core_hz;
    machine_processor_t processor;
    bool stop_requested; /* A violation or a fault stops the board. */
    bool reset_requested;
    bool held_in_reset;
    bool debug_halted;         /* A debugger has stopped the core. */
    uint32_t debug_control[3]; /* DBGMCU_CR, APB1_FZ, APB2_FZ: only a power-on resets them. */
    uint32_t reset_flags;

    peripheral_t *peripherals[MACHINE_PERIPHERALS];
    unsigned peripheral_count;
    /* Index + 1 of the peripheral that starts or lies in each granule of the two peripheral areas. */
    uint8_t *directory;
    uint32_t irq_level[3];
    bool nmi_level;

    uint8_t *flash, *sram, *ccm, *system_memory;
    flash_controller_t flash_controller;
    bool flash_busy;
    uint64_t watched_loads, watched_fetches; /* By pieces of FLASH_PIECE bytes. */
    bool bus_error;                          /* The present write to a register has met one. */

    machine_event_t **heap;
    size_t heap_count, heap_capacity;
    uint64_t event_order;

    machine_input_t *free_inputs, *all_inputs;

    machine_access_t last_access;
    uint64_t violations, faults;
    char *report; /* Violations as text, one a line; MACHINE_REPORT_SIZE. */
    size_t report_length;
};

/* A machine at power_on_ps with erased memories and no peripheral; edge may be NULL (nothing is connected). Returns
 * NULL if there is no memory. */
machine_t *machine_create(const emulator_config_t *config, const board_edge_t *edge, int64_t power_on_ps);

/* Destroy the peripherals and free the machine; inputs_destroy() comes before. */
void machine_destroy(machine_t *machine);

/* System reset: every peripheral's reset function, interrupt lines low. SRAM keeps its content. */
void machine_reset_peripherals(machine_t *machine);

/* Fire, in order, every event at or before time_ps, those that they schedule included. The present is each event's
 * time, and time_ps at the end. */
void machine_fire(machine_t *machine, int64_t time_ps);

/* Time of the earliest event. Returns MACHINE_NEVER if there is none. */
static inline int64_t machine_next_event(const machine_t *machine) {
    return machine->heap_count == 0 ? MACHINE_NEVER : machine->heap[0]->time_ps;
}

/* A peripheral register as the core reaches it; the access is noted for reports. Returns false if nothing is there: a
 * violation is recorded, and the core faults. */
bool machine_core_read(machine_t *machine, uint32_t address, unsigned width, uint32_t *value);
bool machine_core_write(machine_t *machine, uint32_t address, unsigned width, uint32_t value);

/* A store of the core into the flash: the controller's work. Only at FLASH_BASE, not where the flash appears at 0. */
void machine_flash_store(machine_t *machine, uint32_t address, unsigned width, uint32_t value);

/* Whether an address is in the flash, at either of its places. */
static inline bool machine_in_flash(uint32_t address) {
    return (address & ~(FLASH_BASE | (FLASH_SIZE - 1u))) == 0;
}

/* Host address of count bytes of memory as the core sees them (flash also at 0). Returns NULL if they are not all in
 * one memory. */
uint8_t *machine_memory(machine_t *machine, uint32_t address, size_t count);

#endif
