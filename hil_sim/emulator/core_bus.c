#include "emulator/core_bus.h"

#include <string.h>

#include "emulator/code_view.h"
#include "emulator/it_block.h"
#include "emulator/protection.h"
#include "emulator/system_control.h"

#define PRIVATE_BUS_BASE 0xE0000000u
#define PRIVATE_BUS_SIZE 0x00100000u

#define ACTLR_NO_WRITE_BUFFER 2u /* DISDEFWBUF */

const int core_bus_registers[15] = {UC_ARM_REG_R0,  UC_ARM_REG_R1,  UC_ARM_REG_R2,  UC_ARM_REG_R3, UC_ARM_REG_R4,
                                    UC_ARM_REG_R5,  UC_ARM_REG_R6,  UC_ARM_REG_R7,  UC_ARM_REG_R8, UC_ARM_REG_R9,
                                    UC_ARM_REG_R10, UC_ARM_REG_R11, UC_ARM_REG_R12, UC_ARM_REG_SP, UC_ARM_REG_LR};

/* The instruction goes on (Unicorn cannot abandon it here), and the fault is taken after it, with its address. */
void core_bus_fault(cpu_t *cpu, unsigned exception, uint32_t cfsr, uint32_t address) {
    cpu->executed--;
    const uint8_t it_state = code_it_state_at(cpu, cpu->history[cpu->executed % HISTORY]);
    cpu->executed++;
    cpu->fault = (fault_t){
        .exception = exception, .cfsr = cfsr, .address = address, .pc = code_last_address(cpu), .it_state = it_state};
    cpu->deadline = 0;
}

/* A fault of an instruction that the processor abandons. Unicorn goes on with it, though it has not written its
 * registers yet: they are put back when the fault is taken, and the accesses that follow do nothing. */
static void abandon(cpu_t *cpu, unsigned exception, uint32_t cfsr, uint32_t address) {
    core_bus_fault(cpu, exception, cfsr, address);
    cpu->fault.abandoned = true;
    for (int i = 0; i < 15; i++) {
        cpu->fault.registers[i] = cpu_register(cpu, core_bus_registers[i]);
    }
    for (int i = 0; i < 16; i++) {
        uc_reg_read(cpu->uc, UC_ARM_REG_D0 + i, &cpu->fault.floating[i]);
    }
}

static bool is_abandoned(const cpu_t *cpu) {
    return cpu->fault.exception != 0 && cpu->fault.abandoned;
}

void core_bus_unaligned(cpu_t *cpu, uint32_t address, unsigned size, bool write) {
    machine_fault(cpu->machine, "unaligned access at 0x%08x, which CCR.UNALIGN_TRP forbids", (unsigned)address);
    abandon(cpu, EXCEPTION_USAGE_FAULT, CFSR_UNALIGNED, address);
    cpu->fault.memory = write && size <= sizeof cpu->fault.bytes ? machine_memory(cpu->machine, address, size) : NULL;
    cpu->fault.size = size;
    if (cpu->fault.memory != NULL) {
        memcpy(cpu->fault.bytes, cpu->fault.memory, size);
    }
}

void core_bus_take_back(cpu_t *cpu, const fault_t *fault) {
    for (int i = 0; i < 15 && fault->abandoned; i++) {
        cpu_set_register(cpu, core_bus_registers[i], fault->registers[i]);
    }
    for (int i = 0; i < 16 && fault->abandoned; i++) {
        uc_reg_write(cpu->uc, UC_ARM_REG_D0 + i, &fault->floating[i]);
    }
    if (fault->memory != NULL) {
        memcpy(fault->memory, fault->bytes, fault->size);
    }
}

/* A store goes through the write buffer: its error comes behind it, and no register says where it went. */
void core_bus_store_fault(cpu_t *cpu, uint32_t address) {
    uint16_t opcode = 0;
    const uint32_t last = code_last_address(cpu);
    if ((cpu->system.actlr & ACTLR_NO_WRITE_BUFFER) != 0 || !code_opcode_at(cpu, last, &opcode)) {
        core_bus_fault(cpu, EXCEPTION_BUS_FAULT, CFSR_PRECISERR | CFSR_BFARVALID, address);
        return;
    }
    core_bus_fault(cpu, EXCEPTION_BUS_FAULT, CFSR_IMPRECISERR, address);
    cpu->fault.pc = last + thumb_size(opcode);
    cpu->fault.it_state = it_block_advance(cpu->fault.it_state);
}

/* The memory protection unit judges what goes to peripherals. */
static bool admitted(cpu_t *cpu, const bus_window_t *window, uint32_t address, unsigned size, mpu_access_t access) {
    if (!mpu_enabled(&cpu->system.mpu) || window->base == PRIVATE_BUS_BASE ||
        protection_allows(cpu, address, size, access)) {
        return true;
    }
    machine_fault(cpu->machine, "%u-byte %s 0x%08x, which the memory protection unit forbids", size,
                  access == MPU_WRITE ? "write to" : "read of", (unsigned)address);
    abandon(cpu, EXCEPTION_MEMORY_FAULT, CFSR_DACCVIOL | CFSR_MMARVALID, address);
    return false;
}

