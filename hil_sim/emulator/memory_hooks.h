/* memory_hooks.h: what Unicorn asks about memory: what a page may be used for, and what becomes of an access that a
 * region does not let pass (core_bus.h maps the regions, protection.h and flash_wait.h close them).
 *
 * memory_hooks_create() once the memories are mapped; memory_hooks_before_run() before each run of Unicorn, and
 * memory_hooks_follow_rules() whenever the processor's rules have changed. Unicorn must not run meanwhile.
 *
 * Unicorn stores at once only into pages of which it knows that nobody looks at them: that they hold no code, and that
 * no hook is there. Any other store is many times as dear. So RAM is no place of code until a program jumps
 * there, and has no hook but where the memory protection unit forbids something.
 */
#ifndef GOLDFIELD_MEMORY_HOOKS_H
#define GOLDFIELD_MEMORY_HOOKS_H

#include "emulator/processor.h"

/* Returns Unicorn's error. */
uc_err memory_hooks_create(cpu_t *cpu);

/* Unicorn's table of pages has places enough. */
void memory_hooks_before_run(cpu_t *cpu);

/* The rules of the memory protection unit, or of CCR, have changed. */
void memory_hooks_follow_rules(cpu_t *cpu);

/* Unicorn was left as it may not fetch from cpu->pc. Returns whether that was because no program had jumped to the SRAM
 * yet: now it may. */
bool memory_hooks_open_sram(cpu_t *cpu);

#endif
