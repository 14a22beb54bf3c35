#include "core/codes/strongest.h"

#include <string.h>

#define KIND_SUM 3u /* The bits of a kind that tell which sum: 0 is -1, 1 the larger, 2 the smaller one. */
#define KIND_IN  4u /* The code is in the selection. */
#define SUMS     3u

#define CLASSES      228u /* Classes of strengths from 4 to 2^59: four in each octave. */
#define ENTER        8u   /* Times the noise, above which a code enters. */
#define STAY_HALVES  5u   /* Halves of the noise, below which it leaves. */
#define EXCEED       2u   /* Times the sum of the weakest and what enters, above which it is replaced. */
#define MISSING_PART 4u   /* A cycle of which more than this part was not sampled tells nothing. */
#define CHOSEN_PART  8u   /* At most this part of the codes is chosen. */
/* A newcomer leaks 5 (N + 1)^-2 of its strength, at most; eight alike ones 2^11 (N + 1)^-2. */
#define LEAK_EXPONENT 11u

/* What a round has found that is not in the selection, strongest first. */
typedef struct {
    uint32_t count;
    uint64_t strengths[EPOCH_CODES_MAX];
    uint16_t codes[EPOCH_CODES_MAX], words[EPOCH_CODES_MAX];
} newcomers_t;

/* ---- Preparation ---- */

static uint16_t first_word(const gold_family_t *family) {
    return (uint16_t)((family->length + 1u) / 2u);
}

/* Moves the word of code k to that of code k + 1; the last one is that of code N. */
static uint16_t next_word(const gold_family_t *family, uint32_t code, uint16_t word) {
    return code + 1u < family->length ? gold_next_functional(family->v_taps, word) : 0u;
}

static int32_t sum_of(const gold_family_t *family, uint32_t kind) {
    const int32_t away = 1 << (family->degree / 2u + 1u);
    return (kind & KIND_SUM) == 0u ? -1 : (kind & KIND_SUM) == 1u ? away - 1 : -away - 1;
}

void strongest_init(strongest_t *strongest, const gold_family_t *family, despread_t *scratch) {
    strongest->family = family;
    const int16_t one[DESPREAD_AXES] = {1}; /* Correlated with 1, each code gives its sum. */
    despread_start(scratch, family);
    for (uint32_t t = 0; t < family->length; t++) {
        despread_store(scratch, one);
    }
    despread_transform(scratch);
    uint16_t word = first_word(family);
    for (uint32_t code = 0; code <= family->length; code++) {
        const int32_t sum = scratch->words[0][word];
        strongest->kinds[code] = sum == -1 ? 0u : sum > 0 ? 1u : 2u;
        word = next_word(family, code, word);
    }
}

void strongest_clear(strongest_t *strongest, epoch_selection_t *selection) {
    for (uint32_t code = 0; code <= strongest->family->length; code++) {
        strongest->kinds[code] &= KIND_SUM;
    }
    selection->count = 0;
}

/* ---- Strengths ---- */

static uint64_t strength(const strongest_t *strongest, const despread_t *despread, uint32_t kind, uint32_t word) {
    const int32_t *const adjust = strongest->adjust[kind & KIND_SUM];
    const int32_t x = despread->words[0][word] + adjust[0], y = despread->words[1][word] + adjust[1];
    const int32_t z = despread->words[2][word] + adjust[2];
    return (uint64_t)((int64_t)x * x + (int64_t)y * y + (int64_t)z * z);
}

static int32_t nearest(int64_t numerator, int64_t denominator) {
    return (int32_t)((numerator + (numerator < 0 ? -denominator : denominator) / 2) / denominator);
}

/* Solves the two equations of the header on each axis, all in integers below 2^57, and makes the strengths of the
 * selection. With an eighth of the codes at most, the determinant is positive whichever they are. */
