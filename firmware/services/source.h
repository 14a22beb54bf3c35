/* source.h: which source of time a board's chip clock follows that chooses itself (parameter sync_source = 3): the sync
 * wire, messages on CAN or, on a sensor, the beacons' field. timing.h owns the clock and calls this module.
 *
 * Calls, in the order they are made
 *   1. source_automatic  when the parameter is read.
 *   2. source_edge       from sync, for each edge of the wire.
 *   3. source_choose     from plan, before chips are planned.
 *   4. source_asks, source_ready  in main: the application prepares to follow the field.
 *
 * A clock in step keeps its phase, its rate and its numbers through every change; the difference, at most 1 us, is
 * slewed off. Only a source that tells what the clock has is taken, in this order: the wire, CAN, the field.
 *   from        to      when
 *   wire        CAN     no edge has fitted for 3 sync periods, and the last 3 messages agreed within 1 us
 *   wire, CAN   field   nothing has told the time for 5 sync periods, and nothing else can be taken
 *   CAN, field  wire    10 edges in a row lay within 1 us; from CAN that is silent 2
 *   field       CAN     10 messages in a row agreed within 1 us
 * So a clock in hold-over to which wire or messages tell another time keeps to itself, or to the field, as long as it
 * has the lock.
 *
 * A clock that is not in step looks for any source: CAN if no edge of the wire has fitted for 6 periods, the wire if
 * CAN falls silent, the field if neither has told the time for 8. It leaves the field, if that gives no lock in 20
 * periods, for a wire with edges or a CAN with messages.
 *
 * The field. The application does what acquire.h needs in main: source_asks tells that the clock would follow the
 * field, and source_ready that all is prepared; plan then goes over. Own chips begin late_ticks after the beacons'
 * while the field is followed (acquire.h); this is slewed, too, within three chips, and what compares wire and messages
 * with the clock allows for it. The numbers of the cycles go on; a sensor that has known nothing but the field since
 * its start counts from there, until the wire or CAN tells the numbers.
 *
 * Each change is counted (COUNTER_SYNC_CHANGES).
 */
#ifndef GOLDFIELD_SOURCE_H
#define GOLDFIELD_SOURCE_H

#include "core/timing/chip_clock.h"
#include "services/sync.h"

#define SOURCE_SILENT_PERIODS 3u  /* Sync periods without a sound edge, or message, that make a source silent. */
#define SOURCE_SEARCH_PERIODS 6u  /* The same for a clock that is not in step: a master may just have begun to lead. */
#define SOURCE_FIELD_PERIODS  2u  /* So many more before the field is followed: CAN comes first. */
#define SOURCE_TRY_PERIODS    20u /* Time that the field has to give a lock where the wire or CAN is there, too. */
#define SOURCE_MESSAGES       3u  /* Messages in a row that must agree before CAN is followed in place of the wire. */
#define SOURCE_RETURN         10u /* Edges, or messages, in a row that must agree before a better source is followed. */
#define SOURCE_SLEW_CHIPS     3u  /* Chips that a slew by late_ticks takes at most. */

/* How far the application is with the field. */
typedef enum { SOURCE_IDLE = 0, SOURCE_ASKED = 1, SOURCE_READY = 2 } source_stage_t;

typedef struct {
    volatile bool automatic;    /* The clock chooses among the sources. */
    volatile bool by_field;     /* acquire.h serves the clock, so wire and CAN must not. Main sets it at its start. */
    volatile bool field_usable; /* Main tells: this board could follow the field. */
    volatile uint32_t changes;  /* Changes from one source to another. */
    uint32_t error_ns;          /* The clock's estimated error when the field was asked for. */
    int16_t late_ticks;         /* By so many does the field have the own chips begin later. Main sets it. */
    uint32_t settled_chip;      /* Blocks that begin with this chip or later are no longer late. */
    /* Private. */
    volatile uint8_t stage; /* A source_stage_t. Plan asks, main answers. */
    uint32_t wire_chip;     /* The chip that was planned next when the wire's latest good edge came, */
    uint32_t edge_chip;     /* and when any edge came. */
    uint32_t wire_good;     /* Edges in a row that lay within SYNC_NEAR_TICKS. */
    uint32_t field_chip;    /* The same chip when the field was first followed, or gave the lock last. */
} source_t;

/* Let the clock choose its source itself from now on, or not; from main. */
void source_automatic(source_t *source, sync_link_t *link, bool automatic);

/* Take an edge of the wire that the clock has taken or compared: whether it fits. */
void source_edge(source_t *source, const chip_clock_t *clock, bool fits);

/* Go over to another source if one is better. Costs about 60 instructions. */
void source_choose(source_t *source, chip_clock_t *clock, sync_link_t *link);

/* Returns whether the clock would follow the field: main then prepares acquire.h, and calls source_ready. */
static inline bool source_asks(const source_t *source) {
    return source->stage == SOURCE_ASKED;
}

static inline void source_ready(source_t *source) {
    source->stage = SOURCE_READY;
}

/* Returns whether, in a block that begins with this chip, last conversions lie behind the beacons' edge: own chips are
 * late, or were when they were planned. Costs about 10 instructions. */
static inline bool source_late(const source_t *source, uint32_t chip) {
    return source->by_field || (int32_t)(source->settled_chip - chip) > 0;
}

#endif
