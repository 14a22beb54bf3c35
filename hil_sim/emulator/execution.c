/* execution.c: how a deadline is met exactly and cheaply.
 *
 * One code hook runs before each instruction and compares executed, or work, with deadline (a call and a compare, 5 to
 * 10 ns). All else happens when the deadline is reached, in attend(): events fire there, without leaving Unicorn; only
 * exceptions, sleep and the end of a run leave it. A block hook that counts whole blocks would save most of these
 * calls, but Unicorn translates a block with its hooks once and for all, so the blocks near a deadline could not be
 * stepped through without discarding them; and accesses need the program counter, which the code hook keeps.
 */
#include "emulator/execution.h"

#include "emulator/code_view.h"
#include "emulator/core_bus.h"
#include "emulator/exceptions.h"
#include "emulator/flash_wait.h"
#include "emulator/it_block.h"
#include "emulator/memory_hooks.h"
#include "emulator/probes.h"

#define OPCODE_WFI   0xBF30u
#define OPCODE_WFE   0xBF20u
#define OPCODE_YIELD 0xBF10u

#define CPACR_FPU 0x00F00000u

/* ---- Before an instruction ---- */

/* Unicorn cannot stop inside an IT block: events fire there on time, but an exception, and the end of a run, wait
 * for the block's end (at most 4 instructions; the architecture leaves that latency open). At the end of a run the
 * board is then so much ahead, in every slicing alike. */
static bool may_leave(const cpu_t *cpu, uint32_t address) {
    return code_it_state_at(cpu, address) == 0;
}

/* Whether Unicorn must be left before the instruction at address. Fires events and sets the next deadline. */
static bool must_leave(cpu_t *cpu, uint32_t address) {
    machine_t *const machine = cpu->machine;
    const int64_t time = core_clock_time(&cpu->clock, cpu_cycle(cpu));
    cpu->deadline = 0;
    const bool over = time >= cpu->until_ps || cpu->fault.exception != 0 || cpu->rules_changed || cpu->flash.changed ||
                      machine->stop_requested || machine->reset_requested || machine->debug_halted;
    if (over && may_leave(cpu, address)) {
        return true; /* cpu_run() fires what is due before the end. */
    }
    machine_fire(machine, time);
    if (over || cpu->flash.changed || machine->stop_requested || machine->reset_requested || machine->debug_halted ||
        exception_preempts(cpu, true)) {
        return may_leave(cpu, address);
    }
    bool every_instruction = cpu->nvic.candidate_priority <
                             cpu->nvic.active_priority; /* Masked: the mask may open any time. */
    if ((cpu->system.cpacr & CPACR_FPU) != CPACR_FPU) {
        every_instruction = true;
        if (code_is_floating_point(cpu, address)) {
            cpu->fault = (fault_t){.exception = EXCEPTION_USAGE_FAULT,
                                   .cfsr = CFSR_NOCP,
                                   .pc = address,
                                   .it_state = code_it_state_at(cpu, address)};
            machine_fault(machine, "floating-point instruction at 0x%08x while CPACR does not enable the unit",
                          (unsigned)address);
            return may_leave(cpu, address);
        }
    }
    unsigned divisor = 0;
    if ((cpu->system.ccr & CCR_DIV_0_TRP) != 0) {
        every_instruction = true;
        if (code_is_division(cpu, address, &divisor) && cpu_register(cpu, core_bus_registers[divisor]) == 0) {
            cpu->fault = (fault_t){.exception = EXCEPTION_USAGE_FAULT,
                                   .cfsr = CFSR_DIVBYZERO,
                                   .pc = address,
                                   .it_state = code_it_state_at(cpu, address)};
            machine_fault(machine, "division by zero at 0x%08x, which CCR.DIV_0_TRP forbids", (unsigned)address);
            return may_leave(cpu, address);
        }
    }
    if (cpu->probes_active != 0) {
        probes_step(cpu, address);
        every_instruction = every_instruction || cpu->probes_active != 0;
    }
    if (!every_instruction) {
        const int64_t next = machine_next_event(machine);
        const uint64_t cycle = core_clock_cycle(&cpu->clock, next < cpu->until_ps ? next : cpu->until_ps);
        cpu->deadline = (cycle - cpu->skipped) << CYCLE_SHIFT;
        if (cpu->cycles.table == NULL) {
            const uint64_t cost = cpu->cycles.instruction;
            cpu->deadline = cost == CYCLE ? cycle - cpu->skipped : (cpu->deadline + cost - 1u) / cost;
        }
    }
    return false;
}

