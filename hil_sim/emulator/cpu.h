/* cpu.h: life, reset and run of the Cortex-M4F; the machine's processor (machine_processor_t). */
#ifndef GOLDFIELD_CPU_H
#define GOLDFIELD_CPU_H

#include "emulator/processor.h"

/* A processor on a machine, registered there. Writes a sentence to error, of capacity error_size, and returns NULL if
 * there is no memory or Unicorn does not start. */
cpu_t *cpu_create(machine_t *machine, char *error, size_t error_size);
void cpu_destroy(cpu_t *cpu);

/* Run until the given time. At the end the processor may be up to 4 instructions ahead, to the end of an IT block.
 * Returns BOARD_FAULT once the board has halted. */
board_status_t cpu_run(cpu_t *cpu, int64_t until_ps);

#endif
