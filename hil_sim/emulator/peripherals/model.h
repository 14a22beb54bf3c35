/* model.h: what the peripheral models of one chip share: register tables with their rules, clock domains, and signals
 * between models.
 *
 * A model's create function takes memory (chip_allocate), fills in a description and attaches (model_attach); from then
 * on its set, get and restart functions are called. A model that must know a lower one calls it (the end of this file
 * lists the functions by file); a model that only sends, whoever listens, uses chip_t.signals. So models call each
 * other in one direction only: RCC and the watchdogs above the timers, those and the converters above DMA, DMA and the
 * links above the pins.
 *
 * A model is a struct whose first member is model_t. Its register table holds, for each register, the offset, the reset
 * value and the bits that RM0090 defines; everything else is reserved. model.c applies the rules that hold for every
 * register, and only then calls the model:
 *   - the peripheral's clock must be on, and on for the delay that the errata sheet (ES0182, 2.1.6) asks for;
 *   - the width must be one that the peripheral supports; an APB access narrower than a word is duplicated over the
 *     word by the bridge;
 *   - reserved bits must be written with their reset value; a read-only register must not be written.
 * What a model does not do is loud too: model_missing().
 */
#ifndef GOLDFIELD_MODEL_H
#define GOLDFIELD_MODEL_H

#include "emulator/machine.h"
#include "emulator/peripherals/registers.h"

typedef struct chip chip_t;
typedef struct model model_t;

/* Widths that a peripheral takes: a sum of bytes. */
enum { WIDTH_8 = 1, WIDTH_16 = 2, WIDTH_32 = 4, WIDTH_ANY = 7 };
typedef enum { BUS_AHB, BUS_APB1, BUS_APB2, BUS_CORE } bus_t;

enum { MODEL_WORDS = 256 };

typedef struct {
    const char *name;
    uint32_t base, size;
    bus_t bus;
    unsigned read_widths, write_widths;
    const register_layout_t *registers;
    unsigned register_count;
    /* The value of the word at an offset; NULL: the stored value. */
    uint32_t (*get)(model_t *model, uint32_t offset);
    /* A write; value is the whole word that it makes. */
    void (*set)(model_t *model, uint32_t offset, uint32_t value);
    /* The stored values went back to reset. May be NULL. */
    void (*restart)(model_t *model);
} model_description_t;

struct model {
    peripheral_t peripheral; /* First: a peripheral_t of ours is a model_t. */
    const model_description_t *description;
    chip_t *chip;
    machine_t *machine;
    uint32_t value[MODEL_WORDS];
    uint8_t slot[MODEL_WORDS]; /* Index in the register table plus 1, by word. */
    bool clocked, in_reset;    /* Clock and reset as RCC has them. */
    bool settling;             /* Its clock was enabled, and nobody has accessed it since. */
    int64_t settled_ps;        /* The time from which on an access is allowed. */
};

static inline uint32_t reg(const model_t *model, uint32_t offset) {
    return model->value[offset / 4];
}
static inline uint32_t field(uint32_t value, unsigned shift, unsigned width) {
    return (value >> shift) & ((1u << width) - 1u);
}

/* ---- Clock domains: exact tick times. Tick n is at anchor + (n - anchor_tick) * period. ---- */
typedef struct {
    double hz, period_ps; /* Frequency and period as they are, crystal error included. */
    double nominal_hz;    /* Frequency with perfect oscillators. */
    int64_t anchor_ps, anchor_tick;
} clock_domain_t;
/* The first picosecond of a tick, and the tick that a time lies in. What they round fits into an integer, and so needs
 * no call of ceil() or floor(). */
static inline int64_t clock_time(const clock_domain_t *domain, int64_t tick) {
    const double since_ps = (double)(tick - domain->anchor_tick) * domain->period_ps;
    const int64_t below_ps = (int64_t)since_ps;
    return domain->anchor_ps + below_ps + ((double)below_ps < since_ps ? 1 : 0);
}
static inline int64_t clock_tick(const clock_domain_t *domain, int64_t time_ps) {
    int64_t tick = domain->anchor_tick + (int64_t)((double)(time_ps - domain->anchor_ps) / domain->period_ps);
    while (clock_time(domain, tick) > time_ps) {
        tick--;
    }
    while (clock_time(domain, tick + 1) <= time_ps) {
        tick++;
    }
    return tick;
}

