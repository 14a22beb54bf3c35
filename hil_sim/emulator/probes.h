/* probes.h: instructions and cycles of functions.
 *
 * A function whose entry is a branch target starts a block of code in Unicorn, so that entries cost a hook on that one
 * block only. While a probe is inside its function, the processor looks at every instruction for the return address.
 */
#ifndef GOLDFIELD_PROBES_H
#define GOLDFIELD_PROBES_H

#include "emulator/processor.h"

/* Count the function at an entry address from now on. Returns false if PROBES are there already, or Unicorn refuses. */
bool probes_add(cpu_t *cpu, uint32_t entry);

/* The processor enters, or has left, an exception handler: its instructions count for nobody outside. */
void probes_enter_exception(cpu_t *cpu);
void probes_leave_exception(cpu_t *cpu);

/* While a probe is active, before each instruction: ends the probes whose function returns to this address. */
void probes_step(cpu_t *cpu, uint32_t address);

#endif
