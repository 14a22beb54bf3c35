/* access.h: who may change a board. One that has a key (the parameter access_key, 128 bits, the same in all boards of a
 * site) takes changes only on a link on which somebody has just shown that he knows it; one without a key takes them
 * from anybody. Nothing that is read needs the key, nor does a stop (framing.md, "Access").
 *
 * Calls, in the order they are made (all of them from main)
 *   1. access_start      once.
 *   2. access_granted    before each change that a host asks for: one line, with a status "locked" if it is false.
 *      access_rekeyed    behind a change of the key.
 *   3. access_challenge, access_answer, access_lock   when a host asks to unlock, answers, or locks again.
 *      access_secret     for whom tells parameters: what he must not tell.
 *
 * Challenge and response. The board tells a random number, the host its keyed hash (core/link/challenge.h), and the key
 * itself is never on the link but when it is set. A number is good for one answer, within
 * ACCESS_ANSWER_US; until then whoever asks is told the same, so that nobody can void it by asking. No board takes the
 * answer for another one's. The link is then open for ACCESS_IDLE_US behind the latest change that was asked for, at
 * most ACCESS_LONGEST_US in all. A reset locks.
 *
 * Wrong answers. Behind the n-th in a row a link gets no number for ACCESS_WAIT_US * 2^(n-1), at most
 * ACCESS_WAIT_MOST_US: a guess each 8 s finds one of 2^64 answers in a year with a probability of 2e-13. The links are
 * judged apart: who is on one of them cannot keep the other locked.
 *
 * A key that is being set comes in four words. The link of the first one counts as unlocked then, as it does behind
 * every change of a board without a key, so that the others are taken.
 *
 * Time: that of challenge_answer. Memory: 112 bytes.
 */
#ifndef GOLDFIELD_ACCESS_H
#define GOLDFIELD_ACCESS_H

#include "core/link/parameters.h"
#include "hal/hal.h"

#define ACCESS_LINKS        2u
#define ACCESS_ANSWER_US    5000000u   /* Time within which a challenge is answered. */
#define ACCESS_IDLE_US      60000000u  /* Time for which a link stays open behind a change. */
#define ACCESS_LONGEST_US   600000000u /* Time after which it is locked whatever comes. */
#define ACCESS_WAIT_US      250000u
#define ACCESS_WAIT_MOST_US 8000000u

/* What becomes of a challenge that is asked for, or of an answer. */
typedef enum {
    ACCESS_NOTHING = 0,   /* The answer belongs to no challenge of this board: say nothing. */
    ACCESS_OPEN = 1,      /* The link is unlocked, or the board has no key. */
    ACCESS_NUMBER = 2,    /* Tell the number. */
    ACCESS_WRONG = 3,     /* The answer is wrong, which is to be counted. */
    ACCESS_LATE = 4,      /* It is too late. */
    ACCESS_WAIT = 5,      /* There were wrong answers: no challenge yet. */
    ACCESS_NO_RANDOM = 6, /* The board has no random number. */
} access_result_t;

/* Private. */
typedef struct {
    uint64_t number;           /* The challenge, */
    uint64_t asked_us;         /* when it was told, */
    uint64_t idle_us, open_us; /* when the latest change was asked for, and since when the link is open, */
    uint64_t wait_until_us;    /* and until when there is no challenge. */
    uint32_t wrong;            /* Wrong answers in a row. */
    bool asked, open;
} access_link_t;

typedef struct {
    hal_t *hal;
    const parameters_t *parameters;
    access_link_t link[ACCESS_LINKS];
} access_t;

/* Lock both links. *hal and *parameters must live for ever. */
void access_start(access_t *access, hal_t *hal, const parameters_t *parameters);

/* Returns whether the board has a key. */
bool access_keyed(const access_t *access);

/* Returns whether a parameter is part of the key, which is told to nobody. */
bool access_secret(uint32_t id);

/* Returns whether a change that is asked for on a link, 0 or 1, may be carried out. It prolongs the time for which the
 * link is open. */
bool access_granted(access_t *access, uint32_t link);

/* The key was changed by who is on this link: what the old one has opened elsewhere is locked. */
void access_rekeyed(access_t *access, uint32_t link);

/* Ask for a challenge.
 * Returns ACCESS_NUMBER, with the number in *number, ACCESS_OPEN, ACCESS_WAIT or ACCESS_NO_RANDOM. */
access_result_t access_challenge(access_t *access, uint32_t link, uint64_t *number);

/* Take the answer to a challenge: eight bytes, the first of them lowest.
 * Returns ACCESS_OPEN, ACCESS_WRONG, ACCESS_LATE or ACCESS_NOTHING. */
access_result_t access_answer(access_t *access, uint32_t link, uint64_t answer);

/* Lock a link at once. */
void access_lock(access_t *access, uint32_t link);

#endif