static void model(strongest_t *strongest, const despread_t *despread, const epoch_selection_t *selection) {
    const gold_family_t *const family = strongest->family;
    const int64_t chips = family->length, words = chips + 1;
    int64_t sums = 0, squares = 0;
    for (uint32_t i = 0; i < selection->count; i++) {
        const int64_t sum = selection->codes[i].sum;
        sums += sum;
        squares += sum * sum;
    }
    const int64_t a = words - selection->count, c = chips * words - squares, determinant = a * c - sums * sums;
    for (uint32_t axis = 0; axis < DESPREAD_AXES; axis++) {
        int64_t plain = 0, weighted = words * despread->sum[axis];
        for (uint32_t i = 0; i < selection->count; i++) {
            const int32_t correlation = despread->words[axis][selection->codes[i].word];
            plain += correlation;
            weighted -= (int64_t)selection->codes[i].sum * correlation;
        }
        const int64_t fields = c * plain - sums * weighted, offset = a * weighted - sums * plain;
        for (uint32_t kind = 0; kind < SUMS; kind++) {
            strongest->adjust[kind][axis] = nearest(fields - sum_of(family, kind) * offset, determinant);
        }
    }
    for (uint32_t i = 0; i < selection->count; i++) {
        strongest->strengths[i] = strength(strongest, despread, strongest->kinds[selection->codes[i].code],
                                           selection->codes[i].word);
    }
}

/* ---- Noise ---- */

/* Strengths below 4 count as four more, which makes no noise above N. */
static uint32_t class_of(uint64_t value) {
    const uint32_t octave = 61u - (uint32_t)__builtin_clzll(value | 4u); /* That from 4 to 7 is the first. */
    return 4u * octave + ((uint32_t)(value >> octave) & 3u);
}

static uint64_t class_begin(uint32_t i) {
    return (uint64_t)(4u + i % 4u) << i / 4u;
}

/* Returns the upper quartile of count values. */
static uint64_t upper_quartile(const uint16_t classes[CLASSES], uint32_t count) {
    const uint32_t rank = 3u * count / 4u;
    uint32_t below = 0, i = 0;
    for (; below + classes[i] <= rank; i++) { /* The rank is below count. */
        below += classes[i];
    }
    const uint64_t begin = class_begin(i), width = class_begin(i + 1u) - begin;
    return begin + width / classes[i] * (rank - below);
}

/* Sets the noise. Returns the largest strength that is not in the selection. */
static uint64_t survey(strongest_t *strongest, const despread_t *despread, uint32_t chosen) {
    const gold_family_t *const family = strongest->family;
    uint16_t classes[CLASSES];
    memset(classes, 0, sizeof classes);
    uint64_t largest = 0;
    uint16_t word = first_word(family);
    for (uint32_t code = 0; code <= family->length; code++) {
        const uint32_t kind = strongest->kinds[code];
        if ((kind & KIND_IN) == 0u) {
            const uint64_t value = strength(strongest, despread, kind, word);
            classes[class_of(value)]++;
            largest = value > largest ? value : largest;
        }
        word = next_word(family, code, word);
    }
    const uint64_t noise = upper_quartile(classes, family->length + 1u - chosen);
    strongest->noise = noise > family->length ? noise : family->length;
    return largest;
}

/* ---- Coming and going ---- */

static uint32_t weakest_of(const strongest_t *strongest, uint32_t count) {
    uint32_t weakest = 0;
    for (uint32_t i = 1; i < count; i++) {
        weakest = strongest->strengths[i] < strongest->strengths[weakest] ? i : weakest;
    }
    return weakest;
}

/* Returns what a code must exceed to come in. */
static uint64_t bar(const strongest_t *strongest, uint32_t most, const epoch_selection_t *selection) {
    const uint64_t enter = ENTER * strongest->noise;
    if (selection->count < most) {
        return enter;
    }
    return EXCEED * (strongest->strengths[weakest_of(strongest, selection->count)] + enter);
}

static void insert(newcomers_t *newcomers, uint32_t most, uint64_t value, uint32_t code, uint16_t word) {
    uint32_t place = newcomers->count < most ? newcomers->count++ : most;
    for (; place > 0u && newcomers->strengths[place - 1u] < value; place--) {
        if (place < most) {
            newcomers->strengths[place] = newcomers->strengths[place - 1u];
            newcomers->codes[place] = newcomers->codes[place - 1u];
            newcomers->words[place] = newcomers->words[place - 1u];
        }
    }
    if (place < most) {
        newcomers->strengths[place] = value;
        newcomers->codes[place] = (uint16_t)code;
        newcomers->words[place] = word;
    }
}

