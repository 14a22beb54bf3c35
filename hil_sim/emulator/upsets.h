/* upsets.h: what a glitch of the supply or a particle does to a program: an instruction that is skipped once, bits of a
 * register that flip. And which instructions have run, and when first, so that somebody may choose among them.
 *
 * Unicorn cannot be left inside an IT block, so an upset begins at the instruction that opens the block. There the
 * processor is left; an instruction that is to be skipped becomes a NOP in the flash, which is given back behind the
 * block. A hook on these few addresses alone sees to it: all other code runs as fast as without.
 */
#ifndef GOLDFIELD_UPSETS_H
#define GOLDFIELD_UPSETS_H

#include "emulator/processor.h"

/* What emulator.h says of emulator_skip(), emulator_flip() and emulator_struck(). */
bool upsets_skip(cpu_t *cpu, uint32_t address, uint64_t nth);
bool upsets_flip(cpu_t *cpu, uint32_t address, uint64_t nth, unsigned core_register, uint32_t mask);
bool upsets_struck(const cpu_t *cpu);

/* What emulator.h says of emulator_visits_begin() and emulator_visits(). */
bool upsets_visits_begin(cpu_t *cpu, uint32_t from, uint32_t to);
size_t upsets_visits(const cpu_t *cpu, int64_t *first_ps, size_t count);

/* Free what the functions above have allocated; Unicorn need not be there any more. */
void upsets_free(cpu_t *cpu);

#endif
