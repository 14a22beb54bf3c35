/* crash.c: the last words of a board.
 *
 * Any fault, and any interrupt without a handler, ends here: the coil drive goes off, and one line of text goes out by
 * polling, between two frame delimiters, so that a receiver of frames drops it as malformed and a terminal shows it:
 *   crash pc=080012a4 lr=08001275 cfsr=00008200 hfsr=40000000 ipsr=00000003
 * Then the board waits for its watchdog.
 */

#include "boards/stm32f405/stm32f405.h"

extern uint32_t stack_bottom, stack_top;

static void say(const char *text, uint32_t value) {
    uint8_t line[24];
    size_t count = 0;
    while (*text != '\0' && count < sizeof line - 8)
        line[count++] = (uint8_t)*text++;
    for (int shift = 28; shift >= 0; shift -= 4)
        line[count++] = (uint8_t) "0123456789abcdef"[value >> shift & 15u];
    hal_serial_write_polled(&board, line, count);
}

__attribute__((noreturn, used)) static void crash(const uint32_t *frame, uint32_t exception) {
    GPIOC->BSRR = 1u << (9 + 16);
    IWDG->KR = IWDG_KR_KEY_START; /* It may not run yet. */

    /* A stack that ran over has no frame. */
    const bool readable = frame >= &stack_bottom && frame + 8 <= &stack_top;
    static const uint8_t begin[] = {0}, end[] = {'\r', '\n', 0};
    hal_serial_write_polled(&board, begin, sizeof begin);
    say("crash pc=", readable ? frame[6] : 0);
    say(" lr=", readable ? frame[5] : 0);
    say(" cfsr=", SCB->CFSR);
    say(" hfsr=", SCB->HFSR);
    say(" ipsr=", exception);
    hal_serial_write_polled(&board, end, sizeof end);
    for (;;)
        __asm volatile("wfi");
}

/* The exception's frame lies at the stack pointer. If the stack ran over, or nearly, the report takes the stack from
 * its top, whose contents are lost anyway. */
__attribute__((naked)) void Fault_Handler(void) {
    __asm volatile("cpsid i\n\t"
                   "mov r0, sp\n\t"
                   "mrs r1, ipsr\n\t"
                   "ldr r2, =stack_bottom + 256\n\t"
                   "ldr r3, =stack_top\n\t"
                   "cmp r0, r2\n\t"
                   "it lo\n\t"
                   "movlo sp, r3\n\t"
                   "b crash");
}
