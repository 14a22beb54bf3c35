#include "rig/can_bus.h"

#include <math.h>
#include <stdlib.h>

#include "rig/array.h"

enum {
    CRC_BITS = 15,
    CRC_DELIMITER_BITS = 1,
    ACKNOWLEDGE_BITS = 2, /* Slot and delimiter. */
    END_OF_FRAME_BITS = 7,
    INTERFRAME_BITS = 3,
    ERROR_BITS = 14, /* Active error flag and delimiter. */
    FIRST_WRONG_BIT = 50,
    STUFFED_BITS_MAX = 1 + 32 + 6 + 64 + CRC_BITS
};
static const uint16_t crc_polynomial = 0x4599; /* x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1 */

typedef struct {
    unsigned node, mailbox;
    board_frame_t frame;
    uint32_t key;
    int64_t time_ps;  /* Wants the bus from here on */
    int64_t until_ps; /* and no more from here on. */
} request_t;

struct can_bus {
    int64_t bit_ps;
    unsigned nodes;
    int64_t *joined_ps;
    request_t *requests; /* In order of arrival. */
    size_t count, capacity;
    int64_t idle_ps; /* The bus is free from here on. */
    can_statistics_t statistics;
    double error_probability;
    uint64_t random; /* State of the sequence that draws errors. */
    unsigned corrupt;
    int64_t delay_ps;
};

/* ---- Length of a frame ---- */

typedef struct {
    uint8_t bits[STUFFED_BITS_MAX];
    unsigned count;
} bit_string_t;

static void append(bit_string_t *string, uint32_t value, unsigned count) {
    for (unsigned i = count; i-- > 0;) {
        string->bits[string->count++] = (uint8_t)((value >> i) & 1u);
    }
}

static uint16_t checksum(const bit_string_t *string) {
    uint16_t crc = 0;
    for (unsigned i = 0; i < string->count; ++i) {
        const unsigned next = string->bits[i] ^ (unsigned)(crc >> 14);
        crc = (uint16_t)((crc << 1) & 0x7FFF);
        if (next != 0) {
            crc ^= crc_polynomial;
        }
    }
    return crc;
}

/* The part of a frame that is stuffed: start of frame to the end of the checksum. */
static bit_string_t stuffed_part(const board_frame_t *frame) {
    bit_string_t string = {.count = 0};
    const uint32_t remote = frame->remote ? 1 : 0;
    const unsigned length = frame->length > 8 ? 8 : frame->length;
    append(&string, 0, 1);
    if (frame->extended) {
        append(&string, frame->id >> 18, 11);
        append(&string, 3, 2); /* Substitute remote request, identifier extension. */
        append(&string, frame->id, 18);
        append(&string, remote, 1);
        append(&string, 0, 2); /* Reserved. */
    } else {
        append(&string, frame->id, 11);
        append(&string, remote, 1);
        append(&string, 0, 2); /* Identifier extension, reserved. */
    }
    append(&string, length, 4);
    for (unsigned i = 0; i < length && !frame->remote; ++i) {
        append(&string, frame->data[i], 8);
    }
    append(&string, checksum(&string), CRC_BITS);
    return string;
}

/* After five equal bits a bit of the other value is inserted; it counts for the next five. */
static unsigned stuff_bits(const bit_string_t *string) {
    unsigned inserted = 0;
    unsigned run = 0;
    unsigned last = 2;
    for (unsigned i = 0; i < string->count; ++i) {
        run = string->bits[i] == last ? run + 1 : 1;
        last = string->bits[i];
        if (run == 5) {
            ++inserted;
            last = 1u - last;
            run = 1;
        }
    }
    return inserted;
}

unsigned can_frame_bits(const board_frame_t *frame) {
    const bit_string_t string = stuffed_part(frame);
    return string.count + stuff_bits(&string) + CRC_DELIMITER_BITS + ACKNOWLEDGE_BITS + END_OF_FRAME_BITS;
}

uint32_t can_arbitration_key(const board_frame_t *frame) {
    const uint32_t remote = frame->remote ? 1 : 0;
    if (frame->extended) {
        return ((frame->id >> 18) << 21) | (3u << 19) | ((frame->id & 0x3FFFFu) << 1) | remote;
    }
    return (frame->id << 21) | (remote << 20);
}

