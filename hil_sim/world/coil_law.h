/* coil_law.h: the laws that the currents of a coil follow between two changes, in closed form. coil.h has their
 * equations.
 *
 * coil.c fills a segment in (the circuit) and the currents at a piece's start; coil_law_hold() or coil_law_drive() says
 * what goes on from there, coil_law_arrival() for how long, and the others look at it. elapsed counts from the piece's
 * start, in seconds.
 */
#ifndef GOLDFIELD_WORLD_COIL_LAW_H
#define GOLDFIELD_WORLD_COIL_LAW_H

#include <stdbool.h>
#include <stdint.h>

#define COIL_PIECES 4 /* Most pieces of a segment: down by the diodes, zero, toward the target, held. */

#define COIL_MODES 2 /* Most time constants of a current: shorted turns have a second. */

#define COIL_GONE_LAGS 40.0 /* exp(-this) is below a tenth of the last bit of 1: added to 1 it changes nothing. */

/* One law of the currents, in force between two ages of its segment: limit + sum of mode exp(-t / slow). */
typedef struct {
    double since_s, until_s;
    double current_A; /* Current at the piece's start. */
    double second_A;  /* Current in the shorted turns at the piece's start. */
    double lagged_A;  /* Lagged current at the piece's start. */
    double limit_A;   /* Where the current tends to; that in the shorted turns tends to 0. */
    double slow_s[COIL_MODES];
    double mode_A[COIL_MODES], second_mode_A[COIL_MODES];
    unsigned modes; /* 0: the current stays as it is. */
    bool held;      /* It stays at current_A, whatever the shorted turns do. */
} coil_piece_t;

typedef struct {
    int64_t start_ps;
    double full_A;     /* Where the supply alone would bring the current. */
    double shorted;    /* Share of the turns that are shorted, f; 0: none. */
    double first_H;    /* Inductance of the turns that are not, L1; L if there are none that are. */
    double mutual_H;   /* M. */
    double second_H;   /* L2. */
    double copper_Ohm; /* Resistance of the turns that are driven, */
    double second_Ohm; /* and of those that are shorted. */
    double loop_Ohm;   /* That of the copper and of the supply. */
    double supply_V;
    double slow_s[COIL_MODES]; /* Time constants while the supply drives, */
    double held_s;             /* and that of the shorted turns while the driver holds the current. */
    double dead_s;             /* Until then both halves of the bridge are off. */
    unsigned count;            /* Pieces; the last is in force for ever. */
    coil_piece_t piece[COIL_PIECES];
} coil_segment_t;

/* The driver holds the current where it is; that in the shorted turns dies away. */
void coil_law_hold(const coil_segment_t *segment, coil_piece_t *piece);

/* The supply drives the current toward a limit. */
void coil_law_drive(const coil_segment_t *segment, coil_piece_t *piece, double limit_A);

/* Returns when a driven current arrives at a target on its way to the limit; infinite if it never does. */
double coil_law_arrival(const coil_segment_t *segment, const coil_piece_t *piece, double target_A);

/* Return the current, and that in the shorted turns, A. */
double coil_law_current(const coil_piece_t *piece, double elapsed);
double coil_law_second(const coil_piece_t *piece, double elapsed);

/* Returns the field's current behind a low-pass with the time constant lag, s, which is none of the circuit's. */
double coil_law_lagged(const coil_segment_t *segment, const coil_piece_t *piece, double lag, double elapsed);

/* Returns the heat of the copper since the piece's start, J. */
double coil_law_heat(const coil_segment_t *segment, const coil_piece_t *piece, double elapsed);

#endif
