#include "emulator/upsets.h"

#include <stdlib.h>
#include <string.h>

#include "emulator/code_view.h"
#include "emulator/flash_wait.h"
#include "emulator/it_block.h"

#define NOP         0xBF00u
#define NOP_W_FIRST 0xF3AFu
#define NOP_W_LAST  0x8000u
#define BLOCK_BYTES 14u /* An instruction of an IT block lies at most so far behind its opening. */
#define CORE_FLAGS  16u /* Numbers of registers, as emulator.h has them. */
#define CORE_PC     15u
#define FLAGS_MASK  0xF8000000u

typedef enum {
    UPSET_NONE,
    UPSET_AWAITED, /* left executions of the instruction at opening are to come. */
    UPSET_SET,     /* The NOP is there; the processor has not yet gone on at opening, */
    UPSET_RUNS,    /* and now it has. */
} phase_t;

struct upsets {
    phase_t phase;
    uint32_t target, size;    /* The instruction, */
    uint32_t opening, behind; /* where its IT block opens, or itself; and the first one behind the block, or it. */
    uint64_t left;
    uint32_t mask; /* Bits to flip; 0: the instruction is skipped. */
    unsigned core_register;
    uint8_t bytes[4]; /* Those of the instruction, while the NOP is there. */
    bool hooked, struck;
    uc_hook hook;

    uint32_t from, to; /* Visits are noted here, */
    int64_t *first_ps; /* a place a halfword: when its instruction began first, or -1. NULL: nowhere. */
    uc_hook visit_hook;
};

static upsets_t *upsets_of(cpu_t *cpu) {
    if (cpu->upsets == NULL) {
        cpu->upsets = calloc(1, sizeof *cpu->upsets);
    }
    return cpu->upsets;
}

/* ---- Striking ---- */

/* Leave before the instruction that is about to run, which the code hook has counted already. */
static void leave_before(cpu_t *cpu, uint32_t address, uint32_t go_on) {
    cpu->executed--;
    if (cpu->cycles.table != NULL) {
        cpu->work -= cycles_of(&cpu->cycles, cpu->machine, address);
        cpu->cycles.expected = address;
    }
    cpu->deadline = 0;
    cpu->leave = LEAVE_STOPPED;
    cpu->pc = go_on;
    cpu->it_state = 0;
    uc_emu_stop(cpu->uc);
}

static void rewrite(cpu_t *cpu, const uint8_t *bytes) {
    const upsets_t *const upsets = cpu->upsets;
    memcpy(machine_memory(cpu->machine, upsets->target, upsets->size), bytes, upsets->size);
    flash_wait_changed(cpu, upsets->target & (FLASH_SIZE - 1u), upsets->size);
}

static void flip(cpu_t *cpu) {
    const upsets_t *const upsets = cpu->upsets;
    const int core = upsets->core_register < 13u    ? UC_ARM_REG_R0 + (int)upsets->core_register
                     : upsets->core_register == 13u ? UC_ARM_REG_SP
                     : upsets->core_register == 14u ? UC_ARM_REG_LR
                                                    : UC_ARM_REG_XPSR;
    const uint32_t value = cpu_register(cpu, core) ^ upsets->mask;
    if (core == UC_ARM_REG_XPSR) {
        cpu_set_register(cpu, UC_ARM_REG_XPSR_NZCVQG, value & ~IT_BLOCK_XPSR);
    } else {
        cpu_set_register(cpu, core, value);
    }
}

static void strike(cpu_t *cpu, uint32_t address) {
    upsets_t *const upsets = cpu->upsets;
    static const uint16_t narrow[] = {NOP}, wide[] = {NOP_W_FIRST, NOP_W_LAST};
    upsets->struck = true;
    if (upsets->mask == 0) {
        memcpy(upsets->bytes, machine_memory(cpu->machine, upsets->target, upsets->size), upsets->size);
        rewrite(cpu, upsets->size == sizeof narrow ? (const uint8_t *)narrow : (const uint8_t *)wide);
        upsets->phase = UPSET_SET;
    } else {
        upsets->phase = UPSET_NONE;
        if (upsets->core_register != CORE_PC) {
            flip(cpu);
        }
    }
    leave_before(cpu, address, upsets->core_register == CORE_PC ? address ^ upsets->mask : address);
}

static void on_upset(uc_engine *uc, uint64_t address, uint32_t size, void *user) {
    (void)uc;
    (void)size;
    cpu_t *const cpu = user;
    upsets_t *const upsets = cpu->upsets;
    if (cpu->leave != LEAVE_NOTHING) {
        return; /* The instruction does not begin yet. */
    }
    const bool opens = (uint32_t)address == upsets->opening;
    if (upsets->phase == UPSET_AWAITED && opens) {
        upsets->left--;
        if (upsets->left == 0) {
            strike(cpu, (uint32_t)address);
        }
    } else if (upsets->phase == UPSET_SET && opens) {
        upsets->phase = UPSET_RUNS;
    } else if (upsets->phase == UPSET_RUNS && (opens || (uint32_t)address == upsets->behind)) {
        rewrite(cpu, upsets->bytes);
        upsets->phase = UPSET_NONE;
        leave_before(cpu, (uint32_t)address, (uint32_t)address);
    }
}

/* ---- Choosing ---- */

