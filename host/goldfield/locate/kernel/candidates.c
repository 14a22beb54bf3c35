#include "candidates.h"

#include <math.h>
#include <string.h>

#include "level_set.h"
#include "wahba.h"

#define TWO_PI 6.28318530717958647692

/* Relative change of the fields between neighbouring points, taken as an error: no narrow valley may be missed. */
#define COARSENESS 0.3

/* A start beacon is this many standard deviations strong if one is. */
#define OUTSTANDING 20.0

/* Above this noise, relative, the level set has a thickness: three levels, this many standard deviations apart. */
#define NOISY      0.03
#define LEVEL_STEP 1.5

#define LEVELS         3
#define RINGS          ((size_t)2 * GF_RAYS) /* From above the coil's outside over its axis to below its outside. */
#define MOST_AZIMUTHS  32
#define LEAST_AZIMUTHS 4

typedef struct {
    double x[3]; /* A frame of the coil: x, y in its plane, z along its axis. */
    double y[3];
    double z[3];
    double centre[3];
} frame_t;

typedef struct {
    size_t count[RINGS]; /* azimuths of each ring */
    double rho[RINGS];
    double height[RINGS];
    bool around; /* whether the sheet is a tube around the wire, so that its innermost rings meet in the plane */
    double loss[RINGS][MOST_AZIMUTHS];
} sheet_t;

static double strength(const gf_epoch_t *epoch, size_t i) {
    const double *const b = epoch->field_T + 3 * i;
    const double magnitude = sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2]);
    return isfinite(magnitude) ? magnitude : 0.0;
}

size_t gf_start_coil(const gf_epoch_t *epoch) {
    size_t loudest = 0;
    size_t nearest = GF_MOST_COILS;
    double most = -1.0;
    double least = INFINITY;
    for (size_t i = 0; i < epoch->coils->count; ++i) {
        const double magnitude = strength(epoch, i);
        const double out = magnitude / epoch->sigma_T[i];
        const double volume = epoch->coils->moment_A_m2[i] / fmax(magnitude, 1e-300);
        if (out > most) {
            most = out;
            loudest = i;
        }
        if (out > OUTSTANDING && volume < least) {
            least = volume;
            nearest = i;
        }
    }
    return nearest < GF_MOST_COILS ? nearest : loudest;
}

static void enter_frame(const gf_coils_t *coils, size_t coil, frame_t *frame) {
    size_t flattest = 0;
    double square = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        frame->z[k] = coils->axis[k][coil];
        frame->centre[k] = coils->centre_m[k][coil];
        flattest = fabs(coils->axis[k][coil]) < fabs(coils->axis[flattest][coil]) ? k : flattest;
    }
    for (size_t k = 0; k < 3; ++k) {
        frame->x[k] = (k == flattest ? 1.0 : 0.0) - frame->z[flattest] * frame->z[k];
        square += frame->x[k] * frame->x[k];
    }
    for (size_t k = 0; k < 3; ++k) {
        frame->x[k] /= sqrt(square);
    }
    for (size_t k = 0; k < 3; ++k) {
        const size_t a = (k + 1) % 3;
        const size_t b = (k + 2) % 3;
        frame->y[k] = frame->z[a] * frame->x[b] - frame->z[b] * frame->x[a];
    }
}

static void place(const frame_t *frame, const sheet_t *sheet, size_t ring, size_t azimuth, double out[3]) {
    const double angle = TWO_PI * ((double)azimuth + 0.5 * (double)(ring % 2)) / (double)sheet->count[ring];
    const double x = sheet->rho[ring] * cos(angle);
    const double y = sheet->rho[ring] * sin(angle);
    for (size_t k = 0; k < 3; ++k) {
        out[k] = frame->centre[k] + x * frame->x[k] + y * frame->y[k] + sheet->height[ring] * frame->z[k];
    }
}

static double loss_at(gf_epoch_t *epoch, const double position[3]) {
    gf_sources_t sources;
    gf_sources(epoch->coils, position, &sources);
    ++epoch->evaluations;
    const double loss = gf_wahba_loss(epoch->coils->count, &sources, epoch->field_T, epoch->weight);
    return isfinite(loss) ? loss : INFINITY;
}

