/* emulator.h: one board: an STM32F405 that runs an unmodified ARM image on Unicorn 2.1.4.
 *
 * The board's edge (pins, volts, bytes, frames) is firmware/boards/board_edge.h. Boards share nothing: several may run
 * in as many threads.
 */
#ifndef GOLDFIELD_EMULATOR_H
#define GOLDFIELD_EMULATOR_H

#include "boards/board_edge.h"

typedef struct {
    double crystal_ppm;  /* Error of this board's 8 MHz crystal. */
    double internal_ppm; /* Error of the 16 MHz internal oscillator (10,000 = 1 %). */
    bool crystal_dead;   /* The crystal never starts. */
    uint8_t unique_id[12];
    double temperature_degc; /* Of the die: the internal temperature sensor. */
    bool strict; /* A violation (see machine.h) stops the board with BOARD_FAULT; else it is only recorded. */
} emulator_config_t;

typedef struct {
    uint64_t instructions; /* Executed since reset. */
    uint64_t interrupts;   /* Exceptions taken. */
    uint64_t cycles;       /* Core cycles, asleep or not. */
    uint64_t sleep_cycles; /* Of these, in WFI. */
    uint64_t violations;
    uint32_t stack_low; /* Lowest main stack pointer seen at an exception entry. */
} emulator_stats_t;

/* Load segments of an image into flash (physical addresses 0x08000000..0x080FFFFF). Erased flash reads 0xFF. Returns
 * NULL and writes a sentence to error (capacity error_size) if something is wrong. power_on_ps: when the board gets
 * power and starts its reset sequence. */
board_t *emulator_create(const emulator_config_t *config, const board_edge_t *edge, int64_t power_on_ps, char *error,
                         size_t error_size);
bool emulator_load(board_t *board, uint32_t address, const uint8_t *bytes, size_t count);

extern const board_operations_t emulator_operations;

void emulator_stats(const board_t *board, emulator_stats_t *stats);

/* Count instructions between two addresses (a function's entry and its return to the caller): how often the entry
 * was reached, and the largest and the summed count of instructions until control came back to the return address,
 * interrupts taken inside excluded. At most 8 probes. */
typedef struct {
    uint32_t entry;
    uint64_t calls, total, largest;
} emulator_probe_t;
bool emulator_probe_add(board_t *board, uint32_t entry);
bool emulator_probe_read(const board_t *board, unsigned index, emulator_probe_t *probe);

/* Debug and test access: registers r0..r15, xpsr (16), msp (17), psp (18), primask (19), basepri (20), faultmask
 * (21), control (22), fpscr (23); memory as the core sees it. */
uint32_t emulator_register(const board_t *board, unsigned index);
bool emulator_memory_read(const board_t *board, uint32_t address, uint8_t *bytes, size_t count);

#endif
