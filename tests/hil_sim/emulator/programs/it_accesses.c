/* Loads and stores within IT blocks of which the emulator's engine asks: the first of a page, those of a page that is
 * forbidden in part, all while unaligned ones are forbidden. What follows the IT block is noted: none of it is skipped.
 */
#include "runtime.h"

#define PAGE         1024u /* Bytes: Unicorn's page. */
#define PAGES        6u
#define TRAP_UNALIGN (1u << 3) /* CCR */
#define PRIVILEGED   4u        /* MPU_CONTROL: what no region covers is allowed. */

static uint8_t memory[PAGES * PAGE] __attribute__((aligned(1024)));

/* The condition holds inside of the block and no more behind it, where another translated block begins. */
#define IN_BLOCK(name, access)                                                                                         \
    static __attribute__((noinline)) uint32_t name(uint32_t address) {                                                 \
        uint32_t sum, word = 0x77u;                                                                                    \
        __asm volatile("movs %0, #1\n cmp %0, #1\n ittt eq\n " access                                                  \
                       "\n moveq %0, #2\n addeq %0, #3\n cmp %0, #0\n b 1f\n 1: adds %0, #10\n adds %0, #20"           \
                       "\n adds %0, #40"                                                                               \
                       : "=&l"(sum), "+l"(word)                                                                        \
                       : "l"(address)                                                                                  \
                       : "cc", "memory");                                                                              \
        return sum;                                                                                                    \
    }
IN_BLOCK(load, "ldreq %1, [%2]")
IN_BLOCK(store, "streq %1, [%2]")

/* The engine forgets all pages when a rule changes. */
static void rule(uint32_t base, uint32_t rules) {
    MPU_CONTROL = 0;
    MPU_BASE = base | 0x10u;
    MPU_RULES = rules | 1u;
    MPU_CONTROL = PRIVILEGED | 1u;
    BARRIER();
}

static void accesses(void) {
    for (uint32_t page = 0; page < PAGES; page++) {
        const uint32_t place = (uint32_t)memory + page * PAGE;
        rule(place, READ_ONLY | NO_EXECUTE | SIZE(8));
        note(load(place + 512u));
        rule(place, READ_ONLY | NO_EXECUTE | SIZE(8));
        note(store(place + 516u));
        note(store(place + 516u));
        note(*(volatile uint32_t *)(place + 516u));
    }
}

int main(void) {
    accesses();
    CCR |= TRAP_UNALIGN;
    BARRIER();
    accesses();
    finish();
    return 0;
}
