#include "world/front_end.h"

#include "world/noise.h"

static const double middle_V = 1.65;

void front_end_init(front_end_t *front_end, const front_end_config_t *config, uint64_t seed, unsigned board) {
    *front_end = (front_end_t){.config = *config, .seed = seed, .board = board};
    for (unsigned axis = 0; axis < 3u; ++axis) {
        front_end->last_ps[axis] = -FRONT_END_BURST_PS;
    }
}

double front_end_volts(front_end_t *front_end, unsigned axis, const double field_T[3], int64_t time_ps) {
    const front_end_config_t *const config = &front_end->config;
    if (time_ps - front_end->last_ps[axis] >= FRONT_END_BURST_PS) {
        front_end->burst_start_ps[axis] = time_ps;
    }
    front_end->last_ps[axis] = time_ps;

    const uint64_t chip = noise_stream(NOISE_CHIP, front_end->board, axis);
    double seen_T = config->offset_T[axis] +
                    config->noise_T * noise_normal(front_end->seed, chip, (uint64_t)front_end->burst_start_ps[axis]);
    for (unsigned i = 0; i < 3u; ++i) {
        seen_T += config->gain[axis][i] * field_T[i];
    }
    const uint64_t converter = noise_stream(NOISE_CONVERTER, front_end->board, axis);
    return middle_V * (1.0 + seen_T / config->range_T) +
           config->converter_noise_V * noise_normal(front_end->seed, converter, (uint64_t)time_ps);
}