typedef struct rcc rcc_t;
typedef struct gpio gpio_t;
typedef struct exti exti_t;
typedef struct dma dma_t;
typedef struct tim tim_t;
typedef struct adc adc_t;
typedef struct usart usart_t;
typedef struct can can_t;

/* ---- Request lines to the DMA controllers ---- */
typedef enum {
    DMA_NONE,
    DMA_ADC1,
    DMA_ADC2,
    DMA_ADC3,
    DMA_DAC1,
    DMA_DAC2,
    DMA_TIM1_UP,
    DMA_TIM1_CH1,
    DMA_TIM1_CH2,
    DMA_TIM1_CH3,
    DMA_TIM1_CH4,
    DMA_TIM1_TRIG,
    DMA_TIM1_COM,
    DMA_TIM8_UP,
    DMA_TIM8_CH1,
    DMA_TIM8_CH2,
    DMA_TIM8_CH3,
    DMA_TIM8_CH4,
    DMA_TIM8_TRIG,
    DMA_TIM8_COM,
    DMA_TIM2_UP,
    DMA_TIM2_CH1,
    DMA_TIM2_CH2,
    DMA_TIM2_CH3,
    DMA_TIM2_CH4,
    DMA_TIM3_UP,
    DMA_TIM3_CH1,
    DMA_TIM3_CH2,
    DMA_TIM3_CH3,
    DMA_TIM3_CH4,
    DMA_TIM3_TRIG,
    DMA_TIM4_UP,
    DMA_TIM4_CH1,
    DMA_TIM4_CH2,
    DMA_TIM4_CH3,
    DMA_TIM5_UP,
    DMA_TIM5_CH1,
    DMA_TIM5_CH2,
    DMA_TIM5_CH3,
    DMA_TIM5_CH4,
    DMA_TIM5_TRIG,
    DMA_TIM6_UP,
    DMA_TIM7_UP,
    DMA_USART1_RX,
    DMA_USART1_TX,
    DMA_USART2_RX,
    DMA_USART2_TX,
    DMA_USART3_RX,
    DMA_USART3_TX,
    DMA_UART4_RX,
    DMA_UART4_TX,
    DMA_UART5_RX,
    DMA_UART5_TX,
    DMA_USART6_RX,
    DMA_USART6_TX,
    DMA_OTHER, /* A line of a peripheral that has no model: SPI, I2C, I2S, SDIO, DCMI, CRYP, HASH. */
    DMA_SOURCES
} dma_source_t;

typedef struct {
    bool high[DMA_SOURCES];
    bool pulse[DMA_SOURCES];                /* Falls when served. */
    struct dma_stream *stream[DMA_SOURCES]; /* The enabled stream that listens, or NULL. */
    dma_source_t served;                    /* The request that an item is being moved for, else DMA_NONE. */
} dma_lines_t;

/* ---- Signals that start conversions ---- */
typedef enum {
    TRIGGER_TIM1_CC1,
    TRIGGER_TIM1_CC2,
    TRIGGER_TIM1_CC3,
    TRIGGER_TIM1_CC4,
    TRIGGER_TIM1_TRGO,
    TRIGGER_TIM2_CC1,
    TRIGGER_TIM2_CC2,
    TRIGGER_TIM2_CC3,
    TRIGGER_TIM2_CC4,
    TRIGGER_TIM2_TRGO,
    TRIGGER_TIM3_CC1,
    TRIGGER_TIM3_CC2,
    TRIGGER_TIM3_CC3,
    TRIGGER_TIM3_CC4,
    TRIGGER_TIM3_TRGO,
    TRIGGER_TIM4_CC1,
    TRIGGER_TIM4_CC2,
    TRIGGER_TIM4_CC3,
    TRIGGER_TIM4_CC4,
    TRIGGER_TIM4_TRGO,
    TRIGGER_TIM5_CC1,
    TRIGGER_TIM5_CC2,
    TRIGGER_TIM5_CC3,
    TRIGGER_TIM5_CC4,
    TRIGGER_TIM5_TRGO,
    TRIGGER_TIM8_CC1,
    TRIGGER_TIM8_CC2,
    TRIGGER_TIM8_CC3,
    TRIGGER_TIM8_CC4,
    TRIGGER_TIM8_TRGO,
    TRIGGER_TIM6_TRGO,
    TRIGGER_TIM7_TRGO,
    TRIGGER_EXTI9,
    TRIGGER_EXTI11,
    TRIGGER_EXTI15,
    TRIGGER_COUNT,
    TRIGGER_NONE
} trigger_t;

