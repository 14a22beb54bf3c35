#include "core/timing/acquire_record.h"

#define MID_SCALE 2048

/* The sums of an axis's conversions relative to mid-scale: the first four, the next three, the last. */
typedef struct {
    int32_t first, second, last;
} parts_t;

static parts_t parts(const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES], uint32_t axis) {
    return (parts_t){
        burst[0][axis] + burst[1][axis] + burst[2][axis] + burst[3][axis] - 4 * MID_SCALE,
        burst[4][axis] + burst[5][axis] + burst[6][axis] - 3 * MID_SCALE,
        burst[7][axis] - MID_SCALE,
    };
}

/* Returns eight times the mean of the first seven conversions, rounded. */
static int32_t without_last(parts_t part) {
    const int32_t sum = part.first + part.second;
    return (sum * 8 + (sum < 0 ? -3 : 3)) / 7;
}

void record_burst(acquire_record_t *record, uint32_t chip, record_cut_t cut,
                  const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES]) {
    for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
        const parts_t part = parts(burst, axis);
        int32_t field, step;
        if (cut == RECORD_HALVES) {
            field = part.first + part.second + part.last;
            step = 2 * (part.second + part.last - part.first);
        } else {
            field = without_last(part);
            step = 8 * part.last - field;
        }
        record->field[chip][axis] = (int16_t)field;
        record->step[chip][axis] = (int16_t)step;
    }
}

void acquire_sample(const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES], int16_t sample[ACQUIRE_AXES]) {
    for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
        sample[axis] = (int16_t)without_last(parts(burst, axis));
    }
}

void record_statistics(const acquire_record_t *record, float average[ACQUIRE_AXES], float variance[ACQUIRE_AXES]) {
    for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
        int32_t sum = 0;
        for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
            sum += record->field[chip][axis];
        }
        average[axis] = (float)sum / (float)ACQUIRE_CHIPS;
        variance[axis] = 0.0f;
        for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
            const float value = (float)record->field[chip][axis] - average[axis];
            variance[axis] += value * value / (float)ACQUIRE_CHIPS;
        }
    }
}
