/* tim.h: between the parts of the timers' model (RM0090 chapters 17 to 20).
 *
 *     tim.c            registers, interrupts, DMA requests
 *     tim_counter.c    the counter, its updates, the next moment that somebody observes
 *     tim_channels.c   compare and capture
 *     tim_outputs.c    what the channels drive pins and converters' triggers with; dead time
 *     tim_break.c      main output enable, break, locked bits
 *     tim_slave.c      TRGO: timers that trigger converters and one another
 *     tim_registers.c  register tables and pins
 */
#ifndef GOLDFIELD_TIM_H
#define GOLDFIELD_TIM_H

#include "emulator/peripherals/model.h"

enum {
    TIM_CR1 = 0x00,
    TIM_CR2 = 0x04,
    TIM_SMCR = 0x08,
    TIM_DIER = 0x0C,
    TIM_SR = 0x10,
    TIM_EGR = 0x14,
    TIM_CCMR1 = 0x18,
    TIM_CCMR2 = 0x1C,
    TIM_CCER = 0x20,
    TIM_CNT = 0x24,
    TIM_PSC = 0x28,
    TIM_ARR = 0x2C,
    TIM_RCR = 0x30,
    TIM_CCR1 = 0x34,
    TIM_BDTR = 0x44,
    TIM_DCR = 0x48,
    TIM_DMAR = 0x4C,
    TIM_OR = 0x50
};

/* TIM_CR1 */
#define CEN  1u
#define UDIS 2u
#define URS  4u
#define OPM  8u
#define ARPE 0x80u
#define CCDS 8u /* TIM_CR2: compare and capture requests go out at the update. */
/* TIM_SR */
#define UIF   1u
#define COMIF 0x20u
#define TIF   0x40u
#define BIF   0x80u
/* TIM_CR2 */
#define CCPC 1u /* Modes and enables of channels with a complementary output act from the commutation event on. */
#define CCUS 4u /* A rising trigger is such an event, too. */
/* TIM_BDTR */
#define OSSI 0x0400u
#define OSSR 0x0800u
#define BKE  0x1000u
#define BKP  0x2000u
#define AOE  0x4000u
#define MOE  0x8000u

typedef struct {
    const char *name;
    uint32_t base;
    bus_t bus;
    const register_layout_t *registers;
    unsigned register_count, channels;
    bool advanced, wide;
    unsigned irq_update, irq_channels; /* Equal where one line serves all. */
    unsigned irq_trigger;              /* In use where the lines are separate: the advanced timers. */
    dma_source_t dma_update, dma_channel[4], dma_trigger;
    trigger_t first_channel_trigger, trgo;
    uint8_t master[4]; /* Timer number behind ITR0..3; 0: none. */
} tim_description_t;

/* The first two index the outputs of a channel. */
enum { TIM_PIN_CHANNEL, TIM_PIN_COMPLEMENT, TIM_PIN_BREAK };
typedef struct {
    uint8_t pin, timer, alternate, channel, role; /* The channel counts from 0; a break input has none. */
} tim_pin_t;

extern const tim_description_t tim_descriptions[TIM_COUNT];
extern const tim_pin_t tim_pins[];
extern const unsigned tim_pin_count;

struct tim {
    model_t model;
    const tim_description_t *what;
    const clock_domain_t *clock;
    bool running;
    int64_t base_tick, base_count; /* The counter has base_count at base_tick. */
    int64_t marked;                /* Counter values up to this one have been compared since the last overflow. */
    uint32_t prescaler, reload, compare[4], repetition; /* Active (shadow) values. */
    uint32_t modes[2], enables; /* CCMR1, CCMR2 and CCER as they act: with CCPC, later than they are written. */
    bool reference[4];          /* OCxREF. */
    pin_output_t output[4][2];  /* OCx, OCxN behind enables, polarity and dead time. */
    uint8_t wired[2];           /* Channels whose OCx, OCxN is the alternate function of a pin. */
    struct {
        tim_t *timer;
        unsigned channel;
        int64_t until_ps; /* Both outputs stay inactive until then. */
        machine_event_t end;
    } dead[4];
    bool breaking, broken, bdtr_written; /* The break input is active; a break took MOE, which is still off. */
    bool silent_trigger;                 /* The violation of a trigger that never comes was recorded. */
    uint16_t slaves;                     /* Timers that listen to its TRGO: bit 0 is TIM1. */
    machine_event_t event;               /* The next moment that somebody observes. */
    struct {
        tim_t *timer;
        unsigned input;
        bool raw, level; /* Level before and behind the filter. */
        machine_event_t filter;
    } input[4];
    uint8_t edges[4]; /* Captured edges that the prescaler has swallowed. */
    bool update_line, channel_line, trigger_line, break_line;
    unsigned burst_index;      /* Registers of the DMA burst that are done, */
    dma_source_t burst_source; /* and the request that it answers. */
};

