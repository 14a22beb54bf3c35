/* Modules of the core under the address and undefined-behaviour sanitizers, with extremes and seeded noise; and the
 * queue between two threads. Those of a track are in sanitized_track.c. Exit 0: nothing found. Results are judged by
 * the other tests; here only what the sanitizers see, and order and loss in the queue. */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/codes/block_sums.h"
#include "core/codes/epoch.h"
#include "core/codes/gold.h"
#include "core/codes/separation.h"
#include "core/codes/strongest.h"
#include "core/drive/current.h"
#include "core/drive/waveform.h"
#include "core/link/challenge.h"
#include "core/link/frame.h"
#include "core/link/parameter_set.h"
#include "core/link/parameters.h"
#include "core/link/queue.h"
#include "core/storage/crc32.h"
#include "core/storage/store.h"
#include "core/timing/acquire_record.h"
#include "core/timing/chip_clock.h"
#include "core/timing/code_field.h"
#include "core/timing/code_search.h"
#include "core/timing/edge_fit.h"
#include "core/timing/edge_track.h"

#define REQUIRE(condition) ((condition) ? (void)0 : (fprintf(stderr, "line %d: %s\n", __LINE__, #condition), exit(1)))

static uint32_t random_state = 12345;

static uint32_t noise(void) { /* xorshift32, Marsaglia 2003 */
    random_state ^= random_state << 13;
    random_state ^= random_state >> 17;
    random_state ^= random_state << 5;
    return random_state;
}

static void gold(void) {
    for (uint32_t degree = 0; degree < 14; degree++) {
        const gold_family_t *family = gold_family(degree);
        for (uint32_t i = 0; family != NULL && i < 200; i++) {
            gold_generator_t generator;
            REQUIRE(gold_start(&generator, degree, noise() % (family->length + 2u), noise()));
            (void)gold_next(&generator);
        }
    }
}

static void despread(void) {
    static epoch_collector_t collector;
    for (uint32_t run = 0; run < 24; run++) {
        const uint32_t mode = run % 4u;
        const gold_family_t *family = gold_family((const uint32_t[]){5, 6, 7, 9, 10, 11}[run / 4u]);
        static strongest_t strongest;
        static epoch_selection_t selection;
        strongest_init(&strongest, family, &collector.epochs[0].despread);
        strongest_clear(&strongest, &selection);
        epoch_init(&collector, family);
        for (uint32_t t = 0; t < 3u * family->length; t++) {
            int16_t sample[3];
            for (uint32_t axis = 0; axis < 3; axis++) {
                sample[axis] = mode == 0 ? INT16_MIN : mode == 1 ? INT16_MAX : (int16_t)(noise() & 0xFFFFu);
            }
            const uint32_t label = mode == 3 ? noise() & 0xFFFFu : t % family->length;
            (void)epoch_feed(&collector, mode == 3 ? noise() & 4095u : t, t, (uint16_t)label, sample, false, true);
            epoch_t *epoch = epoch_ready(&collector);
            if (epoch != NULL) {
                despread_transform(&epoch->despread);
                for (uint32_t code = 0; code < family->length + 5u; code += 3u) {
                    (void)despread_correlation(&epoch->despread, code % 4u, despread_word(family, code));
                }
                (void)strongest_choose(&strongest, &epoch->despread, noise() % 70u, &selection);
                epoch_release(&collector);
            }
        }
    }
}