static void enter_sheet(const gf_epoch_t *epoch, size_t coil, double level, sheet_t *sheet) {
    gf_level_set_t set;
    gf_level_set(epoch->coils->moment_A_m2[coil], epoch->coils->radius_m[coil], level, &set);
    sheet->around = set.around;
    for (size_t ring = 0; ring < RINGS; ++ring) {
        const size_t ray = ring < GF_RAYS ? ring : RINGS - 1 - ring;
        const double steps = ceil(TWO_PI * set.rho_m[ray] / set.spacing_m[ray]);
        sheet->rho[ring] = set.rho_m[ray];
        sheet->height[ring] = ring < GF_RAYS ? set.z_m[ray] : -set.z_m[ray];
        sheet->count[ring] = (size_t)fmin(fmax(steps, LEAST_AZIMUTHS), MOST_AZIMUTHS);
    }
}

static void fill_sheet(gf_epoch_t *epoch, const frame_t *frame, sheet_t *sheet) {
    for (size_t ring = 0; ring < RINGS; ++ring) {
        for (size_t azimuth = 0; azimuth < sheet->count[ring]; ++azimuth) {
            double position[3];
            place(frame, sheet, ring, azimuth, position);
            sheet->loss[ring][azimuth] = loss_at(epoch, position);
        }
    }
}

void gf_spread(gf_epoch_t *epoch, size_t coil, gf_pose_t out[GF_SPREAD]) {
    frame_t frame;
    sheet_t sheet;
    enter_frame(epoch->coils, coil, &frame);
    enter_sheet(epoch, coil, strength(epoch, coil), &sheet);
    gf_soften(epoch, COARSENESS);
    for (size_t i = 0; i < GF_SPREAD; ++i) {
        const size_t ring = i % RINGS;
        const size_t azimuth = i / RINGS * sheet.count[ring] * RINGS / GF_SPREAD;
        place(&frame, &sheet, ring, azimuth, out[i].position_m);
        gf_align(epoch, &out[i]);
    }
}

/* Whether no neighbour is better: two on the ring, and the nearest three on either ring beside it. The first ring and
 * the last meet in the coil's plane. */
static bool is_least(const sheet_t *sheet, size_t ring, size_t azimuth) {
    const double mine = sheet->loss[ring][azimuth];
    if (!isfinite(mine)) {
        return false;
    }
    for (size_t side = 0; side < 3; ++side) {
        const size_t other = (ring + RINGS + side - 1) % RINGS;
        if (!sheet->around && ring + other == RINGS - 1 && ring != 0 && other != 0) {
            continue; /* the other end of the axis */
        }
        const size_t count = sheet->count[other];
        const size_t middle = azimuth * count / sheet->count[ring];
        for (size_t step = 0; step < 3; ++step) {
            const size_t near = (middle + count + step - 1) % count;
            if (sheet->loss[other][near] < mine && !(other == ring && near == azimuth)) {
                return false;
            }
        }
    }
    return true;
}

size_t gf_candidates(gf_epoch_t *epoch, size_t coil, gf_pose_t out[GF_CANDIDATES]) {
    const double magnitude = strength(epoch, coil);
    const double noise = epoch->sigma_T[coil] / fmax(magnitude, 1e-300);
    const size_t levels = noise > NOISY ? LEVELS : 1;
    double best[GF_CANDIDATES];
    size_t found = 0;
    frame_t frame;
    enter_frame(epoch->coils, coil, &frame);
    gf_soften(epoch, COARSENESS);
    for (size_t level = 0; level < levels; ++level) {
        static const double sides[LEVELS] = {0.0, -1.0, 1.0};
        const double part = fmin(LEVEL_STEP * noise, 0.7);
        sheet_t sheet;
        enter_sheet(epoch, coil, magnitude * (1.0 + sides[level] * part), &sheet);
        fill_sheet(epoch, &frame, &sheet);
        for (size_t ring = 0; ring < RINGS; ++ring) {
            for (size_t azimuth = 0; azimuth < sheet.count[ring]; ++azimuth) {
                const double loss = sheet.loss[ring][azimuth];
                if (!is_least(&sheet, ring, azimuth) || (found == GF_CANDIDATES && loss >= best[found - 1])) {
                    continue;
                }
                size_t rank = found < GF_CANDIDATES ? found++ : found - 1;
                for (; rank > 0 && loss < best[rank - 1]; --rank) {
                    best[rank] = best[rank - 1];
                    out[rank] = out[rank - 1];
                }
                best[rank] = loss;
                place(&frame, &sheet, ring, azimuth, out[rank].position_m);
            }
        }
    }
    for (size_t i = 0; i < found; ++i) {
        gf_align(epoch, &out[i]);
    }
    return found;
}

void gf_align(gf_epoch_t *epoch, gf_pose_t *pose) {
    gf_sources_t sources;
    gf_sources(epoch->coils, pose->position_m, &sources);
    ++epoch->evaluations;
    gf_attitude(epoch->coils->count, &sources, epoch->field_T, epoch->weight, pose->rotation);
}
