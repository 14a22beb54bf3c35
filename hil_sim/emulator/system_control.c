/* system_control.c: system control block, data watchpoint unit's cycle counter, and the identification registers at
 * 0xE0000000..0xE00FFFFF (ARMv7-M architecture reference manual B3, C1; PM0214; RM0090, 38 for DBGMCU). The trace
 * macrocell swallows what is written to it. */
#include "emulator/system_control.h"

#include "emulator/systick.h"

#define CPUID_M4          0x410FC241u
#define DEVICE_ID         0x6413u
#define DEFAULT_REVISION  0x1007u
#define AIRCR_KEY         0x05FAu
#define DEMCR_TRACE       (1u << 24)
#define FPCCR_ASPEN_LSPEN 0xC0000000u

/* ---- Cycle counter: counts while the core is awake (its clock stops in sleep when no debugger holds it). ---- */

static bool cycle_counter_runs(const system_control_t *system) {
    return (system->demcr & DEMCR_TRACE) != 0 && (system->dwt_control & 1u) != 0;
}

static uint64_t counted_cycles(cpu_t *cpu) {
    return cpu_awake_cycle(cpu) + cpu->waited;
}

static uint32_t cycle_counter(cpu_t *cpu) {
    const system_control_t *const system = &cpu->system;
    return cycle_counter_runs(system) ? (uint32_t)(counted_cycles(cpu) - system->dwt_origin) : system->dwt_stopped;
}

static void cycle_counter_set(cpu_t *cpu, uint32_t demcr, uint32_t dwt_control, uint32_t count) {
    cpu->system.demcr = demcr;
    cpu->system.dwt_control = dwt_control;
    cpu->system.dwt_stopped = count;
    cpu->system.dwt_origin = counted_cycles(cpu) - count;
}

/* ---- System control block ---- */

static uint32_t interrupt_control_state(const cpu_t *cpu) {
    const nvic_t *const nvic = &cpu->nvic;
    uint32_t value = cpu_register(cpu, UC_ARM_REG_IPSR) & 0x1FFu;
    value |= nvic_active_count(nvic) <= 1 ? 1u << 11 : 0;
    value |= (uint32_t)nvic->candidate << 12;
    for (unsigned exception = EXCEPTION_INTERRUPT; exception < NVIC_EXCEPTIONS; exception++) {
        value |= nvic_is_pending(nvic, exception) ? 1u << 22 : 0;
    }
    value |= nvic_is_pending(nvic, EXCEPTION_SYSTICK) ? 1u << 26 : 0;
    value |= nvic_is_pending(nvic, EXCEPTION_PENDSV) ? 1u << 28 : 0;
    value |= nvic_is_pending(nvic, EXCEPTION_NMI) ? 1u << 31 : 0;
    return value;
}

static void write_interrupt_control(nvic_t *nvic, uint32_t value) {
    static const struct {
        unsigned set, clear, exception;
    } actions[] = {{31, 32, EXCEPTION_NMI}, {28, 27, EXCEPTION_PENDSV}, {26, 25, EXCEPTION_SYSTICK}};
    for (unsigned i = 0; i < 3; i++) {
        if ((value >> actions[i].set & 1u) != 0) {
            nvic_pend(nvic, actions[i].exception);
        } else if (actions[i].clear < 32 && (value >> actions[i].clear & 1u) != 0) {
            nvic_unpend(nvic, actions[i].exception);
        }
    }
}

/* SHCSR: enable bits are stored; active and pending bits are the NVIC's. */
static const struct {
    unsigned bit;
    unsigned exception;
    bool pending;
} handler_state[] = {
    {0, EXCEPTION_MEMORY_FAULT, false}, {1, EXCEPTION_BUS_FAULT, false},    {3, EXCEPTION_USAGE_FAULT, false},
    {7, EXCEPTION_SVCALL, false},       {10, EXCEPTION_PENDSV, false},      {11, EXCEPTION_SYSTICK, false},
    {12, EXCEPTION_USAGE_FAULT, true},  {13, EXCEPTION_MEMORY_FAULT, true}, {14, EXCEPTION_BUS_FAULT, true},
    {15, EXCEPTION_SVCALL, true},
};

static uint32_t handler_control(const cpu_t *cpu) {
    uint32_t value = cpu->system.shcsr;
    for (unsigned i = 0; i < sizeof handler_state / sizeof handler_state[0]; i++) {
        const bool set = handler_state[i].pending ? nvic_is_pending(&cpu->nvic, handler_state[i].exception)
                                                  : nvic_is_active(&cpu->nvic, handler_state[i].exception);
        value |= set ? 1u << handler_state[i].bit : 0;
    }
    return value;
}

