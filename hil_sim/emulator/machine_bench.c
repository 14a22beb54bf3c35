#include "emulator/machine_bench.h"

#include "emulator/cycles.h"
#include "emulator/inputs.h"
#include "emulator/machine_internal.h"
#include "emulator/peripherals/model.h"
#include "emulator/peripherals/outside.h"
#include "emulator/peripherals/peripherals.h"

machine_t *machine_bench_create(const emulator_config_t *config, const board_edge_t *edge) {
    machine_t *const machine = machine_create(config, edge, 0);
    if (machine != NULL) {
        peripherals_create(machine);
        machine_reset_peripherals(machine);
    }
    return machine;
}

static bool in_flash(uint32_t address) {
    return address - FLASH_BASE < FLASH_SIZE;
}

static void load_from_flash(machine_t *machine, uint32_t address, unsigned width) {
    while (machine->flash_busy) {
        machine_fire(machine, machine_next_event(machine));
    }
    if ((machine->watched_loads >> (address - FLASH_BASE) / FLASH_PIECE & 1u) != 0) {
        machine->flash_controller.watched(machine->flash_controller.context, address - FLASH_BASE, width, false);
    }
}

bool machine_bench_read(machine_t *machine, uint32_t address, unsigned width, uint32_t *value) {
    if (in_flash(address)) {
        load_from_flash(machine, address, width);
    }
    const uint8_t *const memory = machine_memory(machine, address, width);
    return memory != NULL ? machine_bus_read(machine, address, width, value)
                          : machine_core_read(machine, address, width, value);
}

bool machine_bench_write(machine_t *machine, uint32_t address, unsigned width, uint32_t value) {
    if (in_flash(address)) {
        machine_flash_store(machine, address, width, value);
        return true;
    }
    const uint8_t *const memory = machine_memory(machine, address, width);
    return memory != NULL ? machine_bus_write(machine, address, width, value)
                          : machine_core_write(machine, address, width, value);
}

bool machine_bench_irq(const machine_t *machine, unsigned position) {
    return position < MACHINE_IRQ_LINES && (machine->irq_level[position >> 5] >> (position & 31u) & 1u) != 0;
}

bool machine_bench_reset_requested(machine_t *machine, uint32_t *flags) {
    const bool requested = machine->reset_requested;
    *flags = machine->reset_flags;
    machine->reset_requested = false;
    machine->reset_flags = 0;
    return requested;
}

void machine_bench_reset(machine_t *machine) {
    machine_reset_peripherals(machine);
}

unsigned machine_bench_class_cycles(uint16_t first, uint16_t second) {
    return cycles_of_class(first, second);
}

uint64_t machine_bench_violations(const machine_t *machine) {
    return machine->violations;
}

void machine_bench_forget_violations(machine_t *machine) {
    machine->violations = 0;
    machine->report_length = 0;
    machine->report[0] = '\0';
}

bool machine_bench_nmi(const machine_t *machine) {
    return machine->nmi_level;
}

bool machine_bench_held(const machine_t *machine) {
    return machine->held_in_reset;
}

void machine_bench_crystal(machine_t *machine, bool alive) {
    rcc_crystal_in(machine, alive);
}

void machine_bench_noise(machine_t *machine, bool alive) {
    rng_noise_in(machine, alive);
}

void machine_bench_supply(machine_t *machine, double volts) {
    pwr_supply_in(machine, volts);
}

void machine_bench_cut_flash(machine_t *machine, uint64_t step, double fraction, uint64_t id, int64_t off_ps) {
    flash_cut_in(machine, step, fraction, id, off_ps);
}

uint64_t machine_bench_flash_steps(const machine_t *machine) {
    return flash_steps_out(machine);
}

double machine_bench_core_clock(const machine_t *machine) {
    return machine->core_hz;
}

double machine_bench_bus_clock(const machine_t *machine, const char *name) {
    const chip_t *const chip = chip_of(machine);
    const model_t *const model = chip_model(chip, name);
    if (model == NULL) {
        return 0;
    }
    switch (model->description->bus) {
    case BUS_APB1:
        return chip->pclk1.hz;
    case BUS_APB2:
        return chip->pclk2.hz;
    default:
        return chip->hclk.hz;
    }
}

double machine_bench_timer_clock(const machine_t *machine, const char *name) {
    const chip_t *const chip = chip_of(machine);
    const model_t *const model = chip_model(chip, name);
    if (model == NULL) {
        return 0;
    }
    return model->description->bus == BUS_APB2 ? chip->timer2.hz : chip->timer1.hz;
}

bool machine_bench_dma_pulse(machine_t *machine, const char *source) {
    const dma_source_t line = dma_source(source);
    if (line != DMA_NONE) {
        dma_line_pulse(chip_of(machine), line);
    }
    return line != DMA_NONE;
}

static board_status_t bench_run(board_t *board, int64_t until_ps) {
    machine_t *const machine = (machine_t *)board;
    machine_fire(machine, until_ps - 1);
    if (until_ps > machine->now_ps) {
        machine->now_ps = until_ps;
    }
    return BOARD_OK;
}

static int64_t bench_now(const board_t *board) {
    return machine_now((const machine_t *)board);
}

static const char *bench_report(const board_t *board) {
    return ((const machine_t *)board)->report;
}

static void bench_destroy(board_t *board) {
    inputs_destroy((machine_t *)board);
    machine_destroy((machine_t *)board);
}

const board_operations_t machine_bench_operations = {
    .run = bench_run,
    .now = bench_now,
    .pin_in = inputs_pin,
    .uart_in = inputs_uart,
    .can_in = inputs_can,
    .can_sent = inputs_can_sent,
    .can_error = inputs_can_error,
    .can_rate = inputs_can_rate,
    .report = bench_report,
    .destroy = bench_destroy,
};
