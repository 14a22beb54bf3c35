/* exceptions.c: what differs from the manual.
 *
 * The floating-point registers are stacked at entry even when FPCCR.LSPEN asks for lazy stacking: what a program can
 * see is the same but for FPCCR and FPCAR. Tail-chaining is a return followed by an entry. The exclusive monitor is not
 * cleared: Unicorn's STREX compares the value as well.
 */
#include "emulator/exceptions.h"

#include <string.h>

#include "emulator/it_block.h"
#include "emulator/probes.h"
#include "emulator/protection.h"

#define CONTROL_UNPRIVILEGED   1u
#define CONTROL_PROCESS_STACK  2u
#define CONTROL_FLOATING_POINT 4u
#define XPSR_ALIGNED           (1u << 9)
#define XPSR_EXCEPTION         0x1FFu
#define CCR_STACK_ALIGN        0x200u
#define CCR_NON_BASE_THREAD    1u
#define SCR_SLEEP_ON_EXIT      2u
#define BASIC_FRAME            0x20u
#define EXTENDED_FRAME         0x68u
#define RETURN_BASIC_FRAME     0x10u
#define RETURN_THREAD          0x8u
#define RETURN_PROCESS_STACK   0x4u

enum { FRAME_R0, FRAME_R1, FRAME_R2, FRAME_R3, FRAME_R12, FRAME_LR, FRAME_PC, FRAME_XPSR, FRAME_WORDS };

/* The priority below which (numerically) an exception preempts. */
static int execution_priority(const cpu_t *cpu, bool heed_primask) {
    int priority = cpu->nvic.active_priority;
    const uint32_t basepri = cpu_register(cpu, UC_ARM_REG_BASEPRI) & 0xF0u;
    if (basepri != 0) {
        const int boosted = nvic_group_priority(&cpu->nvic, (int)basepri);
        priority = boosted < priority ? boosted : priority;
    }
    if (heed_primask && priority > 0 && (cpu_register(cpu, UC_ARM_REG_PRIMASK) & 1u) != 0) {
        priority = 0;
    }
    if (priority > -1 && (cpu_register(cpu, UC_ARM_REG_FAULTMASK) & 1u) != 0) {
        priority = -1;
    }
    return priority;
}

bool exception_preempts(const cpu_t *cpu, bool heed_primask) {
    /* The masks cost calls into Unicorn: they are read last. */
    return cpu->nvic.candidate_priority < cpu->nvic.active_priority &&
           cpu->nvic.candidate_priority < execution_priority(cpu, heed_primask);
}

static uint8_t *stack_memory(const cpu_t *cpu, uint32_t address, size_t count) {
    const uint32_t area = address >> 24;
    return area == SRAM_BASE >> 24 || area == CCM_BASE >> 24 ? machine_memory(cpu->machine, address, count) : NULL;
}

/* Unicorn caches which mode it translates for; writing flags makes it look again. */
static void refresh_mode(cpu_t *cpu, uint32_t xpsr) {
    cpu_set_register(cpu, UC_ARM_REG_APSR_NZCV, xpsr & 0xF0000000u);
}

static void save_floating_point(cpu_t *cpu, uint8_t *frame) {
    for (int i = 0; i < 8; i++) {
        uint64_t pair = 0;
        uc_reg_read(cpu->uc, UC_ARM_REG_D0 + i, &pair);
        memcpy(frame + BASIC_FRAME + 8 * i, &pair, sizeof pair);
    }
    const uint32_t status = cpu_register(cpu, UC_ARM_REG_FPSCR);
    memcpy(frame + BASIC_FRAME + 64, &status, sizeof status);
}

static void restore_floating_point(cpu_t *cpu, const uint8_t *frame) {
    for (int i = 0; i < 8; i++) {
        uint64_t pair;
        memcpy(&pair, frame + BASIC_FRAME + 8 * i, sizeof pair);
        uc_reg_write(cpu->uc, UC_ARM_REG_D0 + i, &pair);
    }
    uint32_t status;
    memcpy(&status, frame + BASIC_FRAME + 64, sizeof status);
    cpu_set_register(cpu, UC_ARM_REG_FPSCR, status);
}

/* CONTROL and mode of a processor that is in handler mode or privileged. */
static void become_handler(cpu_t *cpu, uint32_t xpsr, uint32_t control) {
    if ((control & CONTROL_UNPRIVILEGED) != 0) {
        /* Unprivileged thread mode may not write CONTROL; handler mode may, except for the stack selection. */
        cpu_set_register(cpu, UC_ARM_REG_XPSR_NZCVQG, xpsr);
        cpu_set_register(cpu, UC_ARM_REG_CONTROL, 0);
        cpu_set_register(cpu, UC_ARM_REG_XPSR_NZCVQG, xpsr & ~XPSR_EXCEPTION);
    }
    if (control != 0) {
        cpu_set_register(cpu, UC_ARM_REG_CONTROL, 0);
    }
    cpu_set_register(cpu, UC_ARM_REG_XPSR_NZCVQG, xpsr);
    if ((control & CONTROL_UNPRIVILEGED) != 0) {
        cpu_set_register(cpu, UC_ARM_REG_CONTROL, CONTROL_UNPRIVILEGED);
    }
    refresh_mode(cpu, xpsr);
}

