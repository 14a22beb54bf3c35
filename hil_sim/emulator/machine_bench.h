/* machine_bench.h: a machine without a processor, to test peripheral models: the caller takes the core's place.
 *
 *   machine_t *m = machine_bench_create(&config, &edge);
 *   machine_bench_write(m, 0x40023830, 4, 1);              RCC_AHB1ENR: a core's store, same checks and violations
 *   machine_bench_operations.run((board_t *)m, 1000000);   let 1 us pass: events before that time fire
 *
 * Every model is attached (peripherals_create) and reset; the core clock is what RCC's reset sets. config.strict
 * changes nothing here: violations are counted.
 */
#ifndef GOLDFIELD_MACHINE_BENCH_H
#define GOLDFIELD_MACHINE_BENCH_H

#include "emulator/machine.h"

/* edge may be NULL: nothing is connected. Returns NULL if there is no memory. */
machine_t *machine_bench_create(const emulator_config_t *config, const board_edge_t *edge);

/* run, now, pin_in, uart_in, can_in, can_sent, report (the violations so far), destroy. run always returns BOARD_OK. */
extern const board_operations_t machine_bench_operations;

/* A load or store of the core, now; width is 1, 2 or 4. A load from the flash waits while that is busy: time passes.
 * Returns false if it would raise a BusFault. */
bool machine_bench_read(machine_t *machine, uint32_t address, unsigned width, uint32_t *value);
bool machine_bench_write(machine_t *machine, uint32_t address, unsigned width, uint32_t value);

/* Level of a request line to the NVIC (0..81). */
bool machine_bench_irq(const machine_t *machine, unsigned position);

/* Whether a watchdog asked for a reset, and in flags what it wants set in RCC_CSR. The request is taken back. */
bool machine_bench_reset_requested(machine_t *machine, uint32_t *flags);
/* What the processor does upon a reset request: every model's reset. */
void machine_bench_reset(machine_t *machine);

/* Level of the request line to the NMI; whether the supply holds the chip in reset. */
bool machine_bench_nmi(const machine_t *machine);
bool machine_bench_held(const machine_t *machine);
/* As emulator_crystal(), emulator_noise() and emulator_supply() do it, now. */
void machine_bench_crystal(machine_t *machine, bool alive);
void machine_bench_noise(machine_t *machine, bool alive);
void machine_bench_supply(machine_t *machine, double volts);

/* As emulator_cut_flash() and emulator_flash_steps() do it. */
void machine_bench_cut_flash(machine_t *machine, uint64_t step, double fraction, uint64_t id, int64_t off_ps);
uint64_t machine_bench_flash_steps(const machine_t *machine);

/* Clocks in Hz, crystal error included: the core's, and those of a peripheral, named as in the SVD: of its bus, and of
 * the timers on that bus. Return 0 if there is no such peripheral. */
double machine_bench_core_clock(const machine_t *machine);
double machine_bench_bus_clock(const machine_t *machine, const char *name);
double machine_bench_timer_clock(const machine_t *machine, const char *name);

/* A pulse on a request line to the DMA controllers (RM0090 tables 42 and 43): "TIM1_UP", "TIM1_CH4", "ADC1",
 * "USART1_TX". Returns false if there is no such line. */
bool machine_bench_dma_pulse(machine_t *machine, const char *source);

/* Cycles of an instruction by its class (cycles.h). */
unsigned machine_bench_class_cycles(uint16_t first, uint16_t second);

uint64_t machine_bench_violations(const machine_t *machine);
void machine_bench_forget_violations(machine_t *machine);

#endif