static bool attend(cpu_t *cpu, uint32_t address) {
    if (!must_leave(cpu, address)) {
        return false;
    }
    cpu->deadline = 0;
    cpu->leave = LEAVE_STOPPED;
    cpu->pc = address;
    cpu->it_state = 0;
    uc_emu_stop(cpu->uc);
    return true;
}

static inline void begin_instruction(cpu_t *cpu, uint32_t address) {
    cpu->history[cpu->executed % HISTORY] = address;
    cpu->executed++;
}

static inline void begin_by_class(cpu_t *cpu, uint32_t address, uint32_t size) {
    cpu->cycles.expected += size;
    begin_instruction(cpu, address);
    cpu->work += cycles_of(&cpu->cycles, cpu->machine, address);
}

/* By themselves, so that the hook needs no frame of its own in all other cases. */
static __attribute__((noinline)) void attend_first(cpu_t *cpu, uint32_t address) {
    if (!attend(cpu, address)) {
        begin_instruction(cpu, address);
    }
}

static void on_instruction(uc_engine *uc, uint64_t address, uint32_t size, void *user) {
    (void)uc;
    (void)size;
    cpu_t *const cpu = user;
    if (cpu->executed >= cpu->deadline) {
        attend_first(cpu, (uint32_t)address);
    } else {
        begin_instruction(cpu, (uint32_t)address);
    }
}

static __attribute__((noinline)) void attend_first_by_class(cpu_t *cpu, uint32_t address, uint32_t size) {
    if (!attend(cpu, address)) {
        begin_by_class(cpu, address, size);
    }
}

/* The same where instructions differ in their costs. A branch's refill delays the instruction that it leads to. */
static void on_instruction_by_class(uc_engine *uc, uint64_t address, uint32_t size, void *user) {
    (void)uc;
    cpu_t *const cpu = user;
    if ((uint32_t)address != cpu->cycles.expected) {
        cpu->work += cpu->cycles.refill;
        cpu->cycles.expected = (uint32_t)address;
    }
    if (cpu->work >= cpu->deadline) {
        attend_first_by_class(cpu, (uint32_t)address, size);
    } else {
        begin_by_class(cpu, (uint32_t)address, size);
    }
}

static void on_interrupt(uc_engine *uc, uint32_t number, void *user) {
    cpu_t *const cpu = user;
    cpu->leave = LEAVE_EXCEPTION;
    cpu->leave_exception = number;
    uc_emu_stop(uc);
}

/* ---- After Unicorn returned ---- */

/* The instruction at code_last_address() did not complete. */
static void instruction_failed(cpu_t *cpu, unsigned exception, uint32_t cfsr, const char *what) {
    const uint32_t address = cpu->bad_address;
    core_bus_fault(cpu, exception, cfsr, address);
    cpu->machine->now_ps = core_clock_time(&cpu->clock, cpu_access_cycle(cpu));
    if ((cfsr & (CFSR_BFARVALID | CFSR_MMARVALID)) != 0) {
        machine_fault(cpu->machine, "%s 0x%08x", what, (unsigned)address);
    } else {
        machine_fault(cpu->machine, "%s", what);
    }
}