/* What is read of a cycle and of blocks with a full list of codes, and what becomes of it. */
static void lists(void) {
    static epoch_t epoch;
    static block_collector_t collector;
    static epoch_selection_t selection;
    static code_bits_t bits;
    for (uint32_t degree = 5; degree <= GOLD_DEGREE_MAX; degree += degree == 7 ? 2u : 1u) {
        const gold_family_t *family = gold_family(degree);
        uint16_t codes[EPOCH_CODES_MAX];
        int16_t sums_of[EPOCH_CODES_MAX];
        for (uint32_t i = 0; i < EPOCH_CODES_MAX; i++) {
            codes[i] = (uint16_t)((7u * i + noise() % 2u) % (family->length + 2u));
        }
        (void)epoch_select(&selection, family, codes, EPOCH_CODES_MAX);
        code_bits_init(&bits, family);
        block_collect_init(&collector, family->length);
        despread_start(&epoch.despread, family);
        for (uint32_t t = 0; t < family->length; t++) {
            uint16_t burst[EPOCH_BURST][EPOCH_AXES];
            int16_t of_burst[EPOCH_AXES];
            for (uint32_t i = 0; i < EPOCH_BURST * EPOCH_AXES; i++) {
                burst[i / EPOCH_AXES][i % EPOCH_AXES] = (uint16_t)(noise() & EPOCH_SAMPLE_MAX);
            }
            (void)epoch_sample((const uint16_t(*)[EPOCH_AXES])burst, of_burst);
            const int16_t sample[EPOCH_AXES] = {INT16_MIN, INT16_MAX, (int16_t)(noise() & 0xFFFFu)};
            despread_store(&epoch.despread, sample);
            block_collect(&collector, t, 0, t, sample, noise() & 7u, true);
        }
        despread_transform(&epoch.despread);
        epoch_sums_t sums;
        epoch_read(&epoch, &selection, &sums);
        const epoch_calibration_t calibration = {.matrix = {{1e-7f, 1e-9f, 0}, {0, 1e-7f, 0}, {0, 0, 1e-7f}}};
        for (uint32_t i = 0; i < selection.count; i++) {
            float field_T[EPOCH_AXES];
            epoch_field(&sums, &calibration, &selection, i, field_T);
            (void)epoch_integer(field_T[0], 1e-10f);
            sums_of[i] = selection.codes[i].sum;
        }
        for (const block_samples_t *block; (block = block_ready(&collector)) != NULL; block_release(&collector)) {
            block_sums_t of_block;
            block_sums(block, &bits, &selection, &calibration, &of_block);
        }
        separation_t separation;
        float field[SEPARATION_CODES_MAX] = {1.0f};
        for (uint32_t count = 0; count <= SEPARATION_CODES_MAX; count++) {
            if (separation_init(&separation, family->length, codes, sums_of, count)) {
                separation_apply(&separation, 1.0f, field);
            }
        }
    }
}

static void clocks(void) {
    static const uint16_t lengths[] = {31, 63, 1023, 2047};
    for (uint32_t i = 0; i < 8; i++) {
        chip_clock_t clock;
        REQUIRE(chip_clock_init(&clock, &(chip_clock_config_t){lengths[i % 4u], 16422, 16000, 16900, true}));
        clock.chip = i < 4 ? 0 : 0xFFFFF000u;
        for (uint32_t t = 0; t < 20000; t++) {
            const chip_clock_chip_t planned = chip_clock_plan(&clock);
            REQUIRE(planned.period_ticks >= 16000 && planned.period_ticks <= 16900 &&
                    planned.code_chip < lengths[i % 4u]);
            if (t > 100 && noise() % (i % 2u == 0u ? 100u : 1023u) == 0u) {
                chip_clock_edge(&clock, clock.chip - noise() % 130u, (uint16_t)(noise() % 17000u));
                chip_clock_number_cycle(&clock, noise());
            }
        }
    }
}

static void currents(void) {
    for (uint32_t i = 0; i < 100; i++) {
        current_t loop;
        const float amplitude = (float)(noise() % 17u), limit = (float)(noise() % 20u);
        const current_config_t config = {
            .sense_A = 0.0078125f,
            .reference_A = 0.00390625f,
            .amplitude_A = amplitude,
            .open_fraction = (float)(noise() % 3u) / 2.0f,
            .several_levels = i % 2u == 0u,
            .guard = {.over_current_A = limit, .rms_A = (float)(noise() % 20u), .rms_chips = 1000.0f},
        };
        memset(&loop, 0, sizeof loop);
        if (current_configure(&loop, &config)) {
            for (uint32_t t = 0; t < 300 && i % 5u != 0u; t++) {
                (void)current_sample(&loop, false, 0, 2048);
            }
            current_start(&loop);
            for (uint32_t t = 0; t < 3000; t++) {
                const int32_t set_point = i % 2u == 0u ? (int32_t)(noise() % 8191u) - 4095
                                                       : current_set_point(&loop, (int32_t)(noise() % 2u) * 2 - 1);
                (void)current_sample(&loop, noise() % 7u != 0u, (int16_t)set_point,
                                     (uint16_t)(i % 3u == 0u ? (int32_t)noise() : 2048 + set_point / 2));
                REQUIRE(loop.reference <= 4095);
            }
        }
    }
}

