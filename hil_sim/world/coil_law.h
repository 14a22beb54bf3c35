/* coil_law.h: the laws that the currents of a coil follow between two changes, in closed form. coil.h has their
 * equations.
 *
 * coil.c fills a segment in (the circuit) and the currents at a piece's start; coil_law_hold() or coil_law_drive() says
 * what goes on from there, coil_law_arrival() for how long, and the others look at it. elapsed counts from the piece's
 * start, in seconds.
 */
#ifndef GOLDFIELD_WORLD_COIL_LAW_H
#define GOLDFIELD_WORLD_COIL_LAW_H

#include "world/coil.h"

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
