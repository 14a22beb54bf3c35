#include "world/front_end.h"

#include <math.h>

#include "world/noise.h"

#define COUNTS 4096.0 /* Steps of the converter. */

static const double middle_V = 1.65, full_V = 3.3;

void front_end_init(front_end_t *front_end, const front_end_config_t *config, uint64_t seed, unsigned board) {
    *front_end = (front_end_t){.config = *config, .seed = seed, .board = board};
    for (unsigned axis = 0; axis < 3u; ++axis) {
        front_end->last_ps[axis] = -FRONT_END_BURST_PS;
        front_end->last_V[axis] = middle_V;
    }
}

void front_end_break(front_end_t *front_end, unsigned axis, front_end_fault_t fault, double value) {
    front_end->fault[axis] = fault;
    front_end->value[axis] = value;
}

/* Returns the volts that an axis of the sensor gives, at the time of the burst under way at a pin. */
static double amplified(const front_end_t *front_end, unsigned axis, const double field_T[3], int64_t burst_ps) {
    const front_end_config_t *const config = &front_end->config;
    const uint64_t chip = noise_stream(NOISE_CHIP, front_end->board, axis);
    double seen_T = config->offset_T[axis] + config->noise_T * noise_normal(front_end->seed, chip, (uint64_t)burst_ps);
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
    const uint64_t converter = noise_stream(NOISE_CONVERTER, front_end->board, axis);
    const double pin_V = amplified(front_end, source, field_T, front_end->burst_start_ps[axis]);
    double volts = pin_V +
                   front_end->config.converter_noise_V * noise_normal(front_end->seed, converter, (uint64_t)time_ps);
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
