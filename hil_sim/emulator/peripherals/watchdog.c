/* watchdog.c: the independent watchdog (RM0090 21.4), the window watchdog (RM0090 22.6), and what a debugger that has
 * halted the core does to them (RM0090 38.16.2): the counter stands still if DBGMCU_APB1_FZ says so. */
#include "emulator/peripherals/model.h"

#include <math.h>

enum { KR = 0x00, PR = 0x04, RLR = 0x08, SR = 0x0C };
enum { CR = 0x00, CFR = 0x04, WSR = 0x08 };
#define PVU           1u
#define RVU           2u
#define IWDGRSTF      (1u << 29)
#define WWDGRSTF      (1u << 30)
#define UPDATE_CYCLES 5 /* Periods of the 32 kHz clock. */

static const register_layout_t iwdg_registers[] = {{"KR", KR, 0, 0xFFFF, ACCESS_WO},
                                                   {"PR", PR, 0, 0x7, ACCESS_RW},
                                                   {"RLR", RLR, 0xFFF, 0xFFF, ACCESS_RW},
                                                   {"SR", SR, 0, 0x3, ACCESS_RO}};
static const register_layout_t wwdg_registers[] = {
    {"CR", CR, 0x7F, 0xFF, ACCESS_RW}, {"CFR", CFR, 0x7F, 0x3FF, ACCESS_RW}, {"SR", WSR, 0, 0x1, ACCESS_RC_W0}};

/* What DBGMCU_APB1_FZ can freeze, by bit (RM0090 38.16.4); the rest of both registers freezes timers and buses. */
#define FREEZE_WWDG 11u
#define FREEZE_IWDG 12u

typedef struct {
    model_t model;
    bool running, unlocked;
    int64_t left_ps;            /* While a debugger has it stand still: what it had to go; else -1. */
    uint32_t prescaler, reload; /* In the 32 kHz domain, after PVU and RVU have fallen. */
    machine_event_t expiry, prescaler_update, reload_update;
} iwdg_t;

typedef struct {
    model_t model;
    int64_t base_tick;   /* Tick of PCLK1 at which the counter had the stored value. */
    int64_t frozen_tick; /* The one at which a debugger made it stand still; else -1. */
    machine_event_t early, expiry;
} wwdg_t;

/* ---- Independent watchdog ---- */

static void refresh(iwdg_t *w) {
    if (w->running) {
        const unsigned divider = 4u << (w->prescaler > 6 ? 6 : w->prescaler);
        const double seconds = (double)divider * (w->reload + 1) / rcc_lsi_hz(w->model.chip);
        machine_schedule(w->model.machine, &w->expiry, machine_now(w->model.machine) + llround(seconds * 1e12));
    }
}

static void iwdg_expired(void *context, int64_t time_ps) {
    iwdg_t *const w = context;
    (void)time_ps;
    machine_reset_request(w->model.machine, IWDGRSTF);
}

static void prescaler_updated(void *context, int64_t time_ps) {
    iwdg_t *const w = context;
    (void)time_ps;
    w->prescaler = reg(&w->model, PR);
    w->model.value[SR / 4] &= ~PVU;
    refresh(w); /* The present count is not known to a digit; a running down-counter is restarted. */
}

static void reload_updated(void *context, int64_t time_ps) {
    iwdg_t *const w = context;
    (void)time_ps;
    w->reload = reg(&w->model, RLR);
    w->model.value[SR / 4] &= ~RVU;
}

static void iwdg_set(model_t *model, uint32_t offset, uint32_t value) {
    iwdg_t *const w = (iwdg_t *)model;
    const int64_t later = machine_now(model->machine) + llround(UPDATE_CYCLES * 1e12 / rcc_lsi_hz(model->chip));
    if (offset == KR) {
        w->unlocked = value == 0x5555u;
        if (value == 0xCCCCu) {
            rcc_force_lsi(model->chip);
            w->running = true;
            refresh(w);
        } else if (value == 0xAAAAu) {
            refresh(w);
        } else if (value != 0x5555u) {
            machine_violation(model->machine, "IWDG_KR: 0x%04X is no key", (unsigned)value);
        }
        return;
    }
    const uint32_t busy = offset == PR ? PVU : RVU;
    if (!w->unlocked || (reg(model, SR) & busy) != 0) {
        machine_violation(model->machine, "IWDG_%s: written %s", offset == PR ? "PR" : "RLR",
                          w->unlocked ? "while the update before is under way (SR)" : "without the key 0x5555");
        return;
    }
    model->value[offset / 4] = value;
    model->value[SR / 4] |= busy;
    machine_schedule(model->machine, offset == PR ? &w->prescaler_update : &w->reload_update, later);
}

