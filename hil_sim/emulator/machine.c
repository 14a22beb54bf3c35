#include "emulator/machine_internal.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- Life ---- */

#define DIRECTORY_GRANULE 256u
#define DIRECTORY_SIZE    ((PERIPHERAL_SIZE + PERIPHERAL2_SIZE) / DIRECTORY_GRANULE)

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
    machine->directory = calloc(DIRECTORY_SIZE, 1);
    machine->report = calloc(MACHINE_REPORT_SIZE, 1);
    if (machine->flash == NULL || machine->sram == NULL || machine->ccm == NULL || machine->system_memory == NULL ||
        machine->directory == NULL || machine->report == NULL) {
        machine_destroy(machine);
        return NULL;
    }
    write_factory_bytes(machine);
    return machine;
}

void machine_destroy(machine_t *machine) {
    for (unsigned i = 0; i < machine->peripheral_count; i++) {
        if (machine->peripherals[i]->destroy != NULL) {
            machine->peripherals[i]->destroy(machine->peripherals[i]);
        }
    }
    machine_inputs_destroy(machine);
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

uint32_t machine_reset_flags(const machine_t *machine) {
    return machine->reset_flags;
}

const emulator_config_t *machine_config(const machine_t *machine) {
    return &machine->config;
}

const board_edge_t *machine_edge(const machine_t *machine) {
    return &machine->edge;
}

/* ---- Time and events: a binary heap; the order number keeps equal times first come, first served ---- */

int64_t machine_now(const machine_t *machine) {
    return machine->now_ps;
}

void machine_set_core_clock(machine_t *machine, double hz) {
    machine->core_hz = hz;
    if (machine->processor.processor != NULL) {
        machine->processor.clock(machine->processor.processor, hz);
    }
}

double machine_core_clock(const machine_t *machine) {
    return machine->core_hz;
}

void machine_event_init(machine_event_t *event, void (*fire)(void *context, int64_t time_ps), void *context) {
    *event = (machine_event_t){.fire = fire, .context = context, .heap_index = -1};
}

static bool earlier(const machine_event_t *a, const machine_event_t *b) {
    return a->time_ps != b->time_ps ? a->time_ps < b->time_ps : a->order < b->order;
}

static void place(machine_t *machine, size_t index, machine_event_t *event) {
    machine->heap[index] = event;
    event->heap_index = (int32_t)index;
}

static void sift(machine_t *machine, size_t index, machine_event_t *event) {
    while (index > 0 && earlier(event, machine->heap[(index - 1) / 2])) {
        place(machine, index, machine->heap[(index - 1) / 2]);
        index = (index - 1) / 2;
    }
    for (;;) {
        size_t child = 2 * index + 1;
        if (child + 1 < machine->heap_count && earlier(machine->heap[child + 1], machine->heap[child])) {
            child++;
        }
        if (child >= machine->heap_count || !earlier(machine->heap[child], event)) {
            break;
        }
        place(machine, index, machine->heap[child]);
        index = child;
    }
    place(machine, index, event);
}

void machine_cancel(machine_t *machine, machine_event_t *event) {
    if (event->heap_index < 0) {
        return;
    }
    const size_t index = (size_t)event->heap_index;
    event->heap_index = -1;
    machine->heap_count--;
    machine_event_t *const last = machine->heap[machine->heap_count];
    if (last != event) {
        sift(machine, index, last);
    }
}

void machine_schedule(machine_t *machine, machine_event_t *event, int64_t time_ps) {
    machine_cancel(machine, event);
    if (machine->heap_count == machine->heap_capacity) {
        const size_t capacity = machine->heap_capacity == 0 ? 64 : 2 * machine->heap_capacity;
        machine_event_t **const heap = realloc(machine->heap, capacity * sizeof *heap);
        if (heap == NULL) {
            abort(); /* A simulation that lost an event would be wrong without a sign. */
        }
        machine->heap = heap;
        machine->heap_capacity = capacity;
    }
    event->time_ps = time_ps;
    event->order = machine->event_order++;
    machine->heap_count++;
    sift(machine, machine->heap_count - 1, event);
    if (event->heap_index == 0 && machine->processor.processor != NULL) {
        machine->processor.attention(machine->processor.processor);
    }
}

void machine_fire(machine_t *machine, int64_t time_ps) {
    while (machine->heap_count > 0 && machine->heap[0]->time_ps <= time_ps) {
        machine_event_t *const event = machine->heap[0];
        machine_cancel(machine, event);
        if (event->time_ps > machine->now_ps) {
            machine->now_ps = event->time_ps;
        }
        event->fire(event->context, event->time_ps);
    }
    if (time_ps > machine->now_ps) {
        machine->now_ps = time_ps;
    }
}

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

/* ---- Violations ---- */

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

void machine_violation(machine_t *machine, const char *format, ...) {
    machine->violations++;
    machine->stop_requested = machine->stop_requested || machine->config.strict;
    const machine_processor_t *const processor = &machine->processor;
    report_print(machine, "violation at %.9f s", (double)machine->now_ps * 1e-12);
    if (processor->processor != NULL) {
        report_print(machine, ", PC 0x%08x", (unsigned)processor->program_counter(processor->processor));
    }
    report_print(machine, ": ");
    va_list arguments;
    va_start(arguments, format);
    report_append(machine, format, arguments);
    va_end(arguments);
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

/* ---- Bus ---- */

static uint32_t directory_index(uint32_t address) {
    if (address - PERIPHERAL_BASE < PERIPHERAL_SIZE) {
        return (address - PERIPHERAL_BASE) / DIRECTORY_GRANULE;
    }
    if (address - PERIPHERAL2_BASE < PERIPHERAL2_SIZE) {
        return (address - PERIPHERAL2_BASE + PERIPHERAL_SIZE) / DIRECTORY_GRANULE;
    }
    return DIRECTORY_SIZE;
}

void machine_attach(machine_t *machine, peripheral_t *peripheral) {
    if (machine->peripheral_count == MACHINE_PERIPHERALS || directory_index(peripheral->base) == DIRECTORY_SIZE) {
        machine_violation(
            machine, "peripheral %s cannot be attached: 64 are already, or its address is outside the peripheral areas",
            peripheral->name);
        return;
    }
    machine->peripherals[machine->peripheral_count++] = peripheral;
    peripheral->machine = machine;
    for (uint32_t offset = 0; offset < peripheral->size; offset += DIRECTORY_GRANULE) {
        const uint32_t index = directory_index(peripheral->base + offset);
        if (index < DIRECTORY_SIZE) {
            machine->directory[index] = (uint8_t)machine->peripheral_count;
        }
    }
}

peripheral_t *machine_peripheral(machine_t *machine, const char *name) {
    for (unsigned i = 0; i < machine->peripheral_count; i++) {
        if (strcmp(machine->peripherals[i]->name, name) == 0) {
            return machine->peripherals[i];
        }
    }
    return NULL;
}

static peripheral_t *find(const machine_t *machine, uint32_t address, unsigned width) {
    const uint32_t index = directory_index(address);
    if (index == DIRECTORY_SIZE || machine->directory[index] == 0) {
        return NULL;
    }
    peripheral_t *const peripheral = machine->peripherals[machine->directory[index] - 1];
    const uint32_t offset = address - peripheral->base;
    return offset < peripheral->size && width <= peripheral->size - offset ? peripheral : NULL;
}

static bool peripheral_read(machine_t *machine, uint32_t address, unsigned width, uint32_t *value) {
    *value = 0;
    peripheral_t *const peripheral = find(machine, address, width);
    if (peripheral == NULL) {
        machine_violation(machine, "%u-byte read of unmapped address 0x%08x", width, (unsigned)address);
        return false;
    }
    if ((address & (width - 1u)) != 0) {
        machine_violation(machine, "unaligned %u-byte read of 0x%08x in %s", width, (unsigned)address,
                          peripheral->name);
        return false;
    }
    *value = peripheral->read(peripheral, address - peripheral->base, width);
    return true;
}

static bool peripheral_write(machine_t *machine, uint32_t address, unsigned width, uint32_t value) {
    peripheral_t *const peripheral = find(machine, address, width);
    if (peripheral == NULL) {
        machine_violation(machine, "%u-byte write of 0x%x to unmapped address 0x%08x", width, (unsigned)value,
                          (unsigned)address);
        return false;
    }
    if ((address & (width - 1u)) != 0) {
        machine_violation(machine, "unaligned %u-byte write to 0x%08x in %s", width, (unsigned)address,
                          peripheral->name);
        return false;
    }
    peripheral->write(peripheral, address - peripheral->base, value, width);
    return true;
}

bool machine_core_read(machine_t *machine, uint32_t address, unsigned width, uint32_t *value) {
    machine->last_access = (machine_access_t){.address = address, .width = width, .time_ps = machine->now_ps};
    const bool done = peripheral_read(machine, address, width, value);
    machine->last_access.value = *value;
    return done;
}

bool machine_core_write(machine_t *machine, uint32_t address, unsigned width, uint32_t value) {
    machine->last_access = (machine_access_t){
        .address = address, .value = value, .width = width, .write = true, .time_ps = machine->now_ps};
    return peripheral_write(machine, address, width, value);
}

static uint8_t *within(uint8_t *memory, uint32_t base, uint32_t size, uint32_t address, size_t count) {
    const uint32_t offset = address - base;
    return offset < size && count <= size - offset ? memory + offset : NULL;
}

/* Memory that every bus master reaches. */
static uint8_t *shared_memory(machine_t *machine, uint32_t address, size_t count) {
    switch (address >> 24) {
    case SRAM_BASE >> 24:
        return within(machine->sram, SRAM_BASE, SRAM_SIZE, address, count);
    case FLASH_BASE >> 24:
        return within(machine->flash, FLASH_BASE, FLASH_SIZE, address, count);
    case SYSTEM_MEMORY_BASE >> 24:
        return within(machine->system_memory, SYSTEM_MEMORY_BASE, SYSTEM_MEMORY_SIZE, address, count);
    default:
        return NULL;
    }
}

uint8_t *machine_memory(machine_t *machine, uint32_t address, size_t count) {
    if (address < FLASH_SIZE) {
        return within(machine->flash, 0, FLASH_SIZE, address, count);
    }
    if (address >> 24 == CCM_BASE >> 24) {
        return within(machine->ccm, CCM_BASE, CCM_SIZE, address, count);
    }
    return shared_memory(machine, address, count);
}

bool machine_bus_read(machine_t *machine, uint32_t address, unsigned width, uint32_t *value) {
    const uint8_t *const memory = shared_memory(machine, address, width);
    if (memory == NULL) {
        return peripheral_read(machine, address, width, value);
    }
    *value = 0;
    memcpy(value, memory, width); /* Both are little-endian. */
    return true;
}

bool machine_bus_write(machine_t *machine, uint32_t address, unsigned width, uint32_t value) {
    uint8_t *const memory = shared_memory(machine, address, width);
    if (memory == NULL) {
        return peripheral_write(machine, address, width, value);
    }
    if (address >> 24 != SRAM_BASE >> 24) {
        machine_violation(machine, "%u-byte bus master write to read-only address 0x%08x", width, (unsigned)address);
        return false;
    }
    memcpy(memory, &value, width);
    return true;
}
