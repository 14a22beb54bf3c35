/* execution.h: instructions on Unicorn, stopped at exact moments.
 *
 * Events fire on time between two instructions; exceptions, sleep and the end of a run leave Unicorn, and this module
 * turns each reason into the processor's new state.
 */
#ifndef GOLDFIELD_EXECUTION_H
#define GOLDFIELD_EXECUTION_H

#include "emulator/processor.h"

/* Open Unicorn as a Cortex-M4 with the machine's address map and hooks. Returns Unicorn's error. */
uc_err execution_create(cpu_t *cpu);

/* Run from cpu->pc until something must be done outside of Unicorn: an exception that preempts, a fault, sleep, a reset
 * request, or cpu->until_ps. */
void execution_run(cpu_t *cpu);

#endif
