#include "core/link/bus_share.h"

/* Nanoseconds of bus time in a microsecond that all boards together may take. */
#define NS_A_US ((int64_t)10 * BUS_SHARE_PERCENT)

static int64_t most_ns(const bus_share_t *share) {
    return BUS_SHARE_CREDIT_BITS * share->bit_ns;
}

static int64_t cost_ns(const bus_share_t *share, uint32_t messages) {
    return (int64_t)messages * BUS_SHARE_MESSAGE_BITS * share->bit_ns;
}

/* Returns the value, between -most_ns() and +most_ns(). */
static int64_t limited(const bus_share_t *share, int64_t credit_ns) {
    const int64_t most = most_ns(share);
    if (credit_ns > most) {
        return most;
    }
    return credit_ns < -most ? -most : credit_ns;
}

static bool is_there(const bus_share_t *share, uint32_t i, uint64_t now_us) {
    return share->others[i].node != 0u && now_us - share->others[i].heard_us <= BUS_SHARE_FORGET_US;
}

/* Lets the credit grow by the time since it did so last. */
static void fill(bus_share_t *share, uint64_t now_us) {
    const uint64_t passed_us = now_us - share->filled_us;
    const int64_t enough_us = 2 * most_ns(share); /* Whoever shares, the credit is full behind it. */
    const int64_t grown_us = passed_us < (uint64_t)enough_us ? (int64_t)passed_us : enough_us;
    share->filled_us = now_us;
    share->credit_ns = limited(share, share->credit_ns + grown_us * NS_A_US / (int64_t)bus_share_boards(share, now_us));
}

void bus_share_start(bus_share_t *share, uint32_t bit_s, uint64_t now_us) {
    *share = (bus_share_t){.bit_ns = 1000000000 / (int64_t)bit_s, .filled_us = now_us};
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
    const int64_t cost = cost_ns(share, messages);
    fill(share, now_us);
    if (share->credit_ns < cost) {
        return false;
    }
    share->credit_ns -= cost;
    return true;
}

void bus_share_spend(bus_share_t *share, uint32_t messages, uint64_t now_us) {
    fill(share, now_us);
    share->credit_ns = limited(share, share->credit_ns - cost_ns(share, messages));
}
