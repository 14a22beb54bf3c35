/* atomics.h: stands for the compiler's own, which Frama-C does not know. The other context may have changed a word at
 * any moment: what is read is anything. */
#ifndef GOLDFIELD_PROOF_ATOMICS_H
#define GOLDFIELD_PROOF_ATOMICS_H

#include "any.h"

#define __atomic_load_n(place, order)         ((void)*(place), any_word())
#define __atomic_store_n(place, value, order) (*(place) = (value))

#endif
