/* Writes code into pages of the RAM that hold data, and code that runs; after each writing it runs the code, and notes
 * what it returned. */
#include "runtime.h"

#define PAGE        256u /* Words: 1 KB, Unicorn's page. */
#define PLACES      (64u * PAGE)
#define FLASH_WORDS ((volatile uint32_t *)0)

static uint32_t memory[6u * PAGE] __attribute__((aligned(1024)));

/* movs r0, #value; bx lr */
static void write_code(uint32_t *place, uint32_t value) {
    *place = 0x47702000u | value;
    BARRIER();
}

static uint32_t call(const uint32_t *place) {
    uint32_t (*function)(void);
    const uint32_t address = (uint32_t)place | 1u;
    __asm volatile("mov %0, %1" : "=r"(function) : "r"(address));
    return function();
}

/* Pages of memory that are one and the same to a narrow table of pages. */
static uint32_t wander(void) {
    uint32_t sum = 0;
    for (unsigned round = 0; round < 6000; round++) {
        for (unsigned page = 0; page < 8; page++) {
            sum ^= FLASH_WORDS[page * PLACES] ^ memory[0];
        }
    }
    return sum & 0u;
}

static void round_of_writes(uint32_t first) {
    for (uint32_t page = 0; page < 6; page++) {
        for (uint32_t word = 0; word < PAGE; word++) {
            memory[page * PAGE + word] = word;
        }
        for (uint32_t version = 0; version < 3; version++) {
            write_code(&memory[page * PAGE + 7u], first + 3u * page + version);
            note(call(&memory[page * PAGE + 7u]));
            memory[page * PAGE + 9u] = version; /* Data beside the code. */
        }
        note(memory[page * PAGE + 9u] + memory[page * PAGE + 8u]);
    }
    for (uint32_t page = 0; page < 6; page++) { /* All of them, one behind the other, after all were written. */
        note(call(&memory[page * PAGE + 7u]));
    }
}

int main(void) {
    round_of_writes(1);
    note(wander());
    round_of_writes(101);
    finish();
    return 0;
}
