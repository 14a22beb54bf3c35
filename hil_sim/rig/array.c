#include "rig/array.h"

#include <stdio.h>
#include <stdlib.h>

void *array_reserve(void *items, size_t *capacity, size_t needed, size_t item_size) {
    if (needed <= *capacity) {
        return items;
    }
    size_t grown = *capacity > 0 ? *capacity : 16;
    while (grown < needed) {
        grown *= 2;
    }
    void *const moved = realloc(items, grown * item_size);
    if (moved == NULL) {
        fputs("goldfield rig: out of memory\n", stderr);
        abort();
    }
    *capacity = grown;
    return moved;
}