static void waveforms(void) {
    for (uint32_t i = 0; i < 2000; i++) {
        waveform_config_t config = {.kind = noise() % 6u,
                                    .code = noise() % 2049u,
                                    .slots = noise() % 2048u,
                                    .slot = noise() % 64u,
                                    .periods = noise() % 1200u};
        for (uint32_t j = 0; j < WAVEFORM_CODES; j++) {
            config.codes[j] = (waveform_code_t){noise() % 13u, noise() % 70u, noise() % 40u,
                                                i % 9u == 0u ? noise() : noise() % 40u};
        }
        waveform_t waveform;
        if (waveform_start(&waveform, 4u + noise() % 9u, &config)) {
            for (uint32_t t = 0; t < 3000; t++) {
                int16_t level[WAVEFORM_CHANNELS];
                waveform_next(&waveform, level);
                REQUIRE(level[0] >= -WAVEFORM_ONE && level[0] <= WAVEFORM_ONE && level[1] >= -WAVEFORM_ONE &&
                        level[1] <= WAVEFORM_ONE);
            }
        }
    }
}

static void bytes(void) {
    frame_decoder_t decoder;
    frame_decoder_init(&decoder);
    for (uint32_t i = 0; i < 300000; i++) {
        frame_t frame;
        uint8_t encoded[FRAME_ENCODED_MAX];
        if (frame_decode(&decoder, (uint8_t)(noise() % (i < 100000 ? 5u : 256u)), &frame)) {
            REQUIRE(frame.length <= 8 && frame.id <= FRAME_ID_MAX && frame_encode(&frame, encoded) >= 8);
        }
        frame = (frame_t){.id = noise() & FRAME_ID_MAX, .length = (uint8_t)(noise() % 9u)};
        memset(frame.data, (int)(noise() % 3u), frame.length);
        REQUIRE(frame_encode(&frame, encoded) == frame.length + 8u);
    }
    for (uint32_t i = 0; i < 2000; i++) {
        const size_t size = noise() % 1025u;
        uint8_t *page = malloc(size + 1u); /* Exact size, so that reading beyond it is seen. */
        for (size_t j = 0; j < size; j++) {
            page[j] = (uint8_t)(noise() % (i % 2u == 0u ? 256u : 4u));
        }
        if (size >= 8u) {
            memcpy(page, "GFP1", 4);
            const uint32_t count = page[4] | (uint32_t)page[5] << 8;
            if (8u + 8u * count <= size) {
                const uint16_t crc = frame_crc(page + 8, 8u * count);
                memcpy(page + 6, &crc, sizeof crc);
            }
        }
        parameters_t parameters;
        uint32_t refused;
        parameters_init(&parameters);
        (void)parameters_load(&parameters, page, size, &refused);
        free(page);
    }
}

/* Sets of parameters whose end is that of their memory, and challenges. */
static void sets(void) {
    static parameters_t parameters;
    parameters_init(&parameters);
    uint32_t *const words = malloc(PARAMETER_SET_WORDS * sizeof *words);
    REQUIRE(parameter_set_write(&parameters, 1u, words) == PARAMETER_SET_WORDS);
    REQUIRE(parameter_set_holds(&parameters, 1u, words));
    for (uint32_t i = 0; i < 2000; i++) {
        const uint32_t count = noise() % 40u;
        uint32_t *const stored = malloc(count * sizeof *stored + 1u), refused;
        for (uint32_t j = 0; j < count; j++) {
            stored[j] = j == 0u ? words[0] : noise() % 3u == 0u ? noise() : noise() & 0x5FFFFu;
        }
        (void)parameter_set_read(&parameters, stored, count, &refused);
        free(stored);
        (void)parameters_next(noise() & 0xFFFu, noise() % 4u);
    }
    free(words);
    uint8_t *const bytes = malloc(CHALLENGE_KEY_BYTES);
    memset(bytes, 1, CHALLENGE_KEY_BYTES);
    REQUIRE(challenge_answer(bytes, bytes + CHALLENGE_KEY_BYTES - CHALLENGE_ID_BYTES, noise()) != 0u);
    free(bytes);
}

