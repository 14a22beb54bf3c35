/* sync.c: a chip clock that is told anything: edges of a wire, messages of masters on CAN, estimates, and who leads.
 * Each planned chip has an allowed length and a place in its cycle, begins where the one before it ended, and is found
 * again; a clock leads locked, holds over no longer than it may, and tells a finite error. */
#include "services/sync.c" /* It is no part of the core; what it needs of other services stands below. */

#include "fuzz.h"

typedef struct {
    chip_clock_t clock;
    sync_link_t link;
    sync_format_t format;
    chip_clock_chip_t latest;
    uint32_t planned, since; /* Chips planned, and those since something was told that counts as an edge. */
} follower_t;

static hal_stamp_t waiting;
static bool stamped;

/* The two functions that sync.c needs of others. */
bool hal_can_stamp(hal_t *hal, hal_stamp_t *stamp) {
    (void)hal;
    if (stamped) {
        *stamp = waiting;
    }
    const bool there = stamped;
    stamped = false;
    return there;
}

void node_send(node_t *node, node_links_t links, uint32_t message, uint32_t index, const uint8_t *data,
               uint8_t length) {
    (void)node;
    REQUIRE(links == NODE_CAN && message == GOLDFIELD_FOLLOW_UP_FRAME_ID && index == 0u && length <= 8u);
    struct goldfield_follow_up_t told;
    REQUIRE(goldfield_follow_up_unpack(&told, data, length) == 0);
    REQUIRE(told.cycle <= SYNC_CYCLE_MASK);
}

static void plan(follower_t *follower, uint32_t chips) {
    chip_clock_t *const clock = &follower->clock;
    for (uint32_t i = 0; i < chips; i++) {
        const uint32_t absolute = clock->chip;
        const chip_clock_chip_t chip = chip_clock_plan(clock);
        chip_clock_chip_t found;
        REQUIRE(chip.period_ticks >= HAL_CHIP_TICKS_MIN && chip.period_ticks <= HAL_CHIP_TICKS_MAX);
        REQUIRE(chip.code_chip < clock->config.chips && sync_chip(&follower->format, &chip) < follower->format.chips);
        REQUIRE(follower->planned == 0u || chip.position == follower->latest.position + follower->latest.period_ticks);
        REQUIRE(chip_clock_at(clock, absolute, &found) && found.position == chip.position);
        REQUIRE(found.code_chip == chip.code_chip && found.period_ticks == chip.period_ticks);
        REQUIRE(!chip_clock_at(clock, absolute + 1u, &found));
        follower->latest = chip;
        follower->planned++;
        follower->since++;
    }
    /* A cycle and a half of grace: where the last edge lay in its cycle is not known here. */
    const uint32_t longest = (2u * CHIP_CLOCK_HOLDOVER_CYCLES + 3u) * clock->config.chips / 2u +
                             CHIP_CLOCK_HOLDOVER_CYCLES / 2u * clock->config.chips;
    REQUIRE(!clock->config.follow || !clock->locked || follower->since <= longest);
    REQUIRE(clock->config.follow || clock->locked);
}

static void look(const follower_t *follower) {
    const chip_clock_quality_t quality = chip_clock_quality(&follower->clock, 168);
    const double chip_ticks = (double)follower->clock.period / 4294967296.0;
    REQUIRE(chip_ticks >= HAL_CHIP_TICKS_MIN && chip_ticks <= HAL_CHIP_TICKS_MAX);
    REQUIRE(quality.rate_ppb >= -11000000 && quality.rate_ppb <= 11000000);
    REQUIRE(follower->clock.config.follow || quality.error_ns == 0u);
}

/* A frame of CAN that ended in a chip not long ago, of one of the two types or of any other. */
static void stamp(follower_t *follower, input_t *input) {
    waiting = (hal_stamp_t){.chip = follower->clock.chip - take_u8(input),
                            .ticks = (uint16_t)(take_u16(input) % 17000u)};
    const uint32_t kind = take_u8(input);
    waiting.sent = kind % 4u == 3u;
    const uint32_t node = kind / 4u % 4u, cycle = take_u16(input) % 32u;
    uint8_t *const data = waiting.frame.data;
    if (kind % 8u < 4u) {
        const struct goldfield_sync_t sync = {.cycle = cycle, .chips = follower->format.chips};
        waiting.frame.id = GOLDFIELD_SYNC_FRAME_ID | node;
        waiting.frame.length = (uint8_t)goldfield_sync_pack(data, &sync, 8);
    } else {
        const struct goldfield_follow_up_t follow_up = {.cycle = cycle,
                                                        .ticks = (int32_t)take_u32(input) / (1 << (kind >> 4))};
        waiting.frame.id = GOLDFIELD_FOLLOW_UP_FRAME_ID | node;
        waiting.frame.length = (uint8_t)goldfield_follow_up_pack(data, &follow_up, 8);
    }
    if (kind >= 0xF0u) {
        waiting.frame.id ^= take_u32(input) & FRAME_ID_MAX;
        waiting.frame.length = (uint8_t)(take_u8(input) % 9u);
        memset(data, take_u8(input), 4);
    }
    stamped = true;
    sync_link_serve(&follower->link, &follower->clock, &follower->format, NULL);
    follower->since = 0;
}

