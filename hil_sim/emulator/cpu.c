#include "emulator/cpu.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "emulator/code_view.h"
#include "emulator/core_bus.h"
#include "emulator/exceptions.h"
#include "emulator/execution.h"
#include "emulator/flash_wait.h"
#include "emulator/it_block.h"
#include "emulator/memory_hooks.h"
#include "emulator/system_control.h"
#include "emulator/systick.h"
#include "emulator/upsets.h"

/* ---- Running ---- */

static double internal_clock(const machine_t *machine) {
    return 16e6 * (1.0 + machine->config.internal_ppm * 1e-6);
}

static void reset(cpu_t *cpu) {
    machine_t *const machine = cpu->machine;
    machine->reset_requested = false;
    machine_set_core_clock(machine, internal_clock(machine));
    nvic_reset(&cpu->nvic);
    system_control_reset(cpu);
    cpu->asleep = false;
    cpu->event_register = false;
    cpu->fault = (fault_t){0};
    cpu->flash.load_waits = false;
    cpu->depth = 0;
    cpu->probes_active = 0;
    for (unsigned i = 0; i < cpu->probe_count; i++) {
        cpu->probes[i].active = false;
    }
    machine_reset_peripherals(machine);
    machine->reset_flags = 0;

    uint32_t vectors[2];
    memcpy(vectors, machine->flash, sizeof vectors);
    cpu_set_register(cpu, UC_ARM_REG_XPSR_NZCVQG, XPSR_THUMB | EXCEPTION_NMI); /* A handler may write every register. */
    static const int zeroed[] = {UC_ARM_REG_CONTROL, UC_ARM_REG_PSP,       UC_ARM_REG_PRIMASK,
                                 UC_ARM_REG_BASEPRI, UC_ARM_REG_FAULTMASK, UC_ARM_REG_FPSCR};
    for (unsigned i = 0; i < sizeof zeroed / sizeof zeroed[0]; i++) {
        cpu_set_register(cpu, zeroed[i], 0);
    }
    cpu_set_register(cpu, UC_ARM_REG_XPSR_NZCVQG, XPSR_THUMB);
    cpu_set_register(cpu, UC_ARM_REG_CONTROL, 0);
    cpu_set_register(cpu, UC_ARM_REG_APSR_NZCV, 0);
    cpu_set_register(cpu, UC_ARM_REG_SP, vectors[0] & ~3u);
    cpu_set_register(cpu, UC_ARM_REG_LR, 0xFFFFFFFFu);
    cpu->pc = vectors[1] & ~1u;
    cpu->cycles.expected = cpu->pc;
    cpu->it_state = 0;
}

/* Skip to the next event or the end of the run. */
static void pass_time(cpu_t *cpu) {
    const int64_t next = machine_next_event(cpu->machine);
    cpu->skipped = core_clock_cycle(&cpu->clock, next < cpu->until_ps ? next : cpu->until_ps) -
                   (cpu_work(cpu) >> CYCLE_SHIFT);
}

/* The same, while the flash holds the core up. */
static void pass_wait(cpu_t *cpu) {
    const uint64_t before = cpu->skipped;
    pass_time(cpu);
    cpu->waited += cpu->skipped - before;
}

/* Asleep: the core wakes for an exception that would preempt if PRIMASK were clear. */
static void pass_sleep(cpu_t *cpu) {
    if (exception_preempts(cpu, false)) {
        cpu->asleep = false;
        return;
    }
    pass_time(cpu);
}

