/* exceptions.h: exception entry, return and fault escalation (ARMv7-M architecture reference manual, B1.5).
 *
 * The frame's return address is cpu->pc and its ITSTATE cpu->it_state; both become those of the handler.
 */
#ifndef GOLDFIELD_EXCEPTIONS_H
#define GOLDFIELD_EXCEPTIONS_H

#include "emulator/processor.h"

/* Whether the NVIC's candidate would preempt what runs now; with heed_primask false, whether it would if PRIMASK were
 * clear, which is what wakes a sleeping core. */
bool exception_preempts(const cpu_t *cpu, bool heed_primask);

/* Stack the context and enter the handler. The board halts in lockup if there is no stack or no vector. */
void exception_enter(cpu_t *cpu, unsigned exception);

/* A branch to an EXC_RETURN value: unstack, or raise a usage fault if the value does not fit the state. */
void exception_return(cpu_t *cpu, uint32_t exc_return);

/* Enter the handler of a synchronous exception, or escalate to HardFault, or halt in lockup. */
void exception_synchronous(cpu_t *cpu, unsigned exception);

/* Set a fault's status bits and enter its handler as exception_synchronous() does. */
void exception_fault(cpu_t *cpu, const fault_t *fault);

#endif
