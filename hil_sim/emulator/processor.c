#include "emulator/processor.h"

uint32_t cpu_register(const cpu_t *cpu, int unicorn_register) {
    uint32_t value = 0;
    uc_reg_read(cpu->uc, unicorn_register, &value);
    return value;
}

void cpu_set_register(cpu_t *cpu, int unicorn_register, uint32_t value) {
    uc_reg_write(cpu->uc, unicorn_register, &value);
}

void cpu_halt(cpu_t *cpu, const char *reason) {
    cpu->halted = true;
    machine_violation(cpu->machine, "%s", reason);
}

uint64_t cpu_awake_cycle(cpu_t *cpu) {
    if (cpu->cycles.table == NULL) {
        return ((cpu->executed - 1u) * cpu->cycles.instruction) >> CYCLE_SHIFT;
    }
    const uint32_t address = cpu->history[(cpu->executed - 1u) % HISTORY];
    const uint32_t accesses = cpu->access_executed == cpu->executed ? cpu->access_cost : 0;
    return (cpu->work - cycles_look_up(&cpu->cycles, cpu->machine, address) - accesses) >> CYCLE_SHIFT;
}
