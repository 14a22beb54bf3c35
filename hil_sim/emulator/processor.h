/* processor.h: the state of the Cortex-M4F inside the emulator, for the files that make it up and for nobody else.
 *
 * From the bottom up: nvic.h (which exception comes first), mpu.h (which access is allowed), code_view.h (the program
 * as bytes), probes.h (instruction counts), exceptions.h (entry, return, faults), systick.h and system_control.h (the
 * core's own registers), protection.h (what is forbidden), core_bus.h (what lies at which address), flash_wait.h (what
 * a busy flash holds up), upsets.h (glitches), memory_hooks.h (what Unicorn asks about memory), execution.h (Unicorn),
 * cpu.h (life, reset and the run of a processor).
 *
 * Time. executed counts instructions, cpu_work() what they cost (cycles.h), skipped the cycles asleep; the instruction
 * about to run starts at cycle work + skipped. An instruction whose condition fails inside an IT block costs nothing
 * (Unicorn does not report it). Nothing happens to the machine before executed or work reaches deadline (execution.c);
 * whoever makes something due earlier sets deadline to 0.
 */
#ifndef GOLDFIELD_PROCESSOR_H
#define GOLDFIELD_PROCESSOR_H

#include <unicorn/unicorn.h>

#include "emulator/core_clock.h"
#include "emulator/cycles.h"
#include "emulator/machine_internal.h"
#include "emulator/mpu.h"
#include "emulator/nvic.h"

/* Fault status bits. */
#define CFSR_IACCVIOL    (1u << 0)
#define CFSR_DACCVIOL    (1u << 1)
#define CFSR_MUNSTKERR   (1u << 3)
#define CFSR_MSTKERR     (1u << 4)
#define CFSR_MMARVALID   (1u << 7)
#define CFSR_IBUSERR     (1u << 8)
#define CFSR_PRECISERR   (1u << 9)
#define CFSR_IMPRECISERR (1u << 10)
#define CFSR_UNSTKERR    (1u << 11)
#define CFSR_STKERR      (1u << 12)
#define CFSR_BFARVALID   (1u << 15)
#define CFSR_UNDEFINSTR  (1u << 16)
#define CFSR_INVSTATE    (1u << 17)
#define CFSR_INVPC       (1u << 18)
#define CFSR_NOCP        (1u << 19)
#define CFSR_UNALIGNED   (1u << 24)
#define CFSR_DIVBYZERO   (1u << 25)
#define HFSR_FORCED      (1u << 30)
#define HFSR_DEBUGEVT    (1u << 31)

#define CCR_UNALIGN_TRP (1u << 3)
#define CCR_DIV_0_TRP   (1u << 4)

#define PROBES  12u
#define HISTORY 8u /* Addresses kept of the last instructions; power of 2, more than 5 (the longest IT block). */

typedef struct {
    uint32_t control, reload, active_reload;
    bool counted;     /* COUNTFLAG. */
    uint32_t stopped; /* The count while the timer is not enabled. */
    uint64_t zero;    /* While enabled: the cycle at which it last was, or counts as having been, zero. */
    machine_event_t event;
} systick_t;

/* Registers of the private peripheral bus that keep a value, named as in the ARMv7-M manual. */
typedef struct {
    uint32_t vtor, scr, ccr, shcsr, cfsr, hfsr, dfsr, mmfar, bfar, afsr, cpacr, fpccr, fpcar, actlr, demcr, dwt_control;
    uint64_t dwt_origin;  /* Awake cycles at which CYCCNT was 0. */
    uint32_t dwt_stopped; /* CYCCNT while it does not run. */
    systick_t systick;
    mpu_t mpu;
} system_control_t;

/* A function whose instructions and cycles are counted. */
typedef struct {
    uint32_t entry;                 /* Its address, the Thumb bit clear. */
    uint64_t calls, total, largest; /* What emulator_probe_t (emulator.h) tells. */
    uint64_t cycles;                /* The same. */
    bool active;                    /* The function is running. */
    unsigned depth;                 /* Exceptions active at its entry. */
    uint32_t return_address, stack; /* LR and SP at its entry. */
    uint64_t start, excluded;       /* Counts at its entry: executed, and inside[depth]; */
    uint64_t work, work_excluded;   /* cpu_work(), and work_inside[depth]. */
} probe_t;

typedef struct {
    unsigned exception;  /* 0: there is no fault. */
    uint32_t cfsr, hfsr; /* Status bits to set. */
    uint32_t address;    /* Address for BFAR or MMFAR. */
    uint32_t pc;         /* Where the handler returns to. */
    uint8_t it_state;    /* ITSTATE there. */
    bool abandoned;      /* The instruction had no effect on the registers: they were these before it. */
    uint32_t registers[15];
    uint64_t floating[16]; /* d0 to d15. */
    uint8_t *memory;       /* Nor on what it would have written: it was this before; NULL: it wrote nothing. */
    uint8_t bytes[8];
    unsigned size;
} fault_t;

