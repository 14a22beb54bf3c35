#include "services/access.h"

#include <string.h>

#include "core/link/challenge.h"

#define WORDS     4u
#define MOST_WAIT 5u /* Doublings of ACCESS_WAIT_US up to ACCESS_WAIT_MOST_US. */

_Static_assert(CHALLENGE_KEY_BYTES == WORDS * sizeof(uint32_t), "the key is these words");
_Static_assert(CHALLENGE_ID_BYTES == HAL_UNIQUE_ID_BYTES, "the unique id is a board's");
_Static_assert(PARAMETER_ACCESS_KEY_ELEMENTS == WORDS, "the key is this parameter");
_Static_assert(ACCESS_WAIT_US << MOST_WAIT == ACCESS_WAIT_MOST_US, "the longest wait");

void access_start(access_t *access, hal_t *hal, const parameters_t *parameters) {
    memset(access, 0, sizeof *access);
    access->hal = hal;
    access->parameters = parameters;
}

bool access_keyed(const access_t *access) {
    uint32_t any = 0;
    for (uint32_t i = 0; i < WORDS; i++) {
        any |= parameters_unsigned(access->parameters, PARAMETER_ACCESS_KEY + i);
    }
    return any != 0u;
}

bool access_secret(uint32_t id) {
    return id >= PARAMETER_ACCESS_KEY && id < PARAMETER_ACCESS_KEY + WORDS;
}

static void open_link(access_link_t *link, uint64_t now_us) {
    link->open = true;
    link->open_us = link->idle_us = now_us;
}

bool access_granted(access_t *access, uint32_t link) {
    access_link_t *const own = &access->link[link];
    const uint64_t now_us = hal_microseconds(access->hal);
    own->open = own->open && now_us - own->idle_us < ACCESS_IDLE_US && now_us - own->open_us < ACCESS_LONGEST_US;
    own->idle_us = now_us;
    return own->open || !access_keyed(access);
}

void access_rekeyed(access_t *access, uint32_t link) {
    for (uint32_t i = 0; i < ACCESS_LINKS; i++) {
        access->link[i].open = access->link[i].open && i == link;
        access->link[i].asked = false;
    }
    if (!access->link[link].open) { /* The board had no key before. */
        open_link(&access->link[link], hal_microseconds(access->hal));
    }
}

access_result_t access_challenge(access_t *access, uint32_t link, uint64_t *number) {
    access_link_t *const own = &access->link[link];
    const uint64_t now_us = hal_microseconds(access->hal);
    if (!access_keyed(access)) {
        return ACCESS_OPEN;
    }
    if (now_us < own->wait_until_us) {
        return ACCESS_WAIT;
    }
    if (!own->asked || now_us - own->asked_us >= ACCESS_ANSWER_US) {
        own->asked = false;
        if (!hal_random(access->hal, &own->number)) {
            return ACCESS_NO_RANDOM;
        }
        own->asked = true;
        own->asked_us = now_us;
    }
    *number = own->number;
    return ACCESS_NUMBER;
}

/* Returns whether this is the answer to the challenge. The time that it takes does not tell where it is wrong. */
static bool is_right(const access_t *access, uint64_t number, uint64_t answer) {
    uint8_t key[CHALLENGE_KEY_BYTES], unique_id[HAL_UNIQUE_ID_BYTES];
    for (uint32_t i = 0; i < CHALLENGE_KEY_BYTES; i++) {
        key[i] = (uint8_t)(parameters_unsigned(access->parameters, PARAMETER_ACCESS_KEY + i / 4u) >> (i % 4u * 8u));
    }
    hal_unique_id(access->hal, unique_id);
    const uint64_t wrong = challenge_answer(key, unique_id, number) ^ answer;
    volatile uint8_t *const used = key; /* A crash tells words of the stack: the key is not among them. */
    for (uint32_t i = 0; i < CHALLENGE_KEY_BYTES; i++) {
        used[i] = 0;
    }
    return ((uint32_t)wrong | (uint32_t)(wrong >> 32)) == 0u;
}

access_result_t access_answer(access_t *access, uint32_t link, uint64_t answer) {
    access_link_t *const own = &access->link[link];
    const uint64_t now_us = hal_microseconds(access->hal);
    if (!own->asked) {
        return ACCESS_NOTHING;
    }
    own->asked = false;
    if (now_us - own->asked_us >= ACCESS_ANSWER_US) {
        return ACCESS_LATE;
    }
    if (!is_right(access, own->number, answer)) {
        const uint32_t doublings = own->wrong < MOST_WAIT ? own->wrong : MOST_WAIT;
        own->wrong += own->wrong < MOST_WAIT;
        own->wait_until_us = now_us + ((uint64_t)ACCESS_WAIT_US << doublings);
        return ACCESS_WRONG;
    }
    own->wrong = 0;
    open_link(own, now_us);
    return ACCESS_OPEN;
}

void access_lock(access_t *access, uint32_t link) {
    access->link[link].open = false;
}
