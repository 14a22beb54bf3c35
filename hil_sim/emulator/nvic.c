#include "emulator/nvic.h"

#include <string.h>

#define PRIORITY_BITS 0xF0u

static bool bit(const uint32_t *words, unsigned exception) {
    return (words[exception >> 5] >> (exception & 31u) & 1u) != 0;
}

static void set_bit(uint32_t *words, unsigned exception, bool value) {
    const uint32_t mask = 1u << (exception & 31u);
    words[exception >> 5] = value ? words[exception >> 5] | mask : words[exception >> 5] & ~mask;
}

int nvic_group_priority(const nvic_t *nvic, int priority) {
    return priority < 0 ? priority : priority & ~((2 << nvic->priority_group) - 1);
}

int nvic_priority(const nvic_t *nvic, unsigned exception) {
    return exception == EXCEPTION_NMI ? -2 : exception == EXCEPTION_HARD_FAULT ? -1 : nvic->priority[exception];
}

static void update_candidate(nvic_t *nvic) {
    int best = NVIC_IDLE_PRIORITY;
    nvic->candidate = 0;
    for (unsigned word = 0; word < 4; word++) {
        for (uint32_t ready = nvic->pending[word] & nvic->enabled[word]; ready != 0; ready &= ready - 1u) {
            const unsigned exception = 32u * word + (unsigned)__builtin_ctz(ready);
            const int priority = nvic_priority(nvic, exception);
            if (priority < best) { /* Equal priorities: the lower number goes first. */
                best = priority;
                nvic->candidate = exception;
            }
        }
    }
    nvic->candidate_priority = nvic->candidate == 0 ? NVIC_IDLE_PRIORITY : nvic_group_priority(nvic, best);
}

static void update_active(nvic_t *nvic) {
    int best = NVIC_IDLE_PRIORITY;
    for (unsigned word = 0; word < 4; word++) {
        for (uint32_t active = nvic->active[word]; active != 0; active &= active - 1u) {
            const int priority = nvic_group_priority(nvic,
                                                     nvic_priority(nvic, 32u * word + (unsigned)__builtin_ctz(active)));
            best = priority < best ? priority : best;
        }
    }
    nvic->active_priority = best;
}

void nvic_reset(nvic_t *nvic) {
    memset(nvic, 0, sizeof *nvic);
    nvic->enabled[0] = 0xFFFFu;
    update_candidate(nvic);
    update_active(nvic);
}

void nvic_line(nvic_t *nvic, unsigned interrupt, bool level) {
    const unsigned exception = EXCEPTION_INTERRUPT + interrupt;
    set_bit(nvic->line, exception, level);
    if (level) {
        nvic_pend(nvic, exception);
    }
}

void nvic_pend(nvic_t *nvic, unsigned exception) {
    set_bit(nvic->pending, exception, true);
    update_candidate(nvic);
}

void nvic_unpend(nvic_t *nvic, unsigned exception) {
    set_bit(nvic->pending, exception, bit(nvic->line, exception) && !bit(nvic->active, exception));
    update_candidate(nvic);
}

void nvic_activate(nvic_t *nvic, unsigned exception) {
    set_bit(nvic->pending, exception, false);
    set_bit(nvic->active, exception, true);
    update_candidate(nvic);
    update_active(nvic);
}

void nvic_deactivate(nvic_t *nvic, unsigned exception) {
    set_bit(nvic->active, exception, false);
    update_active(nvic);
    if (bit(nvic->line, exception)) {
        nvic_pend(nvic, exception);
    }
}

bool nvic_is_pending(const nvic_t *nvic, unsigned exception) {
    return bit(nvic->pending, exception);
}

bool nvic_is_active(const nvic_t *nvic, unsigned exception) {
    return bit(nvic->active, exception);
}

unsigned nvic_active_count(const nvic_t *nvic) {
    unsigned count = 0;
    for (unsigned word = 0; word < 4; word++) {
        count += (unsigned)__builtin_popcount(nvic->active[word]);
    }
    return count;
}

void nvic_set_priority_group(nvic_t *nvic, unsigned group) {
    nvic->priority_group = group;
    update_candidate(nvic);
    update_active(nvic);
}