/* PC and ITSTATE as Unicorn keeps them at the end of a block. */
static uint32_t take_state(cpu_t *cpu) {
    static const int registers[] = {UC_ARM_REG_PC, UC_ARM_REG_XPSR};
    uint32_t pc = 0, xpsr = 0;
    void *values[] = {&pc, &xpsr};
    uc_reg_read_batch(cpu->uc, registers, values, 2);
    cpu->pc = pc & ~1u;
    cpu->it_state = it_block_from_xpsr(xpsr);
    return pc;
}

static void fetch_failed(cpu_t *cpu, uint32_t pc) {
    if (cpu->forbidden) {
        cpu->fault = (fault_t){
            .exception = EXCEPTION_MEMORY_FAULT, .cfsr = CFSR_IACCVIOL, .pc = cpu->pc, .it_state = cpu->it_state};
        machine_fault(cpu->machine, "instruction fetch from 0x%08x, which the memory protection unit forbids",
                      (unsigned)pc);
        return;
    }
    cpu->fault = (fault_t){
        .exception = EXCEPTION_BUS_FAULT, .cfsr = CFSR_IBUSERR, .pc = cpu->pc, .it_state = cpu->it_state};
    machine_fault(cpu->machine, "instruction fetch from 0x%08x, where there is no memory", (unsigned)pc);
}

static void exception_left(cpu_t *cpu) {
    const uint32_t pc = take_state(cpu);
    switch (cpu->leave_exception) {
    case UNICORN_SVC:
        exception_synchronous(cpu, EXCEPTION_SVCALL);
        break;
    case UNICORN_PREFETCH_ABORT:
    case UNICORN_EXCEPTION_EXIT:
        if (pc >= 0xFFFFFF00u) {
            exception_return(cpu, pc | 1u);
        } else {
            fetch_failed(cpu, pc);
        }
        break;
    case UNICORN_DATA_ABORT:
        instruction_failed(cpu, EXCEPTION_USAGE_FAULT, CFSR_UNALIGNED,
                           "unaligned access by an instruction that needs alignment");
        break;
    case UNICORN_BREAKPOINT:
        instruction_failed(cpu, EXCEPTION_HARD_FAULT, 0, "breakpoint instruction without a debugger");
        cpu->fault.hfsr = HFSR_DEBUGEVT;
        break;
    default:
        instruction_failed(cpu, EXCEPTION_USAGE_FAULT, CFSR_UNDEFINSTR, "instruction that the processor cannot run");
        break;
    }
}

static void hint_left(cpu_t *cpu, uint16_t opcode) {
    take_state(cpu);
    if (opcode == OPCODE_WFI) {
        cpu->asleep = true;
    } else if (opcode == OPCODE_WFE) {
        /* SEV sets no event here: a wait after it sleeps until the next exception. */
        cpu->asleep = !cpu->event_register;
        cpu->event_register = false;
    }
}

