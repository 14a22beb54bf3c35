#include "emulator/machine_internal.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PORRSTF (1u << 27) /* RCC_CSR */

/* ---- Life ---- */

static void store16(uint8_t *bytes, unsigned value) {
    bytes[0] = (uint8_t)value;
    bytes[1] = (uint8_t)(value >> 8);
}

/* Factory bytes (STM32F405 data sheet, 5.3.22 and 5.3.24; RM0090, 39). The calibration points are those of the
 * typical sensor: 0.76 V at 25 degC, 2.5 mV/K; 1.21 V reference; converted at 3.3 V. */
static void write_factory_bytes(machine_t *machine) {
    uint8_t *const area = machine->system_memory + (0x1FFF7A00u - SYSTEM_MEMORY_BASE);
    memcpy(area + 0x10, machine->config.unique_id, sizeof machine->config.unique_id);
    store16(area + 0x22, FLASH_SIZE / 1024u);
    store16(area + 0x2A, 1502);
    store16(area + 0x2C, 959);
    store16(area + 0x2E, 1207);
}

static uint8_t *memory_new(size_t size, int fill) {
    /* Aligned to pages: the processor maps these very bytes. */
    uint8_t *const bytes = aligned_alloc(4096, size);
    if (bytes != NULL) {
        memset(bytes, fill, size);
    }
    return bytes;
}

machine_t *machine_create(const emulator_config_t *config, const board_edge_t *edge, int64_t power_on_ps) {
    machine_t *const machine = calloc(1, sizeof *machine);
    if (machine == NULL) {
        return NULL;
    }
    machine->config = *config;
    if (edge != NULL) {
        machine->edge = *edge;
    }
    machine->now_ps = power_on_ps;
    machine->flash = memory_new(FLASH_SIZE, 0xFF);
    machine->sram = memory_new(SRAM_SIZE, 0);
    machine->ccm = memory_new(CCM_SIZE, 0);
    machine->system_memory = memory_new(SYSTEM_MEMORY_SIZE, 0xFF);
    machine->directory = calloc(MACHINE_DIRECTORY_SIZE, 1);
    machine->report = calloc(MACHINE_REPORT_SIZE, 1);
    if (machine->flash == NULL || machine->sram == NULL || machine->ccm == NULL || machine->system_memory == NULL ||
        machine->directory == NULL || machine->report == NULL) {
        machine_destroy(machine);
        return NULL;
    }
    write_factory_bytes(machine);
    machine_forget_memories(machine);
    return machine;
}

void machine_destroy(machine_t *machine) {
    for (unsigned i = 0; i < machine->peripheral_count; i++) {
        if (machine->peripherals[i]->destroy != NULL) {
            machine->peripherals[i]->destroy(machine->peripherals[i]);
        }
    }
    free(machine->heap);
    free(machine->report);
    free(machine->directory);
    free(machine->system_memory);
    free(machine->ccm);
    free(machine->sram);
    free(machine->flash);
    free(machine);
}

void machine_reset_peripherals(machine_t *machine) {
    memset(machine->irq_level, 0, sizeof machine->irq_level);
    machine->nmi_level = false;
    for (unsigned i = 0; i < machine->peripheral_count; i++) {
        if (machine->peripherals[i]->reset != NULL) {
            machine->peripherals[i]->reset(machine->peripherals[i]);
        }
    }
}

void machine_reset_request(machine_t *machine, uint32_t csr_flags) {
    machine->reset_requested = true;
    machine->reset_flags |= csr_flags;
    if (machine->processor.processor != NULL) {
        machine->processor.attention(machine->processor.processor);
    }
}

void machine_hold_in_reset(machine_t *machine) {
    machine->held_in_reset = true;
    machine_reset_request(machine, 0);
}

void machine_release_reset(machine_t *machine, uint32_t csr_flags) {
    machine->held_in_reset = false;
    if ((csr_flags & PORRSTF) != 0) {
        memset(machine->debug_control, 0, sizeof machine->debug_control);
    }
    machine_reset_request(machine, csr_flags);
}

void machine_debug_halt(machine_t *machine, bool halted) {
    machine->debug_halted = halted;
    if (machine->processor.processor != NULL) {
        machine->processor.attention(machine->processor.processor);
    }
}

bool machine_debug_frozen(const machine_t *machine, unsigned bus, unsigned bit) {
    return machine->debug_halted && (machine->debug_control[bus] >> bit & 1u) != 0;
}

