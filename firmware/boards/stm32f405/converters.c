/* converters.c: what is analog, but for the DAC (chip_engine.c).
 *
 * A conversion takes 15 + 12 cycles of 21 MHz, 216 ticks of the chip timer; a start takes up to 3 cycles (24 ticks).
 * The three converters run together, in the mode "regular simultaneous and injected simultaneous" (RM0090, 13.9.7):
 * the regular group is the burst, the injected one the currents and what is monitored.
 *   burst          (sensor, anchor) It takes 8 x 216 ticks from TIM3's compare 1 at count 14540 and ends at
 *                  16268..16292, 0.77 to 0.92 us before the nominal end of the chip. Each converter has one axis;
 *                  after each conversion DMA fetches three half-words (axis 0, 1, 2) from the common data register.
 *   coil currents  (beacon, anchor) Channel 0 is on ADC1, channel 1 on ADC2, at one moment, in the second of two
 *                  conversions that TIM4's compare 1 starts. TIM4 ends every 8192 ticks, so they come twice: a beacon's
 *                  at count 7448 and at 15640, done by 15880, inside the shortest chip; an anchor's at 6048 and at
 *                  14240, done by 14480, before its burst. A third time comes after the longest chip. Which it was the
 *                  count tells: the interrupt of the first may wait until the second is there, and that of the second
 *                  until the first of the next chip. Where TIM1 stands TIM4 goes on, but the count runs beyond a chip.
 *   edges          (beacon) The regular group is one conversion of both coils' currents, which TIM3's compare 1 starts
 *                  at count 540: they are held at 672, 4 us into the chip, and done by 780. An anchor has none, since
 *                  its regular group is the burst.
 *   monitor        (beacon, anchor) The first of the two takes the coils' temperatures, on ADC1 and ADC2, and the
 *                  supply, on ADC3, which takes the driver's temperature beside the currents.
 *   temperature    Channel 16 on ADC1 takes 480 + 12 cycles (3936 ticks), started by software in the beginning of a
 *                  chip, when nothing else converts, and done before the middle's currents, or by count 8200 where
 *                  there are no coils. For this one conversion it takes the place of the injected group, whose trigger
 *                  is off meanwhile: a start by software beside an armed trigger is nothing that RM0090 describes. If
 *                  its interrupt comes late by up to 40 us it costs the currents of the middle, and not those of the
 *                  end. Converters that run together must sample equally long: ADC2 and ADC3 look at pins meanwhile,
 *                  for nobody. A beacon's is started by the interrupt of an edge, behind which nothing converts
 *                  whatever has become of the chips: where edges come no more, so does the temperature. An interrupt
 *                  that waited, as for an erasure of the flash, may come amid the regular group of a later chip: the
 *                  injected one is then changed behind it.
 *
 * In step. Chip c's burst lies at 24 (c mod 62) half-words of the two sample blocks. Between two bursts the stream's
 * counter tells whether it is there: 0 behind is in step, 1..23 is a burst that still runs (up to 1.7 us beyond the
 * end of the shortest chip), 24 or more is a burst missed. And each converter's own data register still holds its last
 * conversion, so the last three half-words must be these, in the order of the converters: otherwise the axes are
 * exchanged. Then, or after an overrun, which stops DMA, the stream is stopped, and blocks read 0 (saturated) until it
 * starts again at the beginning of the buffer, in the first chip of an even block. What the common data register gives
 * next after an overrun is not written anywhere: the converters are reset before they start again, so that the first
 * is that of ADC1, as after power-on.
 */

#include <string.h>

#include "boards/stm32f405/stm32f405.h"

#define CONVERSION_TICKS     216u /* Length of a conversion, ticks: 27 cycles. */
#define BURST_START          (HAL_CHIP_TICKS - 154u - HAL_BURST * CONVERSION_TICKS)
#define TRIGGER_TICKS        12u   /* Mean delay of a start, ticks: half of what it takes at most. */
#define SAMPLING_TICKS       120u  /* Length of the sampling in a conversion, ticks: 15 cycles. */
#define TEMPERATURE_TICKS    3960u /* What the temperature takes at most. */
#define BEFORE_TRIGGER       400u  /* So long before a trigger it must be over, for its interrupt. */
#define CHIP_SAMPLES         (HAL_BURST * HAL_AXES)
#define BUFFER_SAMPLES       (RING_CHIPS * CHIP_SAMPLES)
#define CURRENT_START        (HAL_CHIP_TICKS_MIN - 360u)
#define CURRENT_START_ANCHOR (BURST_START - 300u)
#define EDGE_START           (HAL_EDGE_US * 168u - TRIGGER_TICKS - SAMPLING_TICKS)
#define TIMERS_APART         64u   /* Ticks by which two timers that count the same chip differ at most. */
#define CURRENTS_APART       8192u /* Ticks from the currents amid the chip to those before its end. */
#define BURST_BEYOND         300u  /* A burst may end so far behind the end of the shortest chip. */
#define EDGE_DONE            (EDGE_START + 2u * TRIGGER_TICKS + CONVERSION_TICKS)

