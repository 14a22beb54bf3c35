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
