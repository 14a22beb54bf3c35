#include "core/link/bus_share.h"

/* Nanoseconds of bus time in a microsecond that all boards together may take. */
#define NS_A_US ((int64_t)10 * BUS_SHARE_PERCENT)

/* Returns the value, between -BUS_SHARE_CREDIT_NS and +BUS_SHARE_CREDIT_NS. */
static int64_t limited(int64_t credit_ns) {
    if (credit_ns > BUS_SHARE_CREDIT_NS) {
        return BUS_SHARE_CREDIT_NS;
    }
    return credit_ns < -BUS_SHARE_CREDIT_NS ? -BUS_SHARE_CREDIT_NS : credit_ns;
}

static bool is_there(const bus_share_t *share, uint32_t i, uint64_t now_us) {
    return share->others[i].node != 0u && now_us - share->others[i].heard_us <= BUS_SHARE_FORGET_US;
}

/* Lets the credit grow by the time since it did so last. */
static void fill(bus_share_t *share, uint64_t now_us) {
    const uint64_t passed_us = now_us - share->filled_us;
    const int64_t enough_us = 2 * (int64_t)BUS_SHARE_CREDIT_NS; /* Whoever shares, the credit is full behind it. */
    const int64_t grown_us = passed_us < (uint64_t)enough_us ? (int64_t)passed_us : enough_us;
    share->filled_us = now_us;
    share->credit_ns = limited(share->credit_ns + grown_us * NS_A_US / (int64_t)bus_share_boards(share, now_us));
}

void bus_share_start(bus_share_t *share, uint64_t now_us) {
    *share = (bus_share_t){.filled_us = now_us};
}

void bus_share_heard(bus_share_t *share, uint32_t node, uint64_t now_us) {
    uint32_t place = BUS_SHARE_OTHERS;
    for (uint32_t i = 0; i < BUS_SHARE_OTHERS; i++) {
        if (share->others[i].node == node) {
            place = i;
            break;
        }
        if (place == BUS_SHARE_OTHERS && !is_there(share, i, now_us)) {
            place = i;
        }
    }
    if (place < BUS_SHARE_OTHERS) {
        share->others[place].node = node;
        share->others[place].heard_us = now_us;
    }
}

uint32_t bus_share_boards(const bus_share_t *share, uint64_t now_us) {
    uint32_t boards = 1u;
    for (uint32_t i = 0; i < BUS_SHARE_OTHERS; i++) {
        boards += is_there(share, i, now_us);
    }
    return boards;
}

bool bus_share_take(bus_share_t *share, uint32_t messages, uint64_t now_us) {
    const int64_t cost_ns = (int64_t)messages * BUS_SHARE_MESSAGE_NS;
    fill(share, now_us);
    if (share->credit_ns < cost_ns) {
        return false;
    }
    share->credit_ns -= cost_ns;
    return true;
}

void bus_share_spend(bus_share_t *share, uint32_t messages, uint64_t now_us) {
    fill(share, now_us);
    share->credit_ns = limited(share->credit_ns - (int64_t)messages * BUS_SHARE_MESSAGE_NS);
}