static void left_unicorn(cpu_t *cpu, uc_err error) {
    uint16_t opcode = 0;
    if (cpu->leave == LEAVE_STOPPED) {
        return;
    }
    if (cpu->leave == LEAVE_EXCEPTION) {
        exception_left(cpu);
        return;
    }
    if (cpu->flash.load_waits) {
        flash_wait_load_again(cpu);
        return;
    }
    const bool forbidden = cpu->forbidden && (error == UC_ERR_READ_PROT || error == UC_ERR_WRITE_PROT);
    if (forbidden) {
        uc_ctl_flush_tlb(cpu->uc); /* Unicorn would let the next read of that page pass. */
        instruction_failed(cpu, EXCEPTION_MEMORY_FAULT, CFSR_DACCVIOL | CFSR_MMARVALID,
                           "access that the memory protection unit forbids, to");
        return;
    }
    switch (error) {
    case UC_ERR_OK:
        hint_left(cpu, OPCODE_WFI);
        break;
    case UC_ERR_INSN_INVALID:
        if (code_opcode_at(cpu, code_last_address(cpu), &opcode) && (opcode == OPCODE_WFE || opcode == OPCODE_YIELD)) {
            hint_left(cpu, opcode);
        } else {
            instruction_failed(cpu, EXCEPTION_USAGE_FAULT, CFSR_UNDEFINSTR, "undefined instruction");
        }
        break;
    case UC_ERR_READ_UNMAPPED:
    case UC_ERR_READ_PROT:
        instruction_failed(cpu, EXCEPTION_BUS_FAULT, CFSR_PRECISERR | CFSR_BFARVALID, "read of unmapped address");
        break;
    case UC_ERR_WRITE_UNMAPPED:
    case UC_ERR_WRITE_PROT:
        instruction_failed(cpu, EXCEPTION_BUS_FAULT, CFSR_PRECISERR | CFSR_BFARVALID,
                           error == UC_ERR_WRITE_PROT ? "write to read-only address" : "write to unmapped address");
        core_bus_store_fault(cpu, cpu->bad_address);
        break;
    case UC_ERR_FETCH_UNMAPPED:
    case UC_ERR_FETCH_PROT: {
        const uint32_t pc = take_state(cpu);
        if (cpu->forbidden || (!flash_wait_fetch(cpu, pc & ~1u) && !memory_hooks_open_sram(cpu))) {
            fetch_failed(cpu, pc);
        }
        break;
    }
    case UC_ERR_EXCEPTION:
        take_state(cpu);
        cpu->fault = (fault_t){.exception = EXCEPTION_USAGE_FAULT, .cfsr = CFSR_INVSTATE, .pc = cpu->pc};
        machine_fault(cpu->machine, "branch to 0x%08x without the Thumb bit", (unsigned)cpu->pc);
        break;
    default:
        cpu_halt(cpu, uc_strerror(error));
        break;
    }
}

void execution_run(cpu_t *cpu) {
    memory_hooks_before_run(cpu);
    if (cpu->it_state != 0) {
        cpu_set_register(cpu, UC_ARM_REG_EPSR, it_block_to_xpsr(cpu->it_state) | XPSR_THUMB);
    }
    cpu->resume_pc = cpu->pc;
    cpu->resume_it_state = cpu->it_state;
    cpu->resume_executed = cpu->executed;
    cpu->access_executed = UINT64_MAX;
    cpu->leave = LEAVE_NOTHING;
    cpu->forbidden = false;
    cpu->deadline = 0;
    left_unicorn(cpu, uc_emu_start(cpu->uc, cpu->pc | 1u, 0, 0, 0));
}

/* ---- Life ---- */

uc_err execution_create(cpu_t *cpu) {
    uc_err error = uc_open(UC_ARCH_ARM, UC_MODE_THUMB, &cpu->uc); /* UC_MODE_MCLASS would make it a Cortex-M33. */
    if (error == UC_ERR_OK) {
        error = uc_ctl_set_cpu_model(cpu->uc, UC_CPU_ARM_CORTEX_M4);
    }
    if (error == UC_ERR_OK) {
        error = uc_ctl_exits_enable(cpu->uc); /* No exit addresses: else each stop discards the code at one. */
    }
    if (error == UC_ERR_OK) {
        error = core_bus_map(cpu);
    }
    void (*const hook)(uc_engine *, uint64_t, uint32_t, void *) = cpu->cycles.table != NULL ? on_instruction_by_class
                                                                                            : on_instruction;
    if (error == UC_ERR_OK) {
        error = uc_hook_add(cpu->uc, &cpu->code_hook, UC_HOOK_CODE, (void *)hook, cpu, 1, 0);
    }
    if (error == UC_ERR_OK) {
        error = uc_hook_add(cpu->uc, &cpu->interrupt_hook, UC_HOOK_INTR, (void *)on_interrupt, cpu, 1, 0);
    }
    if (error == UC_ERR_OK) {
        error = memory_hooks_create(cpu);
    }
    return error;
}
