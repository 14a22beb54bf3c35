/* Exceptions of every kind, each noting where it was and what it saw. Ends with all notes in results[]. */
#include "runtime.h"

static volatile uint32_t step;

static void note_state(uint32_t tag) {
    uint32_t ipsr, primask, basepri, control;
    __asm volatile("mrs %0, ipsr\n mrs %1, primask\n mrs %2, basepri\n mrs %3, control"
                   : "=r"(ipsr), "=r"(primask), "=r"(basepri), "=r"(control));
    note(tag << 24 | (control & 7u) << 20 | (primask & 1u) << 16 | (basepri & 0xF0u) << 8 | ipsr);
}

static void pend(unsigned irq) {
    ISPR = 1u << irq;
    BARRIER();
}
static void set_basepri(uint32_t value) {
    __asm volatile("msr basepri, %0\n isb" ::"r"(value) : "memory");
}

void irq0_handler(void) /* Lowest: makes 2 pending, which must wait or nest according to the priorities. */
{
    note_state(0x10);
    if (step == 1) {
        pend(1); /* Higher: nests here. */
        note_state(0x11);
    }
    if (step == 2) {
        pend(2); /* Same group: follows. */
        note_state(0x12);
    }
    if (step == 3) {
        ICSR = 1u << 28; /* PendSV, lowest of all. */
        BARRIER();
        note(IABR);
        note(SHCSR & 0xFFFFu);
        note((ICSR >> 12 & 0x1FFu) | (ICSR & 0x1FFu) << 16);
        note_state(0x13);
    }
}

void irq1_handler(void) {
    note_state(0x20);
    if (step == 1) {
        pend(3); /* Highest, nests twice. */
        note_state(0x21);
        pend(0); /* Own lower one while active: again later. */
        step = 9;
    }
}

void irq2_handler(void) {
    note_state(0x30);
}

void irq3_handler(void) {
    note_state(0x40);
    __asm volatile("vmov s0, %0\n vmov s15, %0\n vmov s16, s0\n vmsr fpscr, %1" ::"r"(0x40400000u), "r"(0x80000000u)
                   : "s0", "s15");
    uint32_t control;
    __asm volatile("mrs %0, control" : "=r"(control));
    note(control);
}

void pendsv_handler(void) {
    note_state(0x50);
}

void systick_handler(void) {
    note_state(0x60);
}

__attribute__((used)) void svcall_seen(const uint32_t *frame, uint32_t exc_return) {
    note_state(0x70);
    if (*(const uint8_t *)(frame[6] - 2u) == 99) {
        finish();
    }
    note(*(const uint8_t *)(frame[6] - 2u));
    for (unsigned i = 0; i < 4; i++) {
        note(frame[i]);
    }
    note(exc_return);
    note(frame[7] & 0xF80F0000u);
    ((uint32_t *)frame)[0] = frame[0] + frame[1];
}

__attribute__((naked)) void svcall_handler(void) {
    __asm volatile("tst lr, #4\n ite eq\n mrseq r0, msp\n mrsne r0, psp\n mov r1, lr\n push {r4, lr}\n bl "
                   "svcall_seen\n pop {r4, pc}");
}

/* Faults: notes, then goes on behind the instruction (2 or 4 bytes). */
__attribute__((used)) void fault_seen(uint32_t *frame) {
    note_state(0x80);
    note(CFSR & ~(1u << 13)); /* QEMU knows no lazy stacking fault. */
    note(HFSR);
    if ((CFSR & 1u << 15) != 0) {
        note(BFAR);
    }
    note(frame[6]);
    note(frame[7] & 0x0600FC00u);
    CFSR = CFSR;
    HFSR = HFSR;
    const uint16_t opcode = *(const uint16_t *)frame[6];
    if (step == 40) {
        CPACR = 0xF00000u; /* The instruction runs again. */
        BARRIER();
    } else {
        frame[6] += opcode >> 11 >= 0x1Du ? 4u : 2u;
        frame[7] &= ~0x0600FC00u;
    }
}

__attribute__((naked)) void hard_fault_handler(void) {
    __asm volatile(
        "tst lr, #4\n ite eq\n mrseq r0, msp\n mrsne r0, psp\n push {r4, lr}\n bl fault_seen\n pop {r4, pc}");
}
void usage_fault_handler(void) __attribute__((alias("hard_fault_handler")));
void bus_fault_handler(void) __attribute__((alias("hard_fault_handler")));

static void faults(void) {
    REGISTER(0xE000E008u) = 2u; /* No write buffer, as QEMU has none: stores fault precisely. */
    __asm volatile("udf #7");
    __asm volatile("udf.w #1027");
    __asm volatile("ldr r0, [%0]\n str r0, [%0, #4]" ::"r"(0x60000000u) : "r0", "memory");
    __asm volatile("cmp r0, r0\n itt eq\n moveq r1, #3\n ldreq r0, [%0]" ::"r"(0x60000010u)
                   : "r0", "r1", "cc", "memory");
    step = 40;
    CPACR = 0;
    BARRIER();
    __asm volatile("vmov s1, %0\n vadd.f32 s2, s1, s1" ::"r"(0x3F800000u) : "s1", "s2");
    step = 41;
    uint32_t sum;
    __asm volatile("vmov %0, s2" : "=r"(sum));
    note(sum);
}