static void write_reset_control(cpu_t *cpu, uint32_t value) {
    if (value >> 16 != AIRCR_KEY) {
        machine_violation(cpu->machine, "AIRCR written without its key: 0x%08x", (unsigned)value);
        return;
    }
    nvic_set_priority_group(&cpu->nvic, value >> 8 & 7u);
    if ((value & 4u) != 0) {
        machine_reset_request(cpu->machine, 1u << 28); /* RCC_CSR.SFTRSTF */
    }
}

/* Where a register is kept that only holds what is written, and in *mask the bits that exist. NULL: it is not one of
 * these. */
static uint32_t *plain_register(cpu_t *cpu, uint32_t address, uint32_t *mask) {
    system_control_t *const system = &cpu->system;
    *mask = 0xFFFFFFFFu;
    switch (address) {
    case 0xE000E008:
        return &system->actlr;
    case 0xE000ED08:
        *mask = 0xFFFFFF80u;
        return &system->vtor;
    case 0xE000ED10:
        *mask = 0x16u;
        return &system->scr;
    case 0xE000ED14:
        *mask = 0x31Bu;
        return &system->ccr;
    case 0xE000ED34:
        return &system->mmfar;
    case 0xE000ED38:
        return &system->bfar;
    case 0xE000ED3C:
        return &system->afsr;
    case 0xE000ED88:
        *mask = 0x00F00000u;
        return &system->cpacr;
    case 0xE000EF34:
        *mask = FPCCR_ASPEN_LSPEN;
        return &system->fpccr;
    case 0xE000EF38:
        *mask = 0xFFFFFFF8u;
        return &system->fpcar;
    case 0xE0042004:
        *mask = 0x000000E7u;
        return &cpu->machine->debug_control[0];
    case 0xE0042008:
        *mask = 0x06E01DFFu;
        return &cpu->machine->debug_control[1];
    case 0xE004200C:
        *mask = 0x00070003u;
        return &cpu->machine->debug_control[2];
    default:
        return NULL;
    }
}

static bool constant(uint32_t address, uint32_t *value) {
    static const struct {
        uint32_t address, value;
    } constants[] = {
        {0xE000E004, 2},          {0xE000ED00, CPUID_M4},   {0xE000ED40, 0x00000030}, {0xE000ED44, 0x00000200},
        {0xE000ED48, 0x00100000}, {0xE000ED4C, 0},          {0xE000ED50, 0x00100030}, {0xE000ED54, 0},
        {0xE000ED58, 0x01000000}, {0xE000ED5C, 0},          {0xE000ED60, 0x01141110}, {0xE000ED64, 0x02112000},
        {0xE000ED68, 0x21232231}, {0xE000ED6C, 0x01111131}, {0xE000ED70, 0x01310132}, {0xE000EDF0, 0},
        {0xE000EF3C, 0},          {0xE000EF40, 0x10110021}, {0xE000EF44, 0x11000011},
    };
    for (unsigned i = 0; i < sizeof constants / sizeof constants[0]; i++) {
        if (constants[i].address == address) {
            *value = constants[i].value;
            return true;
        }
    }
    return false;
}

/* The instrumentation trace macrocell, the watchpoint unit's rest, the breakpoint unit, the trace port and the embedded
 * trace macrocell: no debugger is there to see them. */
static bool is_trace(uint32_t address) {
    return address < 0xE0003000u || (address >= 0xE0040000u && address < 0xE0042000u);
}

static bool word_read(cpu_t *cpu, uint32_t address, uint32_t *value) {
    uint32_t mask;
    const uint32_t *const plain = plain_register(cpu, address, &mask);
    if (plain != NULL) {
        *value = *plain;
        return true;
    }
    switch (address) {
    case 0xE000ED04:
        *value = interrupt_control_state(cpu);
        return true;
    case 0xE000ED0C:
        *value = 0xFA050000u | cpu->nvic.priority_group << 8;
        return true;
    case 0xE000ED24:
        *value = handler_control(cpu);
        return true;
    case 0xE000ED28:
        *value = cpu->system.cfsr;
        return true;
    case 0xE000ED2C:
        *value = cpu->system.hfsr;
        return true;
    case 0xE000ED30:
        *value = cpu->system.dfsr;
        return true;
    case 0xE000EDFC:
        *value = cpu->system.demcr;
        return true;
    case 0xE0042000: {
        const uint32_t revision = cpu->machine->config.revision;
        *value = (revision != 0 ? revision : DEFAULT_REVISION) << 16 | DEVICE_ID;
        return true;
    }
    case 0xE0001000:
        *value = 0x40000000u | cpu->system.dwt_control;
        return true;
    case 0xE0001004:
        *value = cycle_counter(cpu);
        return true;
    default:
        break;
    }
    if (constant(address, value) || mpu_read(&cpu->system.mpu, address, value)) {
        return true;
    }
    *value = 0;
    return is_trace(address);
}