/* ---- Signals from models that do not know who listens. Each listener enters itself when it is created. ---- */
enum { CHIP_PIN_LISTENERS = 2 };
/* What a peripheral's output does to a pin. OUTPUT_UNSEEN: it has no model, or its bytes and frames have edges of their
 * own. */
typedef enum { OUTPUT_OFF, OUTPUT_LOW, OUTPUT_HIGH, OUTPUT_UNSEEN } pin_output_t;
typedef void (*pin_edge_t)(chip_t *chip, unsigned pin, bool level, int64_t time_ps);
typedef struct {
    pin_edge_t pin_edge[CHIP_PIN_LISTENERS]; /* GPIO: a pin's level changed. EXTI, then the timers. */
    /* GPIO: what the alternate function af drives a pin to. The timers. */
    pin_output_t (*pin_output)(const chip_t *chip, unsigned pin, unsigned af);
    /* GPIO: modes or alternate functions of pins are about to change (done is false), or have changed. The timers. */
    void (*pin_routing)(chip_t *chip, bool done);
    /* RCC: HCLK, PLL48CLK or the clock enables may have changed. The random number generator. */
    void (*clocks_changed)(chip_t *chip);
    /* RCC: the clock security system found the crystal dead. TIM1 and TIM8, whose second source of a break it is. */
    void (*clock_failed)(chip_t *chip);
    /* A timer or EXTI: an edge of a trigger of the analog-to-digital converters. */
    void (*convert)(chip_t *chip, trigger_t trigger, bool rising, int64_t time_ps);
    /* A timer or EXTI: a rising edge of a trigger of the digital-to-analog converter. */
    void (*output)(chip_t *chip, trigger_t trigger, int64_t time_ps);
    /* DMA: the last transfer that a line asked for (NDTR became 0). The analog-to-digital converters. */
    void (*last_transfer)(chip_t *chip, dma_source_t source);
    /* The flash: somebody asked for the supply to change in one of its steps. PWR. */
    void (*supply)(chip_t *chip, double volts);
} chip_signals_t;

enum { TIM_COUNT = 14, USART_COUNT = 6, GPIO_COUNT = 9 };

struct chip {
    machine_t *machine;
    const emulator_config_t *config;
    const board_edge_t *edge;
    clock_domain_t hclk, pclk1, pclk2, timer1, timer2; /* timer1: timers on APB1. */
    rcc_t *rcc;
    gpio_t *gpio;
    exti_t *exti;
    dma_t *dma[2];
    tim_t *tim[TIM_COUNT]; /* TIM1 first. */
    adc_t *adc;
    model_t *pwr, *flash, *dac;
    double supply_V; /* The chip's supply, which its converters refer to. */
    usart_t *usart[USART_COUNT];
    can_t *can[2];
    dma_lines_t lines;
    chip_signals_t signals;
    bool trigger_heard[TRIGGER_COUNT];  /* An analog-to-digital converter listens: the timer must make events. */
    bool trigger_wanted[TRIGGER_COUNT]; /* The same for the digital-to-analog converter. */
    uint8_t shared_irq[82];             /* Count of the sources that hold a shared interrupt line high. */
    void *allocated[32];
    unsigned allocated_count;
    model_t *models[64];
    unsigned model_count;
};

/* The chip of a machine whose peripherals exist, and its model of a name; NULL if there is none. */
chip_t *chip_of(const machine_t *machine);
model_t *chip_model(const chip_t *chip, const char *name);

