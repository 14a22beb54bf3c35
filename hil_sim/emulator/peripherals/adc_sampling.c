/* adc_sampling.c: channels and pins, volts to codes, times of a conversion.
 *
 * The converters' clock is PCLK2 divided by ADCPRE. A result is round(volts / supply * 4096), clamped.
 */
#include "emulator/peripherals/adc.h"

#include <math.h>

#define INTERNAL_SAMPLING_PS 10e6
#define ADC_LIMIT_HZ         36e6

static uint32_t common(const unit_t *u) {
    return reg(&adc_of(u)->common, ADC_CCR);
}

int64_t adc_divider(const unit_t *u) {
    return 2 * ((int64_t)field(common(u), 16, 2) + 1);
}

unsigned adc_length(const unit_t *u, activity_t group) {
    const uint32_t length = group == REGULAR ? field(reg(&u->model, ADC_SQR1), 20, 4)
                                             : field(reg(&u->model, ADC_JSQR), 20, 2);
    return adc_scans(u) ? length + 1 : 1;
}

unsigned adc_channel(const unit_t *u, activity_t group, unsigned index) {
    static const uint8_t offsets[3] = {ADC_SQR3, ADC_SQR2, ADC_SQR1};
    if (group == REGULAR) {
        return field(reg(&u->model, offsets[index / 6 % 3]), 5 * (index % 6), 5); /* At most 16 ranks. */
    }
    const uint32_t jsqr = reg(&u->model, ADC_JSQR); /* A short group is at the end: JSQ4 is its last. */
    return field(jsqr, 5 * (index + 3 - field(jsqr, 20, 2)), 5);
}

unsigned adc_sampling(const unit_t *u, unsigned channel) {
    static const uint16_t cycles[8] = {3, 15, 28, 56, 84, 112, 144, 480};
    return cycles[channel < 10 ? field(reg(&u->model, ADC_SMPR2), 3 * channel, 3)
                               : field(reg(&u->model, ADC_SMPR1), 3 * (channel - 10), 3)];
}

int64_t adc_start_tick(const unit_t *u, int64_t time_ps, int64_t latency) {
    const int64_t div = adc_divider(u), tick = clock_tick(&u->model.chip->pclk2, time_ps - 1) + 1;
    return (tick + div - 1) / div * div + latency * div;
}

bool adc_ready(unit_t *u, const char *what) {
    chip_t *const chip = u->model.chip;
    const char *wrong = NULL;
    if ((reg(&u->model, ADC_CR2) & ADON) == 0 || !u->model.clocked) {
        wrong = "while ADON is 0 or its clock is off";
    } else if (machine_now(chip->machine) < u->stable_ps) {
        wrong = "less than 3 us after ADON was set";
    } else if (chip->pclk2.nominal_hz / (double)adc_divider(u) > ADC_LIMIT_HZ + 1) {
        wrong = "with a converter clock above 36 MHz (ADCPRE)";
    }
    if (wrong != NULL) {
        machine_violation(chip->machine, "%s: %s %s", model_name(&u->model), what, wrong);
    }
    return wrong == NULL;
}

unsigned adc_pin(const unit_t *u, unsigned channel) {
    static const uint8_t first[16] = {0,  1,  2,  3,  4,  5,  6,  7,
                                      16, 17, 32, 33, 34, 35, 36, 37}; /* PA0..7, PB0, PB1, PC0..5 */
    static const uint8_t third[16] = {0,  1,  2,  3,  86, 87, 88, 89,
                                      90, 83, 32, 33, 34, 35, 84, 85}; /* PF6..10, PF3, PF4, PF5 */
    return channel > 15 ? ADC_NO_PIN : u->number == 2 ? third[channel] : first[channel];
}

static double internal_volts(unit_t *u, unsigned channel) {
    const bool battery = channel == 18;
    const double sampling_ps = (double)(adc_sampling(u, channel) * adc_divider(u)) * u->model.chip->pclk2.period_ps;
    if (u->number != 0 || (common(u) >> (battery ? 22 : 23) & 1u) == 0) {
        machine_violation(u->model.machine, "%s: channel %u converted, but %s", model_name(&u->model), channel,
                          u->number != 0 ? "only ADC1 has it" : "ADC_CCR does not enable it");
        return 0;
    }
    if (sampling_ps < INTERNAL_SAMPLING_PS && !battery) {
        machine_violation(u->model.machine, "ADC1: channel %u needs 10 us of sampling, got %.3f us", channel,
                          sampling_ps * 1e-6);
    }
    return battery ? 1.65 : channel == 17 ? 1.21 : 0.76 + 0.0025 * (chip_temperature_degc(u->model.chip) - 25);
}

uint32_t adc_sample(unit_t *u, unsigned channel, int64_t opens_ps) {
    chip_t *const chip = u->model.chip;
    double volts = 0;
    if (channel > 18) {
        machine_violation(chip->machine, "%s: there is no channel %u", model_name(&u->model), channel);
    } else if (channel > 15) {
        volts = internal_volts(u, channel);
    } else {
        const unsigned pin = adc_pin(u, channel);
        if (!chip_pin_is_analog(chip, pin)) {
            machine_violation(chip->machine, "%s: channel %u converted, but its pin P%c%u is not in analog mode",
                              model_name(&u->model), channel, (char)('A' + pin / 16), pin % 16);
        }
        volts = chip->edge->analog_in ? chip->edge->analog_in(chip->edge->context, pin, opens_ps) : 0;
    }
    const double code = floor(volts / chip->supply_V * 4096 + 0.5);
    return code < 0 || isnan(code) ? 0 : code > 4095 ? 4095 : (uint32_t)code;
}