/* Which exception is entered in place of one whose frame could not be stacked; its own frame is not stacked again.
 * HardFault and NMI are entered all the same (ARMv7-M manual, B1.5.8 and B1.5.15). */
static unsigned stacking_failed(cpu_t *cpu, unsigned exception, bool bus_error, uint32_t stack) {
    const unsigned fault = bus_error ? EXCEPTION_BUS_FAULT : EXCEPTION_MEMORY_FAULT;
    machine_fault(cpu->machine, "frame of exception %u at 0x%08x, %s", exception, (unsigned)stack,
                  bus_error ? "where there is no RAM" : "which the memory protection unit forbids");
    cpu->system.cfsr |= bus_error ? CFSR_STKERR : CFSR_MSTKERR;
    if (exception <= EXCEPTION_HARD_FAULT) {
        return exception;
    }
    const bool enabled = (cpu->system.shcsr >> (12u + fault) & 1u) != 0; /* MEMFAULTENA is bit 16. */
    if (!enabled) {
        cpu->system.hfsr |= HFSR_FORCED;
    }
    const int own = nvic_group_priority(&cpu->nvic, nvic_priority(&cpu->nvic, exception));
    if (enabled && nvic_group_priority(&cpu->nvic, nvic_priority(&cpu->nvic, fault)) >= own) {
        nvic_pend(&cpu->nvic, fault); /* The exception itself goes first. */
        return exception;
    }
    if (exception == EXCEPTION_SVCALL) {
        nvic_pend(&cpu->nvic, exception);
    }
    return enabled ? fault : (unsigned)EXCEPTION_HARD_FAULT;
}

void exception_enter(cpu_t *cpu, unsigned exception) {
    static const int saved[] = {UC_ARM_REG_R0, UC_ARM_REG_R1, UC_ARM_REG_R2,   UC_ARM_REG_R3,     UC_ARM_REG_R12,
                                UC_ARM_REG_LR, UC_ARM_REG_SP, UC_ARM_REG_XPSR, UC_ARM_REG_CONTROL};
    uint32_t frame[FRAME_WORDS], stack = 0, xpsr = 0, control = 0;
    void *const values[] = {&frame[FRAME_R0],  &frame[FRAME_R1], &frame[FRAME_R2], &frame[FRAME_R3],
                            &frame[FRAME_R12], &frame[FRAME_LR], &stack,           &xpsr,
                            &control};
    uc_reg_read_batch(cpu->uc, saved, (void **)values, sizeof saved / sizeof saved[0]);

    const bool floating_point = (control & CONTROL_FLOATING_POINT) != 0;
    const uint32_t size = floating_point ? EXTENDED_FRAME : BASIC_FRAME;
    const bool align = (stack & 4u) != 0 && (floating_point || (cpu->system.ccr & CCR_STACK_ALIGN) != 0);
    const uint32_t new_stack = stack - size - (align ? 4u : 0u);
    frame[FRAME_PC] = cpu->pc;
    frame[FRAME_XPSR] = (xpsr & ~(IT_BLOCK_XPSR | XPSR_ALIGNED)) | XPSR_THUMB | it_block_to_xpsr(cpu->it_state) |
                        (align ? XPSR_ALIGNED : 0);

    const bool from_handler = (xpsr & XPSR_EXCEPTION) != 0;
    const bool privileged = from_handler || (control & CONTROL_UNPRIVILEGED) == 0;
    uint8_t *const memory = stack_memory(cpu, new_stack, size);
    if (memory == NULL || !protection_allows_frame(cpu, new_stack, size, MPU_WRITE, privileged)) {
        exception = stacking_failed(cpu, exception, memory == NULL, new_stack);
    } else {
        memcpy(memory, frame, sizeof frame);
        if (floating_point) {
            save_floating_point(cpu, memory);
        }
    }
    const uint8_t *const vector = machine_memory(cpu->machine, cpu->system.vtor + 4u * exception, 4);
    if (vector == NULL) {
        cpu_halt(cpu, "lockup: the vector table is outside of memory");
        return;
    }

    const bool process_stack = !from_handler && (control & CONTROL_PROCESS_STACK) != 0;
    const uint32_t exc_return = 0xFFFFFFE1u | (floating_point ? 0 : RETURN_BASIC_FRAME) |
                                (from_handler ? 0 : RETURN_THREAD) | (process_stack ? RETURN_PROCESS_STACK : 0);
    cpu_set_register(cpu, UC_ARM_REG_SP,
                     new_stack); /* SP is that of the stack in use; becoming a handler switches to the main stack. */
    cpu_set_register(cpu, UC_ARM_REG_LR, exc_return);
    become_handler(cpu, (xpsr & ~(IT_BLOCK_XPSR | XPSR_EXCEPTION)) | XPSR_THUMB | exception, control);

    nvic_activate(&cpu->nvic, exception);
    cpu->event_register = true;
    cpu->interrupts++;
    const uint32_t main_stack = process_stack ? cpu_register(cpu, UC_ARM_REG_SP) : new_stack;
    cpu->stack_low = main_stack < cpu->stack_low ? main_stack : cpu->stack_low;
    probes_enter_exception(cpu);

    uint32_t handler;
    memcpy(&handler, vector, sizeof handler);
    cpu->pc = handler & ~1u;
    cpu->it_state = 0;
    cpu->work += cycles_exception(&cpu->cycles, true, floating_point);
    cpu->cycles.expected = cpu->pc;
    if ((handler & 1u) == 0) {
        exception_fault(cpu, &(fault_t){.exception = EXCEPTION_USAGE_FAULT, .cfsr = CFSR_INVSTATE});
    }
}