static uint32_t supervisor_call(uint32_t a, uint32_t b) {
    register uint32_t r0 __asm("r0") = a;
    register uint32_t r1 __asm("r1") = b;
    register uint32_t r2 __asm("r2") = 0x22222222u;
    register uint32_t r3 __asm("r3") = 0x33333333u;
    __asm volatile("svc #42" : "+r"(r0) : "r"(r1), "r"(r2), "r"(r3) : "memory");
    return r0;
}

static void masks(void) {
    __asm volatile("cpsid i");
    pend(0);
    ICSR = 1u << 28;
    BARRIER();
    note(ICSR & 1u << 28);
    note_state(1);
    __asm volatile("cpsie i\n isb");
    note_state(2);
    set_basepri(0x40);
    pend(0);
    pend(1);
    pend(3); /* Only this one gets through. */
    note_state(3);
    note(ISPR & 0xFu);
    set_basepri(0x70); /* And now irq 1. */
    note_state(4);
    __asm volatile("msr basepri_max, %0\n isb" ::"r"(0x90)); /* Does not lower the mask. */
    note_state(5);
    set_basepri(0);
    note_state(6);
    __asm volatile("cpsid f");
    pend(3);
    note_state(7);
    __asm volatile("cpsie f\n isb");
    note_state(8);
    __asm volatile("cpsid i");
    pend(1);
    ICPR = 2u;
    BARRIER();
    __asm volatile("cpsie i\n isb");
    note_state(9);
}

static uint32_t process_stack[256] __attribute__((aligned(8)));

static void floating_point_frames(void) {
    uint32_t s0, s15, s16, fpscr;
    __asm volatile("vmov s0, %4\n vmov s15, %5\n vmov s16, %5\n vmsr fpscr, %6\n str %7, [%8]\n dsb\n isb\n vmov %0, "
                   "s0\n vmov %1, s15\n vmov %2, s16\n vmrs %3, fpscr"
                   : "=&r"(s0), "=&r"(s15), "=&r"(s16), "=&r"(fpscr)
                   : "r"(0x3F800001u), "r"(0x12345678u), "r"(0x20000000u), "r"(8u), "r"(&ISPR)
                   : "s0", "s15", "memory");
    note(s0);
    note(s15);
    note(s16); /* Not saved by hardware: the handler's. */
    note(fpscr);
    uint32_t control;
    __asm volatile("mrs %0, control" : "=r"(control));
    note(control);
    __asm volatile("msr control, %0\n isb" ::"r"(control & ~4u));
    pend(3);
    __asm volatile("mrs %0, control" : "=r"(control));
    note(control);
}

/* On the process stack from here on, first privileged, then not. The second stack is not aligned to 8 bytes. */
__attribute__((used, noreturn)) void unprivileged(void) {
    uint32_t psp, control;
    __asm volatile("mrs %0, control" : "=r"(control));
    note(control);
    note(supervisor_call(7, 8));
    __asm volatile("cpsid i"); /* No effect. */
    __asm volatile("mrs %0, control" : "=r"(control));
    note(control);
    note(supervisor_call(9, 10));
    __asm volatile("mov %0, sp" : "=r"(psp));
    note(psp % 8);
    __asm volatile("svc #99"); /* QEMU's semihosting wants privilege. */
    for (;;) {
    }
}

__attribute__((used, noreturn)) void on_process_stack(void) {
    note(supervisor_call(1000, 234));
    pend(0);
    uint32_t psp, stack;
    __asm volatile("mrs %0, psp\n mov %1, sp" : "=r"(psp), "=r"(stack));
    note(psp == stack);
    __asm volatile("msr psp, %0\n msr control, %1\n isb\n b unprivileged" ::"r"(process_stack + 249), "r"(3u));
    __builtin_unreachable();
}

int main(void) {
    CPACR = 0xF00000u;
    BARRIER();
    CCR |= 0x200u;
    AIRCR = 0x05FA0000u | 3u << 8; /* All four bits preempt. */
    PRIORITY(0) = 0x80;
    PRIORITY(1) = 0x60;
    PRIORITY(2) = 0x80;
    PRIORITY(3) = 0x20;
    SYSTEM_PRIORITY(11) = 0x40;
    SYSTEM_PRIORITY(14) = 0xF0;
    SYSTEM_PRIORITY(15) = 0xF0;
    note(REGISTER(0xE000E400));
    note(REGISTER(0xE000ED20));
    ISER = 0xF;
    note(ISER & 0xFu);
    for (step = 0; step < 4; step++) {
        const uint32_t current = step;
        pend(0);
        note_state(current);
        step = current;
    }
    step = 0;
    AIRCR = 0x05FA0000u | 7u << 8; /* Nothing preempts any more. */
    step = 1;
    pend(0);
    note_state(0x0A);
    AIRCR = 0x05FA0000u | 6u << 8; /* Only the top bit does: 0x80 against 0x60 and 0x20. */
    step = 1;
    pend(0);
    note_state(0x0B);
    AIRCR = 0x05FA0000u | 3u << 8;
    step = 20;
    masks();
    floating_point_frames();
    step = 30;
    note(supervisor_call(11, 22));
    ICSR = 1u << 26; /* SysTick, by software. */
    BARRIER();
    faults(); /* All escalate to HardFault. */
    SHCSR = 0x70000u;
    faults(); /* Each its own. */
    step = 50;
    __asm volatile("msr psp, %0\n msr control, %1\n isb\n b on_process_stack" ::"r"(process_stack + 256), "r"(2u));
    return 0;
}
