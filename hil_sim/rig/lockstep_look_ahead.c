/* lockstep_look_ahead.c: how far the boards can go in one step without missing anything of each other. */
#include "rig/lockstep_internal.h"

#define LOOSE_QUANTA_MAX 152u /* A block of 31 chips. */
#define QUANTA_MAX       40u  /* Eight chips, in which a coil changes less often than its history is long (coil.h). */
#define MOST_PS          ((QUANTA_MAX + 2) * (int64_t)RIG_QUANTUM_PS) /* How far a step looks. */

/* Returns a time before which no board asks anything of the bus, nor changes the sync wire. */
static int64_t earliest_request(const rig_t *rig) {
    int64_t earliest_ps = INT64_MAX;
    for (unsigned board = 0; board < rig->slots; ++board) {
        const int64_t asks_ps = rig->ahead[board].asks_ps;
        earliest_ps = asks_ps < earliest_ps && !rig->loose[board] ? asks_ps : earliest_ps;
    }
    for (unsigned board = 0; board < rig->slots; ++board) {
        if (rig->written[board] && !rig->loose[board] && rig->slot[board].serial.next_ps < earliest_ps) {
            earliest_ps = rig->slot[board].serial.next_ps;
        }
    }
    return earliest_ps;
}

bool look_ahead_open(const rig_t *rig) {
    return rig->leaders > 1 && wires_is_silent(rig, rig->now_ps + MOST_PS);
}

unsigned look_ahead_quanta(const rig_t *rig) {
    /* A beacon with a sensor looks at the others' coils as they are; a deputy that takes over changes the order. */
    if (rig->others_sense || look_ahead_open(rig)) {
        return 1;
    }
    const int64_t now_ps = rig->now_ps, asks_ps = earliest_request(rig);
    if (asks_ps == INT64_MIN) {
        return 1;
    }
    const int64_t heard_ps = can_bus_heard(rig->bus, asks_ps);
    if (heard_ps < now_ps) {
        return 1;
    }
    int64_t end_ps = heard_ps < now_ps + MOST_PS ? heard_ps : now_ps + MOST_PS;
    end_ps -= 2 * (int64_t)RIG_QUANTUM_PS; /* The leader is ahead by so much. */
    end_ps = end_ps < rig->until_ps ? end_ps : rig->until_ps;
    return end_ps >= now_ps + 2 * (int64_t)RIG_QUANTUM_PS ? (unsigned)((end_ps - now_ps) / RIG_QUANTUM_PS) : 1u;
}

int64_t look_ahead_loose(const rig_t *rig) {
    int64_t known_ps = rig->until_ps < INT64_MAX / 2 ? rig->until_ps + RIG_QUANTUM_PS : INT64_MAX / 2;
    for (unsigned i = 0; i < rig->leaders; ++i) {
        const int64_t asks_ps = rig->ahead[rig->leading[i]].asks_ps;
        known_ps = asks_ps < known_ps ? asks_ps : known_ps;
    }
    for (unsigned board = 0; board < rig->slots; ++board) {
        known_ps = rig->written[board] && rig->loose[board] ? rig->end_ps : known_ps;
    }
    const int64_t longest_ps = rig->end_ps + LOOSE_QUANTA_MAX * (int64_t)RIG_QUANTUM_PS;
    known_ps = known_ps < longest_ps ? known_ps : longest_ps;
    /* They are ahead of the rig's time by a quantum. */
    return known_ps < rig->end_ps + 2 * (int64_t)RIG_QUANTUM_PS
               ? rig->end_ps
               : known_ps - (known_ps - rig->end_ps) % RIG_QUANTUM_PS - RIG_QUANTUM_PS;
}
