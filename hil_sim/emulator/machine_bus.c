/* machine_bus.c: what lies at which address: peripherals by a directory of granules, memories by their areas. */
#include "emulator/machine_internal.h"

#include <string.h>

static uint32_t directory_index(uint32_t address) {
    if (address - PERIPHERAL_BASE < PERIPHERAL_SIZE) {
        return (address - PERIPHERAL_BASE) / MACHINE_DIRECTORY_GRANULE;
    }
    if (address - PERIPHERAL2_BASE < PERIPHERAL2_SIZE) {
        return (address - PERIPHERAL2_BASE + PERIPHERAL_SIZE) / MACHINE_DIRECTORY_GRANULE;
    }
    return MACHINE_DIRECTORY_SIZE;
}

void machine_attach(machine_t *machine, peripheral_t *peripheral) {
    if (machine->peripheral_count == MACHINE_PERIPHERALS ||
        directory_index(peripheral->base) == MACHINE_DIRECTORY_SIZE) {
        machine_violation(
            machine, "peripheral %s cannot be attached: 64 are already, or its address is outside the peripheral areas",
            peripheral->name);
        return;
    }
    machine->peripherals[machine->peripheral_count++] = peripheral;
    peripheral->machine = machine;
    for (uint32_t offset = 0; offset < peripheral->size; offset += MACHINE_DIRECTORY_GRANULE) {
        const uint32_t index = directory_index(peripheral->base + offset);
        if (index < MACHINE_DIRECTORY_SIZE) {
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
    if (index == MACHINE_DIRECTORY_SIZE || machine->directory[index] == 0) {
        return NULL;
    }
    peripheral_t *const peripheral = machine->peripherals[machine->directory[index] - 1];
    const uint32_t offset = address - peripheral->base;
    return offset < peripheral->size && width <= peripheral->size - offset ? peripheral : NULL;
}

/* A bus error: the processor's is a fault that its program handles, another master's a violation. */
typedef void (*bus_error_t)(machine_t *machine, const char *format, ...) __attribute__((format(printf, 2, 3)));

static bool peripheral_read(machine_t *machine, uint32_t address, unsigned width, uint32_t *value, bus_error_t error) {
    *value = 0;
    peripheral_t *const peripheral = find(machine, address, width);
    if (peripheral == NULL) {
        error(machine, "%u-byte read of unmapped address 0x%08x", width, (unsigned)address);
        return false;
    }
    if ((address & (width - 1u)) != 0) {
        error(machine, "unaligned %u-byte read of 0x%08x in %s", width, (unsigned)address, peripheral->name);
        return false;
    }
    *value = peripheral->read(peripheral, address - peripheral->base, width);
    return true;
}

static bool peripheral_write(machine_t *machine, uint32_t address, unsigned width, uint32_t value, bus_error_t error) {
    peripheral_t *const peripheral = find(machine, address, width);
    if (peripheral == NULL) {
        error(machine, "%u-byte write of 0x%x to unmapped address 0x%08x", width, (unsigned)value, (unsigned)address);
        return false;
    }
    if ((address & (width - 1u)) != 0) {
        error(machine, "unaligned %u-byte write to 0x%08x in %s", width, (unsigned)address, peripheral->name);
        return false;
    }
    peripheral->write(peripheral, address - peripheral->base, value, width);
    const bool done = !machine->bus_error;
    machine->bus_error = false;
    return done;
}

bool machine_core_read(machine_t *machine, uint32_t address, unsigned width, uint32_t *value) {
    machine->last_access = (machine_access_t){.address = address, .width = width, .time_ps = machine->now_ps};
    const bool done = peripheral_read(machine, address, width, value, machine_fault);
    machine->last_access.value = *value;
    return done;
}

bool machine_core_write(machine_t *machine, uint32_t address, unsigned width, uint32_t value) {
    machine->last_access = (machine_access_t){
        .address = address, .value = value, .width = width, .write = true, .time_ps = machine->now_ps};
    return peripheral_write(machine, address, width, value, machine_fault);
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
        return peripheral_read(machine, address, width, value, machine_violation);
    }
    if (machine->flash_busy && address >> 24 == FLASH_BASE >> 24) {
        machine_violation(machine,
                          "%u-byte bus master read of 0x%08x while the flash is busy: the bus would stand still until "
                          "the end, which this model does not do",
                          width, (unsigned)address);
    }
    *value = 0;
    memcpy(value, memory, width); /* Both are little-endian. */
    return true;
}

bool machine_bus_write(machine_t *machine, uint32_t address, unsigned width, uint32_t value) {
    uint8_t *const memory = shared_memory(machine, address, width);
    if (memory == NULL) {
        return peripheral_write(machine, address, width, value, machine_violation);
    }
    if (address >> 24 != SRAM_BASE >> 24) {
        machine_violation(machine, "%u-byte bus master write to read-only address 0x%08x", width, (unsigned)address);
        return false;
    }
    memcpy(memory, &value, width);
    return true;
}