/* ---- The bus ---- */

can_bus_t *can_bus_create(unsigned nodes, uint32_t bits_per_second) {
    can_bus_t *const bus = calloc(1, sizeof *bus);
    int64_t *const joined = calloc(nodes, sizeof *joined);
    if (bus == NULL || joined == NULL) {
        free(bus);
        free(joined);
        return NULL;
    }
    *bus = (can_bus_t){.nodes = nodes, .joined_ps = joined};
    can_bus_rate(bus, bits_per_second);
    for (unsigned node = 0; node < nodes; ++node) {
        joined[node] = INT64_MAX;
    }
    return bus;
}

void can_bus_rate(can_bus_t *bus, uint32_t bits_per_second) {
    bus->bit_ps = INT64_C(1000000000000) / bits_per_second;
}

void can_bus_destroy(can_bus_t *bus) {
    if (bus != NULL) {
        free(bus->joined_ps);
        free(bus->requests);
        free(bus);
    }
}

void can_bus_join(can_bus_t *bus, unsigned node, int64_t time_ps) {
    bus->joined_ps[node] = time_ps;
}

void can_bus_request(can_bus_t *bus, unsigned node, unsigned mailbox, const board_frame_t *frame, int64_t time_ps) {
    bus->requests = array_reserve(bus->requests, &bus->capacity, bus->count + 1, sizeof *bus->requests);
    bus->requests[bus->count++] = (request_t){.node = node,
                                              .mailbox = mailbox,
                                              .frame = *frame,
                                              .key = can_arbitration_key(frame),
                                              .time_ps = time_ps,
                                              .until_ps = INT64_MAX};
}

void can_bus_abort(can_bus_t *bus, unsigned node, unsigned mailbox, int64_t time_ps) {
    for (size_t i = bus->count; i-- > 0;) {
        request_t *const request = &bus->requests[i];
        if (request->node == node && request->mailbox == mailbox && request->until_ps == INT64_MAX) {
            request->until_ps = time_ps;
            return;
        }
    }
}

static void remove_request(can_bus_t *bus, size_t index) {
    --bus->count;
    for (size_t i = index; i < bus->count; ++i) {
        bus->requests[i] = bus->requests[i + 1];
    }
}

static void drop_withdrawn(can_bus_t *bus, int64_t time_ps) {
    for (size_t i = bus->count; i-- > 0;) {
        if (bus->requests[i].until_ps <= time_ps) {
            remove_request(bus, i);
        }
    }
}

/* When the next frame starts: the bus is idle and somebody wants it. INT64_MAX: nobody does. */
static int64_t next_start(const can_bus_t *bus) {
    int64_t start = INT64_MAX;
    for (size_t i = 0; i < bus->count; ++i) {
        const request_t *const request = &bus->requests[i];
        const int64_t wanted = request->time_ps > bus->idle_ps ? request->time_ps : bus->idle_ps;
        if (wanted < request->until_ps && wanted < start) {
            start = wanted;
        }
    }
    return start;
}

int64_t can_bus_heard(const can_bus_t *bus, int64_t asks_ps) {
    int64_t start_ps = asks_ps;
    for (size_t i = 0; i < bus->count; ++i) {
        if (!bus->requests[i].frame.extended) {
            return INT64_MIN;
        }
        start_ps = bus->requests[i].time_ps < start_ps ? bus->requests[i].time_ps : start_ps;
    }
    start_ps = start_ps < bus->idle_ps ? bus->idle_ps : start_ps;
    return start_ps < INT64_MAX / 2 ? start_ps + bus->bit_ps * (CAN_SHORTEST_EXTENDED_BITS - 1) : start_ps;
}

static bool goes_before(const request_t *a, const request_t *b) {
    if (a->key != b->key) {
        return a->key < b->key;
    }
    return a->node != b->node ? a->node < b->node : a->mailbox < b->mailbox;
}