/* Finds the strongest codes above a bar that are not in the selection. */
static void find(const strongest_t *strongest, const despread_t *despread, uint32_t most, uint64_t above,
                 newcomers_t *newcomers) {
    const gold_family_t *const family = strongest->family;
    uint16_t word = first_word(family);
    newcomers->count = 0;
    for (uint32_t code = 0; code <= family->length; code++) {
        const uint32_t kind = strongest->kinds[code];
        const uint64_t value = strength(strongest, despread, kind, word);
        if (value > above && (kind & KIND_IN) == 0u) {
            insert(newcomers, most, value, code, word);
        }
        word = next_word(family, code, word);
    }
}

static void put(strongest_t *strongest, epoch_selection_t *selection, uint32_t place, const newcomers_t *newcomers,
                uint32_t index) {
    const uint16_t code = newcomers->codes[index];
    selection->codes[place].code = code;
    selection->codes[place].word = newcomers->words[index];
    selection->codes[place].sum = (int16_t)sum_of(strongest->family, strongest->kinds[code]);
    strongest->kinds[code] |= KIND_IN;
    strongest->strengths[place] = newcomers->strengths[index];
}

/* Takes in what may come in. Returns whether there was any. */
static bool admit(strongest_t *strongest, const despread_t *despread, uint32_t most, uint64_t largest,
                  epoch_selection_t *selection) {
    const uint64_t least = bar(strongest, most, selection);
    if (largest <= least || most == 0u) {
        return false;
    }
    const uint32_t twice = 2u * strongest->family->degree;
    const uint64_t leak = (largest - 1u) >> (twice > LEAK_EXPONENT ? twice - LEAK_EXPONENT : 0u);
    newcomers_t newcomers;
    find(strongest, despread, most, leak > least ? leak : least, &newcomers);
    for (uint32_t i = 0; i < newcomers.count; i++) {
        if (newcomers.strengths[i] <= bar(strongest, most, selection)) {
            break;
        }
        uint32_t place = selection->count;
        if (place < most) {
            selection->count++;
        } else {
            place = weakest_of(strongest, place);
            strongest->kinds[selection->codes[place].code] &= KIND_SUM;
        }
        put(strongest, selection, place, &newcomers, i);
    }
    return true;
}

static void leave(strongest_t *strongest, epoch_selection_t *selection, uint32_t place) {
    strongest->kinds[selection->codes[place].code] &= KIND_SUM;
    selection->count--;
    for (uint32_t i = place; i < selection->count; i++) {
        selection->codes[i] = selection->codes[i + 1u];
        strongest->strengths[i] = strongest->strengths[i + 1u];
    }
}

/* Lets go what is no longer above the noise. Returns whether there was any. */
static bool let_go(strongest_t *strongest, epoch_selection_t *selection) {
    const uint32_t before = selection->count;
    for (uint32_t i = before; i-- > 0u;) {
        if (2u * strongest->strengths[i] < STAY_HALVES * strongest->noise) {
            leave(strongest, selection, i);
        }
    }
    return selection->count != before;
}

/* ---- The call ---- */

bool strongest_choose(strongest_t *strongest, const despread_t *despread, uint32_t most, epoch_selection_t *selection) {
    const uint32_t length = strongest->family->length;
    const uint32_t part = (length + 1u) / CHOSEN_PART;
    uint32_t limit = part < EPOCH_CODES_MAX ? part : EPOCH_CODES_MAX;
    limit = most < limit ? most : limit;
    bool changed = false;
    if (MISSING_PART * despread->missing > length) {
        return false;
    }
    for (uint32_t round = 0; round < STRONGEST_ROUNDS; round++) {
        model(strongest, despread, selection);
        for (; selection->count > limit; changed = true) { /* Fewer are wanted now. */
            leave(strongest, selection, weakest_of(strongest, selection->count));
            model(strongest, despread, selection);
        }
        const uint64_t largest = survey(strongest, despread, selection->count);
        if (!admit(strongest, despread, limit, largest, selection)) {
            return let_go(strongest, selection) || changed;
        }
        changed = true;
    }
    return changed;
}