static void invalid_return(cpu_t *cpu, uint32_t exc_return) {
    machine_fault(cpu->machine, "exception return with value 0x%08x does not fit the processor's state",
                  (unsigned)exc_return);
    exception_fault(cpu, &(fault_t){.exception = EXCEPTION_USAGE_FAULT, .cfsr = CFSR_INVPC});
}

/* Whether the processor's state allows a return from an exception with this EXC_RETURN value. */
static bool return_fits(const cpu_t *cpu, unsigned exception, uint32_t exc_return) {
    const uint32_t kind = exc_return & 0xFu;
    const unsigned active = nvic_active_count(&cpu->nvic);
    if (exc_return < 0xFFFFFFE0u || (kind != 1u && kind != 9u && kind != 0xDu) ||
        !nvic_is_active(&cpu->nvic, exception)) {
        return false;
    }
    return kind == 1u ? active != 1 : active <= 1 || (cpu->system.ccr & CCR_NON_BASE_THREAD) != 0;
}

/* Take the registers back from a frame. CONTROL comes last, in thread mode: only there can it select the stack, and
 * it may take the privilege away. */
static void restore_registers(cpu_t *cpu, uint32_t frame[FRAME_WORDS], bool process_stack, bool floating_point) {
    static const int restored[] = {UC_ARM_REG_R0, UC_ARM_REG_R1,  UC_ARM_REG_R2,
                                   UC_ARM_REG_R3, UC_ARM_REG_R12, UC_ARM_REG_LR};
    void *const values[] = {&frame[FRAME_R0], &frame[FRAME_R1],  &frame[FRAME_R2],
                            &frame[FRAME_R3], &frame[FRAME_R12], &frame[FRAME_LR]};
    uc_reg_write_batch(cpu->uc, restored, (void *const *)values, 6);

    const uint32_t control = cpu_register(cpu, UC_ARM_REG_CONTROL);
    if ((control & CONTROL_UNPRIVILEGED) != 0) {
        cpu_set_register(cpu, UC_ARM_REG_CONTROL, 0);
    }
    const uint32_t xpsr = (frame[FRAME_XPSR] & ~(XPSR_ALIGNED | IT_BLOCK_XPSR)) | XPSR_THUMB;
    cpu_set_register(cpu, UC_ARM_REG_XPSR_NZCVQG, xpsr);
    const uint32_t new_control = (control & CONTROL_UNPRIVILEGED) | (process_stack ? CONTROL_PROCESS_STACK : 0) |
                                 (floating_point ? CONTROL_FLOATING_POINT : 0);
    if (new_control != control || (control & CONTROL_UNPRIVILEGED) != 0) {
        cpu_set_register(cpu, UC_ARM_REG_CONTROL, new_control);
    }
    refresh_mode(cpu, xpsr);
    cpu->it_state = it_block_from_xpsr(frame[FRAME_XPSR]);
    cpu->pc = frame[FRAME_PC] & ~1u;
}

static void unstacking_failed(cpu_t *cpu, bool bus_error, uint32_t stack) {
    machine_fault(cpu->machine, "exception return to a frame at 0x%08x, %s", (unsigned)stack,
                  bus_error ? "where there is no RAM" : "which the memory protection unit forbids");
    exception_fault(cpu, &(fault_t){.exception = bus_error ? EXCEPTION_BUS_FAULT : EXCEPTION_MEMORY_FAULT,
                                    .cfsr = bus_error ? CFSR_UNSTKERR : CFSR_MUNSTKERR});
}

