#include "emulator/cycles.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "emulator/it_block.h"

enum {
    REFILL = 3,
    DIVISION = 12,
    FLOAT_DIVISION = 14,
    FLOAT_MULTIPLY_ADD = 3,
    BARRIER = 4,
    ENTRY = 12,
    RETURN = 10,
    FLOAT_CONTEXT = 17,
    BRANCH_HITS = 8,  /* One taken branch of so many misses the instruction cache, */
    LITERAL_HITS = 4, /* and one literal load of so many the data cache. */
    LINE_HALFWORDS = 8
};
#define ACR_LATENCY     7u
#define ACR_PREFETCH    0x100u
#define ACR_INSTRUCTION 0x200u
#define ACR_DATA        0x400u

#define APB1_END 0x40010000u
#define APB2_END 0x40020000u

/* ---- Classes (encodings: ARMv7-M architecture reference manual, A5 and A6) ---- */

static unsigned bits_set(unsigned word) {
    return (unsigned)__builtin_popcount(word);
}

static unsigned cycles_16(uint16_t code) {
    const bool load = (code & 0x0800u) != 0;
    switch (code >> 12) {
    case 0x4:
        return (code & 0x0800u) != 0 ? 2 : 1; /* LDR literal. */
    case 0x5:
        return 2; /* Register offset. */
    case 0x6:
    case 0x7:
    case 0x8:
    case 0x9:
        return load ? 2 : 1;
    case 0xB:
        if ((code & 0x0600u) == 0x0400u) { /* PUSH, POP. */
            return 1 + bits_set(code & 0x1FFu);
        }
        return (code & 0x0FE0u) == 0x0660u ? 2 : 1; /* CPS. */
    case 0xC:
        return 1 + bits_set(code & 0xFFu);
    default:
        return 1;
    }
}

static unsigned cycles_float(uint16_t first, uint16_t second) {
    const unsigned operation = first >> 4 & 0xBu;
    if ((first & 0xFFE0u) == 0xEC40u) {
        return 2; /* VMOV, two registers. */
    }
    if ((first & 0xFF20u) == 0xED00u) {
        return (second & 0x100u) != 0 ? 3 : 2; /* VLDR, VSTR. */
    }
    if ((first & 0xFE00u) == 0xEC00u) {
        return 1u + (second & 0xFFu); /* VLDM, VSTM. */
    }
    if ((second & 0x10u) != 0) {
        return 1; /* VMOV, VMRS, VMSR. */
    }
    if (operation == 0x8u || (operation == 0xBu && (first & 0xFu) == 1u && (second & 0xC0u) == 0xC0u)) {
        return FLOAT_DIVISION; /* VDIV, VSQRT. */
    }
    const bool fused = operation == 0x0u || operation == 0x1u || operation == 0x9u || operation == 0xAu;
    return fused ? FLOAT_MULTIPLY_ADD : 1u;
}

static unsigned cycles_32(uint16_t first, uint16_t second) {
    if ((first & 0xEC00u) == 0xEC00u) {
        return cycles_float(first, second);
    }
    if ((first & 0xFE40u) == 0xE800u) {
        return 1 + bits_set(second); /* LDM, STM. */
    }
    if ((first & 0xFE40u) == 0xE840u) {
        const bool dual = (first & 0x0120u) != 0;
        return dual ? 3 : 2; /* LDRD, STRD; exclusive, table branch. */
    }
    if ((first & 0xF800u) == 0xF000u && (second & 0xD000u) == 0x8000u) { /* Miscellaneous control. */
        const unsigned operation = first >> 4 & 0x7Fu;
        return operation == 0x3B ? BARRIER : (operation & 0x7Eu) == 0x38 || (operation & 0x7Eu) == 0x3E ? 2 : 1;
    }
    if ((first & 0xFE00u) == 0xF800u) {
        const bool load = (first & 0x10u) != 0, by_register = (first & 0x80u) == 0 && (second & 0x0FC0u) == 0;
        return load || by_register ? 2 : 1;
    }
    const bool division = (first & 0xFFD0u) == 0xFB90u && (second & 0xF0u) == 0xF0u;
    return division ? DIVISION : 1;
}