static size_t arbitration_winner(can_bus_t *bus, int64_t start_ps) {
    size_t winner = bus->count;
    for (size_t i = 0; i < bus->count; ++i) {
        const request_t *const request = &bus->requests[i];
        if (request->time_ps > start_ps) {
            continue;
        }
        if (winner == bus->count || goes_before(request, &bus->requests[winner])) {
            winner = i;
        }
    }
    for (size_t i = 0; i < bus->count; ++i) {
        const request_t *const request = &bus->requests[i];
        if (request->time_ps <= start_ps && request->key == bus->requests[winner].key &&
            request->node != bus->requests[winner].node) {
            ++bus->statistics.collisions;
        }
    }
    return winner;
}

static bool anybody_else(const can_bus_t *bus, unsigned sender, int64_t time_ps) {
    for (unsigned node = 0; node < bus->nodes; ++node) {
        if (node != sender && bus->joined_ps[node] <= time_ps) {
            return true;
        }
    }
    return false;
}

/* ---- Bit errors ---- */

void can_bus_errors(can_bus_t *bus, double probability, uint64_t seed) {
    bus->error_probability = probability;
    bus->random = seed;
}

void can_bus_corrupt(can_bus_t *bus, unsigned frames) {
    bus->corrupt = frames;
}

void can_bus_delay(can_bus_t *bus, int64_t delay_ps) {
    bus->delay_ps = delay_ps;
}

/* Uniform in 0 (excluded) to 1: SplitMix64. */
static double draw(can_bus_t *bus) {
    uint64_t word = bus->random += 0x9E3779B97F4A7C15u;
    word = (word ^ word >> 30) * 0xBF58476D1CE4E5B9u;
    word = (word ^ word >> 27) * 0x94D049BB133111EBu;
    return ((double)((word ^ word >> 31) >> 11) + 1.0) * 0x1p-53;
}

/* Where in a frame of so many bits the first wrong bit is; 0: nowhere. */
static unsigned wrong_bit(can_bus_t *bus, unsigned bits) {
    unsigned wrong = 0;
    if (bus->corrupt > 0) {
        --bus->corrupt;
        wrong = bits / 2u;
    } else if (bus->error_probability > 0.0) {
        const double until = log(draw(bus)) / log1p(-bus->error_probability); /* Right bits before the first wrong. */
        wrong = until < (double)bits ? (unsigned)until + 1u : 0u;
    }
    return wrong != 0 && wrong < FIRST_WRONG_BIT ? (unsigned)FIRST_WRONG_BIT : wrong;
}

void can_bus_run(can_bus_t *bus, int64_t until_ps, can_deliver_t deliver, void *context) {
    int64_t start_ps;
    while (bus->count > 0 && (start_ps = next_start(bus)) < until_ps) {
        drop_withdrawn(bus, start_ps);
        const size_t index = arbitration_winner(bus, start_ps);
        const request_t request = bus->requests[index];
        remove_request(bus, index);

        const bool acknowledged = anybody_else(bus, request.node, start_ps);
        unsigned bits = can_frame_bits(&request.frame);
        if (!acknowledged) {
            bits += ERROR_BITS - END_OF_FRAME_BITS - 1; /* From the slot on, in place of delimiter and end of frame. */
            ++bus->statistics.unacknowledged;
        }
        const unsigned wrong = wrong_bit(bus, bits);
        if (wrong != 0) {
            bits = wrong + ERROR_BITS;
            ++bus->statistics.errors;
        }
        const int64_t end_ps = start_ps + bus->bit_ps * bits;
        const can_transfer_t transfer = {
            .node = request.node,
            .mailbox = request.mailbox,
            .frame = request.frame,
            .start_ps = start_ps,
            .valid_ps = end_ps - bus->bit_ps + bus->delay_ps,
            .end_ps = end_ps,
            .acknowledged = acknowledged && wrong == 0,
            .destroyed = wrong != 0,
        };
        bus->idle_ps = transfer.end_ps + bus->bit_ps * INTERFRAME_BITS;
        bus->statistics.busy_ps += bus->idle_ps - start_ps;
        ++bus->statistics.frames;
        deliver(context, &transfer);
    }
}

void can_bus_statistics(const can_bus_t *bus, can_statistics_t *statistics) {
    *statistics = bus->statistics;
}
