#include "emulator/flash_wait.h"

#include <string.h>

#include "emulator/code_view.h"
#include "emulator/exceptions.h"
#include "emulator/protection.h"

enum { PIECE_SHIFT = 14, FEW_BYTES = 4096 };

static uint64_t piece_of(uint32_t address) {
    return UINT64_C(1) << ((address & (FLASH_SIZE - 1u)) >> PIECE_SHIFT);
}

void flash_wait_changed(cpu_t *cpu, uint32_t offset, uint32_t count) {
    flash_view_t *const view = &cpu->flash;
    if (count > 0) {
        const bool first = view->changed_from == view->changed_to;
        view->changed_from = first || offset < view->changed_from ? offset : view->changed_from;
        view->changed_to = first || offset + count > view->changed_to ? offset + count : view->changed_to;
    }
    view->changed = true;
    cpu->deadline = 0;
}

/* ---- Standing still ---- */

/* The handler of an exception, or its vector, is in the flash. */
static bool exception_needs_flash(const cpu_t *cpu, unsigned exception) {
    const uint32_t vector = cpu->system.vtor + 4u * exception;
    const uint8_t *const memory = machine_memory(cpu->machine, vector, 4);
    uint32_t handler = 0;
    if (memory != NULL) {
        memcpy(&handler, memory, sizeof handler);
    }
    return machine_in_flash(vector) || machine_in_flash(handler);
}

bool flash_wait_holds(cpu_t *cpu) {
    if (cpu->asleep) {
        return false;
    }
    if (cpu->fault.exception != 0) {
        return exception_needs_flash(cpu, cpu->fault.exception);
    }
    return machine_in_flash(cpu->pc) || cpu->flash.load_waits ||
           (exception_preempts(cpu, true) && exception_needs_flash(cpu, cpu->nvic.candidate));
}

/* ---- Pages ---- */

static void forget_translations(cpu_t *cpu) {
    const uint32_t from = cpu->flash.changed_from, to = cpu->flash.changed_to;
    if (to - from > FEW_BYTES) {
        uc_ctl_flush_tb(cpu->uc);
    } else {
        uc_ctl_remove_cache(cpu->uc, from, to);
        uc_ctl_remove_cache(cpu->uc, FLASH_BASE + from, FLASH_BASE + to);
    }
    cycles_forget(&cpu->cycles, from, to);
    cpu->flash.changed_from = cpu->flash.changed_to = 0;
}

static void close_pieces(cpu_t *cpu, uint64_t loads, uint64_t fetches) {
    flash_view_t *const view = &cpu->flash;
    protection_close(cpu, loads, fetches, (view->closed_loads ^ loads) | (view->closed_fetches ^ fetches));
    view->closed_loads = loads;
    view->closed_fetches = fetches;
    uc_ctl_flush_tlb(cpu->uc);
}

void flash_wait_apply(cpu_t *cpu) {
    flash_view_t *const view = &cpu->flash;
    const machine_t *const machine = cpu->machine;
    const uint64_t loads = machine->flash_busy ? UINT64_MAX : machine->watched_loads;
    const uint64_t fetches = machine->flash_busy ? UINT64_MAX : machine->watched_fetches;
    if (view->changed_from != view->changed_to) {
        forget_translations(cpu);
    }
    if (machine_in_flash(cpu->pc) || view->load_waits) {
        if (view->closed_loads != loads || view->closed_fetches != fetches) {
            close_pieces(cpu, loads, fetches);
        }
    } else if ((loads & ~view->closed_loads) != 0 || (fetches & ~view->closed_fetches) != 0) {
        close_pieces(cpu, view->closed_loads | loads, view->closed_fetches | fetches);
    }
    view->changed = view->load_waits = false;
}

bool flash_wait_met(cpu_t *cpu, uc_mem_type type, uint32_t address, unsigned size, bool *admitted) {
    flash_view_t *const view = &cpu->flash;
    const machine_t *const machine = cpu->machine;
    *admitted = false;
    if (!machine_in_flash(address)) {
        return false;
    }
    if (type == UC_MEM_FETCH_PROT) {
        return (view->closed_fetches & piece_of(address)) != 0;
    }
    if (type != UC_MEM_READ_PROT || (view->closed_loads & piece_of(address)) == 0) {
        return false;
    }
    if (machine->flash_busy || (machine->watched_loads & piece_of(address)) == 0) {
        view->load_waits = true;
        return true;
    }
    machine->flash_controller.watched(machine->flash_controller.context, address & (FLASH_SIZE - 1u), size, false);
    view->closed_loads = 0; /* Unicorn lets the next load from this page pass: it is closed again at once. */
    flash_wait_changed(cpu, 0, 0);
    *admitted = !mpu_enabled(&cpu->system.mpu) || protection_admits(cpu, type, address, size, 0);
    return true;
}

void flash_wait_load_again(cpu_t *cpu) {
    const uint32_t address = code_last_address(cpu);
    cpu->executed--;
    if (cpu->cycles.table != NULL) {
        cpu->work -= cycles_of(&cpu->cycles, cpu->machine, address);
        cpu->cycles.expected = address;
    }
    cpu->it_state = code_it_state_at(cpu, address);
    cpu->pc = address;
    cpu->flash.changed = true;
}

bool flash_wait_fetch(cpu_t *cpu, uint32_t address) {
    const machine_t *const machine = cpu->machine;
    if (!machine_in_flash(address) || (cpu->flash.closed_fetches & piece_of(address)) == 0) {
        return false;
    }
    if (!machine->flash_busy && (machine->watched_fetches & piece_of(address)) != 0) {
        machine->flash_controller.watched(machine->flash_controller.context, address & (FLASH_SIZE - 1u), 2, true);
    }
    cpu->flash.changed = true;
    return true;
}
