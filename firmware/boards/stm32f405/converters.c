/* converters.c: what is analog, but for the DAC (chip_engine.c).
 *
 * A conversion takes 15 + 12 cycles of 21 MHz, 216 ticks of the chip timer; a start takes up to 3 cycles (24 ticks).
 * The three converters run together, in the mode "regular simultaneous and injected simultaneous" (RM0090, 13.9.7):
 * the regular groups are the burst, the injected ones currents and temperature.
 *   burst          (sensor, anchor) It takes 8 x 216 ticks from TIM1's compare 1 at count 14540 and ends at
 *                  16268..16292, 0.77 to 0.92 us before the nominal end of the chip. Each converter has one axis;
 *                  after each conversion DMA fetches three half-words (axis 0, 1, 2) from the common data register.
 *   coil currents  (beacon, anchor) Channel 0 is on ADC1, channel 1 on ADC2, at one moment, from TIM8's compare 2
 *                  (ADC3 converts for nobody). A beacon's are at count 15640 and done by 15890, inside the shortest
 *                  chip, so that the interrupt belongs to that chip. An anchor's are at 14240, done by 14490, before
 *                  its burst.
 *   temperature    Channel 16 on ADC1 takes 480 + 12 cycles (3936 ticks), started by software in the first quarter of
 *                  a chip, when nothing else converts, and done by count 8200. For this one conversion it takes the
 *                  coil current's place in the injected group. Converters that run together must sample equally long:
 *                  ADC2 and ADC3 look at pins meanwhile, for nobody.
 *
 * In step. Chip c's burst lies at 24 (c mod 62) half-words of the two sample blocks. Between two bursts the stream's
 * counter tells whether it is there: 0 behind is in step, 1..23 is a burst that still runs (up to 1.7 us beyond the
 * end of the shortest chip), 24 or more is a burst missed. Then, or after an overrun, which stops DMA, the stream is
 * stopped, and blocks read 0 (saturated) until it starts again at the beginning of the buffer, in the first chip of an
 * even block.
 */

#include <string.h>

#include "boards/stm32f405/stm32f405.h"

#define CONVERSION_TICKS     216u /* Length of a conversion, ticks: 27 cycles. */
#define BURST_START          (HAL_CHIP_TICKS - 154u - HAL_BURST * CONVERSION_TICKS)
#define TRIGGER_TICKS        12u  /* Mean delay of a start, ticks: half of what it takes at most. */
#define SAMPLING_TICKS       120u /* Length of the sampling in a conversion, ticks: 15 cycles. */
#define CHIP_SAMPLES         (HAL_BURST * HAL_AXES)
#define BUFFER_SAMPLES       (RING_CHIPS * CHIP_SAMPLES)
#define CURRENT_START        (HAL_CHIP_TICKS_MIN - 360u)
#define CURRENT_START_ANCHOR (BURST_START - 300u)

_Static_assert(BURST_START == 14540u, "the head of this file says where the burst lies");
_Static_assert(CURRENT_START == 15640u && CURRENT_START_ANCHOR == 14240u, "and the currents");

/* Chooses the injected channel of each converter. A group of one conversion uses the last of its four places. */
static void inject(uint32_t first, uint32_t second, uint32_t third) {
    ADC1->JSQR = first << 15;
    ADC2->JSQR = second << 15;
    ADC3->JSQR = third << 15;
}

static void inject_currents(void) {
    inject(0, 6, 3);
}

static void inject_temperature(void) {
    inject(16, 4, 0);
}