static void iwdg_freeze(iwdg_t *w, bool frozen) {
    machine_t *const machine = w->model.machine;
    if (frozen && w->running && w->left_ps < 0) {
        w->left_ps = w->expiry.time_ps - machine_now(machine);
        machine_cancel(machine, &w->expiry);
    } else if (!frozen && w->left_ps >= 0) {
        machine_schedule(machine, &w->expiry, machine_now(machine) + w->left_ps);
        w->left_ps = -1;
    }
}

static void iwdg_restart(model_t *model) {
    iwdg_t *const w = (iwdg_t *)model;
    w->left_ps = -1;
    machine_cancel(model->machine, &w->expiry);
    machine_cancel(model->machine, &w->prescaler_update);
    machine_cancel(model->machine, &w->reload_update);
    w->running = w->unlocked = false;
    w->prescaler = 0;
    w->reload = 0xFFF;
    if (flash_hardware_watchdog(model->chip)) {
        rcc_force_lsi(model->chip);
        w->running = true;
        refresh(w);
    }
}

/* ---- Window watchdog ---- */

static int64_t wwdg_step(const wwdg_t *w) {
    return (int64_t)4096 << field(reg(&w->model, CFR), 7, 2);
}

static uint32_t wwdg_count(const wwdg_t *w) {
    const clock_domain_t *const clock = &w->model.chip->pclk1;
    const int64_t steps = (clock_tick(clock, machine_now(w->model.machine)) - w->base_tick) / wwdg_step(w);
    return (uint32_t)((int64_t)(reg(&w->model, CR) & 0x7Fu) - steps) & 0x7Fu;
}

static void wwdg_plan(wwdg_t *w) {
    const clock_domain_t *const clock = &w->model.chip->pclk1;
    const int64_t to_40 = (int64_t)(reg(&w->model, CR) & 0x7Fu) - 0x40;
    if ((reg(&w->model, CR) & 0x80u) != 0) {
        machine_schedule(w->model.machine, &w->early, clock_time(clock, w->base_tick + to_40 * wwdg_step(w)));
        machine_schedule(w->model.machine, &w->expiry, clock_time(clock, w->base_tick + (to_40 + 1) * wwdg_step(w)));
    }
}

static void wwdg_interrupt(wwdg_t *w) {
    machine_irq(w->model.machine, 0, (reg(&w->model, WSR) & 1u) != 0 && (reg(&w->model, CFR) & 0x200u) != 0);
}

static void wwdg_early(void *context, int64_t time_ps) {
    wwdg_t *const w = context;
    (void)time_ps;
    w->model.value[WSR / 4] |= 1u;
    wwdg_interrupt(w);
}

static void wwdg_expired(void *context, int64_t time_ps) {
    wwdg_t *const w = context;
    (void)time_ps;
    machine_reset_request(w->model.machine, WWDGRSTF);
}

static void wwdg_set(model_t *model, uint32_t offset, uint32_t value) {
    wwdg_t *const w = (wwdg_t *)model;
    const bool active = (reg(model, CR) & 0x80u) != 0;
    if (offset == CR) {
        const bool too_early = active && wwdg_count(w) > (reg(model, CFR) & 0x7Fu);
        if (too_early || ((value | (active ? 0x80u : 0)) & 0xC0u) == 0x80u) {
            machine_reset_request(model->machine, WWDGRSTF);
        }
        model->value[CR / 4] = value | (active ? 0x80u : 0);
        w->base_tick = clock_tick(&model->chip->pclk1, machine_now(model->machine));
        wwdg_plan(w);
    } else if (offset == WSR) {
        model->value[WSR / 4] &= value;
    } else {
        model->value[CFR / 4] = value | (reg(model, CFR) & 0x200u); /* EWI is cleared only by reset. */
    }
    wwdg_interrupt(w);
}

