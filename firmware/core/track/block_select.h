/* block_select.h: which beacons a track uses where there are more than BLOCK_SELECTED: the strongest, and in turn some
 * of the others; and what the rest adds to the sums of a block, taken out.
 *
 * Calls: block_select at the beginning of each cycle, then block_select_reduce with each block.
 *
 * Method. The time of block_filter.h grows with the square of the number of columns, while the weakest of many beacons
 * tell next to nothing. Of those that are believed BLOCK_SELECTED - BLOCK_GUESTS are taken whose fields are the
 * strongest at the track's position; one that was among them stays until another is stronger by a fifth, so that a
 * sensor on a border does not change them to and fro. BLOCK_GUESTS of the others are taken in turn: thus all of
 * them are compared with the site again and again, and a beacon that is silent is found although it is weak.
 * Beacons that are not believed have columns of their own beside these, since their fields are unknown.
 *
 * The sums hold the signals of the rest, too: codes are not orthogonal within 31 chips. They are known as well as the
 * track is, and are subtracted as they should be at the predicted state, at rest; docs/blocks.md tells
 * what is left of them.
 *
 * Time (Cortex-M4, -O3), with 32 beacons: block_select 12,000 instructions, block_select_reduce 13,000.
 */
#ifndef GOLDFIELD_BLOCK_SELECT_H
#define GOLDFIELD_BLOCK_SELECT_H

#include <stdbool.h>
#include <stdint.h>

#include "core/pose/loop_field.h"
#include "core/track/block_gram.h"
#include "core/track/block_state.h"

#define BLOCK_SELECTED 16u /* Most beacons that are believed and used. With 32 the time is that of 16. */
#define BLOCK_GUESTS   2u  /* How many of them are taken in turn. */

#define BLOCK_GUEST_CYCLES 2u /* For how many cycles: the first is judged while the second one lasts. */

typedef struct {
    uint32_t count;              /* Beacons that have columns. */
    uint8_t rows[BLOCK_BEACONS]; /* Which, rising. */
    uint32_t strong, guests;     /* A bit for each of the strongest, and of those taken in turn, ... */
    uint32_t cycles, next;       /* ... for so many cycles now; the row from which on others are looked for. */
} block_select_t;

/* Choose from so many coils at a position; a bit of out stands for each that is not believed. hold keeps those that are
 * taken in turn: one of them may be what does not agree with the site. */
void block_select(block_select_t *select, const loop_t *coils, uint32_t count, const float position_m[3], uint32_t out,
                  bool hold);

/* Take from the sums of a block, whose columns are those that were chosen, the signals of all others. bits are the
 * codes of all so many coils in the block, as for block_gram. */
void block_select_reduce(const block_select_t *select, const loop_t *coils, uint32_t count, const uint32_t *bits,
                         uint32_t chips, const block_state_t *state, block_t *block);

#endif
