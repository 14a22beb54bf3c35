/* flash_wait.h: the core beside a flash that is programmed or erased: it waits with what it would load or fetch there.
 *
 * The machine says when the flash is busy, which pieces of it are watched, and which bytes have changed
 * (flash_wait_changed() in each case); flash_wait_apply() makes Unicorn follow before the next instruction. Pieces that
 * are busy or watched are closed in Unicorn, so nothing is slower while none is. They are opened again when somebody
 * wants to go there.
 */
#ifndef GOLDFIELD_FLASH_WAIT_H
#define GOLDFIELD_FLASH_WAIT_H

#include "emulator/processor.h"

/* Rules have changed, or count bytes from an offset on (0: none). */
void flash_wait_changed(cpu_t *cpu, uint32_t offset, uint32_t count);

/* Whether the core stands still beside a busy flash: it would go on there, or load from there, or an exception whose
 * vector or handler is there would. */
bool flash_wait_holds(cpu_t *cpu);

/* Unicorn must not run. */
void flash_wait_apply(cpu_t *cpu);

/* Unicorn met a page that lets no access of this type pass. Returns whether the flash has to do with it, and then in
 * admitted whether the access may go on. */
bool flash_wait_met(cpu_t *cpu, uc_mem_type type, uint32_t address, unsigned size, bool *admitted);

/* Unicorn was left at a load that load_waits tells of: it is done again later. */
void flash_wait_load_again(cpu_t *cpu);

/* Unicorn was left as it may not fetch from an address. Returns whether the flash has to do with it: the core goes on
 * there, when it can. */
bool flash_wait_fetch(cpu_t *cpu, uint32_t address);

#endif