/* Sets up eight ranks of one channel. */
static void scan(ADC_registers *adc, uint32_t channel) {
    const uint32_t five = channel | channel << 5 | channel << 10 | channel << 15 | channel << 20;
    adc->SQR3 = five | channel << 25;
    adc->SQR2 = channel | channel << 5;
    adc->SQR1 = (HAL_BURST - 1u) << 20;
    adc->CR1 = ADC_CR1_SCAN;
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

/* The triggers are the rising edges of compare outputs that go to no pin: PWM mode 2 rises at the compare. */
static void triggers_start(const hal_t *hal) {
    TIM1->CCR1 = BURST_START;
    TIM1->CCMR1_Output = TIM_CCMR1_OC1M_PWM2 | TIM_CCMR1_OC1PE;
    TIM1->CCER |= TIM_CCER_CC1E;
    TIM1->BDTR = TIM_BDTR_MOE;
    TIM8->CCR2 = hal_role_samples(hal->role) ? CURRENT_START_ANCHOR : CURRENT_START;
    TIM8->CCMR1_Output = TIM_CCMR1_OC2M_PWM2;
    TIM8->CCER = TIM_CCER_CC2E;
    TIM8->BDTR = TIM_BDTR_MOE;
}

void converters_start(const hal_t *hal) {
    const bool samples = hal_role_samples(hal->role), drives = hal_role_drives(hal->role);
    triggers_start(hal);
    C_ADC->CCR = C_ADC_CCR_ADCPRE_DIV4 | C_ADC_CCR_TSVREFE | C_ADC_CCR_MULT_TRIPLE_COMBINED |
                 (samples ? C_ADC_CCR_DDS : 0u);
    /* What is sampled and measured takes 15 cycles (1), the temperature's group 480 (7). */
    ADC1->SMPR1 = 7u << 18;
    ADC1->SMPR2 = 1u << 0 | 1u << 3;
    ADC2->SMPR2 = 1u << 6 | 7u << 12 | 1u << 18;
    ADC3->SMPR2 = 7u << 0 | 1u << 9;
    inject_currents();
    if (samples) {
        scan(ADC1, 1);
        scan(ADC2, 2);
        scan(ADC3, 3);
        samples_start(hal);
    }
    ADC1->CR1 |= ADC_CR1_JEOCIE;
    ADC2->CR2 = ADC_CR2_ADON;
    ADC3->CR2 = ADC_CR2_ADON;
    /* The converters are stable 3 us later; the first trigger comes 80 us later. */
    ADC1->CR2 = ADC_CR2_ADON | (samples ? ADC_CR2_EXTSEL_TIM1_CC1 | ADC_CR2_EXTEN_RISING : 0u) |
                (drives ? ADC_CR2_JEXTSEL_TIM8_CC2 | ADC_CR2_JEXTEN_RISING : 0u);
}

bool converters_take(hal_t *hal, uint16_t count[HAL_CHANNELS]) {
    ADC1->SR = ~ADC_SR_JEOC & 0x3Fu;
    if (hal->temperature_due) {
        hal->temperature_due = false;
        hal->temperature_count = (uint16_t)ADC1->JDR1;
        inject_currents();
        return false;
    }
    count[0] = (uint16_t)ADC1->JDR1;
    count[1] = (uint16_t)ADC2->JDR1;
    return true;
}

void converters_block(hal_t *hal, uint32_t finished, chip_time_t now) {
    const bool before_burst = now.ticks < CHIP_RELOAD_TICKS;
    bool idle = true;
    if (hal_role_samples(hal->role)) {
        const DMA_stream_registers *stream = &DMA2->S[0];
        const uint32_t position = now.chip - hal->first_chip + (hal->block & 1u) * HAL_BLOCK_CHIPS;
        const uint32_t behind = (stream->NDTR + position * CHIP_SAMPLES) % BUFFER_SAMPLES;
        const bool overrun = (C_ADC->CSR & (C_ADC_CSR_OVR1 | C_ADC_CSR_OVR2 | C_ADC_CSR_OVR3)) != 0;
        if (hal->sampling && (overrun || (before_burst && behind >= CHIP_SAMPLES))) {
            samples_stop();
            hal->sampling = false;
            hal->counters.converter_overruns++;
        }
        if (!hal->sampling) {
            memset(&hal->samples[finished & 1u], 0, sizeof hal->samples[0]);
            if (before_burst && position == 0 && (stream->CR & DMA_S0CR_EN) == 0) {
                ADC1->SR = 0;
                ADC2->SR = 0;
                ADC3->SR = 0;
                samples_start(hal);
                hal->sampling = true;
            }
        }
        idle = hal->sampling && behind == 0;
    }
    if (idle && now.ticks < CHIP_RELOAD_TICKS / 2u) {
        inject_temperature();
        hal->temperature_due = true;
        ADC1->CR2 |= ADC_CR2_JSWSTART;
    }
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
