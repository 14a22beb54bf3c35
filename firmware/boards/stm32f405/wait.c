/* wait.c: waits with a bound. The boot loader has it, too. */

#include "boards/stm32f405/stm32f405.h"

bool wait_for(const volatile uint32_t *address, uint32_t mask, uint32_t value, uint32_t tries) {
    while (tries-- > 0) {
        if ((*address & mask) == value)
            return true;
    }
    return false;
}
