/* A loop of five turns whose sum tells which of its instructions were skipped: each adds a hexadecimal digit of its
 * own. With argument 1 an interrupt comes every 200 cycles. */
#include "runtime.h"

#define ARGUMENT REGISTER(0x000E0000u)

void systick_handler(void) {}

/* r0 is the sum, r1 the turn, r2 where each turn's sum goes. */
__attribute__((naked, noinline, used)) uint32_t sum_of_turns(uint32_t sum, uint32_t turn, uint32_t *turns) {
    __asm volatile("push {r4, lr}\n"
                   ".global at_narrow, at_wide, at_call, at_it, at_then, at_else, at_store, at_branch\n"
                   "1:\n"
                   "at_narrow: adds r0, #1\n"
                   "at_wide: add.w r0, r0, #0x10\n"
                   "at_call: bl add_in_call\n"
                   "cmp r1, #2\n"
                   "at_it: ite lt\n"
                   "at_then: addlt.w r0, r0, #0x1000\n"
                   "at_else: addge.w r0, r0, #0x10000\n"
                   "at_store: str r0, [r2, r1, lsl #2]\n"
                   "adds r1, #1\n"
                   "cmp r1, #5\n"
                   "at_branch: bne 1b\n"
                   "pop {r4, pc}\n"
                   ".thumb_func\n"
                   "add_in_call: add.w r0, r0, #0x100\n"
                   "bx lr\n");
}

int main(void) {
    static uint32_t turns[5];
    if (ARGUMENT == 1) {
        SYSTICK_RELOAD = 199u;
        SYSTICK_COUNT = 0;
        SYSTICK_CONTROL = 7;
    }
    for (uint32_t i = 0; i < 5; i++) {
        turns[i] = 0;
    }
    note(sum_of_turns(0, 0, turns));
    for (uint32_t i = 0; i < 5; i++) {
        note(turns[i]);
    }
    return 0;
}