/* Finds the IT block in which the instruction at an address lies, if it does: in opening where it begins, in behind
 * what follows it. */
static void find_block(const cpu_t *cpu, upsets_t *upsets) {
    upsets->opening = upsets->target;
    upsets->behind = upsets->target + upsets->size;
    for (uint32_t back = 2; back <= BLOCK_BYTES; back += 2) {
        const uint32_t opening = upsets->target - back;
        uint16_t opcode;
        if (!code_opcode_at(cpu, opening, &opcode) || !it_block_opens(opcode)) {
            continue;
        }
        uint8_t state = (uint8_t)opcode;
        uint32_t address = opening + 2u;
        bool inside = false;
        for (; state != 0 && code_opcode_at(cpu, address, &opcode); state = it_block_advance(state)) {
            inside = inside || address == upsets->target;
            address += thumb_size(opcode);
        }
        if (inside) {
            upsets->opening = opening;
            upsets->behind = address;
            return;
        }
    }
}

/* Waits for an instruction's nth execution. Unicorn must not run. */
static bool await(cpu_t *cpu, uint32_t address, uint64_t nth, unsigned core_register, uint32_t mask) {
    upsets_t *const upsets = upsets_of(cpu);
    uint16_t opcode;
    if (upsets == NULL || nth == 0 || !machine_in_flash(address) || !code_opcode_at(cpu, address, &opcode) ||
        upsets->phase == UPSET_SET || upsets->phase == UPSET_RUNS) {
        return false;
    }
    if (upsets->hooked) {
        uc_hook_del(cpu->uc, upsets->hook);
    }
    upsets->target = address;
    upsets->size = thumb_size(opcode);
    upsets->left = nth;
    upsets->core_register = core_register;
    upsets->mask = mask;
    upsets->struck = false;
    find_block(cpu, upsets);
    upsets->hooked = uc_hook_add(cpu->uc, &upsets->hook, UC_HOOK_CODE, (void *)on_upset, cpu, upsets->opening,
                                 upsets->behind) == UC_ERR_OK;
    upsets->phase = upsets->hooked ? UPSET_AWAITED : UPSET_NONE;
    /* What is translated already has no hook. */
    flash_wait_changed(cpu, upsets->opening & (FLASH_SIZE - 1u), upsets->behind + 4u - upsets->opening);
    return upsets->hooked;
}

bool upsets_skip(cpu_t *cpu, uint32_t address, uint64_t nth) {
    return await(cpu, address & ~1u, nth, 0, 0);
}

bool upsets_flip(cpu_t *cpu, uint32_t address, uint64_t nth, unsigned core_register, uint32_t mask) {
    const uint32_t allowed = core_register < CORE_PC       ? UINT32_MAX
                             : core_register == CORE_PC    ? UINT32_MAX - 1u
                             : core_register == CORE_FLAGS ? FLAGS_MASK
                                                           : 0u;
    return mask != 0 && (mask & ~allowed) == 0 && await(cpu, address & ~1u, nth, core_register, mask);
}

bool upsets_struck(const cpu_t *cpu) {
    return cpu->upsets != NULL && cpu->upsets->struck;
}

/* ---- Visits ---- */

static void on_visit(uc_engine *uc, uint64_t address, uint32_t size, void *user) {
    (void)uc;
    (void)size;
    cpu_t *const cpu = user;
    int64_t *const first_ps = &cpu->upsets->first_ps[((uint32_t)address - cpu->upsets->from) / 2u];
    if (cpu->leave == LEAVE_NOTHING && *first_ps < 0) {
        *first_ps = core_clock_time(&cpu->clock, cpu_access_cycle(cpu));
    }
}

bool upsets_visits_begin(cpu_t *cpu, uint32_t from, uint32_t to) {
    upsets_t *const upsets = upsets_of(cpu);
    if (upsets == NULL || from >= to || (from & 1u) != 0 || (to & 1u) != 0) {
        return false;
    }
    if (upsets->first_ps != NULL) {
        uc_hook_del(cpu->uc, upsets->visit_hook);
        free(upsets->first_ps);
    }
    const size_t bytes = (to - from) / 2u * sizeof *upsets->first_ps;
    upsets->first_ps = malloc(bytes);
    if (upsets->first_ps == NULL ||
        uc_hook_add(cpu->uc, &upsets->visit_hook, UC_HOOK_CODE, (void *)on_visit, cpu, from, to - 2u) != UC_ERR_OK) {
        free(upsets->first_ps);
        upsets->first_ps = NULL;
        return false;
    }
    memset(upsets->first_ps, 0xFF, bytes);
    upsets->from = from;
    upsets->to = to;
    uc_ctl_flush_tb(cpu->uc);
    return true;
}

size_t upsets_visits(const cpu_t *cpu, int64_t *first_ps, size_t count) {
    const upsets_t *const upsets = cpu->upsets;
    if (upsets == NULL || upsets->first_ps == NULL) {
        return 0;
    }
    const size_t all = (upsets->to - upsets->from) / 2u, copied = count < all ? count : all;
    memcpy(first_ps, upsets->first_ps, copied * sizeof *first_ps);
    return copied;
}

void upsets_free(cpu_t *cpu) {
    if (cpu->upsets != NULL) {
        free(cpu->upsets->first_ps);
        free(cpu->upsets);
    }
}