/* Memory of a model, zeroed; freed with the machine. Ends the process if there is none. */
void *chip_allocate(chip_t *chip, size_t size);

/* Enter a listener for edges of pins, behind those that are there. */
void chip_listen_to_pins(chip_t *chip, pin_edge_t listener);

/* An interrupt line that several sources drive. held is the source's memory of what it last said. */
void chip_irq_shared(chip_t *chip, unsigned position, bool *held, bool level);

/* Fill in a model and attach it. Instances of one kind each need a description, with their name and base. */
void model_attach(chip_t *chip, model_t *model, const model_description_t *description);
/* Put registers back to their reset values, then call the description's restart. */
void model_reset(model_t *model);
/* RCC's enable bit of the model changed; an access before settled_ps is too soon. */
void model_clock(model_t *model, bool on, int64_t settled_ps);
/* A violation: the program wants something that RM0090 defines and this model does not do. */
void model_missing(model_t *model, const char *what);
const char *model_name(const model_t *model);

/* ---- The models, by file ---- */

/* rcc.c, rcc_clocks.c */
void rcc_create(chip_t *chip);
void rcc_check_limits(chip_t *chip); /* A violation if wait states or voltage scale no longer suffice. */
double rcc_lsi_hz(const chip_t *chip);
double chip_temperature_degc(const chip_t *chip); /* The die is this warm now. */
void rcc_force_lsi(chip_t *chip);                 /* The independent watchdog runs: its oscillator does, until reset. */
#define PLL48_MOST_HZ 48.0001e6 /* RM0090 7.3.2: at most 48 MHz, which a division may miss by its rounding. */
/* The PLL's output for USB, SDIO and random numbers; nominal: with perfect oscillators. 0: it does not run. */
double rcc_pll48_hz(const chip_t *chip, bool nominal);
/* pwr.c, flash.c, flash_operation.c */
unsigned flash_brown_out_level(const chip_t *chip); /* BOR_LEV of the option bytes: 0 is level 3, 3 is off. */
bool flash_hardware_watchdog(const chip_t *chip);   /* WDG_SW is 0: the independent watchdog starts by itself. */
void flash_supply_changed(chip_t *chip);            /* A violation if an operation runs that it is too low for. */
void flash_supply_lost(chip_t *chip);               /* An operation that runs is cut off. */
void pwr_create(chip_t *chip);
void flash_create(chip_t *chip);
/* gpio.c; pins are numbered as in board_edge.h, af is the alternate function. */
void gpio_create(chip_t *chip);
bool chip_pin_is_alternate(const chip_t *chip, unsigned pin, unsigned af);
bool chip_pin_is_analog(const chip_t *chip, unsigned pin);
bool chip_pin_level(const chip_t *chip, unsigned pin);
void chip_pin_driven(chip_t *chip, unsigned pin, int64_t time_ps); /* What signals.pin_output says of it has changed. */
/* exti.c */
void exti_create(chip_t *chip);
void exti_line(chip_t *chip, unsigned line, bool rising, int64_t time_ps); /* An internal line, 16 to 22. */
/* dma.c, dma_arbiter.c, dma_stream.c, dma_map.c */
void dma_create(chip_t *chip);
dma_source_t dma_source(const char *name); /* DMA_NONE if there is no such line. */
void dma_line(chip_t *chip, dma_source_t source, bool level);
void dma_line_pulse(chip_t *chip, dma_source_t source); /* A request that falls when it is served. */
/* tim.c */
void tim_create(chip_t *chip);
/* Around a change of clocks or of who listens to a timer. */
void tim_before_change(chip_t *chip);
void tim_after_change(chip_t *chip);
/* adc.c, dac.c, usart.c, can.c, watchdog.c, crc.c, rng.c */
void adc_create(chip_t *chip);
void dac_create(chip_t *chip);
void usart_create(chip_t *chip);
void can_create(chip_t *chip);
void watchdog_create(chip_t *chip);
void crc_create(chip_t *chip);
void rng_create(chip_t *chip);

#endif
