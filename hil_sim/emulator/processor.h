/* processor.h: the Cortex-M4F inside the emulator; for cpu.c, exceptions.c, system_control.c, probes.c and emulator.c
 * only.
 *
 * Time. executed counts instructions, skipped the cycles asleep; the instruction about to run starts at cycle executed
 * + skipped. An instruction takes one cycle; one whose condition fails inside an IT block takes none (Unicorn does not
 * report it).
 *
 * How a deadline is met exactly and cheaply: one code hook runs before each instruction and compares executed with
 * deadline (a call and a compare, 5 to 10 ns). All else happens when the deadline is reached, in cpu_attend(): events
 * fire there, without leaving Unicorn; only exceptions, sleep and the end of a run leave it. A block hook that counts
 * whole blocks would save most of these calls, but Unicorn translates a block with its hooks once and for all, so the
 * blocks near a deadline could not be stepped through without discarding them; and PC inside accesses needs the code
 * hook anyway.
 */
#ifndef GOLDFIELD_PROCESSOR_H
#define GOLDFIELD_PROCESSOR_H

#include <unicorn/unicorn.h>

#include "emulator/core_clock.h"
#include "emulator/machine_internal.h"
#include "emulator/nvic.h"

/* Fault status bits. */
#define CFSR_IBUSERR    (1u << 8)
#define CFSR_PRECISERR  (1u << 9)
#define CFSR_BFARVALID  (1u << 15)
#define CFSR_UNDEFINSTR (1u << 16)
#define CFSR_INVSTATE   (1u << 17)
#define CFSR_NOCP       (1u << 19)
#define CFSR_UNALIGNED  (1u << 24)
#define HFSR_DEBUGEVT   (1u << 31)

#define PROBES  8u
#define HISTORY 8u /* Addresses of the last instructions; power of 2, more than 5 (the longest IT block). */

typedef struct {
    uint32_t control, reload, active_reload;
    bool counted;     /* COUNTFLAG. */
    uint32_t stopped; /* The count while not enabled. */
    uint64_t zero;    /* While enabled: the cycle at which it last was, or counts as having been, zero. */
    machine_event_t event;
} systick_t;

typedef struct {
    uint32_t vtor, scr, ccr, shcsr, cfsr, hfsr, dfsr, mmfar, bfar, afsr, cpacr, fpccr, fpcar, actlr, demcr, dwt_control,
        debug_control[3];
    uint64_t dwt_origin; /* Awake cycles at which CYCCNT was 0. */
    uint32_t dwt_stopped;
    systick_t systick;
} system_control_t;

typedef struct {
    emulator_probe_t result;
    bool active;
    unsigned depth;
    uint32_t return_address, stack;
    uint64_t start, excluded;
} probe_t;

typedef struct {
    unsigned exception; /* 0: none. */
    uint32_t cfsr, hfsr, address, pc;
    uint8_t it_state;
} fault_t;

typedef struct cpu cpu_t;

typedef struct {
    cpu_t *cpu;
    uint32_t base;
} bus_window_t;

typedef enum { LEAVE_NOTHING, LEAVE_STOPPED, LEAVE_EXCEPTION } leave_t;

struct cpu {
    /* What the code hook touches. */
    uint64_t executed, deadline;
    uint32_t history[HISTORY];

    machine_t *machine;
    uc_engine *uc;
    core_clock_t clock;
    nvic_t nvic;
    system_control_t system;
    uint64_t skipped;
    int64_t until_ps;

    /* Between runs: where to go on. */
    uint32_t pc;
    uint8_t it_state;
    bool asleep, event_register, halted, sram_executable;
    fault_t fault; /* Found by an access or by the check before an instruction; taken before the next instruction. */

    /* Why Unicorn was left. */
    leave_t leave;
    uint32_t leave_exception;

    uint32_t resume_pc; /* Where Unicorn was last entered, and in which state, at which count. */
    uint8_t resume_it_state;
    uint64_t resume_executed;

    uint64_t interrupts;
    uint32_t stack_low;

    probe_t probes[PROBES];
    unsigned probe_count, probes_active;
    unsigned depth;                                                /* Exceptions active. */
    uint64_t entered_at[NVIC_EXCEPTIONS], inside[NVIC_EXCEPTIONS]; /* By depth: count at the last exception from there,
                                                                      instructions in exceptions from there. */

    uint32_t bad_address;
    uint64_t access_executed; /* Instruction of the last peripheral access: several by one instruction are looked at. */

    bus_window_t windows[3];
    uc_hook code_hook, interrupt_hook, memory_hook, probe_hooks[PROBES];
    char *report;
};

/* cpu.c */
cpu_t *cpu_create(machine_t *machine, char *error, size_t error_size);
void cpu_destroy(cpu_t *cpu);
void cpu_reset(cpu_t *cpu);
board_status_t cpu_run(cpu_t *cpu, int64_t until_ps);
void cpu_halt(cpu_t *cpu, const char *reason); /* For good: the board stops. */
uint32_t cpu_register(const cpu_t *cpu, int unicorn_register);
void cpu_set_register(cpu_t *cpu, int unicorn_register, uint32_t value);
static inline uint64_t cpu_cycle(const cpu_t *cpu) {
    return cpu->executed + cpu->skipped;
}

/* code_view.c. False, 0: nothing there. */
bool code_opcode_at(const cpu_t *cpu, uint32_t address, uint16_t *opcode);
/* ITSTATE of the instruction at address, which is about to run or just failed (then with executed one less); 0
 * outside of an IT block. */
uint8_t code_it_state_at(const cpu_t *cpu, uint32_t address);
bool code_is_floating_point(const cpu_t *cpu, uint32_t address);
/* The last instruction that began, and whether it is a load or store of a single item. */
uint32_t code_last_address(const cpu_t *cpu);
bool code_is_single_transfer(const cpu_t *cpu);

/* core_bus.c */
uc_err core_bus_map(cpu_t *cpu);
/* Note a fault of the last instruction; it is taken before the next. */
void core_bus_fault(cpu_t *cpu, unsigned exception, uint32_t cfsr, uint32_t address);

/* exceptions.c. The frame's return address is cpu->pc, its ITSTATE cpu->it_state; both become those of the handler. */
void exception_enter(cpu_t *cpu, unsigned exception);
void exception_return(cpu_t *cpu, uint32_t exc_return);
/* Enter the handler of a synchronous exception, or escalate to HardFault, or halt in lockup. */
void exception_synchronous(cpu_t *cpu, unsigned exception);
void exception_fault(cpu_t *cpu, const fault_t *fault);
/* Priority below which (numerically) an exception preempts. */
int execution_priority(const cpu_t *cpu, bool heed_primask);

/* system_control.c: registers of the private peripheral bus. False: no such register. cycle: of the accessing
 * instruction. */
void system_control_create(cpu_t *cpu);
void system_control_reset(cpu_t *cpu);
void system_control_clock_changed(cpu_t *cpu);
bool system_control_read(cpu_t *cpu, uint32_t address, unsigned width, uint32_t *value);
bool system_control_write(cpu_t *cpu, uint32_t address, unsigned width, uint32_t value);

/* probes.c */
void probes_enter_exception(cpu_t *cpu);
void probes_leave_exception(cpu_t *cpu);
void probes_step(cpu_t *cpu, uint32_t address);

#endif
