/* peripherals.h: the STM32F405's peripherals, all of them. */
#ifndef GOLDFIELD_PERIPHERALS_H
#define GOLDFIELD_PERIPHERALS_H

#include "emulator/machine.h"

/* Create and attach every model. Call once, after the processor exists, if there is one; the models go with the
 * machine. Ends the process if there is no memory, as a chip without peripherals would only mislead. */
void peripherals_create(machine_t *machine);

#endif