_Static_assert(BURST_START == 14540u, "the head of this file says where the burst lies");
_Static_assert(CURRENT_START == 15640u && CURRENT_START_ANCHOR == 14240u, "and the currents");
_Static_assert(EDGE_START == 540u, "and the edges");
_Static_assert(CURRENT_START - CONVERSION_TICKS < 2u * CURRENTS_APART, "TIM4 starts the first ones before its end,");
_Static_assert(CURRENT_START_ANCHOR - CONVERSION_TICKS + CURRENTS_APART > HAL_CHIP_TICKS_MAX, "and none a third time");

/* Channels of the injected group: those of the monitor, and beside the last of them the currents (pinout.md). */
enum { CURRENT_0 = 0, CURRENT_1 = 14, SUPPLY = 10, COIL_0 = 11, COIL_1 = 13, DRIVER = 12, PROCESSOR = 16 };

/* Chooses two injected channels of a converter: they use the last of four places. */
static void inject(ADC_registers *adc, uint32_t first, uint32_t second) {
    adc->JSQR = 1u << 20 | first << 10 | second << 15;
}

static void inject_currents(void) {
    inject(ADC1, COIL_0, CURRENT_0);
    inject(ADC2, COIL_1, CURRENT_1);
    inject(ADC3, SUPPLY, DRIVER);
}

/* One conversion uses the last place. ADC2 and ADC3 look at channels that they do not need otherwise. */
static void inject_temperature(void) {
    ADC1->JSQR = PROCESSOR << 15;
    ADC2->JSQR = DRIVER << 15;
    ADC3->JSQR = COIL_0 << 15;
}

#define CURRENT_TRIGGER (ADC_CR2_JEXTSEL_TIM4_CC1 | ADC_CR2_JEXTEN_RISING)

/* Returns at which count of the chip the currents before its end are converted. */
static uint32_t current_start(const hal_t *hal) {
    return hal_role_samples(hal->role) ? CURRENT_START_ANCHOR : CURRENT_START;
}

/* Returns at which count those amid it are triggered. */
static uint32_t middle_trigger(const hal_t *hal) {
    return current_start(hal) - CONVERSION_TICKS - CURRENTS_APART;
}

/* One rank: the edges. ADC3, which goes along, looks at a pin for nobody. */
static void scan_edges(void) {
    ADC1->SQR3 = CURRENT_0;
    ADC2->SQR3 = CURRENT_1;
    ADC3->SQR3 = DRIVER;
}

/* Sets up eight ranks of one channel. */
static void scan(ADC_registers *adc, uint32_t channel) {
    const uint32_t five = channel | channel << 5 | channel << 10 | channel << 15 | channel << 20;
    adc->SQR3 = five | channel << 25;
    adc->SQR2 = channel | channel << 5;
    adc->SQR1 = (HAL_BURST - 1u) << 20;
}

static void samples_start(const hal_t *hal) {
    DMA_stream_registers *stream = &DMA2->S[0];
    DMA2->LIFCR = DMA_LIFCR_STREAM0;
    stream->PAR = (uint32_t)&C_ADC->CDR;
    stream->M0AR = (uint32_t)hal->samples;
    stream->NDTR = BUFFER_SAMPLES;
    stream->CR = DMA_S0CR_PL_HIGH | DMA_S0CR_CIRC | DMA_S0CR_MINC | DMA_S0CR_PSIZE_16 | DMA_S0CR_MSIZE_16;
    stream->CR |= DMA_S0CR_EN;
    C_ADC->CCR |= C_ADC_CCR_DMA_MODE1;
}

static void samples_stop(void) {
    C_ADC->CCR &= ~C_ADC_CCR_DMA_MODE1;
    DMA2->S[0].CR &= ~DMA_S0CR_EN;
}

/* The triggers are the rising edges of compare outputs that go to no pin: PWM mode 2 rises at the compare. TIM3 and
 * TIM4 count every second tick. */
static void triggers_start(const hal_t *hal) {
    TIM3->CCR1 = (hal_role_samples(hal->role) ? BURST_START : EDGE_START) / 2u;
    TIM3->CCER |= TIM_CCER_CC1E;
    TIM4->CCMR1_Output = TIM_CCMR1_OC1M_PWM2;
    TIM4->ARR = CURRENTS_APART / 2u - 1u;
    TIM4->CCR1 = middle_trigger(hal) / 2u;
    TIM4->CCER = TIM_CCER_CC1E;
}

