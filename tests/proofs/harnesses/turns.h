/* turns.h: counts the turns of each `while` of the source that is included behind it, in functions whose name begins
 * with the letter COUNTED; a harness sets turns to 0 before a call. More than MOST_TURNS are an alarm. */
#ifndef GOLDFIELD_PROOF_TURNS_H
#define GOLDFIELD_PROOF_TURNS_H

#include <stdbool.h>
#include <stdint.h>

static uint32_t turns;

static inline bool count_turn(bool counted) {
    if (counted) {
        turns++;
        //@ assert turns <= MOST_TURNS;
    }
    return true;
}

/* A space behind the name would make it another macro. */
/* clang-format off */
#define while(condition) while (count_turn(__func__[0] == COUNTED) && (condition))
/* clang-format on */

#endif