unsigned cycles_of_class(uint16_t first, uint16_t second) {
    return thumb_size(first) == 2 ? cycles_16(first) : cycles_32(first, second);
}

static bool loads_literal(uint16_t first) {
    if (thumb_size(first) == 2) {
        return first >> 11 == 9u;
    }
    return (first & 0xFE1Fu) == 0xF81Fu || (first & 0xFF3Fu) == 0xED1Fu || (first & 0xFE5Fu) == 0xE85Fu;
}

/* ---- Costs ---- */

uint32_t cycles_look_up(cycles_t *cycles, machine_t *machine, uint32_t address) {
    const bool in_flash = (address & ~(FLASH_BASE | (FLASH_SIZE - 1u))) == 0;
    uint16_t code[2] = {0, 0};
    const uint8_t *const memory = machine_memory(machine, address, 2);
    if (memory == NULL) {
        return CYCLE;
    }
    memcpy(code, memory, 2);
    const unsigned size = thumb_size(code[0]);
    if (size == 4 && machine_memory(machine, address, 4) != NULL) {
        memcpy(code, memory, 4);
    }
    uint32_t cost = cycles_of_class(code[0], code[1]) * CYCLE;
    if (in_flash) {
        cost += size / 2u * cycles->line + (loads_literal(code[0]) ? cycles->literal : 0);
        cost = cost > UINT16_MAX ? UINT16_MAX : cost;
        cycles->table[(address & (FLASH_SIZE - 1u)) / 2u] = (uint16_t)cost;
    }
    return cost;
}

uint32_t cycles_bus(const cycles_t *cycles, uint32_t address, bool write) {
    if (cycles->table == NULL || write || address >> 28 == 0xEu) {
        return 0;
    }
    return CYCLE * (address < APB1_END ? 8u : address < APB2_END ? 4u : 1u);
}

uint32_t cycles_exception(const cycles_t *cycles, bool entry, bool floating_point) {
    if (cycles->table == NULL) {
        return 0;
    }
    return CYCLE * ((entry ? (unsigned)ENTRY : (unsigned)RETURN) + (floating_point ? (unsigned)FLOAT_CONTEXT : 0u));
}

void cycles_flash_changed(cycles_t *cycles, uint32_t acr) {
    if (cycles->table == NULL) {
        return;
    }
    const uint32_t wait = (acr & ACR_LATENCY) * CYCLE;
    const bool cached = (acr & ACR_INSTRUCTION) != 0;
    cycles->refill = REFILL * CYCLE + (cached ? wait / BRANCH_HITS : wait);
    cycles->line = cached ? 0 : wait / LINE_HALFWORDS / ((acr & ACR_PREFETCH) != 0 ? 2u : 1u);
    cycles->literal = (acr & ACR_DATA) != 0 ? wait / LITERAL_HITS : wait;
    memset(cycles->table, 0, FLASH_SIZE / 2u * sizeof *cycles->table);
}

void cycles_forget(cycles_t *cycles, uint32_t from, uint32_t to) {
    if (cycles->table != NULL) {
        from = from >= 2 ? from - 2u : 0; /* The second halfword of an instruction may have changed. */
        memset(cycles->table + from / 2u, 0, ((to + 1u) / 2u - from / 2u) * sizeof *cycles->table);
    }
}

bool cycles_init(cycles_t *cycles, const emulator_config_t *config) {
    const double wanted = config->cycles_per_instruction;
    cycles->instruction = wanted > 0 ? (uint32_t)lround(wanted * CYCLE) : CYCLE;
    if (!config->cycles_by_class) {
        return true;
    }
    cycles->table = calloc(FLASH_SIZE / 2u, sizeof *cycles->table);
    if (cycles->table == NULL) {
        return false;
    }
    cycles_flash_changed(cycles, 0);
    return true;
}

void cycles_free(cycles_t *cycles) {
    free(cycles->table);
}
