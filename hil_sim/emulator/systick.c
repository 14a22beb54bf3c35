#include "emulator/systick.h"

#define SYSTICK_MASK       0x00FFFFFFu
#define SYSTICK_ENABLE     1u
#define SYSTICK_INTERRUPT  2u
#define SYSTICK_CORE_CLOCK 4u

static uint64_t divider(const systick_t *systick) {
    return (systick->control & SYSTICK_CORE_CLOCK) != 0 ? 1 : 8;
}

static uint32_t count_at(const cpu_t *cpu, uint64_t cycle) {
    const systick_t *const systick = &cpu->system.systick;
    if ((systick->control & SYSTICK_ENABLE) == 0 || cycle < systick->zero) {
        return (systick->control & SYSTICK_ENABLE) == 0 ? systick->stopped : 0;
    }
    const uint64_t modulus = (uint64_t)systick->active_reload + 1u;
    const uint64_t steps = (cycle - systick->zero) / divider(systick) % modulus;
    return steps == 0 ? 0 : (uint32_t)(modulus - steps);
}

static void schedule(cpu_t *cpu) {
    systick_t *const systick = &cpu->system.systick;
    if ((systick->control & SYSTICK_ENABLE) == 0 || systick->active_reload == 0) {
        machine_cancel(cpu->machine, &systick->event);
        return;
    }
    const uint64_t cycle = systick->zero + ((uint64_t)systick->active_reload + 1u) * divider(systick);
    machine_schedule(cpu->machine, &systick->event, core_clock_time(&cpu->clock, cycle));
}

static void fire(void *context, int64_t time_ps) {
    (void)time_ps;
    cpu_t *const cpu = context;
    systick_t *const systick = &cpu->system.systick;
    systick->zero += ((uint64_t)systick->active_reload + 1u) * divider(systick);
    systick->active_reload = systick->reload;
    systick->counted = true;
    if ((systick->control & SYSTICK_INTERRUPT) != 0) {
        nvic_pend(&cpu->nvic, EXCEPTION_SYSTICK);
    }
    schedule(cpu);
}

static void set_control(cpu_t *cpu, uint32_t control, uint64_t cycle) {
    systick_t *const systick = &cpu->system.systick;
    const uint32_t count = count_at(cpu, cycle);
    systick->control = control & 7u;
    systick->stopped = count;
    if (count == 0 || count > systick->active_reload) {
        systick->active_reload = systick->reload;
    }
    const uint64_t elapsed = count == 0 ? 0 : ((uint64_t)systick->active_reload + 1u - count) * divider(systick);
    systick->zero = cycle - elapsed;
    schedule(cpu);
}

bool systick_read(cpu_t *cpu, uint32_t address, uint64_t cycle, uint32_t *value) {
    systick_t *const systick = &cpu->system.systick;
    switch (address) {
    case 0xE000E010:
        *value = systick->control | (systick->counted ? 1u << 16 : 0);
        systick->counted = false;
        return true;
    case 0xE000E014:
        *value = systick->reload;
        return true;
    case 0xE000E018:
        *value = count_at(cpu, cycle);
        return true;
    case 0xE000E01C:
        *value = 0x4000493Eu;
        return true; /* RM0090, 12.1.3: 18750 ticks of HCLK/8 are 1 ms at 150 MHz; not exact (SKEW). */
    default:
        return false;
    }
}

bool systick_write(cpu_t *cpu, uint32_t address, uint64_t cycle, uint32_t value) {
    systick_t *const systick = &cpu->system.systick;
    switch (address) {
    case 0xE000E010:
        set_control(cpu, value, cycle);
        return true;
    case 0xE000E014:
        systick->reload = value & SYSTICK_MASK;
        if (count_at(cpu, cycle) == 0) {
            set_control(cpu, systick->control, cycle);
        }
        return true;
    case 0xE000E018: /* Any write clears the count, without an exception. */
        systick->counted = false;
        systick->stopped = 0;
        systick->active_reload = systick->reload;
        systick->zero = cycle;
        schedule(cpu);
        return true;
    case 0xE000E01C:
        return true;
    default:
        return false;
    }
}

void systick_create(cpu_t *cpu) {
    machine_event_init(&cpu->system.systick.event, fire, cpu);
}

void systick_clock_changed(cpu_t *cpu) {
    schedule(cpu);
}
