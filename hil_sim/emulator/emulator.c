#include "emulator/emulator.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "emulator/cpu.h"
#include "emulator/inputs.h"
#include "emulator/peripherals/outside.h"
#include "emulator/peripherals/peripherals.h"
#include "emulator/probes.h"
#include "emulator/upsets.h"

#define REPORT_SIZE (MACHINE_REPORT_SIZE + 1024u)

static cpu_t *cpu_of(const board_t *board) {
    return ((const machine_t *)board)->processor.processor;
}

board_t *emulator_create(const emulator_config_t *config, const board_edge_t *edge, int64_t power_on_ps, char *error,
                         size_t error_size) {
    machine_t *const machine = machine_create(config, edge, power_on_ps);
    if (machine == NULL) {
        snprintf(error, error_size, "no memory for a board");
        return NULL;
    }
    cpu_t *const cpu = cpu_create(machine, error, error_size);
    char *const report = malloc(REPORT_SIZE);
    if (cpu == NULL || report == NULL) {
        free(report);
        if (cpu != NULL) {
            cpu_destroy(cpu);
            snprintf(error, error_size, "no memory for a board");
        }
        machine_destroy(machine);
        return NULL;
    }
    cpu->report = report;
    peripherals_create(machine);
    machine_reset_request(machine, 0); /* The first run begins with the reset sequence. */
    return (board_t *)machine;
}

bool emulator_load(board_t *board, uint32_t address, const uint8_t *bytes, size_t count) {
    if (address < FLASH_BASE || address - FLASH_BASE >= FLASH_SIZE || count > FLASH_SIZE - (address - FLASH_BASE)) {
        return false;
    }
    memcpy(((machine_t *)board)->flash + (address - FLASH_BASE), bytes, count);
    uc_ctl_flush_tb(cpu_of(board)->uc);
    cycles_flash_changed(&cpu_of(board)->cycles, 0);
    return true;
}

static board_status_t emulator_run(board_t *board, int64_t until_ps) {
    return cpu_run(cpu_of(board), until_ps);
}

static int64_t emulator_now(const board_t *board) {
    return machine_now((const machine_t *)board);
}

static const char *emulator_report(const board_t *board) {
    const machine_t *const machine = (const machine_t *)board;
    const cpu_t *const cpu = cpu_of(board);
    char *const text = cpu->report;
    const system_control_t *const system = &cpu->system;
    snprintf(text, REPORT_SIZE,
             "%s at %.9f s: PC 0x%08x, LR 0x%08x, SP 0x%08x, xPSR 0x%08x\n"
             "fault status: CFSR 0x%08x, HFSR 0x%08x, BFAR 0x%08x, MMFAR 0x%08x; %llu instructions, "
             "%llu violations, %llu faults\n%s",
             cpu->halted ? "stopped" : "running", (double)machine->now_ps * 1e-12,
             (unsigned)machine->processor.program_counter(cpu), (unsigned)cpu_register(cpu, UC_ARM_REG_LR),
             (unsigned)cpu_register(cpu, UC_ARM_REG_SP), (unsigned)cpu_register(cpu, UC_ARM_REG_XPSR),
             (unsigned)system->cfsr, (unsigned)system->hfsr, (unsigned)system->bfar, (unsigned)system->mmfar,
             (unsigned long long)cpu->executed, (unsigned long long)machine->violations,
             (unsigned long long)machine->faults, machine->report);
    return text;
}

static void emulator_destroy(board_t *board) {
    machine_t *const machine = (machine_t *)board;
    cpu_t *const cpu = cpu_of(board);
    machine->processor.processor = NULL;
    cpu_destroy(cpu);
    inputs_destroy(machine);
    machine_destroy(machine);
}

const board_operations_t emulator_operations = {
    .run = emulator_run,
    .now = emulator_now,
    .pin_in = inputs_pin,
    .uart_in = inputs_uart,
    .can_in = inputs_can,
    .can_sent = inputs_can_sent,
    .can_error = inputs_can_error,
    .can_rate = inputs_can_rate,
    .report = emulator_report,
    .destroy = emulator_destroy,
};

void emulator_crystal(board_t *board, bool alive, int64_t time_ps) {
    inputs_crystal(board, alive, time_ps);
}

void emulator_noise(board_t *board, bool alive, int64_t time_ps) {
    inputs_noise(board, alive, time_ps);
}