static inline uint32_t tim_mode_bits(const tim_t *t, unsigned channel) {
    return field(t->modes[channel / 2], 8 * (channel % 2), 8);
}
static inline bool tim_is_capture(const tim_t *t, unsigned channel) {
    return (tim_mode_bits(t, channel) & 3u) != 0;
}
static inline unsigned tim_enable_bits(const tim_t *t, unsigned channel) {
    return field(t->enables, 4 * channel, 4);
}
static inline unsigned tim_compare_mode(const tim_t *t, unsigned channel) {
    return field(tim_mode_bits(t, channel), 4, 3);
}
/* Whether the outputs of an advanced timer are on; others have no such switch. */
static inline bool tim_outputs_on(const tim_t *t) {
    return !t->what->advanced || (t->model.value[TIM_BDTR / 4] & MOE) != 0;
}
static inline unsigned tim_master_mode(const tim_t *t) {
    return field(t->model.value[TIM_CR2 / 4], 4, 3);
}
/* 1 is TIM1. */
static inline unsigned tim_number(const tim_t *t) {
    return (unsigned)(t->what - tim_descriptions) + 1;
}
/* Clocks of a count. */
static inline int64_t tim_step(const tim_t *t) {
    return (int64_t)t->prescaler + 1;
}
static inline bool tim_counting(const tim_t *t) {
    return t->running && t->reload != 0;
}
static inline int64_t tim_now_tick(const tim_t *t) {
    return clock_tick(t->clock, machine_now(t->model.machine));
}
/* The counter at a tick not before the base. */
static inline int64_t tim_position(const tim_t *t, int64_t tick) {
    return tim_counting(t) && tick > t->base_tick ? t->base_count + (tick - t->base_tick) / tim_step(t) : t->base_count;
}

/* tim.c */
void tim_interrupt(tim_t *t); /* SR or DIER has changed. */
/* A request to DMA, if its bit of DIER is set. */
void tim_pulse_dma(tim_t *t, unsigned enable_bit, dma_source_t source);
/* A compare's or capture's request goes out now, or with CCDS at the next update. */
bool tim_asks_at_update(const tim_t *t);
void tim_channel_dma(tim_t *t, unsigned channel);
void tim_commutate(tim_t *t); /* The commutation event. */

/* tim_counter.c */
void tim_counter_init(tim_t *t);
void tim_advance(tim_t *t, int64_t tick); /* Catch up with everything up to and including tick. */
void tim_plan(tim_t *t);                  /* Schedule the next tick that somebody observes. */
void tim_start(tim_t *t, int64_t tick);
void tim_restart_counter(tim_t *t, int64_t tick); /* An update by software or a slave's reset. */
void tim_load(tim_t *t);                          /* Preloaded values become active. */
void tim_rebase(tim_t *t, int64_t tick); /* Before the counter's rule changes: its present value becomes the base, the
                                            prescaler's phase kept. */

/* tim_channels.c */
void tim_pin_edge(chip_t *chip, unsigned pin, bool level, int64_t time_ps); /* Listens to GPIO. */
void tim_channels_init(tim_t *t);
void tim_channels_restart(tim_t *t);
void tim_evaluate_reference(tim_t *t, unsigned channel, bool match, int64_t count, int64_t time_ps);
bool tim_channel_heard(const tim_t *t, unsigned channel); /* Whether a converter waits for this compare. */
/* CCMR1, CCMR2, CCER or CR2 was written, or a commutation event comes: what acts from now on. */
void tim_take_modes(tim_t *t, bool commutation);
void tim_compare_match(tim_t *t, unsigned channel, int64_t tick);
void tim_capture(tim_t *t, unsigned channel, int64_t time_ps);
void tim_write_channel_mode(tim_t *t, uint32_t offset, uint32_t value);

/* tim_outputs.c */
void tim_outputs_init(tim_t *t);
void tim_outputs_restart(tim_t *t);
/* OCxREF has changed: with both outputs of the channel on, the dead time begins. */
void tim_reference_changed(tim_t *t, unsigned channel, int64_t time_ps);
void tim_refresh_output(tim_t *t, unsigned channel, int64_t time_ps); /* Anything else that outputs follow from. */
void tim_outputs_idle(tim_t *t, int64_t time_ps);                     /* MOE has fallen. */
pin_output_t tim_pin_output(const chip_t *chip, unsigned pin, unsigned af);
void tim_pin_routing(chip_t *chip, bool done);

/* tim_break.c */
void tim_break_input(tim_t *t, int64_t time_ps);    /* The level of the break input may have changed. */
void tim_clock_failed(tim_t *t);                    /* A break that the clock security system asks for. */
void tim_break(tim_t *t, int64_t time_ps);          /* A break: MOE falls. */
void tim_update_enables(tim_t *t, int64_t time_ps); /* At an update: AOE. */
void tim_write_bdtr(tim_t *t, uint32_t value, int64_t time_ps);
/* A write with the bits put back that LOCK protects; changing one of them is a violation. */
uint32_t tim_unlocked(tim_t *t, uint32_t offset, uint32_t value);

/* tim_slave.c */
void tim_trgo(tim_t *t, bool rising, bool pulse, int64_t time_ps); /* TRGO rose or fell; a pulse does both at once. */
bool tim_trgo_heard(const tim_t *t);
void tim_connect_slaves(chip_t *chip); /* SMCR has changed. */
void tim_slave_trigger(tim_t *t, int64_t time_ps);

#endif
