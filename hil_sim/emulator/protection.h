/* protection.h: the memory protection unit at work: what it forbids is stopped in Unicorn's memories, in the windows of
 * the peripherals and at the frames of exceptions (mpu.h says what is enforced and what is not).
 */
#ifndef GOLDFIELD_PROTECTION_H
#define GOLDFIELD_PROTECTION_H

#include "emulator/processor.h"

/* The unit's rules changed, or the core was reset. */
void protection_apply(cpu_t *cpu);

/* These pieces of the flash, of FLASH_PIECE bytes each, as bits, let no loads and no fetches pass. Only those in which
 * are looked at. */
void protection_close(cpu_t *cpu, uint64_t loads, uint64_t fetches, uint64_t which);

/* Whether the program that runs now may access the bytes. */
bool protection_allows(const cpu_t *cpu, uint32_t address, unsigned size, mpu_access_t access);

/* The same for the frame of an exception that interrupts a program of this privilege. */
bool protection_allows_frame(const cpu_t *cpu, uint32_t address, uint32_t size, mpu_access_t access, bool privileged);

/* Unicorn met a protected page. A write that the rules allow is done here, as Unicorn would drop it. Returns whether
 * the access may go on. */
bool protection_admits(cpu_t *cpu, uc_mem_type type, uint32_t address, unsigned size, uint64_t value);

#endif
