/* can_filter.h: acceptance filters of bxCAN (RM0090 32.7.4). Pure functions of the filter registers. */
#ifndef GOLDFIELD_CAN_FILTER_H
#define GOLDFIELD_CAN_FILTER_H

#include "boards/board_edge.h"

typedef struct {
    uint32_t mode, scale, fifo, active; /* FM1R, FS1R, FFA1R, FA1R: a bit a bank. */
    uint32_t bank[28][2];
    unsigned first, end; /* This controller's banks: first .. end - 1. */
} can_filters_t;

/* Whether a frame passes, and if so its FIFO (0, 1) and the filter match index. Time of a call: up to 28 banks. */
bool can_filter_match(const can_filters_t *filters, const board_frame_t *frame, unsigned *fifo, unsigned *index);

#endif
