/* machine_flash.c: between the flash's controller, which knows what may be programmed and for how long, the processor,
 * which must wait for it, and the content that both share. */
#include "emulator/machine_internal.h"

void machine_flash_controller(machine_t *machine, const flash_controller_t *controller) {
    machine->flash_controller = *controller;
}

uint8_t *machine_flash(machine_t *machine) {
    return machine->flash;
}

void machine_flash_changed(machine_t *machine, uint32_t offset, uint32_t count) {
    if (machine->processor.processor != NULL) {
        machine->processor.flash_changed(machine->processor.processor, offset, count);
    }
}

static void tell_rules(machine_t *machine) {
    if (machine->processor.processor != NULL) {
        machine->processor.flash_rules(machine->processor.processor);
    }
}

void machine_flash_busy(machine_t *machine, bool busy) {
    if (machine->flash_busy != busy) {
        machine->flash_busy = busy;
        tell_rules(machine);
    }
}

void machine_flash_watch(machine_t *machine, uint64_t loads, uint64_t fetches) {
    if (machine->watched_loads != loads || machine->watched_fetches != fetches) {
        machine->watched_loads = loads;
        machine->watched_fetches = fetches;
        tell_rules(machine);
    }
}

void machine_flash_store(machine_t *machine, uint32_t address, unsigned width, uint32_t value) {
    machine->last_access = (machine_access_t){
        .address = address, .value = value, .width = width, .write = true, .time_ps = machine->now_ps};
    machine->flash_controller.store(machine->flash_controller.context, address - FLASH_BASE, value, width);
}
