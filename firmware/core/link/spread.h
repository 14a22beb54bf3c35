/* spread.h: when in a period a board tells what it tells once in each, so that the boards of a bus do not all speak at
 * once: what is urgent would wait behind all of them.
 *
 * A period is divided into places, as many as there are or as are long enough, and the board's number tells which one
 * is its own. Boards whose numbers follow one another are two places apart, as two boards' places may begin up to one
 * place after one another: of 33 places (the blocks of a cycle) any 16 boards in a row of numbers leave a place free
 * between any two, and any 33 are alone in theirs.
 *
 * Time: a division. It has no state.
 */
#ifndef GOLDFIELD_SPREAD_H
#define GOLDFIELD_SPREAD_H

#include <stdint.h>

/* Returns the place of a board, below places. node is its number; there is at least one place. The last one of an even
 * number of places stays empty: steps of two then reach all others. */
uint32_t spread_place(uint32_t node, uint32_t places);

#endif