/* What the core must know of the flash (flash_wait.h). */
typedef struct {
    uint64_t closed_loads, closed_fetches; /* The pieces that Unicorn does not reach now. */
    uint32_t changed_from, changed_to;     /* Bytes that have changed; none if equal. */
    bool changed;    /* Its rules, or bytes that may be translated: seen to before the next run. */
    bool load_waits; /* The instruction at pc loads from the flash and met a closed piece. */
} flash_view_t;

typedef struct cpu cpu_t;
typedef struct upsets upsets_t; /* upsets.c */

typedef struct {
    cpu_t *cpu;
    uint32_t base;
} bus_window_t;

/* The addresses of RAM, from the first to the last of an area, at which the memory protection unit may forbid
 * something; none if last is 0. */
typedef struct {
    uint32_t first, last;
    uc_hook hook; /* 0: there is none. */
} closed_ram_t;

typedef enum { LEAVE_NOTHING, LEAVE_STOPPED, LEAVE_EXCEPTION } leave_t;

/* Numbers that Unicorn hands to an interrupt hook (qemu/target/arm/cpu.h). */
enum {
    UNICORN_SVC = 2,
    UNICORN_PREFETCH_ABORT = 3,
    UNICORN_DATA_ABORT = 4,
    UNICORN_BREAKPOINT = 7,
    UNICORN_EXCEPTION_EXIT = 8
};

struct cpu {
    /* What the code hook touches at each instruction. */
    uint64_t executed; /* Instructions. */
    uint64_t deadline; /* In instructions; where their costs differ, in units of work. */
    uint64_t work;     /* Where costs differ: that of all instructions, 2^-CYCLE_SHIFT cycles. */
    uint32_t history[HISTORY];
    cycles_t cycles;

    machine_t *machine;
    uc_engine *uc;
    core_clock_t clock;
    nvic_t nvic;
    system_control_t system;
    uint64_t skipped; /* Cycles without an instruction: asleep, or waiting for the flash, */
    uint64_t waited;  /* which alone are these. */
    int64_t until_ps; /* End of the present run. */
    flash_view_t flash;

    /* Between runs: where to go on. */
    uint32_t pc;
    uint8_t it_state;
    bool asleep, event_register, halted, sram_executable;
    bool forbidden;         /* It was the memory protection unit that forbade the access at bad_address. */
    bool rules_changed;     /* That unit's, or those of CCR: Unicorn follows before the next instruction. */
    bool alignment_watched; /* alignment_hook is there: CCR.UNALIGN_TRP is set. */
    fault_t fault; /* Found by an access or by the check before an instruction; taken before the next instruction. */

    /* Why Unicorn was left. */
    leave_t leave;
    uint32_t leave_exception;

    /* Where Unicorn was last entered, in which state, at which count. */
    uint32_t resume_pc;
    uint8_t resume_it_state;
    uint64_t resume_executed;

    uint64_t interrupts; /* Exceptions taken. */

    probe_t probes[PROBES];
    unsigned probe_count, probes_active;
    unsigned depth;     /* Exceptions active. */
    uint32_t stack_low; /* The lowest main stack pointer at an exception entry. */
    /* Count at the last exception from each depth, and instructions in exceptions from there. */
    uint64_t entered_at[NVIC_EXCEPTIONS], inside[NVIC_EXCEPTIONS];
    uint64_t work_at[NVIC_EXCEPTIONS], work_inside[NVIC_EXCEPTIONS];

    uint32_t bad_address;     /* Address of the access that Unicorn could not do. */
    uint32_t access_cost;     /* What the accesses of the last instruction that made some have cost. */
    uint64_t access_executed; /* Count at the last peripheral access: several by one instruction are looked at. */

    bus_window_t windows[3];
    unsigned pages_asked;       /* Pages that Unicorn asked about since its table of them was widened. */
    closed_ram_t closed_ram[2]; /* The SRAM's, and that of the core-coupled memory. */
    uc_hook code_hook, interrupt_hook, memory_hooks[3], page_hook, alignment_hook, probe_hooks[PROBES];
    upsets_t *upsets; /* NULL: nobody has asked for any. */
    char *report;     /* Text of the last report (emulator.c). */
};

/* A register by Unicorn's name (UC_ARM_REG_...), as of now. A call into Unicorn: tens of nanoseconds. */
uint32_t cpu_register(const cpu_t *cpu, int unicorn_register);
void cpu_set_register(cpu_t *cpu, int unicorn_register, uint32_t value);

/* Stop the board for good, and record the reason as a violation. */
void cpu_halt(cpu_t *cpu, const char *reason);

/* What the instructions so far have cost, 2^-CYCLE_SHIFT cycles. */
static inline uint64_t cpu_work(const cpu_t *cpu) {
    return cpu->cycles.table != NULL ? cpu->work : cpu->executed * cpu->cycles.instruction;
}

/* The cycle at which the instruction about to run starts. */
static inline uint64_t cpu_cycle(const cpu_t *cpu) {
    return (cpu_work(cpu) >> CYCLE_SHIFT) + cpu->skipped;
}

/* The awake cycles before the instruction that runs, and the cycle at which it started: its accesses are there. */
uint64_t cpu_awake_cycle(cpu_t *cpu);
static inline uint64_t cpu_access_cycle(cpu_t *cpu) {
    return cpu_awake_cycle(cpu) + cpu->skipped;
}

#endif
