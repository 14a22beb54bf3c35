/* model.c: the rules that hold for every register. */
#include "emulator/peripherals/model.h"

#include <stdlib.h>
#include <string.h>

const char *model_name(const model_t *model) {
    return model->peripheral.name;
}

void model_missing(model_t *model, const char *what) {
    machine_violation(model->machine, "%s: this model does not do %s", model_name(model), what);
}

static const register_layout_t *describe(const model_t *model, uint32_t offset) {
    const unsigned slot = model->slot[offset / 4];
    return slot == 0 ? NULL : &model->description->registers[slot - 1];
}

/* Is the peripheral reachable, and is there such a register? */
static const register_layout_t *admit(model_t *model, uint32_t offset, unsigned width, bool write) {
    const register_layout_t *const r = describe(model, offset & ~3u);
    const char *const verb = write ? "write to" : "read of";
    if (!model->clocked || model->in_reset) {
        machine_violation(model->machine, "%s: %s offset 0x%03X (%s) while %s", model_name(model), verb,
                          (unsigned)offset, r ? r->name : "no register",
                          model->in_reset ? "RCC holds the peripheral in reset" : "its clock is off in RCC");
        return NULL;
    }
    if (model->settling) {
        if (machine_now(model->machine) < model->settled_ps) {
            machine_violation(model->machine,
                              "%s: %s offset 0x%03X too soon after its clock was enabled (errata ES0182: read the "
                              "enable register back first)",
                              model_name(model), verb, (unsigned)offset);
        }
        model->settling = false;
    }
    if (r == NULL) {
        machine_violation(model->machine, "%s: %s offset 0x%03X, where no register is", model_name(model), verb,
                          (unsigned)offset);
        return NULL;
    }
    if (((write ? model->description->write_widths : model->description->read_widths) & width) == 0) {
        machine_violation(model->machine, "%s_%s: %s %u bits is not supported", model_name(model), r->name, verb,
                          8 * width);
    }
    return r;
}

static uint32_t bus_read(peripheral_t *self, uint32_t offset, unsigned width) {
    model_t *const model = (model_t *)self;
    const register_layout_t *const r = admit(model, offset, width, false);
    if (r == NULL) {
        return 0;
    }
    const uint32_t word = model->description->get ? model->description->get(model, offset & ~3u)
                                                  : reg(model, offset & ~3u);
    const uint32_t part = word >> (8 * (offset & 3u));
    return width == 4 ? part : part & ((1u << (8 * width)) - 1u);
}

static void bus_write(peripheral_t *self, uint32_t offset, uint32_t value, unsigned width) {
    model_t *const model = (model_t *)self;
    const register_layout_t *const r = admit(model, offset, width, true);
    if (r == NULL) {
        return;
    }
    if (r->access == ACCESS_RO) {
        machine_violation(model->machine, "%s_%s: write of 0x%08X to a read-only register", model_name(model), r->name,
                          (unsigned)value);
        return;
    }
    uint32_t word = value;
    uint32_t lanes = 0xFFFFFFFFu;
    if (width != 4) {
        const uint32_t mask = (1u << (8 * width)) - 1u;
        lanes = mask << (8 * (offset & 3u));
        if (model->description->bus == BUS_AHB || model->description->bus == BUS_CORE) {
            const uint32_t rest = r->access == ACCESS_WO ? 0 : reg(model, offset & ~3u);
            word = (rest & ~lanes) | ((value & mask) << (8 * (offset & 3u)));
        } else {
            if ((offset & 3u) != 0) {
                machine_violation(
                    model->machine,
                    "%s_%s: a write of %u bits at offset 0x%03X is duplicated over the whole word by the APB bridge",
                    model_name(model), r->name, 8 * width, (unsigned)offset);
            }
            word = (value & mask) * (width == 1 ? 0x01010101u : 0x00010001u) & (r->bits | mask);
        }
    }
    if (r->access != ACCESS_RC_W0 && ((word ^ r->reset) & ~r->bits & lanes) != 0) {
        machine_violation(model->machine, "%s_%s: write of 0x%08X changes reserved bits 0x%08X, which must keep 0x%08X",
                          model_name(model), r->name, (unsigned)word, (unsigned)((word ^ r->reset) & ~r->bits & lanes),
                          (unsigned)(r->reset & ~r->bits));
        word = (word & r->bits) | (r->reset & ~r->bits);
    }
    model->description->set(model, offset & ~3u, word);
}

void model_reset(model_t *model) {
    for (unsigned i = 0; i < model->description->register_count; i++) {
        model->value[model->description->registers[i].offset / 4] = model->description->registers[i].reset;
    }
    if (model->description->restart) {
        model->description->restart(model);
    }
}

static void bus_reset(peripheral_t *self) {
    model_reset((model_t *)self);
}

void *chip_allocate(chip_t *chip, size_t size) {
    void *const memory = calloc(1, size);
    if (memory == NULL || chip->allocated_count == sizeof chip->allocated / sizeof chip->allocated[0]) {
        abort();
    }
    chip->allocated[chip->allocated_count++] = memory;
    return memory;
}

void chip_listen_to_pins(chip_t *chip, pin_edge_t listener) {
    for (unsigned i = 0; i < CHIP_PIN_LISTENERS; i++) {
        if (chip->signals.pin_edge[i] == NULL) {
            chip->signals.pin_edge[i] = listener;
            return;
        }
    }
}

void chip_irq_shared(chip_t *chip, unsigned position, bool *held, bool level) {
    if (*held != level) {
        *held = level;
        chip->shared_irq[position] = (uint8_t)(chip->shared_irq[position] + (level ? 1 : -1));
        machine_irq(chip->machine, position, chip->shared_irq[position] != 0);
    }
}

void model_clock(model_t *model, bool on, int64_t settled_ps) {
    if (on && !model->clocked) {
        model->settling = true;
        model->settled_ps = settled_ps;
    }
    model->clocked = on;
}

void model_attach(chip_t *chip, model_t *model, const model_description_t *description) {
    model->description = description;
    model->chip = chip;
    model->machine = chip->machine;
    model->clocked = true; /* RCC takes it from those that it gates. */
    for (unsigned i = 0; i < description->register_count; i++) {
        model->slot[description->registers[i].offset / 4] = (uint8_t)(i + 1);
        model->value[description->registers[i].offset / 4] = description->registers[i].reset;
    }
    model->peripheral = (peripheral_t){.name = description->name,
                                       .base = description->base,
                                       .size = description->size,
                                       .machine = chip->machine,
                                       .state = model,
                                       .read = bus_read,
                                       .write = bus_write,
                                       .reset = bus_reset};
    chip->models[chip->model_count++] = model;
    machine_attach(chip->machine, &model->peripheral);
}

model_t *chip_model(const chip_t *chip, const char *name) {
    for (unsigned i = 0; i < chip->model_count; i++) {
        if (strcmp(model_name(chip->models[i]), name) == 0) {
            return chip->models[i];
        }
    }
    return NULL;
}

const register_layout_t *machine_register_table(const machine_t *machine, const char *name, unsigned *count) {
    const model_t *const model = chip_model(chip_of(machine), name);
    *count = model ? model->description->register_count : 0;
    return model ? model->description->registers : NULL;
}

/* RCC is attached first, so this search ends at once. */
chip_t *chip_of(const machine_t *machine) {
    return ((const model_t *)(const void *)machine_peripheral((machine_t *)(uintptr_t)machine, "RCC"))->chip;
}
