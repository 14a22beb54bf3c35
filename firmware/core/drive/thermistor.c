#include "core/drive/thermistor.h"

#define STEP_K 10.0f
#define STEPS  19u

/* Counts from -40 to 150 degC: 4096 R / (R + 10 kOhm), R = 10 kOhm exp(3950 K (1 / T - 1 / 298.15 K)). */
static const uint16_t counts[STEPS + 1u] = {3997, 3901, 3741, 3496, 3157, 2739, 2278, 1825, 1419, 1082,
                                            816,  613,  462,  350,  267,  206,  160,  126,  100,  80};

float thermistor_degC(uint16_t count) {
    if (count >= counts[0]) {
        return THERMISTOR_MIN_DEGC;
    }
    for (uint32_t i = 0; i < STEPS; i++) {
        if (count > counts[i + 1u]) {
            const float part = (float)(counts[i] - count) / (float)(counts[i] - counts[i + 1u]);
            return THERMISTOR_MIN_DEGC + STEP_K * ((float)i + part);
        }
    }
    return THERMISTOR_MAX_DEGC;
}

uint16_t thermistor_count(float degC) {
    if (!(degC > THERMISTOR_MIN_DEGC)) {
        return counts[0];
    }
    const float steps = (degC - THERMISTOR_MIN_DEGC) / STEP_K;
    if (steps >= (float)STEPS) {
        return counts[STEPS];
    }
    const uint32_t i = (uint32_t)steps;
    return (uint16_t)((float)counts[i] - (steps - (float)i) * (float)(counts[i] - counts[i + 1u]) + 0.5f);
}
