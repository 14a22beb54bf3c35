#include "emulator/code_view.h"

#include <string.h>

#include "emulator/it_block.h"

bool code_opcode_at(const cpu_t *cpu, uint32_t address, uint16_t *opcode) {
    const uint8_t *const memory = machine_memory(cpu->machine, address, 2);
    if (memory != NULL) {
        memcpy(opcode, memory, sizeof *opcode);
    }
    return memory != NULL;
}

/* ITSTATE at target, if walking from address with state leads there inside the block; else 0. */
static uint8_t walk(const cpu_t *cpu, uint32_t address, uint8_t state, uint32_t target) {
    uint16_t opcode;
    while (state != 0 && address < target && code_opcode_at(cpu, address, &opcode)) {
        address += thumb_size(opcode);
        state = it_block_advance(state);
    }
    return address == target ? state : 0;
}

/* ITSTATE of the instruction at address, which is about to run or just failed, from the instructions that ran before
 * it. */
uint8_t code_it_state_at(const cpu_t *cpu, uint32_t address) {
    if (cpu->executed - cpu->resume_executed < 5) {
        const uint8_t state = walk(cpu, cpu->resume_pc, cpu->resume_it_state, address);
        if (state != 0) {
            return state;
        }
    }
    for (uint64_t back = 1; back <= 5 && back <= cpu->executed - cpu->resume_executed; back++) {
        const uint32_t origin = cpu->history[(cpu->executed - back) % HISTORY];
        uint16_t opcode;
        if (origin < address && code_opcode_at(cpu, origin, &opcode) && it_block_opens(opcode)) {
            return walk(cpu, origin + 2u, (uint8_t)opcode, address);
        }
    }
    return 0;
}

/* Instructions that need the floating-point unit: coprocessors 10 and 11 (ARMv7-M manual, A5.3.18). */
bool code_is_floating_point(const cpu_t *cpu, uint32_t address) {
    uint16_t first, second;
    return code_opcode_at(cpu, address, &first) && (first & 0xEC00u) == 0xEC00u &&
           code_opcode_at(cpu, address + 2u, &second) && (second & 0x0E00u) == 0x0A00u;
}

bool code_is_division(const cpu_t *cpu, uint32_t address, unsigned *divisor) {
    uint16_t first, second;
    if (!code_opcode_at(cpu, address, &first) || (first & 0xFFD0u) != 0xFB90u ||
        !code_opcode_at(cpu, address + 2u, &second) || (second & 0xF0u) != 0xF0u) {
        return false;
    }
    *divisor = second & 0xFu;
    return true;
}

uint32_t code_last_address(const cpu_t *cpu) {
    return cpu->history[(cpu->executed - 1u) % HISTORY];
}

bool code_is_single_transfer(const cpu_t *cpu) {
    uint16_t opcode;
    if (!code_opcode_at(cpu, code_last_address(cpu), &opcode)) {
        return false;
    }
    /* 16 bits: LDR/STR and halfwords. 32 bits: A5.3.7 to A5.3.10, single data items. */
    return thumb_size(opcode) == 2 ? (opcode >> 12 >= 5u && opcode >> 12 <= 9u) || opcode >> 11 == 9u
                                   : (opcode & 0xFE00u) == 0xF800u;
}