void nvic_set_priority(nvic_t *nvic, unsigned exception, uint8_t priority) {
    nvic->priority[exception] = priority & PRIORITY_BITS;
    update_candidate(nvic);
    update_active(nvic);
}

/* ---- Registers. Bits of interrupts lie in exception numbers, 16 further. ---- */

#define BASE           0xE000E000u
#define STIR           0xF00u
#define LAST_INTERRUPT (NVIC_EXCEPTIONS - 1u - EXCEPTION_INTERRUPT)

typedef enum {
    SET_ENABLE = 0x100,
    CLEAR_ENABLE = 0x180,
    SET_PENDING = 0x200,
    CLEAR_PENDING = 0x280,
    ACTIVE = 0x300,
    PRIORITY = 0x400
} bank_t;

static uint32_t interrupt_bits(const uint32_t *words, uint32_t bank) {
    return words[bank] >> 16 | (bank < 3 ? words[bank + 1] << 16 : 0);
}

bool nvic_read(const nvic_t *nvic, uint32_t address, unsigned width, uint32_t *value) {
    const uint32_t offset = address - BASE;
    *value = 0;
    if (offset >= PRIORITY && offset < PRIORITY + 240u) {
        for (unsigned i = 0; i < width && offset - PRIORITY + i <= LAST_INTERRUPT; i++) {
            *value |= (uint32_t)nvic->priority[EXCEPTION_INTERRUPT + offset - PRIORITY + i] << (8u * i);
        }
        return true;
    }
    const uint32_t bank = (offset & 0x7Fu) / 4u;
    if (width != 4 || bank >= 8) {
        return false;
    }
    if (bank >= 3) {
        return offset < PRIORITY; /* Interrupts that this chip has not. */
    }
    switch ((bank_t)(offset & ~0x7Fu)) {
    case SET_ENABLE:
    case CLEAR_ENABLE:
        *value = interrupt_bits(nvic->enabled, bank);
        return true;
    case SET_PENDING:
    case CLEAR_PENDING:
        *value = interrupt_bits(nvic->pending, bank);
        return true;
    case ACTIVE:
        *value = interrupt_bits(nvic->active, bank);
        return true;
    case PRIORITY:
    default:
        return false;
    }
}

static bool write_bits(nvic_t *nvic, bank_t bank, unsigned first, uint32_t value) {
    for (; value != 0; value &= value - 1u) {
        const unsigned interrupt = first + (unsigned)__builtin_ctz(value);
        if (interrupt > LAST_INTERRUPT) {
            break;
        }
        const unsigned exception = EXCEPTION_INTERRUPT + interrupt;
        switch (bank) {
        case SET_ENABLE:
        case CLEAR_ENABLE:
            set_bit(nvic->enabled, exception, bank == SET_ENABLE);
            break;
        case SET_PENDING:
            set_bit(nvic->pending, exception, true);
            break;
        case CLEAR_PENDING:
            nvic_unpend(nvic, exception);
            break;
        case ACTIVE:
            break; /* Read-only. */
        case PRIORITY:
        default:
            return false;
        }
    }
    update_candidate(nvic);
    return true;
}

bool nvic_write(nvic_t *nvic, uint32_t address, unsigned width, uint32_t value) {
    const uint32_t offset = address - BASE;
    if (offset >= PRIORITY && offset < PRIORITY + 240u) {
        for (unsigned i = 0; i < width && offset - PRIORITY + i <= LAST_INTERRUPT; i++) {
            nvic_set_priority(nvic, EXCEPTION_INTERRUPT + offset - PRIORITY + i, (uint8_t)(value >> (8u * i)));
        }
        return true;
    }
    if (offset == STIR && (value & 0x1FFu) <= LAST_INTERRUPT) {
        nvic_pend(nvic, EXCEPTION_INTERRUPT + (value & 0x1FFu));
        return true;
    }
    const uint32_t bank = (offset & 0x7Fu) / 4u;
    if (width != 4 || bank >= 8 || offset < SET_ENABLE || offset >= PRIORITY) {
        return offset == STIR;
    }
    return write_bits(nvic, (bank_t)(offset & ~0x7Fu), 32u * bank, value);
}