static uint32_t wwdg_get(model_t *model, uint32_t offset) {
    wwdg_t *const w = (wwdg_t *)model;
    return offset == CR && (reg(model, CR) & 0x80u) != 0 ? 0x80u | wwdg_count(w) : reg(model, offset);
}

static void wwdg_freeze(wwdg_t *w, bool frozen) {
    machine_t *const machine = w->model.machine;
    const int64_t tick = clock_tick(&w->model.chip->pclk1, machine_now(machine));
    if (frozen && w->frozen_tick < 0) {
        w->frozen_tick = tick;
        machine_cancel(machine, &w->early);
        machine_cancel(machine, &w->expiry);
    } else if (!frozen && w->frozen_tick >= 0) {
        w->base_tick += tick - w->frozen_tick;
        w->frozen_tick = -1;
        wwdg_plan(w);
    }
}

static void wwdg_restart(model_t *model) {
    wwdg_t *const w = (wwdg_t *)model;
    w->frozen_tick = -1;
    machine_cancel(model->machine, &w->early);
    machine_cancel(model->machine, &w->expiry);
    wwdg_interrupt(w);
}

/* ---- A debugger ---- */

void debug_halt_in(machine_t *machine, bool halted) {
    const chip_t *const chip = chip_of(machine);
    machine_debug_halt(machine, halted);
    for (unsigned bit = 0; bit < 32; bit++) {
        if (bit != FREEZE_WWDG && bit != FREEZE_IWDG && machine_debug_frozen(machine, 1, bit)) {
            machine_violation(machine, "DBGMCU_APB1_FZ: this model does not freeze what bit %u stands for", bit);
        }
        if (machine_debug_frozen(machine, 2, bit)) {
            machine_violation(machine, "DBGMCU_APB2_FZ: this model does not freeze what bit %u stands for", bit);
        }
    }
    iwdg_freeze((iwdg_t *)chip_model(chip, "IWDG"), machine_debug_frozen(machine, 1, FREEZE_IWDG));
    wwdg_freeze((wwdg_t *)chip_model(chip, "WWDG"), machine_debug_frozen(machine, 1, FREEZE_WWDG));
}

void watchdog_create(chip_t *chip) {
    static const model_description_t iwdg_description = {.name = "IWDG",
                                                         .base = 0x40003000,
                                                         .size = 0x400,
                                                         .bus = BUS_APB1,
                                                         .read_widths = WIDTH_16 | WIDTH_32,
                                                         .write_widths = WIDTH_16 | WIDTH_32,
                                                         .registers = iwdg_registers,
                                                         .register_count = 4,
                                                         .set = iwdg_set,
                                                         .restart = iwdg_restart};
    static const model_description_t wwdg_description = {.name = "WWDG",
                                                         .base = 0x40002C00,
                                                         .size = 0x400,
                                                         .bus = BUS_APB1,
                                                         .read_widths = WIDTH_16 | WIDTH_32,
                                                         .write_widths = WIDTH_16 | WIDTH_32,
                                                         .registers = wwdg_registers,
                                                         .register_count = 3,
                                                         .get = wwdg_get,
                                                         .set = wwdg_set,
                                                         .restart = wwdg_restart};
    iwdg_t *const iwdg = chip_allocate(chip, sizeof *iwdg);
    machine_event_init(&iwdg->expiry, iwdg_expired, iwdg);
    machine_event_init(&iwdg->prescaler_update, prescaler_updated, iwdg);
    machine_event_init(&iwdg->reload_update, reload_updated, iwdg);
    iwdg->left_ps = -1;
    model_attach(chip, &iwdg->model, &iwdg_description);
    wwdg_t *const wwdg = chip_allocate(chip, sizeof *wwdg);
    machine_event_init(&wwdg->early, wwdg_early, wwdg);
    machine_event_init(&wwdg->expiry, wwdg_expired, wwdg);
    wwdg->frozen_tick = -1;
    model_attach(chip, &wwdg->model, &wwdg_description);
}