static bool word_write(cpu_t *cpu, uint32_t address, uint32_t value) {
    system_control_t *const system = &cpu->system;
    uint32_t mask;
    uint32_t *const plain = plain_register(cpu, address, &mask);
    if (plain != NULL) {
        *plain = value & mask;
        if (address == 0xE000EF34 && (value & 1u << 31) == 0) {
            machine_violation(cpu->machine,
                              "FPCCR.ASPEN cleared: this emulator always stacks an active floating-point context");
        }
        if (address == 0xE000ED14) {
            cpu->rules_changed = true;
        }
        return true;
    }
    switch (address) {
    case 0xE000ED04:
        write_interrupt_control(&cpu->nvic, value);
        return true;
    case 0xE000ED0C:
        write_reset_control(cpu, value);
        return true;
    case 0xE000ED24:
        system->shcsr = value & 0x00070000u;
        return true;
    case 0xE000ED28:
        system->cfsr &= ~value;
        return true;
    case 0xE000ED2C:
        system->hfsr &= ~value;
        return true;
    case 0xE000ED30:
        system->dfsr &= ~value;
        return true;
    case 0xE000EDFC:
        cycle_counter_set(cpu, value, system->dwt_control, cycle_counter(cpu));
        return true;
    case 0xE0001000:
        cycle_counter_set(cpu, system->demcr, value & 0x0FFFFFFFu, cycle_counter(cpu));
        return true;
    case 0xE0001004:
        cycle_counter_set(cpu, system->demcr, system->dwt_control, value);
        return true;
    case 0xE000EF3C:
        if (value != 0) {
            machine_violation(cpu->machine, "FPDSCR is not modelled: 0x%08x written", (unsigned)value);
        }
        return true;
    default:
        break;
    }
    bool changed = false;
    if (mpu_write(&system->mpu, address, value, &changed)) {
        cpu->rules_changed = cpu->rules_changed || changed;
        return true;
    }
    uint32_t ignored;
    return constant(address, &ignored) || is_trace(address) || address == 0xE0042000u;
}

static bool is_handler_priority(uint32_t address) {
    return address >= 0xE000ED18u && address < 0xE000ED24u;
}

bool system_control_read(cpu_t *cpu, uint32_t address, unsigned width, uint32_t *value) {
    *value = 0;
    if (is_handler_priority(address)) {
        for (unsigned i = 0; i < width; i++) {
            *value |= (uint32_t)cpu->nvic.priority[4u + address - 0xE000ED18u + i] << (8u * i);
        }
        return true;
    }
    if (address >= 0xE000E100u && address < 0xE000E4F0u) {
        return nvic_read(&cpu->nvic, address, width, value);
    }
    if ((address & 3u) != 0 || width != 4) {
        return is_trace(address) ||
               (address >= 0xE000ED28u && address < 0xE000ED2Cu && word_read(cpu, address & ~3u, value) &&
                (*value = *value >> (8u * (address & 3u)) & (width == 1 ? 0xFFu : 0xFFFFu), true));
    }
    return systick_read(cpu, address, cpu_access_cycle(cpu), value) || word_read(cpu, address, value);
}

bool system_control_write(cpu_t *cpu, uint32_t address, unsigned width, uint32_t value) {
    cpu->deadline = 0; /* Nearly every register here decides on what runs next. */
    if (is_handler_priority(address)) {
        for (unsigned i = 0; i < width; i++) {
            nvic_set_priority(&cpu->nvic, 4u + address - 0xE000ED18u + i, (uint8_t)(value >> (8u * i)));
        }
        return true;
    }
    if ((address >= 0xE000E100u && address < 0xE000E4F0u) || address == 0xE000EF00u) {
        return nvic_write(&cpu->nvic, address, width, value);
    }
    if ((address & 3u) != 0 || width != 4) {
        return is_trace(address) || (address >= 0xE000ED28u && address < 0xE000ED2Cu &&
                                     word_write(cpu, address & ~3u, value << (8u * (address & 3u))));
    }
    return systick_write(cpu, address, cpu_access_cycle(cpu), value) || word_write(cpu, address, value);
}

void system_control_reset(cpu_t *cpu) {
    machine_cancel(cpu->machine, &cpu->system.systick.event);
    cpu->rules_changed = true;
    cpu->system = (system_control_t){.mpu.applied = cpu->system.mpu.applied, .ccr = 0x200u, .fpccr = FPCCR_ASPEN_LSPEN};
    systick_create(cpu);
}
