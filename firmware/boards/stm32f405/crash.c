/* crash.c: the last words of a board.
 *
 * Any fault, and any interrupt without a handler, ends here. The coil drive goes off; what is known goes into the
 * record that outlives the reset (reset.c); and one line of text goes out by polling, between two frame delimiters, so
 * that a receiver of frames drops it as malformed and a terminal shows it:
 *   crash pc=080012a4 lr=08001275 cfsr=00008200 hfsr=40000000 ipsr=00000003
 * Then the board waits for its watchdog.
 */

#include <string.h>

#include "boards/stm32f405/stm32f405.h"

#define EXC_RETURN_BASIC 0x10u /* Set: the frame has no floating-point registers (ARMv7-M, table B1-8). */
#define FRAME_WORDS      8u
#define FRAME_WORDS_FP   26u
#define XPSR_ALIGNED     (1u << 9) /* A word of padding lies above the frame. */

enum { FRAME_LR = 5, FRAME_PC = 6, FRAME_XPSR = 7 };

extern uint32_t stack_bottom[], stack_top[];
extern const uint32_t text_start, text_end;

static void say(const char *text, uint32_t value) {
    uint8_t line[24];
    size_t count = 0;
    while (*text != '\0' && count < sizeof line - 8)
        line[count++] = (uint8_t)*text++;
    for (int shift = 28; shift >= 0; shift -= 4)
        line[count++] = (uint8_t) "0123456789abcdef"[value >> shift & 15u];
    hal_serial_write_polled(&board, line, count);
}

static void say_all(const hal_crash_t *crash) {
    static const uint8_t begin[] = {0}, end[] = {'\r', '\n', 0};
    hal_serial_write_polled(&board, begin, sizeof begin);
    say("crash pc=", crash->pc);
    say(" lr=", crash->lr);
    say(" cfsr=", crash->cfsr);
    say(" hfsr=", crash->hfsr);
    say(" ipsr=", crash->exception);
    hal_serial_write_polled(&board, end, sizeof end);
}

/* A frame that could not be pushed, an address just below the stack, or a stack pointer that has left it: the stack
 * ran over. The address counts only if its register is valid. */
static bool ran_over(const hal_crash_t *crash) {
    const uint32_t bottom = (uint32_t)stack_bottom;
    return (crash->cfsr & (SCB_CFSR_MSTKERR | SCB_CFSR_STKERR)) != 0 || crash->sp < bottom ||
           (crash->address < bottom && crash->address >= bottom - STACK_GUARD_BYTES);
}

/* Takes from the stack what the processor pushed, if all of it lies inside, and what lies above. */
static void read_stack(hal_crash_t *crash, const uint32_t *frame, uint32_t exc_return) {
    if (frame < stack_bottom || frame + FRAME_WORDS > stack_top)
        return;
    crash->lr = frame[FRAME_LR];
    crash->pc = frame[FRAME_PC];
    const uint32_t *above = frame + ((exc_return & EXC_RETURN_BASIC) != 0 ? FRAME_WORDS : FRAME_WORDS_FP);
    above += (frame[FRAME_XPSR] & XPSR_ALIGNED) != 0 ? 1u : 0u;
    crash->sp = (uint32_t)above;
    for (unsigned i = 0; i < HAL_CRASH_STACK && above + i < stack_top; i++)
        crash->stack[i] = above[i];
}

/* Takes from the far end of a stack that ran over the words that may be return addresses: they tell who called whom. */
static void read_calls(hal_crash_t *crash) {
    const uint32_t words = ((uint32_t)stack_top - (uint32_t)stack_bottom) / sizeof stack_bottom[0];
    uint32_t found = 0;
    for (uint32_t i = 0; i < words && found < HAL_CRASH_STACK; i++) {
        const uint32_t word = stack_bottom[i];
        if ((word & 1u) != 0 && word >= (uint32_t)&text_start && word < (uint32_t)&text_end)
            crash->stack[found++] = word;
    }
}

__attribute__((noreturn, used)) static void crash(const uint32_t *frame, uint32_t exception, uint32_t exc_return) {
    hal_drive_enable(&board, false);
    IWDG->KR = IWDG_KR_KEY_START; /* It may not run yet. */

    hal_crash_t crash;
    memset(&crash, 0, sizeof crash);
    crash.exception = exception;
    crash.sp = (uint32_t)frame;
    crash.cfsr = SCB->CFSR;
    crash.hfsr = SCB->HFSR;
    crash.address = (crash.cfsr & SCB_CFSR_MMARVALID) != 0   ? SCB->MMFAR
                    : (crash.cfsr & SCB_CFSR_BFARVALID) != 0 ? SCB->BFAR
                                                             : 0u;
    crash.stack_overflow = ran_over(&crash);
    read_stack(&crash, frame, exc_return);
    if (crash.stack_overflow)
        read_calls(&crash);
    reset_crash(&crash);
    reset_note_uptime(&board);
    say_all(&crash);
    for (;;)
        __asm volatile("wfi");
}

/* The exception's frame lies at the stack pointer. If the stack ran over, or nearly, the report takes the stack from
 * its top, whose contents are lost anyway. */
__attribute__((naked)) void Fault_Handler(void) {
    __asm volatile("cpsid i\n\t"
                   "mov r0, sp\n\t"
                   "mrs r1, ipsr\n\t"
                   "mov r2, lr\n\t"
                   "ldr r3, =stack_bottom + 512\n\t"
                   "ldr r12, =stack_top\n\t"
                   "cmp r0, r3\n\t"
                   "it lo\n\t"
                   "movlo sp, r12\n\t"
                   "b crash");
}