/* Sets all converters up, from their reset state. */
static void converters_setup(const hal_t *hal) {
    const bool samples = hal_role_samples(hal->role), drives = hal_role_drives(hal->role);
    C_ADC->CCR = C_ADC_CCR_ADCPRE_DIV4 | C_ADC_CCR_TSVREFE | C_ADC_CCR_MULT_TRIPLE_COMBINED |
                 (samples ? C_ADC_CCR_DDS : 0u);
    /* What is sampled and measured takes 15 cycles (1), the temperature's group 480 (7). */
    ADC1->SMPR1 = 1u << 3 | 7u << 18;
    ADC1->SMPR2 = 1u << 0 | 1u << 3;
    ADC2->SMPR1 = 7u << 6 | 1u << 9 | 1u << 12;
    ADC2->SMPR2 = 1u << 6;
    ADC3->SMPR1 = 1u << 0 | 7u << 3 | 1u << 6;
    ADC3->SMPR2 = 1u << 9;
    inject_currents();
    if (samples) {
        scan(ADC1, 1);
        scan(ADC2, 2);
        scan(ADC3, 3);
        samples_start(hal);
    } else {
        scan_edges();
    }
    ADC1->CR1 = ADC_CR1_SCAN | ADC_CR1_JEOCIE | (samples ? 0u : ADC_CR1_EOCIE);
    ADC2->CR1 = ADC_CR1_SCAN;
    ADC3->CR1 = ADC_CR1_SCAN;
    ADC2->CR2 = ADC_CR2_ADON;
    ADC3->CR2 = ADC_CR2_ADON;
    /* The converters are stable 3 us later, before the first trigger comes. */
    ADC1->CR2 = ADC_CR2_ADON | ADC_CR2_EXTSEL_TIM3_CC1 | ADC_CR2_EXTEN_RISING | (drives ? CURRENT_TRIGGER : 0u);
}

void converters_start(hal_t *hal) {
    hal->sampling = true;
    triggers_start(hal);
    converters_setup(hal);
}

/* Starts the converters again from the state that they have after power-on, in the first half of a chip. */
static void converters_restart(const hal_t *hal) {
    RCC->APB2RSTR |= RCC_APB2RSTR_ADCRST;
    RCC->APB2RSTR &= ~RCC_APB2RSTR_ADCRST;
    converters_setup(hal);
}

static void start_temperature(hal_t *hal) {
    ADC1->CR2 &= ~ADC_CR2_JEXTEN_RISING;
    inject_temperature();
    hal->temperature_due = true;
    ADC1->CR2 |= ADC_CR2_JSWSTART;
}

/* Returns whether the regular group may be under way at a count of the chip. */
static bool scans(const hal_t *hal, uint32_t now) {
    return hal_role_samples(hal->role) ? now >= BURST_START || now < BURST_BEYOND
                                       : now >= EDGE_START && now < EDGE_DONE;
}

/* Returns whether the two timers that count the chip tell the same, as they do unless one of them stands: then no
 * current can be told to belong to a chip. */
static bool agree(uint32_t one, uint32_t other) {
    const uint32_t apart = one > other ? one - other : other - one;
    return apart < TIMERS_APART || apart > HAL_CHIP_TICKS_MIN - TIMERS_APART; /* One has begun the next chip. */
}

/* Returns which currents were converted last, at a count of the chip. */
static look_t latest(const hal_t *hal, uint32_t now) {
    const uint32_t end = current_start(hal) + CONVERSION_TICKS;
    if (now >= end - CURRENTS_APART && now < end)
        return LOOK_MIDDLE;
    return now < HAL_CHIP_TICKS_MAX ? LOOK_END : LOOK_NONE;
}

look_t converters_take(hal_t *hal, uint16_t count[HAL_CHANNELS]) {
    if ((ADC1->SR & ADC_SR_JEOC) == 0)
        return LOOK_NONE;
    const uint32_t primask = interrupts_off();
    const uint32_t now = TIM8->CNT, other = TIM1->CNT;
    interrupts_restore(primask);
    if (hal->temperature_due && scans(hal, now))
        return LOOK_NONE; /* The flag stays, so the interrupt comes again: it had waited, as for the flash. */
    ADC1->SR = ~ADC_SR_JEOC & 0x3Fu;
    if (hal->temperature_due) {
        hal->temperature_due = false;
        hal->temperature_count = (uint16_t)ADC1->JDR1;
        inject_currents();
        if (hal_role_drives(hal->role))
            ADC1->CR2 |= CURRENT_TRIGGER;
        return LOOK_NONE;
    }
    hal->monitor = (hal_monitor_t){
        .supply = (uint16_t)ADC3->JDR1,
        .coil = {(uint16_t)ADC1->JDR1, (uint16_t)ADC2->JDR1},
        .driver = (uint16_t)ADC3->JDR2,
    };
    count[0] = (uint16_t)ADC1->JDR2;
    count[1] = (uint16_t)ADC2->JDR2;
    return agree(now, other) ? latest(hal, now) : LOOK_NONE;
}

