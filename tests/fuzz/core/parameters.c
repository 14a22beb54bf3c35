/* parameters.c: whatever a page in flash, a saved set or a message says, every parameter stays in the range of its
 * table; what is refused changes nothing; a page does what its entries do one by one; and a set that was written is
 * read back as it was. */
#include "core/link/parameters.h"
#include "core/link/frame.h"
#include "core/link/parameter_set.h"
#include "fuzz.h"

#define PAGE_MAX  1024u
#define WORDS_MAX 512u

enum { PAGE = 0, SET = 1, MESSAGES = 2, KINDS = 3 };

static float float_of(uint32_t bits) {
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static bool allowed(const parameter_entry_t *entry, uint32_t bits) {
    switch (entry->kind) {
    case PARAMETER_FLOAT: {
        const float value = float_of(bits);
        return value - value == 0.0f && value >= float_of(entry->minimum) && value <= float_of(entry->maximum);
    }
    case PARAMETER_SIGNED:
        return (int64_t)(int32_t)bits >= (int32_t)entry->minimum && (int64_t)(int32_t)bits <= (int32_t)entry->maximum;
    default:
        return bits >= entry->minimum && bits <= entry->maximum && (entry->excluded == 0u || bits != entry->excluded);
    }
}

static void require_ranges(const parameters_t *parameters) {
    const parameter_entry_t *entry;
    uint32_t elements = 0;
    for (uint32_t i = 0; (entry = parameters_entry(i)) != NULL; i++) {
        for (uint32_t j = 0; j < (uint32_t)entry->rows * entry->elements; j++) {
            const uint32_t id = entry->first_id + j / entry->elements * entry->stride + j % entry->elements;
            REQUIRE(allowed(entry, parameters->bits[elements]));     /* They are in the order of the table. */
            if (j + 1u == (uint32_t)entry->rows * entry->elements) { /* To find each of them takes long. */
                parameter_value_t value;
                REQUIRE(parameters_get(parameters, id, &value) == PARAMETER_OK);
                REQUIRE(value.kind == entry->kind && value.bits == parameters->bits[elements]);
                REQUIRE(entry->kind != PARAMETER_FLOAT || parameters_float(parameters, id) == float_of(value.bits));
                REQUIRE(entry->kind != PARAMETER_UNSIGNED || parameters_unsigned(parameters, id) == value.bits);
            }
            elements++;
        }
    }
    REQUIRE(elements == PARAMETERS_COUNT);
}

static void require_same(const parameters_t *a, const parameters_t *b) {
    REQUIRE(memcmp(a, b, sizeof *a) == 0);
}

/* The page, whose frame is repaired on demand: what lies behind a check must be found, too. */
static void load_page(input_t *input, parameters_t *parameters, bool repair) {
    const size_t size = input->left < PAGE_MAX ? input->left : PAGE_MAX;
    uint8_t *page = malloc(size + 1u);
    REQUIRE(page != NULL);
    memcpy(page, input->bytes, size);
    if (repair && size >= 8u) {
        const size_t room = (size - 8u) / 8u, count = page[4] % (room + 1u);
        memcpy(page, "GFP1", 4);
        page[4] = (uint8_t)count;
        page[5] = 0;
        const uint16_t crc = frame_crc(page + 8, count * 8u);
        page[6] = (uint8_t)crc;
        page[7] = (uint8_t)(crc >> 8);
    }
    const parameters_t before = *parameters;
    parameters_t expected = before;
    uint32_t refused, wanted = 0;
    const parameters_page_t result = parameters_load(parameters, page, size, &refused);
    for (size_t i = 0; result == PARAMETERS_PAGE_LOADED && i < (size_t)(page[4] | page[5] << 8); i++) {
        input_t entry = {page + 8u + 8u * i, 8};
        const uint32_t id = take_u16(&entry), kind = take_u16(&entry);
        const parameter_value_t value = {(uint8_t)(kind < 256u ? kind : 255u), take_u32(&entry)};
        wanted += parameters_set(&expected, id, value) != PARAMETER_OK;
    }
    REQUIRE(refused == wanted);
    REQUIRE(result == PARAMETERS_PAGE_LOADED || !repair || size < 8u);
    require_same(parameters, &expected);
    free(page);
}

static void read_set(input_t *input, parameters_t *parameters, bool repair) {
    const uint32_t count = (uint32_t)(input->left / 4u < WORDS_MAX ? input->left / 4u : WORDS_MAX);
    uint32_t *words = malloc(count * sizeof *words + 1u);
    REQUIRE(words != NULL);
    for (uint32_t i = 0; i < count; i++) {
        words[i] = take_u32(input);
    }
    if (repair && count > 0u) {
        words[0] = PARAMETER_SET_MARK | PARAMETER_SET_FORMAT;
    }
    const parameters_t before = *parameters;
    uint32_t refused;
    if (parameter_set_read(parameters, words, count, &refused) != PARAMETER_SET_LOADED) {
        require_same(parameters, &before);
        REQUIRE(refused == 0u);
    }
    REQUIRE(refused <= count);
    free(words);
}

static void set_each(input_t *input, parameters_t *parameters) {
    while (input->left > 0u) {
        const uint32_t id = take_u16(input) % 0x1800u;
        const parameter_value_t value = {take_u8(input), take_u32(input)};
        parameter_value_t before, after;
        const parameter_status_t known = parameters_get(parameters, id, &before);
        const parameter_status_t status = parameters_set(parameters, id, value);
        REQUIRE(parameters_get(parameters, id, &after) == known);
        REQUIRE((status == PARAMETER_UNKNOWN) == (known == PARAMETER_UNKNOWN));
        const parameter_value_t *expected = status == PARAMETER_OK ? &value : &before;
        REQUIRE(after.kind == expected->kind && after.bits == expected->bits);
        const parameter_entry_t *next = parameters_next(id, value.kind % 4u);
        REQUIRE(next == NULL || (next->first_id >= id && (next->roles >> value.kind % 4u & 1u) == 1u));
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size) {
    input_t input = {bytes, size};
    const uint32_t mode = take_u8(&input);
    static parameters_t defaults; /* A constant, which takes a while to make. */
    if (defaults.bits[0] == 0u) {
        parameters_init(&defaults);
    }
    parameters_t parameters = defaults, again = defaults;
    if (mode % KINDS == PAGE) {
        load_page(&input, &parameters, mode >= 128u);
    } else if (mode % KINDS == SET) {
        read_set(&input, &parameters, mode >= 128u);
    } else {
        set_each(&input, &parameters);
    }
    require_ranges(&parameters);
    if (mode % 16u >= KINDS) { /* It takes most of the time. */
        return 0;
    }
    static uint32_t words[PARAMETER_SET_WORDS];
    uint32_t refused;
    REQUIRE(parameter_set_write(&parameters, take_u32(&input), words) == PARAMETER_SET_WORDS);
    REQUIRE(parameter_set_read(&again, words, PARAMETER_SET_WORDS, &refused) == PARAMETER_SET_LOADED && refused == 0u);
    require_same(&parameters, &again);
    return 0;
}