board_status_t cpu_run(cpu_t *cpu, int64_t until_ps) {
    machine_t *const machine = cpu->machine;
    cpu->until_ps = until_ps;
    while (!cpu->halted) {
        if (machine->stop_requested) {
            cpu->halted = true;
            break;
        }
        if (machine->reset_requested) {
            reset(cpu);
        }
        if (cpu->rules_changed) {
            cpu->rules_changed = false;
            memory_hooks_follow_rules(cpu);
        }
        const int64_t time = core_clock_time(&cpu->clock, cpu_cycle(cpu));
        machine_fire(machine, time < until_ps ? time : until_ps - 1);
        if (machine->stop_requested || machine->reset_requested) {
            continue;
        }
        if (time >= until_ps) {
            machine->now_ps = until_ps > machine->now_ps ? until_ps : machine->now_ps;
            return BOARD_OK;
        }
        if (machine->held_in_reset || machine->debug_halted) {
            pass_time(cpu);
        } else if (machine->flash_busy && flash_wait_holds(cpu)) {
            pass_wait(cpu);
        } else if (cpu->fault.exception != 0) {
            const fault_t fault = cpu->fault;
            cpu->fault = (fault_t){0};
            cpu->pc = fault.pc;
            cpu->it_state = fault.it_state;
            core_bus_take_back(cpu, &fault);
            exception_fault(cpu, &fault);
        } else if (cpu->asleep) {
            pass_sleep(cpu);
        } else if (exception_preempts(cpu, true)) {
            exception_enter(cpu, cpu->nvic.candidate);
        } else {
            if (cpu->flash.changed) {
                flash_wait_apply(cpu);
            }
            execution_run(cpu);
        }
    }
    return BOARD_FAULT;
}

/* ---- What the machine asks of its processor ---- */

static void irq(void *processor, unsigned position, bool level) {
    cpu_t *const cpu = processor;
    nvic_line(&cpu->nvic, position, level);
    cpu->deadline = 0;
}

static void nmi(void *processor) {
    cpu_t *const cpu = processor;
    nvic_pend(&cpu->nvic, EXCEPTION_NMI);
    cpu->deadline = 0;
}

static void clock_changed(void *processor, double hz) {
    cpu_t *const cpu = processor;
    core_clock_set(&cpu->clock, cpu_cycle(cpu), hz);
    systick_clock_changed(cpu);
    cpu->deadline = 0;
}

static void flash_access(void *processor, uint32_t acr) {
    cycles_flash_changed(&((cpu_t *)processor)->cycles, acr);
}

static void flash_changed(void *processor, uint32_t offset, uint32_t count) {
    flash_wait_changed(processor, offset, count);
}

static void flash_rules(void *processor) {
    flash_wait_changed(processor, 0, 0);
}

static void attention(void *processor) {
    ((cpu_t *)processor)->deadline = 0;
}

static uint32_t program_counter(const void *processor) {
    const cpu_t *const cpu = processor;
    return cpu->executed == 0 ? cpu->pc : code_last_address(cpu);
}

/* ---- Life ---- */

cpu_t *cpu_create(machine_t *machine, char *error, size_t error_size) {
    cpu_t *const cpu = calloc(1, sizeof *cpu);
    if (cpu == NULL) {
        snprintf(error, error_size, "no memory for a processor");
        return NULL;
    }
    cpu->machine = machine;
    cpu->stack_low = UINT32_MAX;
    if (!cycles_init(&cpu->cycles, &machine->config)) {
        snprintf(error, error_size, "no memory for a processor");
        cpu_destroy(cpu);
        return NULL;
    }
    const uc_err result = execution_create(cpu);
    if (result != UC_ERR_OK) {
        snprintf(error, error_size, "Unicorn cannot start a Cortex-M4: %s", uc_strerror(result));
        cpu_destroy(cpu);
        return NULL;
    }
    cpu->clock.base_ps = machine->now_ps;
    core_clock_set(&cpu->clock, 0, internal_clock(machine));
    systick_create(cpu);
    machine->processor = (machine_processor_t){.irq = irq,
                                               .nmi = nmi,
                                               .clock = clock_changed,
                                               .flash_access = flash_access,
                                               .flash_changed = flash_changed,
                                               .flash_rules = flash_rules,
                                               .attention = attention,
                                               .program_counter = program_counter,
                                               .processor = cpu};
    return cpu;
}

void cpu_destroy(cpu_t *cpu) {
    if (cpu->uc != NULL) {
        uc_close(cpu->uc);
    }
    cycles_free(&cpu->cycles);
    upsets_free(cpu);
    free(cpu->report);
    free(cpu);
}
