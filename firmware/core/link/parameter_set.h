/* parameter_set.h: all parameters of a board as words, as they are saved in flash (storage/store.h), and back.
 *
 * Calls: parameter_set_write() makes the words, parameter_set_holds() looks whether they are right, and
 * parameter_set_read() takes them over, of another image as well.
 *
 * The words are a mark with the number of this format, the version of the image that wrote them, and runs: a head with
 * the id of the first value, the kind and how many values follow, then these values, whose ids are successive. So an
 * image reads what another one has written, older or newer, without a table of what that one knew:
 *   a value whose id it does not have, or of another kind, or out of its range, is skipped and counted;
 *   a parameter of its own of which the words hold nothing stays as it is.
 * What is skipped is not carried over: the next save holds what this image knows. A set holds every parameter of its
 * image, also those that have their defaults: what an image takes from a set does not depend on defaults, which may
 * change from one to the next. The number of the format changes only if a reader of this format would go wrong.
 *
 *   word 0   PARAMETER_SET_MARK | PARAMETER_SET_FORMAT
 *   word 1   version of the image: major << 16 | minor << 8 | patch; nobody acts on it
 *   a head   id of the first value (bits 11..0) | parameter_kind_t (15..12) | values that follow (31..16), 1 and more
 *
 * Contexts: all calls come from main. Memory: none beside the caller's. Time: to read, a search of the table for each
 * value.
 */
#ifndef GOLDFIELD_PARAMETER_SET_H
#define GOLDFIELD_PARAMETER_SET_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/link/parameters.h"

#define PARAMETER_SET_MARK   0x50415200u /* "PAR" above the format's number. */
#define PARAMETER_SET_FORMAT 1u
/* Words of every set of this image. */
#define PARAMETER_SET_WORDS (2u + PARAMETERS_COUNT + PARAMETERS_RUNS)

typedef enum {
    PARAMETER_SET_LOADED = 0, /* The set was read; single values may have been refused. */
    PARAMETER_SET_OTHER = 1,  /* Its format is another one than this image reads: nothing was taken. */
    PARAMETER_SET_BAD = 2     /* Its runs do not add up to its length: nothing was taken. */
} parameter_set_t;

/* Write all parameters into words, of which there are PARAMETER_SET_WORDS.
 * Returns how many it has written, which is all of them. */
uint32_t parameter_set_write(const parameters_t *parameters, uint32_t version, uint32_t *words);

/* Look at PARAMETER_SET_WORDS words, one by one and to the end: an instruction that went wrong as they were written is
 * seen.
 * Returns whether they are what parameter_set_write() makes of the parameters. */
bool parameter_set_holds(const parameters_t *parameters, uint32_t version, const uint32_t *words);

/* Set parameters from count words. *refused tells how many values were skipped.
 * Returns what became of the set. */
parameter_set_t parameter_set_read(parameters_t *parameters, const uint32_t *words, uint32_t count, uint32_t *refused);

#endif
