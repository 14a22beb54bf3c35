/* array.h: growth of a plain array. The simulator cannot go on without memory, so lack of it ends the process with a
 * message. */
#ifndef GOLDFIELD_ARRAY_H
#define GOLDFIELD_ARRAY_H

#include <stddef.h>

/* Make room for at least needed items of item_size bytes, and update *capacity, which at least doubles when it grows.
 * Returns the items, which may have moved. */
void *array_reserve(void *items, size_t *capacity, size_t needed, size_t item_size);

#endif
