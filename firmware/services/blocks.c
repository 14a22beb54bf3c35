#include "services/blocks.h"

#include <string.h>

#include "goldfield.h"

/* Resolutions and largest integers of BLOCK and BLOCK_SUM (goldfield.dbc); one below the smallest: not measured. */
#define PLAIN_T     8e-10f
#define PLAIN_LIMIT 262143
#define SUM_T       4e-10f
#define SUM_LIMIT   524287

_Static_assert(BLOCK_CHIPS == HAL_BLOCK_CHIPS, "The sums are those of the blocks that the chip engine executes.");

/* Makes the integers of a message from a sum. */
static void integers(const block_sums_t *sums, uint32_t row, float resolution_T, int32_t limit,
                     int32_t value[EPOCH_AXES]) {
    for (uint32_t axis = 0; axis < EPOCH_AXES; axis++) {
        const float scaled = sums->sums_T[row][axis] / ((float)BLOCK_CHIPS * resolution_T);
        /* What is not a number is in no range. */
        const bool measured = (sums->unmeasured >> axis & 1u) == 0u && scaled >= (float)-limit &&
                              scaled <= (float)limit;
        value[axis] = measured ? (int32_t)(scaled < 0.0f ? scaled - 0.5f : scaled + 0.5f) : -limit - 1;
    }
}

static void send(const block_sums_t *sums, node_t *node, node_links_t links, const epoch_selection_t *selection) {
    uint8_t data[8];
    int32_t value[EPOCH_AXES];
    integers(sums, sums->count, PLAIN_T, PLAIN_LIMIT, value);
    const struct goldfield_block_t block = {
        .x = value[0],
        .y = value[1],
        .z = value[2],
        .cycle_low = sums->cycle & 0x7u,
        .block_low = sums->number & 0xFu,
    };
    uint8_t length = (uint8_t)goldfield_block_pack(data, &block, sizeof data);
    node_send(node, links, GOLDFIELD_BLOCK_FRAME_ID, sums->chip, data, length);
    for (uint32_t i = 0; i < sums->count; i++) {
        integers(sums, i, SUM_T, SUM_LIMIT, value);
        const struct goldfield_block_sum_t sum = {
            .x = value[0], .y = value[1], .z = value[2], .block_low = sums->number & 0xFu};
        length = (uint8_t)goldfield_block_sum_pack(data, &sum, sizeof data);
        node_send(node, links, GOLDFIELD_BLOCK_SUM_FRAME_ID, selection->codes[i].code, data, length);
    }
    node_flush(node);
}

void blocks_start(blocks_t *blocks, const gold_family_t *family) {
    memset(blocks, 0, sizeof *blocks);
    code_bits_init(&blocks->codes, family);
    block_collect_init(&blocks->collector, family->length);
}

void blocks_configure(blocks_t *blocks, const parameters_t *parameters) {
    const bool poses = parameters_unsigned(parameters, PARAMETER_POSE) == 1u &&
                       parameters_unsigned(parameters, PARAMETER_POSE_BLOCKS) > 0u;
    blocks->links = (node_links_t)parameters_unsigned(parameters, PARAMETER_BLOCKS);
    blocks->wanted = blocks->links != NODE_NO_LINK || poses;
}

const block_sums_t *blocks_step(blocks_t *blocks, node_t *node, const epoch_selection_t *selection,
                                const epoch_calibration_t *calibration) {
    const block_samples_t *const block = block_ready(&blocks->collector);
    if (block == NULL) {
        return NULL;
    }
    block_sums(block, &blocks->codes, selection, calibration, &blocks->sums);
    block_release(&blocks->collector);
    const uint32_t messages = 1u + selection->count, report = selection->count + BLOCKS_REPORT_BESIDE;
    const node_links_t links = node_motion_room(node, blocks->links, messages, report);
    if (links != NODE_NO_LINK) {
        send(&blocks->sums, node, links, selection);
    }
    return &blocks->sums;
}
