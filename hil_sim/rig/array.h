/* array.h: growth of a plain array. The simulator cannot go on without memory, so lack of it ends the process with a
 * message. */
#ifndef GOLDFIELD_ARRAY_H
#define GOLDFIELD_ARRAY_H

#include <stddef.h>

/* Room for at least needed items: returns items, or where they have been moved to; updates *capacity (at least
 * doubled when it grows). */
void *array_reserve(void *items, size_t *capacity, size_t needed, size_t item_size);

#endif
