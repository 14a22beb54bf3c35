/* parameters.c: any id, value, page and set, whatever the parameters were. start() is an entry of its own. */
#include "core/link/parameters.h"

#include "any.h"
#include "core/link/parameter_set.h"

#define PAGE  8192u
#define SET   4087u /* Most words of a record of the store: a slot without what is around them. */
#define SMALL 20u
#define FEW   4u

static void load(uint32_t size) {
    static uint8_t page[PAGE];
    parameters_t parameters;
    uint32_t refused;
    fill(&parameters, sizeof parameters);
    fill(page, sizeof page);
    (void)parameters_load(&parameters, page + (PAGE - size), size, &refused);
}

static void one(void) {
    parameters_t parameters;
    fill(&parameters, sizeof parameters);
    parameter_value_t value;
    (void)parameters_get(&parameters, any_word(), &value);
    //@ assert \initialized(&value.kind) && \initialized(&value.bits);
    value = (parameter_value_t){any_byte(), any_word()};
    (void)parameters_set(&parameters, any_word(), value);
    (void)parameters_unsigned(&parameters, any_word());
    (void)parameters_float(&parameters, any_word());
    const parameter_entry_t *entry = parameters_entry(any_word());
    //@ assert entry == \null || \valid_read(entry);
    entry = parameters_next(any_word(), any_up_to(3));
    //@ assert entry == \null || \valid_read(entry);
}
/* Sets of any words, as long as the store holds one. */
static void set(uint32_t count) {
    static uint32_t words[SET];
    parameters_t parameters;
    uint32_t refused;
    fill(&parameters, sizeof parameters);
    fill(words, sizeof words);
    (void)parameter_set_read(&parameters, words + (SET - count), count, &refused);
}

void start(void) {
    parameters_t parameters;
    parameters_init(&parameters);
    //@ assert \initialized(&parameters.bits[0 .. PARAMETERS_COUNT - 1]);
    uint32_t words[PARAMETER_SET_WORDS];
    const uint32_t count = parameter_set_write(&parameters, any_word(), words);
    //@ assert count == PARAMETER_SET_WORDS && \initialized(&words[0 .. PARAMETER_SET_WORDS - 1]);
    (void)parameter_set_holds(&parameters, any_word(), words);
}

int main(void) {
    one();
    for (uint32_t size = 0; size <= SMALL; size++) {
        load(size);
    }
    load(PAGE);
    for (uint32_t count = 0; count <= FEW; count++) {
        set(count);
    }
    set(SET);
    return 0;
}
