#include "world/coil_law.h"

#include <math.h>

double coil_law_current(const coil_piece_t *piece, double elapsed) {
    double current_A = piece->limit_A;
    for (unsigned m = 0; m < piece->modes; ++m) {
        current_A += piece->mode_A[m] * exp(-elapsed / piece->slow_s[m]);
    }
    return current_A;
}

double coil_law_second(const coil_piece_t *piece, double elapsed) {
    double current_A = 0.0;
    for (unsigned m = 0; m < piece->modes; ++m) {
        const double mode_A = piece->second_mode_A[m];
        current_A += mode_A != 0.0 ? mode_A * exp(-elapsed / piece->slow_s[m]) : 0.0;
    }
    return current_A;
}

/* The current of all turns that makes the same field as both. */
static double field_of(const coil_segment_t *segment, double current_A, double second_A) {
    return (1.0 - segment->shorted) * current_A + segment->shorted * second_A;
}

/* Where the low-pass is. The filter's answer to b exp(-t/T) is b T/(T - lag) exp(-t/T), that to the limit is the limit,
 * and the rest dies away with the filter's own time constant. */
double coil_law_lagged(const coil_segment_t *segment, const coil_piece_t *piece, double lag, double elapsed) {
    const double limit = field_of(segment, piece->limit_A, 0.0);
    double lagged_A = limit, rest = piece->lagged_A - limit;
    for (unsigned m = 0; m < piece->modes; ++m) {
        const double slow = piece->slow_s[m], away = field_of(segment, piece->mode_A[m], piece->second_mode_A[m]);
        const double forced = lag > 0.0 ? away * slow / (slow - lag) : away;
        lagged_A += forced * exp(-elapsed / slow);
        rest -= forced;
    }
    const bool gone = elapsed > COIL_GONE_LAGS * lag && fabs(rest) <= fabs(lagged_A);
    return lag > 0.0 && !gone ? lagged_A + rest * exp(-elapsed / lag) : lagged_A;
}

/* Returns the integral of the square of limit + sum of mode exp(-t / slow), A^2 s. */
static double square_in(const coil_piece_t *piece, double limit, const double mode[COIL_MODES], double elapsed) {
    double sum = limit * limit * elapsed;
    for (unsigned m = 0; m < piece->modes; ++m) {
        const double slow = piece->slow_s[m];
        sum += 2.0 * limit * mode[m] * slow * (1.0 - exp(-elapsed / slow));
        for (unsigned n = 0; n < piece->modes; ++n) {
            const double both = slow * piece->slow_s[n] / (slow + piece->slow_s[n]);
            sum += mode[m] * mode[n] * both * (1.0 - exp(-elapsed / both));
        }
    }
    return sum;
}

/* Returns the heat of the copper, J. */
double coil_law_heat(const coil_segment_t *segment, const coil_piece_t *piece, double elapsed) {
    return segment->copper_Ohm * square_in(piece, piece->limit_A, piece->mode_A, elapsed) +
           segment->second_Ohm * square_in(piece, 0.0, piece->second_mode_A, elapsed);
}

/* The driver holds the current where it is; that in the shorted turns dies away. */
void coil_law_hold(const coil_segment_t *segment, coil_piece_t *piece) {
    piece->held = true;
    piece->limit_A = piece->current_A;
    piece->modes = segment->shorted > 0.0 ? 1 : 0;
    piece->slow_s[0] = segment->held_s;
    piece->mode_A[0] = 0.0;
    piece->second_mode_A[0] = piece->second_A;
}

/* The supply drives the current toward a limit. With shorted turns, L di/dt = -R i for the two has the solutions
 * (M, T r - L1) exp(-t/T), r the resistance around the driven turns; they are orthogonal as the resistances weigh. */
void coil_law_drive(const coil_segment_t *segment, coil_piece_t *piece, double limit_A) {
    const double away = piece->current_A - limit_A, ohms = segment->loop_Ohm;
    piece->held = false;
    piece->limit_A = limit_A;
    piece->modes = segment->shorted > 0.0 ? 2 : 1;
    for (unsigned m = 0; m < piece->modes; ++m) {
        const double slow = piece->slow_s[m] = segment->slow_s[m];
        const double x = segment->mutual_H, y = slow * ohms - segment->first_H;
        const double share = (ohms * x * away + segment->second_Ohm * y * piece->second_A) /
                             (ohms * x * x + segment->second_Ohm * y * y);
        piece->mode_A[m] = piece->modes == 1 ? away : share * x;
        piece->second_mode_A[m] = piece->modes == 1 ? 0.0 : share * y;
    }
}

/* Returns when a driven current arrives at a target on its way to the limit, s from the piece's start. */
double coil_law_arrival(const coil_segment_t *segment, const coil_piece_t *piece, double target_A) {
    if (piece->modes == 1) {
        const double ahead = (piece->current_A - piece->limit_A) / (target_A - piece->limit_A);
        return ahead > 0.0 ? segment->slow_s[0] * log(ahead) : INFINITY;
    }
    const double side = copysign(1.0, target_A - piece->current_A);
    double late = 1e-3 * fmin(segment->slow_s[0], segment->slow_s[1]), early = 0.0;
    const double end = 100.0 * fmax(segment->slow_s[0], segment->slow_s[1]);
    while (side * (coil_law_current(piece, late) - target_A) < 0.0) {
        early = late;
        late *= 2.0;
        if (late > end) {
            return INFINITY;
        }
    }
    for (unsigned i = 0; i < 60; ++i) {
        const double middle = 0.5 * (early + late);
        *(side * (coil_law_current(piece, middle) - target_A) < 0.0 ? &early : &late) = middle;
    }
    return late;
}