bool converters_take_edge(const hal_t *hal, uint16_t count[HAL_CHANNELS]) {
    if (hal_role_samples(hal->role) || (ADC1->SR & ADC_SR_EOC) == 0)
        return false;
    count[0] = (uint16_t)ADC1->DR; /* Reading it clears the flag. */
    count[1] = (uint16_t)ADC2->DR;
    return true;
}

/* Returns whether the temperature may be started at a count of the chip, in its beginning. */
static bool is_early(const hal_t *hal, uint32_t now) {
    return now <
           (hal_role_drives(hal->role) ? middle_trigger(hal) - TEMPERATURE_TICKS - BEFORE_TRIGGER : MIDDLE_TICKS / 2u);
}

void converters_behind_edge(hal_t *hal) {
    const uint32_t now = TIM8->CNT;
    if (hal->temperature_wanted && !scans(hal, now) && is_early(hal, now)) {
        hal->temperature_wanted = false;
        start_temperature(hal);
    }
}

void hal_monitor(const hal_t *hal, hal_monitor_t *monitor) {
    *monitor = hal->monitor;
}

/* Returns whether the latest burst, the one before a position in the buffer, lies there in the order of the axes. */
static bool in_order(const hal_t *hal, uint32_t position) {
    const uint32_t before = (position + RING_CHIPS - 1u) % RING_CHIPS;
    const uint16_t *last = hal->samples[before / HAL_BLOCK_CHIPS][before % HAL_BLOCK_CHIPS][HAL_BURST - 1u];
    return last[0] == ADC1->DR && last[1] == ADC2->DR && last[2] == ADC3->DR;
}

/* Checks the samples at a block boundary, and starts them again if they are not in step. Returns whether no burst
 * runs. */
static bool check_samples(hal_t *hal, uint32_t finished, chip_time_t now) {
    const bool before_burst = now.ticks < MIDDLE_TICKS;
    const uint32_t position = now.chip - hal->first_chip + (hal->block & 1u) * HAL_BLOCK_CHIPS;
    const uint32_t behind = (DMA2->S[0].NDTR + position * CHIP_SAMPLES) % BUFFER_SAMPLES;
    const bool overrun = (C_ADC->CSR & (C_ADC_CSR_OVR1 | C_ADC_CSR_OVR2 | C_ADC_CSR_OVR3)) != 0;
    const bool missed = before_burst && behind >= CHIP_SAMPLES;
    const bool exchanged = before_burst && behind == 0 && !in_order(hal, position);
    if (hal->sampling && (overrun || missed || exchanged)) {
        samples_stop();
        hal->sampling = false;
        hal->counters.converter_overruns++;
    }
    if (!hal->sampling) {
        memset(&hal->samples[finished & 1u], 0, sizeof hal->samples[0]);
        if (before_burst && position == 0 && (DMA2->S[0].CR & DMA_S0CR_EN) == 0) {
            converters_restart(hal);
            hal->sampling = true;
        }
        return false;
    }
    return behind == 0;
}

void converters_block(hal_t *hal, uint32_t finished, chip_time_t now) {
    if (!hal_role_samples(hal->role))
        hal->temperature_wanted = true;
    else if (check_samples(hal, finished, now) && is_early(hal, now.ticks))
        start_temperature(hal);
}

hal_burst_t hal_burst_timing(void) {
    return (hal_burst_t){BURST_START + TRIGGER_TICKS + SAMPLING_TICKS, CONVERSION_TICKS};
}

/* The temperature lies on the line through the two calibration points of this very chip; on a chip without them the
 * data sheet's typical 0.76 V at 25 degC and 2.5 mV/degC serve. */
int16_t hal_temperature(const hal_t *hal) {
    int32_t low = 959, high = 1207;
    if (hal->whole && TEMPERATURE_CALIBRATION[1] > TEMPERATURE_CALIBRATION[0] &&
        TEMPERATURE_CALIBRATION[1] <= HAL_SAMPLE_MAX) {
        low = TEMPERATURE_CALIBRATION[0];
        high = TEMPERATURE_CALIBRATION[1];
    }
    if (hal->temperature_count == 0)
        return 0; /* It has not been measured yet. */
    return (int16_t)(300 + (hal->temperature_count - low) * 800 / (high - low));
}
