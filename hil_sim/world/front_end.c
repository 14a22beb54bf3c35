#include "world/front_end.h"

#include <math.h>

#include "world/noise.h"

#define COUNTS 4096.0 /* Steps of the converter. */

static const double middle_V = 1.65, full_V = 3.3;

void front_end_init(front_end_t *front_end, const front_end_config_t *config, uint64_t seed, unsigned board) {
    *front_end = (front_end_t){.config = *config};
    for (unsigned axis = 0; axis < 3u; ++axis) {
        front_end->last_ps[axis] = -FRONT_END_BURST_PS;
        front_end->last_V[axis] = middle_V;
        front_end->drawn_ps[axis] = -1;
        front_end->chip_stream[axis] = noise_stream(seed, NOISE_CHIP, board, axis);
        front_end->converter_stream[axis] = noise_stream(seed, NOISE_CONVERTER, board, axis);
    }
}

void front_end_break(front_end_t *front_end, unsigned axis, front_end_fault_t fault, double value) {
    front_end->fault[axis] = fault;
    front_end->value[axis] = value;
    front_end->drawn_ps[axis] = -1; /* The pin may have another axis' noise from now on. */
}

/* Returns the volts that an axis of the sensor gives, in the burst under way at a pin. */
static double amplified(front_end_t *front_end, unsigned axis, unsigned pin, const double field_T[3]) {
    const front_end_config_t *const config = &front_end->config;
    const int64_t burst_ps = front_end->burst_start_ps[pin];
    if (front_end->drawn_ps[pin] != burst_ps) {
        front_end->drawn_ps[pin] = burst_ps;
        front_end->chip_noise[pin] = noise_normal(front_end->chip_stream[axis], (uint64_t)burst_ps);
    }
    double seen_T = config->offset_T[axis] + config->noise_T * front_end->chip_noise[pin];
    for (unsigned i = 0; i < 3u; ++i) {
        seen_T += config->gain[axis][i] * field_T[i];
    }
    return middle_V * (1.0 + seen_T / config->range_T);
}

/* Returns the voltage in the middle of the step of a result, one bit of which does not move. */
static double with_bit(double volts, unsigned bit, bool high) {
    const double steps = floor(volts / full_V * COUNTS);
    const uint32_t result = steps < 0.0 ? 0u : steps < COUNTS ? (uint32_t)steps : (uint32_t)COUNTS - 1u;
    const uint32_t mask = UINT32_C(1) << bit;
    return ((double)(high ? result | mask : result & ~mask) + 0.5) * full_V / COUNTS;
}

double front_end_volts(front_end_t *front_end, unsigned axis, const double field_T[3], int64_t time_ps) {
    const front_end_fault_t fault = front_end->fault[axis];
    const double value = front_end->value[axis];
    if (time_ps - front_end->last_ps[axis] >= FRONT_END_BURST_PS) {
        front_end->burst_start_ps[axis] = time_ps;
    }
    front_end->last_ps[axis] = time_ps;

    const unsigned source = fault == FRONT_END_OTHER ? (unsigned)value : axis;
    const double noise = noise_normal(front_end->converter_stream[axis], (uint64_t)time_ps);
    double volts = amplified(front_end, source, axis, field_T) + front_end->config.converter_noise_V * noise;
    if (fault == FRONT_END_HELD) {
        volts = front_end->last_V[axis];
    } else if (fault == FRONT_END_LOW || fault == FRONT_END_HIGH) {
        volts = fault == FRONT_END_HIGH ? full_V : 0.0;
    } else if (fault == FRONT_END_GAIN) {
        volts = middle_V + value * (volts - middle_V);
    } else if (fault == FRONT_END_BIT_HIGH || fault == FRONT_END_BIT_LOW) {
        volts = with_bit(volts, (unsigned)value, fault == FRONT_END_BIT_HIGH);
    }
    front_end->last_V[axis] = volts;
    return volts;
}