/* An edge that is off where one is due by a little, or anywhere. */
static void edge(follower_t *follower, input_t *input) {
    const chip_clock_t *const clock = &follower->clock;
    const uint32_t off = take_u16(input), back = take_u8(input) % 140u;
    const uint32_t to_begin = clock->code_chip < CHIP_CLOCK_HISTORY ? clock->code_chip : back;
    if (off < 0xC000u) {
        (void)chip_clock_edge(&follower->clock, clock->chip - to_begin, (uint16_t)(off % 64u));
    } else {
        (void)chip_clock_edge(&follower->clock, clock->chip - back, (uint16_t)off);
    }
    follower->since = 0;
}

/* What the estimate of the field, or who leads, does to the clock. */
static void other(follower_t *follower, input_t *input, uint32_t what) {
    chip_clock_t *const clock = &follower->clock;
    const uint64_t position = (uint64_t)(clock->position - take_u16(input) * 256u) << 32;
    const uint64_t period = ((uint64_t)HAL_CHIP_TICKS << 32) + (uint64_t)((int64_t)(int32_t)take_u32(input) * 256);
    int32_t phase;
    chip_clock_mark_t mark;
    follower->since = 0;
    switch (what % 8u) {
    case 0:
        chip_clock_jump(clock, position, period);
        break;
    case 1:
        chip_clock_correct(clock, (int16_t)take_u16(input) * 4294967296, (int8_t)take_u8(input) * 268435456LL,
                           (int8_t)take_u8(input), what % 16u >= 8u);
        break;
    case 2:
        clock->config.follow = true; /* A master that steps back does so, too (timing.c). */
        sync_link_follow(&follower->link, clock, what % 16u >= 8u);
        break;
    case 3:
        chip_clock_lead(clock, what % 16u >= 8u);
        break;
    case 4:
        if (!clock->config.follow) {
            chip_clock_yield(clock, what % 16u >= 8u ? &chip_clock_link : &chip_clock_wire);
        }
        break;
    case 5:
        (void)sync_number(clock, &follower->format, &follower->link, follower->format.chips, take_u32(input) >> 12,
                          take_u16(input));
        break;
    case 6:
        sync_distrust(clock, &follower->link);
        break;
    default:
        if (chip_clock_mark(clock, clock->chip - take_u8(input), take_u16(input) % 32000u, &mark)) {
            (void)chip_clock_phase(clock, &mark, (int32_t)take_u32(input), &phase);
            (void)chip_clock_compare(clock, clock->chip - take_u8(input), take_u16(input));
        }
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size) {
    static const uint8_t degrees[] = {5, 6, 7, 9, 10, 11};
    static follower_t follower;
    input_t input = {bytes, size};
    const uint32_t mode = take_u8(&input);
    memset(&follower, 0, sizeof follower);
    stamped = false;
    follower.format = sync_format(degrees[mode % 6u]);
    follower.link.compares = mode >= 128u;
    sync_clock_init(&follower.clock, &follower.format, mode % 16u != 15u);
    if (mode % 3u == 0u) {
        follower.clock.chip = 0xFFFFF000u; /* The count wraps harmlessly. */
    }
    for (uint32_t turns = 0; input.left > 0u && turns < 64u; turns++) {
        const uint32_t what = take_u8(&input);
        plan(&follower, what % 4u == 3u ? follower.clock.config.chips - follower.clock.code_chip : take_u8(&input));
        switch (what / 4u % 4u) {
        case 0:
            edge(&follower, &input);
            break;
        case 1:
            stamp(&follower, &input);
            break;
        case 2:
            other(&follower, &input, what / 16u);
            break;
        default:
            sync_link_answer(&follower.link, NULL);
        }
        look(&follower);
    }
    return 0;
}