void exception_return(cpu_t *cpu, uint32_t exc_return) {
    const unsigned exception = cpu_register(cpu, UC_ARM_REG_IPSR) & XPSR_EXCEPTION;
    const bool to_thread = (exc_return & RETURN_THREAD) != 0;
    cpu->pc = exc_return & ~1u;
    cpu->it_state = 0;
    if (!return_fits(cpu, exception, exc_return)) {
        invalid_return(cpu, exc_return);
        return;
    }
    const bool process_stack = (exc_return & RETURN_PROCESS_STACK) != 0;
    const bool floating_point = (exc_return & RETURN_BASIC_FRAME) == 0;
    const uint32_t size = floating_point ? EXTENDED_FRAME : BASIC_FRAME;
    const uint32_t stack = cpu_register(cpu, process_stack ? UC_ARM_REG_PSP : UC_ARM_REG_SP);
    const uint8_t *const memory = stack_memory(cpu, stack, size);
    const bool privileged = !to_thread || (cpu_register(cpu, UC_ARM_REG_CONTROL) & CONTROL_UNPRIVILEGED) == 0;
    if (memory == NULL || !protection_allows_frame(cpu, stack, size, MPU_READ, privileged)) {
        unstacking_failed(cpu, memory == NULL, stack);
        return;
    }
    uint32_t frame[FRAME_WORDS];
    memcpy(frame, memory, sizeof frame);
    if (((frame[FRAME_XPSR] & XPSR_EXCEPTION) == 0) != to_thread) {
        invalid_return(cpu, exc_return);
        return;
    }
    nvic_deactivate(&cpu->nvic, exception);
    if (exception == EXCEPTION_NMI && cpu->machine->nmi_level) {
        nvic_pend(&cpu->nvic, EXCEPTION_NMI);
    }
    probes_leave_exception(cpu);
    cpu->event_register = true;
    if (exception != EXCEPTION_NMI) {
        cpu_set_register(cpu, UC_ARM_REG_FAULTMASK, 0);
    }
    if (floating_point) {
        restore_floating_point(cpu, memory);
    }
    const uint32_t new_stack = (stack + size) | ((frame[FRAME_XPSR] & XPSR_ALIGNED) != 0 ? 4u : 0u);
    cpu_set_register(cpu, process_stack ? UC_ARM_REG_PSP : UC_ARM_REG_SP, new_stack);
    restore_registers(cpu, frame, process_stack, floating_point);
    cpu->work += cycles_exception(&cpu->cycles, false, floating_point);
    cpu->cycles.expected = cpu->pc;
    cpu->asleep = to_thread && nvic_active_count(&cpu->nvic) == 0 && (cpu->system.scr & SCR_SLEEP_ON_EXIT) != 0;
}

void exception_synchronous(cpu_t *cpu, unsigned exception) {
    const int priority = execution_priority(cpu, true);
    if (exception != EXCEPTION_HARD_FAULT) {
        const bool enabled = exception == EXCEPTION_SVCALL ||
                             (cpu->system.shcsr >> (12u + exception) & 1u) != 0; /* MEMFAULTENA is bit 16. */
        if (enabled && nvic_group_priority(&cpu->nvic, nvic_priority(&cpu->nvic, exception)) < priority) {
            exception_enter(cpu, exception);
            return;
        }
        cpu->system.hfsr |= HFSR_FORCED;
    }
    if (priority <= -1) {
        cpu_halt(cpu, "lockup: a fault inside the HardFault or NMI handler");
        return;
    }
    exception_enter(cpu, EXCEPTION_HARD_FAULT);
}

void exception_fault(cpu_t *cpu, const fault_t *fault) {
    cpu->system.cfsr |= fault->cfsr;
    cpu->system.hfsr |= fault->hfsr;
    if ((fault->cfsr & CFSR_BFARVALID) != 0) {
        cpu->system.bfar = fault->address;
    }
    if ((fault->cfsr & CFSR_MMARVALID) != 0) {
        cpu->system.mmfar = fault->address;
    }
    if ((fault->cfsr & CFSR_IMPRECISERR) != 0) { /* Asynchronous: it waits for its turn. */
        const bool enabled = (cpu->system.shcsr >> (12u + EXCEPTION_BUS_FAULT) & 1u) != 0;
        cpu->system.hfsr |= enabled ? 0 : HFSR_FORCED;
        nvic_pend(&cpu->nvic, enabled ? EXCEPTION_BUS_FAULT : EXCEPTION_HARD_FAULT);
        return;
    }
    exception_synchronous(cpu, fault->exception);
}