uint64_t machine_random(uint64_t *state) {
    uint64_t word = *state += 0x9E3779B97F4A7C15u;
    word = (word ^ word >> 30) * 0xBF58476D1CE4E5B9u;
    word = (word ^ word >> 27) * 0x94D049BB133111EBu;
    return word ^ word >> 31;
}

static void scramble(uint8_t *memory, size_t size, uint64_t *state) {
    for (size_t i = 0; i < size; i += sizeof *state) {
        const uint64_t word = machine_random(state);
        memcpy(memory + i, &word, sizeof word);
    }
}

void machine_forget_memories(machine_t *machine) {
    if (machine->config.memory_seed == 0) {
        return;
    }
    uint64_t state = machine->config.memory_seed ^ (uint64_t)machine->now_ps;
    for (size_t i = 0; i < sizeof machine->config.unique_id; i++) {
        state = machine_random(&state) ^ machine->config.unique_id[i];
    }
    scramble(machine->sram, SRAM_SIZE, &state);
    scramble(machine->ccm, CCM_SIZE, &state);
}

uint32_t machine_reset_flags(const machine_t *machine) {
    return machine->reset_flags;
}

const emulator_config_t *machine_config(const machine_t *machine) {
    return &machine->config;
}

const board_edge_t *machine_edge(const machine_t *machine) {
    return &machine->edge;
}

/* ---- Interrupts ---- */

void machine_irq(machine_t *machine, unsigned position, bool level) {
    const uint32_t bit = 1u << (position & 31u);
    if (position >= MACHINE_IRQ_LINES || ((machine->irq_level[position >> 5] & bit) != 0) == level) {
        return;
    }
    machine->irq_level[position >> 5] ^= bit;
    if (machine->processor.processor != NULL) {
        machine->processor.irq(machine->processor.processor, position, level);
    }
}

void machine_nmi(machine_t *machine, bool level) {
    const bool risen = level && !machine->nmi_level;
    machine->nmi_level = level;
    if (risen && machine->processor.processor != NULL) {
        machine->processor.nmi(machine->processor.processor);
    }
}

/* ---- Violations and faults ---- */

static void report_append(machine_t *machine, const char *format, va_list arguments) {
    const size_t room = MACHINE_REPORT_SIZE - machine->report_length;
    const int length = vsnprintf(machine->report + machine->report_length, room, format,
                                 arguments); /* NOLINT(clang-analyzer-valist.Uninitialized): a caller's */
    if (length > 0) {
        machine->report_length += (size_t)length < room ? (size_t)length : room - 1;
    }
}

static void __attribute__((format(printf, 2, 3))) report_print(machine_t *machine, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    report_append(machine, format, arguments);
    va_end(arguments);
}

static void record(machine_t *machine, const char *kind, const char *format, va_list arguments) {
    const machine_processor_t *const processor = &machine->processor;
    report_print(machine, "%s at %.9f s", kind, (double)machine->now_ps * 1e-12);
    if (processor->processor != NULL) {
        report_print(machine, ", PC 0x%08x", (unsigned)processor->program_counter(processor->processor));
    }
    report_print(machine, ": ");
    report_append(machine, format, arguments);
    const machine_access_t *const access = &machine->last_access;
    if (access->width != 0) {
        report_print(machine, " (last peripheral access: %u-byte %s 0x%08x, value 0x%x, at %.9f s)", access->width,
                     access->write ? "write to" : "read of", (unsigned)access->address, (unsigned)access->value,
                     (double)access->time_ps * 1e-12);
    }
    report_print(machine, "\n");
    if (machine->stop_requested && processor->processor != NULL) {
        processor->attention(processor->processor);
    }
}

void machine_violation(machine_t *machine, const char *format, ...) {
    machine->violations++;
    machine->stop_requested = machine->stop_requested || machine->config.strict;
    va_list arguments;
    va_start(arguments, format);
    record(machine, "violation", format, arguments);
    va_end(arguments);
}

static void record_fault(machine_t *machine, const char *format, va_list arguments) {
    machine->faults++;
    machine->stop_requested = machine->stop_requested || machine->config.stop_at_fault;
    record(machine, "fault", format, arguments);
}

void machine_fault(machine_t *machine, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    record_fault(machine, format, arguments);
    va_end(arguments);
}

void machine_bus_error(machine_t *machine, const char *format, ...) {
    machine->bus_error = true;
    va_list arguments;
    va_start(arguments, format);
    record_fault(machine, format, arguments);
    va_end(arguments);
}