/* The stages of synchronisation by the field, of noise. */
static void field_stages(void) {
    static acquire_record_t record;
    static code_search_t search;
    static code_field_t field;
    for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
        uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES];
        int16_t sample[ACQUIRE_AXES];
        for (uint32_t i = 0; i < ACQUIRE_BURST * ACQUIRE_AXES; i++) {
            burst[i / ACQUIRE_AXES][i % ACQUIRE_AXES] = (uint16_t)(noise() & 4095u);
        }
        record_burst(&record, chip, chip % 2u == 0u ? RECORD_HALVES : RECORD_TRACKING, (const uint16_t(*)[3])burst);
        acquire_sample((const uint16_t(*)[3])burst, sample);
    }
    code_search_start(&search, &record, 1.003f);
    code_search_add(&search, 3);
    const code_peak_t peak = code_search_peak(&search);
    for (uint32_t sliding = 0; sliding < 2u; sliding++) {
        const code_frame_t frame = {sliding != 0u, peak.label, peak.crossing, 1.003f};
        code_field_start(&field, &record, &frame);
        code_field_subtract(&field, CODE_FIELD_CODES - 1u, 3);
        (void)code_field_present(&field, CODE_FIELD_CODES);
        float variance;
        (void)code_field_step(&field, &record, peak.label, 0, ACQUIRE_CHIPS, &variance);
        edge_fit_t fit;
        (void)edge_fit(code_field_profile(&field, &record, &frame), &(edge_shape_t){16422.0f, 2400.0f, 267.0f}, &fit);
    }
    edge_track_t track;
    edge_track_known(&track, 286.0f, 40.0f, 1e-3f);
    for (uint32_t i = 0; i < 20u; i++) {
        const edge_burst_t burst = {1u + i % 7u, 216.0f, 267.0f};
        const edge_look_t looks[2] = {{(float)(noise() % 100u) * 0.01f, 1e-4f, -256.0f}, {0.1f, 1e-3f, 256.0f}};
        edge_track_move(&track, 1023.0f);
        edge_track_rise(&track, &burst, looks);
        (void)edge_track_blind(&track, &burst, looks);
        edge_track_update(&track, &burst, looks);
        REQUIRE(edge_track_variance(&track, 1023.0f) > 0.0f);
    }
}

#define MESSAGES 200000u
static frame_t storage[16];
static queue_t queue;

static void *produce(void *unused) {
    for (uint32_t i = 1; i <= MESSAGES; i++) {
        const frame_t message = {i, 8, {(uint8_t)i, 0, 0, 0, 0, 0, 0, (uint8_t)i}};
        (void)queue_push(&queue, &message);
    }
    return unused;
}

static void threads(void) {
    REQUIRE(queue_init(&queue, storage, 16));
    pthread_t producer;
    REQUIRE(pthread_create(&producer, NULL, produce, NULL) == 0);
    uint32_t last = 0, received = 0;
    bool running = true;
    while (running) {
        running = last != MESSAGES && received + __atomic_load_n(&queue.lost, __ATOMIC_RELAXED) != MESSAGES;
        const frame_t *message = queue_front(&queue);
        if (message != NULL) {
            REQUIRE(message->id > last && message->data[0] == (uint8_t)message->id &&
                    message->data[7] == (uint8_t)message->id);
            last = message->id;
            received++;
            queue_drop(&queue);
        }
    }
    REQUIRE(pthread_join(producer, NULL) == 0);
    REQUIRE(received + queue.lost + queue_count(&queue) == MESSAGES);
}

/* Saves into flash that begins with anything, and whose programming now and then does not take. */
static void store(void) {
    enum { WORDS = 64, ROUNDS = 300, MOST_STEPS = 1000 };
    static uint32_t slots[STORE_SLOTS][WORDS];
    static const uint32_t marks[] = {0, UINT32_MAX, 0x47465331u, 0x2D5A1E69u, 0x5AC3A53Cu, 0x47520001u, 0x4752FFFFu};
    uint32_t data[WORDS];
    for (uint32_t round = 0; round < ROUNDS; round++) {
        for (uint32_t i = 0; i < STORE_SLOTS * WORDS; i++) {
            slots[i / WORDS][i % WORDS] = noise() % 3u == 0u ? noise() : marks[noise() % 7u];
        }
        const store_flash_t flash = {{slots[0], slots[1]}, noise() % (WORDS + 1u)};
        store_t kept;
        store_open(&kept, &flash);
        for (uint32_t i = 0; i < MOST_STEPS; i++) {
            const store_step_t step = store_next(&kept);
            if (step.kind == STORE_PROGRAM && noise() % 8u != 0u) {
                slots[step.slot][step.index] &= step.value;
            } else if (step.kind == STORE_ERASE) {
                memset(slots[step.slot], 0xFF, (size_t)flash.words * sizeof slots[0][0]);
            } else if (step.kind == STORE_NOTHING) {
                data[noise() % WORDS] = noise();
                (void)store_save(&kept, data, noise() % WORDS);
            }
        }
        uint32_t count;
        const uint32_t *const read = store_read(&kept, &count);
        REQUIRE(read != NULL || count == 0u);
        REQUIRE(read == NULL || crc32(0, read, (size_t)count * sizeof *read) != 1u);
    }
}

int main(void) {
    gold();
    despread();
    lists();
    clocks();
    field_stages();
    currents();
    waveforms();
    bytes();
    sets();
    store();
    threads();
    return 0;
}
