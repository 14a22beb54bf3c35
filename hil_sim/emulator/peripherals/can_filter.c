/* can_filter.c: see can_filter.h. */
#include "emulator/peripherals/can_filter.h"

static uint32_t image32(const board_frame_t *f) {
    return (f->extended ? f->id << 3 | 4u : f->id << 21) | (f->remote ? 2u : 0);
}

static uint32_t image16(const board_frame_t *f) {
    const uint32_t standard = f->extended ? f->id >> 18 : f->id;
    return standard << 5 | (f->remote ? 0x10u : 0) | (f->extended ? 0x8u | (f->id >> 15 & 7u) : 0);
}

/* Filters of one bank, in order; -1: none passes. */
static int bank_match(const uint32_t bank[2], bool wide, bool list, const board_frame_t *frame) {
    if (wide) {
        const uint32_t image = image32(frame);
        if (list) {
            return image == (bank[0] & ~1u) ? 0 : image == (bank[1] & ~1u) ? 1 : -1;
        }
        return ((image ^ bank[0]) & bank[1] & ~1u) == 0 ? 0 : -1;
    }
    const uint32_t image = image16(frame);
    const uint32_t part[4] = {bank[0] & 0xFFFFu, bank[0] >> 16, bank[1] & 0xFFFFu, bank[1] >> 16};
    for (int i = 0; i < (list ? 4 : 2); i++) {
        if (list ? image == part[i] : ((image ^ part[2 * i]) & part[2 * i + 1]) == 0) {
            return i;
        }
    }
    return -1;
}

bool can_filter_match(const can_filters_t *filters, const board_frame_t *frame, unsigned *fifo, unsigned *index) {
    unsigned next[2] = {0, 0}; /* Filter numbers are counted for each FIFO, inactive banks too. */
    int best = -1;             /* 32 bits before 16, list before mask, then the lower number. */
    for (unsigned i = filters->first; i < filters->end; i++) {
        const bool wide = (filters->scale >> i & 1u) != 0, list = (filters->mode >> i & 1u) != 0;
        const unsigned to = filters->fifo >> i & 1u;
        const int rank = (wide ? 2 : 0) + (list ? 1 : 0);
        const int match = (filters->active >> i & 1u) != 0 ? bank_match(filters->bank[i], wide, list, frame) : -1;
        if (match >= 0 && rank > best) {
            best = rank;
            *fifo = to;
            *index = next[to] + (unsigned)match;
        }
        next[to] += (wide ? 1u : 2u) * (list ? 2u : 1u);
    }
    return best >= 0;
}
