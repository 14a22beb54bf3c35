/* emulator.h: one board: an STM32F405 that runs an unmodified ARM image on Unicorn 2.1.4.
 *
 * emulator_create() makes a board with its edge to the outside (boards/board_edge.h); emulator_load() puts an image
 * into its flash; emulator_operations.run() lets it live, the other operations bring signals from outside, report and
 * destroy. The rest looks inside: statistics, instruction counts of functions, registers, memory. Boards share nothing:
 * several may run in as many threads.
 */
#ifndef GOLDFIELD_EMULATOR_H
#define GOLDFIELD_EMULATOR_H

#include "boards/board_edge.h"
#include "emulator/config.h"

typedef struct {
    uint64_t instructions;      /* Executed since power-on. */
    uint64_t interrupts;        /* Exceptions taken. */
    uint64_t cycles;            /* Core cycles, asleep or not. */
    uint64_t sleep_cycles;      /* Those of them in WFI or WFE. */
    uint64_t flash_wait_cycles; /* Those that the core waited for a flash that was busy. */
    uint64_t violations;        /* See machine.h. */
    uint64_t faults;            /* The same: those that the processor's handlers took. */
    uint32_t stack_low;         /* Lowest main stack pointer at an exception entry; 0xFFFFFFFF before the first. */
} emulator_stats_t;

typedef struct {
    uint32_t entry;   /* Address of the function. */
    uint64_t calls;   /* How often it returned. */
    uint64_t total;   /* Instructions of all calls, from the entry to the return, interrupts taken inside excluded. */
    uint64_t largest; /* The same of the longest call. */
    uint64_t cycles;  /* Core cycles of the dearest call, the same excluded but for their returns. */
} emulator_probe_t;

/* A board with erased flash (it reads 0xFF). It gets power, and begins its reset sequence, at power_on_ps. Writes a
 * sentence to error, of capacity error_size, and returns NULL if something is wrong. */
board_t *emulator_create(const emulator_config_t *config, const board_edge_t *edge, int64_t power_on_ps, char *error,
                         size_t error_size);

/* Write one segment of an image into flash, at its physical address. Returns false if it does not lie in
 * 0x08000000..0x080FFFFF. */
bool emulator_load(board_t *board, uint32_t address, const uint8_t *bytes, size_t count);

extern const board_operations_t emulator_operations;

/* The crystal stops, or oscillates again, from a time on. */
void emulator_crystal(board_t *board, bool alive, int64_t time_ps);
/* The noise source of the random number generator sticks at one level, or is alive again, from a time on. The generator
 * repeats its number until it sees that, 65 periods of PLL48CLK later: a seed error (SEIS). */
void emulator_noise(board_t *board, bool alive, int64_t time_ps);
/* The chip's supply, 3.3 V from power-on, has this voltage from a time on. */
void emulator_supply(board_t *board, double volts, int64_t time_ps);

/* A debugger stops the core from a time on, or lets it go on. Peripherals go on, and so does SysTick, which on silicon
 * would stop; the two watchdogs stand still if DBGMCU_APB1_FZ says so, and any other bit of it or of DBGMCU_APB2_FZ is
 * a violation then. */
void emulator_debug_halt(board_t *board, bool halted, int64_t time_ps);

/* Cut the chip's supply in a step of its flash, a program or an erase: in the step-th from now on (1: the next; 0: in
 * none any more), when this fraction of its time, 0 to 1, is over. What the step leaves in the cells follows the
 * board's memory_seed and unique id, the step's number, and the id. The supply is back, at 3.3 V, after off_ps; 0: it
 * stays away. */
void emulator_cut_flash(board_t *board, uint64_t step, double fraction, uint64_t id, int64_t off_ps);
/* Returns how many steps have begun since the board was made. */
uint64_t emulator_flash_steps(const board_t *board);

/* The flash's cells, 2 MB: what each byte reads as, then which bits of each are weak, so that they may read otherwise
 * at the next reset. Saving ends a step that is going on, as a loss of power does. Restoring is for a board that has
 * not run yet. */
enum { EMULATOR_CELLS = 0x200000 };
void emulator_cells_save(board_t *board, uint8_t *cells);
void emulator_cells_restore(board_t *board, const uint8_t *cells);

void emulator_stats(const board_t *board, emulator_stats_t *stats);

/* Count the instructions of a function, which may be an exception's handler, from now on. Returns false beyond 12
 * functions. */
bool emulator_probe_add(board_t *board, uint32_t entry);
/* The counts of a probe, numbered from 0 in the order of adding. Returns false if there is none of this number. */
bool emulator_probe_read(const board_t *board, unsigned index, emulator_probe_t *probe);

/* A register: r0..r15, xpsr (16), msp (17), psp (18), primask (19), basepri (20), faultmask (21), control (22), fpscr
 * (23). Returns 0 beyond. */
uint32_t emulator_register(const board_t *board, unsigned index);

/* Memory as the core sees it. Returns false, and copies nothing, if it does not all lie in one memory. */
bool emulator_memory_read(const board_t *board, uint32_t address, uint8_t *bytes, size_t count);

/* Upsets: what a glitch of the supply or a particle does. One of these at a time is awaited; none costs anything while
 * nobody asks for it.
 *
 * An upset strikes in the nth execution from now on (1: the next) of an instruction in flash. Where the instruction
 * lies in an IT block the executions of the block count, the conditions that fail too, and a register flips at its
 * beginning. Returns false if there is no such instruction or register, or if one that is skipped is just running. */

/* Skip the instruction at an address once: a NOP of its length runs in its place. */
bool emulator_skip(board_t *board, uint32_t address, uint64_t nth);
/* Flip the bits of mask in a register just before the instruction: r0..r15 (of r15 not bit 0, which it does not have),
 * or the flags N, Z, C, V and Q of xpsr (16). */
bool emulator_flip(board_t *board, uint32_t address, uint64_t nth, unsigned index, uint32_t mask);
/* Returns whether the upset that was asked for last has struck. */
bool emulator_struck(const board_t *board);
/* Flip the bits of mask in a byte of RAM, now. Returns false if there is none. */
bool emulator_flip_memory(board_t *board, uint32_t address, uint8_t mask);

/* Note from now on when each instruction from one address to another, both even, has begun first. Returns false if
 * there is no memory. */
bool emulator_visits_begin(board_t *board, uint32_t from, uint32_t to);
/* Write these times for at most so many of its halfwords, -1 where no instruction has begun. Returns how many. */
size_t emulator_visits(const board_t *board, int64_t *first_ps, size_t count);

#endif
