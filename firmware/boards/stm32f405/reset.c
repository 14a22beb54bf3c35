/* reset.c: why the board started, and what outlives a reset.
 *
 * The record lies at the end of core-coupled memory, where start-up clears nothing and no stray DMA comes, so that it
 * outlives every reset that leaves the memory its power, and images of other sizes find it. It has three parts:
 *   the history   What led to this start, and how often each cause did. It is sealed by a magic number and a CRC: if
 *                 they are wrong the record is what power-on left, and begins anew. A crash writes its registers and
 *                 seals them.
 *   the diary     How long the board has run and which of its parts stand still, written all the time; each word has
 *                 its complement beside it, since a reset may strike between the two.
 *   the services' words (hal_retained), which are theirs. They are as good as the history's seal.
 * After power-on everything is 0 but the count of that power-on.
 *
 * A power-on sets the flags of brown-out and pin as well, and every reset of the chip itself pulls the pin (RM0090,
 * 7.1.1 and 7.3.21): the flags are looked at from the most telling to the least.
 */

#include <string.h>

#include "boards/stm32f405/stm32f405.h"

#define MAGIC 0x52464731u /* "1GFR": it changes when the record's layout does. */

typedef struct {
    uint32_t value, complement;
} noted_t;

typedef struct {
    uint32_t magic;
    struct {
        uint32_t counts[HAL_RESET_CAUSES];
        hal_crash_t crash; /* How the run that ends now crashed. */
    } history;
    uint32_t crc; /* The history has this CRC-32. */
    noted_t uptime_s, stalled;
    uint32_t words[HAL_RETAINED_WORDS];
} record_t;

__attribute__((section(".retained"))) static record_t record;

/* What hal_last_reset() tells. It lies here only because there is room. */
__attribute__((section(".retained"))) static hal_reset_t last;

/* Returns the CRC-32 of ISO-HDLC (polynomial 0xEDB88320, reflected; check value 0xCBF43926) of whole words. */
static uint32_t crc_of(const uint32_t *words, uint32_t count) {
    uint32_t crc = 0xFFFFFFFFu;
    for (uint32_t i = 0; i < count; i++) {
        crc ^= words[i];
        for (unsigned bit = 0; bit < 32; bit++)
            crc = crc >> 1 ^ ((crc & 1u) != 0 ? 0xEDB88320u : 0u);
    }
    return ~crc;
}

static uint32_t crc_of_history(void) {
    return crc_of((const uint32_t *)&record.history, sizeof record.history / sizeof(uint32_t));
}

static void seal(void) {
    record.magic = MAGIC;
    record.crc = crc_of_history();
}

static void note(noted_t *noted, uint32_t value) {
    *noted = (noted_t){value, ~value};
}

static uint32_t read_note(const noted_t *noted) {
    return noted->complement == ~noted->value ? noted->value : 0u;
}

static hal_reset_cause_t cause_of(uint32_t flags) {
    static const struct {
        uint32_t flag;
        hal_reset_cause_t cause;
    } order[] = {
        {RCC_CSR_PORRSTF, HAL_RESET_POWER_ON},   {RCC_CSR_BORRSTF, HAL_RESET_BROWN_OUT},
        {RCC_CSR_WDGRSTF, HAL_RESET_WATCHDOG},   {RCC_CSR_WWDGRSTF, HAL_RESET_WINDOW},
        {RCC_CSR_LPWRRSTF, HAL_RESET_LOW_POWER}, {RCC_CSR_SFTRSTF, HAL_RESET_SOFTWARE},
        {RCC_CSR_PADRSTF, HAL_RESET_PIN},
    };
    for (unsigned i = 0; i < sizeof order / sizeof order[0]; i++) {
        if ((flags & order[i].flag) != 0)
            return order[i].cause;
    }
    return HAL_RESET_POWER_ON; /* No flag: a partial model of the chip. */
}

void reset_start(hal_t *hal) {
    const hal_reset_cause_t cause = cause_of(RCC->CSR);
    RCC->CSR |= RCC_CSR_RMVF;
    const bool remembered = record.magic == MAGIC && record.crc == crc_of_history();
    if (!remembered || cause == HAL_RESET_POWER_ON)
        memset(&record, 0, sizeof record);
    record.history.counts[cause]++;

    memset(&last, 0, sizeof last);
    last.cause = cause;
    last.uptime_s = read_note(&record.uptime_s);
    last.stalled = cause == HAL_RESET_WATCHDOG ? read_note(&record.stalled) : 0u;
    memcpy(last.counts, record.history.counts, sizeof last.counts);
    last.crash = record.history.crash;
    hal->counters.watchdog_resets = last.counts[HAL_RESET_WATCHDOG];

    memset(&record.history.crash, 0, sizeof record.history.crash);
    note(&record.uptime_s, 0);
    note(&record.stalled, 0);
    seal();
}

void reset_note_uptime(hal_t *hal) {
    note(&record.uptime_s, (uint32_t)(hal_microseconds(hal) / 1000000u));
}

void hal_note_stalled(hal_t *hal, uint32_t stalled) {
    (void)hal;
    note(&record.stalled, stalled);
}

void reset_crash(const hal_crash_t *crash) {
    record.history.crash = *crash;
    seal();
}

const hal_reset_t *hal_last_reset(const hal_t *hal) {
    (void)hal;
    return &last;
}

uint32_t *hal_retained(hal_t *hal) {
    (void)hal;
    return record.words;
}
