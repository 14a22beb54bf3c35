/* edge_track.h: holds what is known of the beacons' edge against the own chips: how late the burst lies, how that
 * changes, and how long the field's ramp lasts.
 *
 * Calls, in the order they are made
 *   1. edge_track_start   after a search and the jump to its edge; edge_track_known with a phase from elsewhere.
 *   2. edge_track_move    to the middle of each record.
 *   3. edge_track_rise    with the two looks of the record, which tell the rise where edge_track_known left it open.
 *   4. edge_track_blind   with them, to see whether there is a ramp at all.
 *   5. edge_track_update  with them.
 *   6. edge_track_variance, to see whether the clock may lock.
 *
 * State. It is the time t from the beacons' edge to the burst's last conversion, ticks; its rate, ticks a chip; the
 * rise L of the ramp, ticks; and their covariance. It comes from a search (edge_fit.h) with the covariance that the
 * search's own noise tells. Between looks phase and rate run on; the rate walks by RATE_WALK.
 *
 * A look is the mean of a burst's late conversions minus the mean of its early ones, as a share of the field's change
 * at the edge: (R(late) - R(early)) / L, with R(t) = t - lag (1 - exp(-t / lag)), the foot of the ramp behind the
 * front end's low-pass (0 before the edge; the head of the ramp is never in a burst that straddles the foot). Earth,
 * mains and what noise a burst has in common cancel in it. Each look brings the variance that its own residuals
 * showed.
 *
 * Method. Two looks (the halves of a record) are joined with the state before them as knowledge, by Gauss and Newton
 * (an iterated extended Kalman filter in information form). The rise is estimated along: an error of it tilts all
 * times on the ramp by the same share, which a filter of phase and rate alone takes for a rate. Looks that fit badly
 * (chi squared above MISFIT) say that the phase is known worse than thought: it is then taken from the look alone.
 *
 * Time: about 15,000 instructions an update. Memory: 52 bytes.
 */
#ifndef GOLDFIELD_EDGE_TRACK_H
#define GOLDFIELD_EDGE_TRACK_H

#include <stdbool.h>
#include <stdint.h>

#include "core/timing/edge_fit.h"

/* How a burst of eight conversions is cut and seen. */
typedef struct {
    uint32_t early;         /* Conversions that count as early, 1..7. */
    float conversion_ticks; /* Time from one conversion to the next, ticks. */
    float lag_ticks;        /* Time constant of the front end's low-pass. */
} edge_burst_t;

typedef struct {
    float share;    /* Share of the change that the late conversions have done more than the early ones. */
    float variance; /* Variance of the share. */
    float chips;    /* When the look was taken, chips after the state's. */
} edge_look_t;

typedef struct {
    float time_ticks;       /* t: from the beacons' edge to the burst's last conversion, ticks. */
    float rate;             /* Change of t, ticks a chip. */
    float rise_ticks;       /* L: how long the ramp lasts, ticks; valid while rise_known. */
    float covariance[3][3]; /* Covariance of these three, in this order. */
    bool rise_known;        /* False: nothing has been seen of the ramp yet. */
} edge_track_t;

/* Begin after a search and a jump that puts the last conversion time_ticks behind the edge found. */
void edge_track_start(edge_track_t *track, const edge_fit_t *fit, float time_ticks);

/* Begin with a time and a rate of 0 that are known from elsewhere with these standard deviations, ticks and ticks a
 * chip. The rise is not known: edge_track_rise is to come before edge_track_blind and edge_track_update. */
void edge_track_known(edge_track_t *track, float time_ticks, float time_deviation, float rate_deviation);

/* Move the state on by so many chips, at least 0. */
void edge_track_move(edge_track_t *track, float chips);

/* Take the rise from the two looks of a record if nothing was known of it: as it would be if the time were right. Its
 * variance then is that of knowing nothing, and edge_track_update weighs it against the time. */
void edge_track_rise(edge_track_t *track, const edge_burst_t *burst, const edge_look_t looks[2]);

/* Returns true if the looks show no ramp at all, by their own noise, where the state says that there should be one:
 * the burst lies before the edge, or far behind it. */
bool edge_track_blind(const edge_track_t *track, const edge_burst_t *burst, const edge_look_t looks[2]);

/* Take the two looks of a record into the state. Looks that do not fit to what was known win over it. */
void edge_track_update(edge_track_t *track, const edge_burst_t *burst, const edge_look_t looks[2]);

/* Returns the variance of the time so many chips later, ticks squared. */
float edge_track_variance(const edge_track_t *track, float chips);

#endif
