/* code_view.h: the program as bytes in memory: which instruction stands where, and where in an IT block an address is.
 */
#ifndef GOLDFIELD_CODE_VIEW_H
#define GOLDFIELD_CODE_VIEW_H

#include "emulator/processor.h"

/* The first halfword of the instruction at an address. Returns false if there is no memory. */
bool code_opcode_at(const cpu_t *cpu, uint32_t address, uint16_t *opcode);

/* ITSTATE of the instruction at an address, which is about to run, or just failed (then with executed one less). It is
 * found from the instructions that ran before it. Returns 0 outside of an IT block. */
uint8_t code_it_state_at(const cpu_t *cpu, uint32_t address);

/* Whether the instruction at an address needs the floating-point unit: coprocessors 10 and 11 (ARMv7-M manual,
 * A5.3.18). */
bool code_is_floating_point(const cpu_t *cpu, uint32_t address);

/* Whether the instruction at an address is UDIV or SDIV (A7.7.127, A7.7.195), and the number of its divisor's register.
 */
bool code_is_division(const cpu_t *cpu, uint32_t address, unsigned *divisor);

/* The address of the last instruction that began, and whether that instruction is a load or store of a single item. */
uint32_t code_last_address(const cpu_t *cpu);
bool code_is_single_transfer(const cpu_t *cpu);

#endif
