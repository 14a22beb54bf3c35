#include "services/sync.h"

#include <stddef.h>

#include "core/link/messages.h"
#include "goldfield.h"
#include "protocol_hash.h"

_Static_assert(GOLDFIELD_SYNC_FRAME_ID == HAL_CAN_STAMP_0 && GOLDFIELD_FOLLOW_UP_FRAME_ID == HAL_CAN_STAMP_1,
               "The board stamps these two");

sync_format_t sync_format(uint32_t degree) {
    return (sync_format_t){
        .degree = (uint16_t)degree,
        .chips = (uint16_t)((1u << degree) - 1u),
        .cycles = (uint16_t)(degree < 10u ? 1u << (10u - degree) : 1u),
    };
}

void sync_clock_init(chip_clock_t *clock, const sync_format_t *format, bool follow) {
    const chip_clock_config_t config = {
        .chips = (uint16_t)(format->chips * format->cycles),
        .nominal_ticks = HAL_CHIP_TICKS,
        .minimum_ticks = HAL_CHIP_TICKS_MIN,
        .maximum_ticks = HAL_CHIP_TICKS_MAX,
        .follow = follow,
    };
    (void)chip_clock_init(clock, &config); /* It cannot fail: all formats lie in its ranges. */
}

sync_told_t sync_number(chip_clock_t *clock, const sync_format_t *format, const sync_link_t *link, uint32_t chips,
                        uint32_t cycle, uint32_t age_us) {
    if (chips != format->chips) {
        return SYNC_OTHER_LENGTH;
    }
    if (clock->tracking && clock->config.follow && !link->follows && age_us < SYNC_FRESH_US) {
        chip_clock_number_cycle(clock, cycle / format->cycles);
        return SYNC_NUMBERED;
    }
    return SYNC_IDLE;
}

void sync_distrust(chip_clock_t *clock, const sync_link_t *link) {
    if (clock->config.follow && !link->follows) {
        chip_clock_forget(clock, &chip_clock_wire);
    }
}

int32_t sync_phase(int32_t ticks) {
    return (int32_t)((int64_t)ticks * 100 / (int32_t)(HAL_TICKS_PER_SECOND / 1000000u));
}

/* ---- Timing over CAN ---- */

/* Returns the cycles from b to a, whose numbers have 20 bits. */
static int32_t cycles_between(uint32_t a, uint32_t b) {
    const uint32_t difference = (a - b) & SYNC_CYCLE_MASK;
    return (int32_t)difference - (difference > SYNC_CYCLE_MASK / 2u ? (int32_t)SYNC_CYCLE_MASK + 1 : 0);
}

/* Prepares the FOLLOW_UP of a master whose own SYNC ended at the mark. One that main has not fetched yet stays. */
static void answer(sync_link_t *link, const chip_clock_t *clock, const sync_format_t *format, uint32_t cycle,
                   const chip_clock_mark_t *mark) {
    const int32_t cycles = cycles_between(mark->cycle * format->cycles, cycle),
                  limit = SYNC_PERIODS_LATE * format->cycles;
    if (!__atomic_load_n(&link->answer_due, __ATOMIC_ACQUIRE) && cycles >= -limit && cycles <= limit) {
        link->answer_cycle = cycle;
        link->answer_ticks = cycles * format->chips * (int32_t)HAL_CHIP_TICKS +
                             chip_clock_told(clock, mark->cycle_ticks);
        __atomic_store_n(&link->answer_due, true, __ATOMIC_RELEASE);
    }
}

static sync_seen_t *find(sync_link_t *link, uint32_t node, uint32_t cycle) {
    for (uint32_t i = 0; i < SYNC_SEEN; i++) {
        if (link->seen[i].open && link->seen[i].node == node && link->seen[i].cycle == cycle) {
            return &link->seen[i];
        }
    }
    return NULL;
}

