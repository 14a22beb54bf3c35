#include "emulator/probes.h"

#define EXC_RETURN_LOWEST 0xFFFFFFE0u /* A handler returns to an address from here on. */

void probes_enter_exception(cpu_t *cpu) {
    cpu->work_at[cpu->depth] = cpu_work(cpu);
    cpu->entered_at[cpu->depth++] = cpu->executed;
}

/* A probe's function has returned. */
static void finish(cpu_t *cpu, probe_t *probe) {
    const uint64_t count = cpu->executed - probe->start - (cpu->inside[cpu->depth] - probe->excluded);
    const uint64_t work = cpu_work(cpu) - probe->work - (cpu->work_inside[cpu->depth] - probe->work_excluded);
    const uint64_t cycles = work >> CYCLE_SHIFT;
    probe->active = false;
    cpu->probes_active--;
    probe->calls++;
    probe->total += count;
    probe->largest = count > probe->largest ? count : probe->largest;
    probe->cycles = cycles > probe->cycles ? cycles : probe->cycles;
}

void probes_leave_exception(cpu_t *cpu) {
    for (unsigned i = 0; cpu->probes_active != 0 && i < cpu->probe_count; i++) {
        probe_t *const probe = &cpu->probes[i];
        if (probe->active && probe->depth == cpu->depth && probe->return_address >= EXC_RETURN_LOWEST) {
            finish(cpu, probe);
        }
    }
    cpu->depth--;
    cpu->inside[cpu->depth] += cpu->executed - cpu->entered_at[cpu->depth];
    cpu->work_inside[cpu->depth] += cpu_work(cpu) - cpu->work_at[cpu->depth];
}

static void on_entry(uc_engine *uc, uint64_t address, uint32_t size, void *user) {
    (void)uc;
    (void)size;
    cpu_t *const cpu = user;
    for (unsigned i = 0; i < cpu->probe_count; i++) {
        probe_t *const probe = &cpu->probes[i];
        /* A block that is entered again after a stop at its first instruction was not called twice; recursion counts
         * as part of the outer call. */
        if (probe->entry == (uint32_t)address && !probe->active) {
            probe->active = true;
            probe->depth = cpu->depth;
            probe->return_address = cpu_register(cpu, UC_ARM_REG_LR) & ~1u;
            probe->stack = cpu_register(cpu, UC_ARM_REG_SP);
            probe->start = cpu->executed;
            probe->excluded = cpu->inside[cpu->depth];
            probe->work = cpu_work(cpu);
            probe->work_excluded = cpu->work_inside[cpu->depth];
            cpu->probes_active++;
            cpu->deadline = 0;
        }
    }
}

void probes_step(cpu_t *cpu, uint32_t address) {
    for (unsigned i = 0; i < cpu->probe_count; i++) {
        probe_t *const probe = &cpu->probes[i];
        if (probe->active && probe->return_address == address && probe->depth == cpu->depth &&
            cpu->executed != probe->start && cpu_register(cpu, UC_ARM_REG_SP) >= probe->stack) {
            finish(cpu, probe);
        }
    }
}

bool probes_add(cpu_t *cpu, uint32_t entry) {
    if (cpu->probe_count == PROBES) {
        return false;
    }
    entry &= ~1u;
    if (uc_hook_add(cpu->uc, &cpu->probe_hooks[cpu->probe_count], UC_HOOK_BLOCK, (void *)on_entry, cpu, entry, entry) !=
        UC_ERR_OK) {
        return false;
    }
    uc_ctl_flush_tb(cpu->uc);
    cpu->probes[cpu->probe_count++] = (probe_t){.entry = entry};
    return true;
}