void emulator_supply(board_t *board, double volts, int64_t time_ps) {
    inputs_supply(board, volts, time_ps);
}

void emulator_debug_halt(board_t *board, bool halted, int64_t time_ps) {
    inputs_halt(board, halted, time_ps);
}

void emulator_cut_flash(board_t *board, uint64_t step, double fraction, uint64_t id, int64_t off_ps) {
    flash_cut_in((machine_t *)board, step, fraction, id, off_ps);
}

uint64_t emulator_flash_steps(const board_t *board) {
    return flash_steps_out((const machine_t *)board);
}

void emulator_cells_save(board_t *board, uint8_t *cells) {
    flash_end_in((machine_t *)board);
    flash_cells_out((machine_t *)board, cells);
}

void emulator_cells_restore(board_t *board, const uint8_t *cells) {
    flash_cells_in((machine_t *)board, cells);
}

void emulator_stats(const board_t *board, emulator_stats_t *stats) {
    const cpu_t *const cpu = cpu_of(board);
    *stats = (emulator_stats_t){
        .instructions = cpu->executed,
        .interrupts = cpu->interrupts,
        .cycles = cpu_cycle(cpu),
        .sleep_cycles = cpu->skipped - cpu->waited,
        .flash_wait_cycles = cpu->waited,
        .violations = ((const machine_t *)board)->violations,
        .faults = ((const machine_t *)board)->faults,
        .stack_low = cpu->stack_low,
    };
}

uint32_t emulator_register(const board_t *board, unsigned index) {
    static const int special[] = {UC_ARM_REG_XPSR,    UC_ARM_REG_MSP,       UC_ARM_REG_PSP,     UC_ARM_REG_PRIMASK,
                                  UC_ARM_REG_BASEPRI, UC_ARM_REG_FAULTMASK, UC_ARM_REG_CONTROL, UC_ARM_REG_FPSCR};
    const cpu_t *const cpu = cpu_of(board);
    if (index < 13) {
        return cpu_register(cpu, UC_ARM_REG_R0 + (int)index);
    }
    switch (index) {
    case 13:
        return cpu_register(cpu, UC_ARM_REG_SP);
    case 14:
        return cpu_register(cpu, UC_ARM_REG_LR);
    case 15:
        return cpu->pc;
    default:
        return index - 16u < sizeof special / sizeof special[0] ? cpu_register(cpu, special[index - 16u]) : 0;
    }
}

bool emulator_memory_read(const board_t *board, uint32_t address, uint8_t *bytes, size_t count) {
    const uint8_t *const memory = machine_memory((machine_t *)board, address, count);
    if (memory != NULL) {
        memcpy(bytes, memory, count);
    }
    return memory != NULL;
}

bool emulator_probe_add(board_t *board, uint32_t entry) {
    return probes_add(cpu_of(board), entry);
}

bool emulator_probe_read(const board_t *board, unsigned index, emulator_probe_t *probe) {
    const cpu_t *const cpu = cpu_of(board);
    if (index >= cpu->probe_count) {
        return false;
    }
    const probe_t *const own = &cpu->probes[index];
    *probe = (emulator_probe_t){
        .entry = own->entry, .calls = own->calls, .total = own->total, .largest = own->largest, .cycles = own->cycles};
    return true;
}

bool emulator_skip(board_t *board, uint32_t address, uint64_t nth) {
    return upsets_skip(cpu_of(board), address, nth);
}

bool emulator_flip(board_t *board, uint32_t address, uint64_t nth, unsigned index, uint32_t mask) {
    return upsets_flip(cpu_of(board), address, nth, index, mask);
}

bool emulator_struck(const board_t *board) {
    return upsets_struck(cpu_of(board));
}

bool emulator_flip_memory(board_t *board, uint32_t address, uint8_t mask) {
    uint8_t *const byte = machine_memory((machine_t *)board, address, 1);
    if (byte == NULL || machine_in_flash(address)) {
        return false;
    }
    *byte ^= mask;
    return true;
}

bool emulator_visits_begin(board_t *board, uint32_t from, uint32_t to) {
    return upsets_visits_begin(cpu_of(board), from, to);
}

size_t emulator_visits(const board_t *board, int64_t *first_ps, size_t count) {
    return upsets_visits(cpu_of(board), first_ps, count);
}