/* Notes a SYNC, sent or received. If one is sent twice, the second counts, as it does for its master. */
static void take_sync(sync_link_t *link, const chip_clock_t *clock, const sync_format_t *format,
                      const hal_stamp_t *stamp) {
    struct goldfield_sync_t sync = {0};
    chip_clock_mark_t mark;
    (void)goldfield_sync_unpack(&sync, stamp->frame.data, stamp->frame.length);
    if (sync.chips != format->chips || !chip_clock_mark(clock, stamp->chip, stamp->ticks, &mark)) {
        return;
    }
    if (stamp->sent) {
        answer(link, clock, format, sync.cycle, &mark);
    } else {
        const uint32_t node = stamp->frame.id & PROTOCOL_NODE_MASK;
        sync_seen_t *before = find(link, node, sync.cycle);
        sync_seen_t *place = before ? before : &link->seen[link->count++ % SYNC_SEEN];
        *place = (sync_seen_t){.open = true, .node = node, .cycle = sync.cycle, .mark = mark};
    }
}

static void take_follow_up(sync_link_t *link, chip_clock_t *clock, const sync_format_t *format,
                           const hal_frame_t *frame) {
    struct goldfield_follow_up_t follow_up = {0};
    (void)goldfield_follow_up_unpack(&follow_up, frame->data, frame->length);
    sync_seen_t *seen = find(link, frame->id & PROTOCOL_NODE_MASK, follow_up.cycle);
    if (seen == NULL) {
        return;
    }
    seen->open = false;
    link->message_chip = clock->chip;
    if (!clock->config.follow || !link->follows) {
        link->compared = chip_clock_phase(clock, &seen->mark, follow_up.ticks, &link->rival_phase);
        link->rival_node = seen->node;
        link->rival_chip = clock->chip;
        const bool near = link->compared && link->rival_phase <= SYNC_NEAR_TICKS &&
                          link->rival_phase >= -SYNC_NEAR_TICKS;
        link->good = near ? link->good + 1u : 0u;
        return;
    }
    if (chip_clock_message(clock, &seen->mark, follow_up.ticks)) {
        chip_clock_number_cycle(clock, follow_up.cycle / format->cycles);
        link->leader = seen->node;
    }
}

void sync_link_serve(sync_link_t *link, chip_clock_t *clock, const sync_format_t *format, hal_t *hal) {
    hal_stamp_t stamp;
    for (uint32_t taken = 0; taken < SYNC_STAMPS_A_BLOCK && hal_can_stamp(hal, &stamp); taken++) {
        if (message_fault(stamp.frame.id, stamp.frame.length) != MESSAGE_OK) {
            continue; /* Somebody else's frame; the node counts it. */
        }
        const bool is_sync = (stamp.frame.id & HAL_CAN_TYPE_MASK) == GOLDFIELD_SYNC_FRAME_ID;
        const bool listens = link->follows || link->compares || !clock->config.follow;
        if (is_sync && (stamp.sent || listens)) {
            take_sync(link, clock, format, &stamp);
        } else if (!is_sync && !stamp.sent && listens) {
            take_follow_up(link, clock, format, &stamp.frame);
        }
    }
}

void sync_link_follow(sync_link_t *link, chip_clock_t *clock, bool follows) {
    link->follows = false; /* It comes first: the interrupt now keeps its hands off. */
    chip_clock_forget(clock, follows ? &chip_clock_link : &chip_clock_wire);
    link->follows = follows;
}

void sync_link_answer(sync_link_t *link, node_t *node) {
    if (!__atomic_load_n(&link->answer_due, __ATOMIC_ACQUIRE)) {
        return;
    }
    const struct goldfield_follow_up_t follow_up = {.cycle = link->answer_cycle, .ticks = link->answer_ticks};
    uint8_t data[8];
    const uint8_t length = (uint8_t)goldfield_follow_up_pack(data, &follow_up, sizeof data);
    node_send(node, NODE_CAN, GOLDFIELD_FOLLOW_UP_FRAME_ID, 0, data, length);
    __atomic_store_n(&link->answer_due, false, __ATOMIC_RELEASE);
}