static void access_begin(cpu_t *cpu, uint32_t address, bool write) {
    cpu->machine->now_ps = core_clock_time(&cpu->clock, cpu_access_cycle(cpu));
    const bool another = cpu->access_executed == cpu->executed;
    if (cpu->cycles.table != NULL) {
        const uint32_t cost = cycles_bus(&cpu->cycles, address, write);
        cpu->work += cost;
        cpu->access_cost = cost + (another ? cpu->access_cost : 0);
    }
    if (another && cpu->fault.exception == 0 && code_is_single_transfer(cpu)) {
        /* Unicorn splits an access that is not aligned. */
        machine_fault(cpu->machine, "unaligned access near 0x%08x", (unsigned)address);
        core_bus_fault(cpu, EXCEPTION_USAGE_FAULT, CFSR_UNALIGNED, address);
    }
    cpu->access_executed = cpu->executed;
}

static uint64_t on_read(uc_engine *uc, uint64_t offset, unsigned size, void *user) {
    (void)uc;
    const bus_window_t *const window = user;
    cpu_t *const cpu = window->cpu;
    const uint32_t address = window->base + (uint32_t)offset;
    uint32_t value = 0;
    access_begin(cpu, address, false);
    if (is_abandoned(cpu) || !admitted(cpu, window, address, size, MPU_READ)) {
        return 0;
    }
    if (window->base != PRIVATE_BUS_BASE) {
        if (!machine_core_read(cpu->machine, address, size, &value)) {
            abandon(cpu, EXCEPTION_BUS_FAULT, CFSR_PRECISERR | CFSR_BFARVALID, address);
        }
    } else if (!system_control_read(cpu, address, size, &value)) {
        machine_fault(cpu->machine, "%u-byte read of unknown core register 0x%08x", size, (unsigned)address);
        abandon(cpu, EXCEPTION_BUS_FAULT, CFSR_PRECISERR | CFSR_BFARVALID, address);
    }
    return value;
}

static void on_write(uc_engine *uc, uint64_t offset, unsigned size, uint64_t value, void *user) {
    (void)uc;
    const bus_window_t *const window = user;
    cpu_t *const cpu = window->cpu;
    const uint32_t address = window->base + (uint32_t)offset;
    access_begin(cpu, address, true);
    if (is_abandoned(cpu) || !admitted(cpu, window, address, size, MPU_WRITE)) {
        return;
    }
    if (window->base != PRIVATE_BUS_BASE) {
        if (!machine_core_write(cpu->machine, address, size, (uint32_t)value)) {
            core_bus_store_fault(cpu, address);
        }
    } else if (!system_control_write(cpu, address, size, (uint32_t)value)) {
        machine_fault(cpu->machine, "%u-byte write to unknown core register 0x%08x", size, (unsigned)address);
        core_bus_fault(cpu, EXCEPTION_BUS_FAULT, CFSR_PRECISERR | CFSR_BFARVALID, address);
    }
}

void core_bus_flash_store(cpu_t *cpu, uint32_t address, unsigned size, uint64_t value) {
    if (is_abandoned(cpu)) {
        return;
    }
    cpu->machine->now_ps = core_clock_time(&cpu->clock, cpu_access_cycle(cpu));
    for (unsigned done = 0; done < size; done += 4) { /* The bus has 32 bits. */
        machine_flash_store(cpu->machine, address + done, size < 4 ? size : 4, (uint32_t)(value >> 8 * done));
    }
}

uc_err core_bus_map(cpu_t *cpu) {
    machine_t *const machine = cpu->machine;
    const uint32_t read_execute = UC_PROT_READ | UC_PROT_EXEC;
    const struct {
        uint32_t base, size, access;
        void *bytes;
    } memories[] = {
        {0, FLASH_SIZE, read_execute, machine->flash}, /* Boot from flash: it appears at 0 too. */
        {FLASH_BASE, FLASH_SIZE, read_execute, machine->flash},
        {SYSTEM_MEMORY_BASE, SYSTEM_MEMORY_SIZE, read_execute, machine->system_memory},
        {SRAM_BASE, SRAM_SIZE, UC_PROT_READ | UC_PROT_WRITE,
         machine->sram}, /* Executable when the first jump goes there (execution.c). */
        {CCM_BASE, CCM_SIZE, UC_PROT_READ | UC_PROT_WRITE,
         machine->ccm}, /* Data only: it is not on the instruction bus. */
    };
    uc_err error = UC_ERR_OK;
    for (unsigned i = 0; i < sizeof memories / sizeof memories[0] && error == UC_ERR_OK; i++) {
        error = uc_mem_map_ptr(cpu->uc, memories[i].base, memories[i].size, memories[i].access, memories[i].bytes);
        if (error == UC_ERR_OK) { /* Else a store that a hook has let pass would be done, where it may only be told. */
            error = uc_mem_protect(cpu->uc, memories[i].base, memories[i].size, memories[i].access);
        }
    }
    static const struct {
        uint32_t base, size;
    } windows[] = {
        {PERIPHERAL_BASE, PERIPHERAL_SIZE}, {PERIPHERAL2_BASE, PERIPHERAL2_SIZE}, {PRIVATE_BUS_BASE, PRIVATE_BUS_SIZE}};
    for (unsigned i = 0; i < 3 && error == UC_ERR_OK; i++) {
        cpu->windows[i] = (bus_window_t){.cpu = cpu, .base = windows[i].base};
        error = uc_mmio_map(cpu->uc, windows[i].base, windows[i].size, on_read, &cpu->windows[i], on_write,
                            &cpu->windows[i]);
    }
    return error;
}
