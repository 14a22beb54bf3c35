/* One cycle of three axes with 1,023 codes on a Cortex-M4: by the transform of the core, by plain correlation, and by
 * CMSIS-DSP's dot product and Fourier transform. Each peer gets what makes it quick: samples that are multiplied with
 * register u's chips once, and register v's chips twice in a row, of which code k begins at chip k.
 */
#include <string.h>

#include "core/codes/despread.h"
#include "dsp/basic_math_functions.h"
#include "dsp/complex_math_functions.h"
#include "dsp/transform_functions.h"

enum { CHIPS = 1023, SPAN = 2048 };

int16_t samples[CHIPS][3];  /* Written by the bench. */
int16_t u_chips[CHIPS];     /* +1 and -1. */
int16_t v_chips[2 * CHIPS]; /* Twice in a row. */
int32_t wanted;             /* How many codes a call of a peer works off: it costs the same for each. */
int32_t found[3][CHIPS];
float found_by_fourier[SPAN];

static despread_t cycle;
static int16_t turned[3][CHIPS];
static arm_rfft_fast_instance_f32 fourier;
static float v_spectrum[SPAN], spectrum[SPAN], block[SPAN];

void transform(void) {
    despread_start(&cycle, gold_family(10));
    for (int t = 0; t < CHIPS; t++) {
        despread_store(&cycle, samples[t]);
    }
    despread_transform(&cycle);
}

void read_out(void) {
    for (int k = 0; k < wanted; k++) {
        const uint16_t word = despread_word(gold_family(10), (uint32_t)k);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            found[axis][k] = despread_correlation(&cycle, axis, word);
        }
    }
}

void turn(void) {
    for (int t = 0; t < CHIPS; t++) {
        for (int axis = 0; axis < 3; axis++) {
            turned[axis][t] = (int16_t)(samples[t][axis] * u_chips[t]);
        }
    }
}

void plain(void) {
    for (int k = 0; k < wanted; k++) {
        for (int axis = 0; axis < 3; axis++) {
            int32_t sum = 0;
            for (int t = 0; t < CHIPS; t++) {
                sum += turned[axis][t] * v_chips[t + k];
            }
            found[axis][k] = sum;
        }
    }
}

void dot_products(void) {
    for (int k = 0; k < wanted; k++) {
        for (int axis = 0; axis < 3; axis++) {
            q63_t sum;
            arm_dot_prod_q15(turned[axis], &v_chips[k], CHIPS, &sum);
            found[axis][k] = (int32_t)sum;
        }
    }
}

/* Once: the spectrum of v. */
void fourier_init(void) {
    arm_rfft_fast_init_2048_f32(&fourier);
    for (int t = 0; t < SPAN; t++) {
        block[t] = t < 2 * CHIPS ? v_chips[t] : 0;
    }
    arm_rfft_fast_f32(&fourier, block, v_spectrum, 0);
}

/* One axis: the correlation of 1,023 samples with 2,046 chips at 1,023 lags does not wrap in 2,048. */
void by_fourier(void) {
    memset(block, 0, sizeof block);
    for (int t = 0; t < CHIPS; t++) {
        block[t] = turned[0][t];
    }
    arm_rfft_fast_f32(&fourier, block, spectrum, 0);
    const float first = spectrum[0] * v_spectrum[0], last = spectrum[1] * v_spectrum[1];
    arm_cmplx_conj_f32(spectrum, spectrum, SPAN / 2);
    arm_cmplx_mult_cmplx_f32(spectrum, v_spectrum, spectrum, SPAN / 2);
    spectrum[0] = first;
    spectrum[1] = last;
    arm_rfft_fast_f32(&fourier, spectrum, found_by_fourier, 1);
}
