#include "core/drive/fall.h"

#include <stdbool.h>

#define SPARE 1.25f /* A fall of FALL_FAST needs so much more way, to be told from one that has arrived. */

/* Judges a fall of so many counts, of the counts that there were to fall. */
static cause_t judge(fall_t *watch, float fall, float way, float supply) {
    if (watch->learned < FALL_LEARNED) {
        if (fall > 0.0f && fall < 0.5f * way) {
            watch->learned++;
            watch->rate += (fall / supply - watch->rate) / (float)watch->learned;
        }
        return CAUSE_NONE;
    }
    const float most = FALL_FAST * watch->rate * supply;
    if (way < SPARE * most) {
        return CAUSE_NONE;
    }
    watch->fast = (uint8_t)(fall > most ? watch->fast + 1u : 0u);
    if (watch->fast < FALL_ROW) {
        return CAUSE_NONE;
    }
    watch->fast = 0;
    return CAUSE_EXCESS;
}

cause_t fall_edge(fall_t *watch, const fall_edge_t *edge) {
    const int32_t before = edge->before;
    const bool large = before >= FALL_MINIMUM || before <= -FALL_MINIMUM;
    if (!large || before * edge->wanted > 0 || edge->supply == 0u) {
        return CAUSE_NONE; /* It does not fall, or one cannot tell. */
    }
    const int32_t sign = before < 0 ? -1 : 1, size = sign * before;
    const float fall = (float)(size - sign * edge->came), way = (float)(size - sign * edge->wanted);
    return judge(watch, fall, way, (float)edge->supply);
}
