/* sensing.h: a three-axis sensor among the coils: from currents and ambient fields to the volts at a board's
 * converters. sensing_init(), sensing_set_path(), then sensing_volts() for each conversion, and sensing_free().
 *
 *     field = rotation(t) * ambient(t) + magnets(t) + sum over all coils of (field per ampere)(t) * (lagged current)(t)
 *       sensor's frame
 *
 * Rotation, the field of magnets and the field per ampere come from the path (path.h), the volts from the front end
 * (front_end.h).
 *
 * The boards that drive the coils may run at the same time as the one that asks. So a sensor looks at each coil no
 * further than coils_t.head, which changes only while no board runs, and beyond that the coil's law goes on as if its
 * inputs stayed (coil.h). The coils of the sensor's own board are seen as they are.
 *
 * Bursts of conversions come close together, and within one the currents of nearly all coils have the same form
 * (coil_view()). So their sum is taken once, at the first conversion, as a cubic of vectors, and again when
 * coils_t.shown has changed or the form of a current ends; a coil is looked up if it has done something since. Coils
 * whose currents have another form, as amid an edge, are added one by one.
 *
 * One thread uses a sensing_t; any number of them look at the same coils_t. Time of a call: in a new burst a cubic a
 * coil; at a new time one cubic and one ambient field; at the same time as before (the three axes are converted at
 * once) nothing of that; then a normal number or two.
 */
#ifndef GOLDFIELD_WORLD_SENSING_H
#define GOLDFIELD_WORLD_SENSING_H

#include <stdbool.h>

#include "world/ambient.h"
#include "world/coil.h"
#include "world/front_end.h"
#include "world/path.h"

/* What others may see of a coil: the number of its latest segment, and how many were made up to that. */
typedef struct {
    uint64_t number, made;
} coil_head_t;

/* All coils of a rig, in the order of the path's columns. */
typedef struct {
    unsigned count;
    coil_t *coil;
    coil_head_t *head; /* One a coil. */
    uint64_t shown;    /* Counts up when heads change, or coils do on which no board runs. */
} coils_t;

/* Three components and a zero, which the processor takes together. */
typedef double sensing_four_t __attribute__((vector_size(32)));

typedef struct {
    const coils_t *coils;
    unsigned own_first, own_count; /* The coils of the sensor's own board. */
    const ambient_t *ambient;
    front_end_t front_end;
    path_t path; /* Without coefficients. */
    sensing_four_t
        *coefficients; /* An interval's after the other's: the cubics of the coils, then those of the rest. */
    coil_view_t *view; /* Views of the coils, each made when so many segments were; */
    uint64_t *view_made;
    double *limit_A;                          /* where their currents tend to, 0 for the others. */
    unsigned *other, others;                  /* Coils whose currents have another form. */
    sensing_four_t limit_sum[4], rest_sum[4]; /* Sums of the cubics times limits, and times rests, */
    size_t sum_interval;                      /* in this interval of the path, */
    uint64_t sum_shown;                       /* of what was shown then, */
    int64_t sum_ps, sum_until_ps, look_ps;    /* from a time to another; and the latest look at them. */
    double sum_lag_s;                         /* The lag of those that have a rest. */
    int64_t field_time_ps;                    /* The time that field_T belongs to. */
    double field_T[3];
} sensing_t;

/* coils and ambient must outlive the sensing; coils.count must have its final value. Returns false if there is no
 * memory. sensing_free() is due in both cases. */
bool sensing_init(sensing_t *sensing, const coils_t *coils, const ambient_t *ambient,
                  const front_end_config_t *front_end, uint64_t seed, unsigned board);
void sensing_free(sensing_t *sensing);

/* The path from now on; coefficients are copied. Returns false, and the old path stays, if the number of columns is
 * wrong, the path is empty, or there is no memory. */
bool sensing_set_path(sensing_t *sensing, const path_t *path);

/* The field in the sensor's frame, before the front end. A path must be set. */
void sensing_field(sensing_t *sensing, int64_t time_ps, double field_T[3]);
/* Returns the volts at the pin of an axis (0..2). Times of one axis must not decrease. */
double sensing_volts(sensing_t *sensing, unsigned axis, int64_t time_ps);

#endif
