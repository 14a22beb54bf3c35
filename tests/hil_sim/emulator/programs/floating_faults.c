/* Floating-point loads and stores that the memory protection unit forbids, one after the other. Each makes 14 notes:
 * exception, CFSR, HFSR, MMFAR, the stacked PC and r1, and s0 to s7 behind it; one that is allowed makes the last eight
 * alone. */
#include "runtime.h"

#define RCC 0x40023800u

uint32_t resume;
uint32_t before[8], behind[8];
__attribute__((aligned(1024))) uint32_t guarded[768];

__attribute__((used)) void fault_seen(uint32_t *frame) {
    uint32_t ipsr;
    __asm volatile("mrs %0, ipsr" : "=r"(ipsr));
    const uint32_t cfsr = CFSR;
    note(ipsr);
    note(cfsr);
    note(HFSR);
    note((cfsr & 0x80u) != 0 ? MMFAR : 0);
    note(frame[6]);
    note(frame[1]);
    CFSR = cfsr;
    frame[6] = resume & ~1u;
}

__attribute__((naked)) void memory_fault_handler(void) {
    __asm volatile(
        "tst lr, #4\n ite eq\n mrseq r0, msp\n mrsne r0, psp\n push {r4, lr}\n bl fault_seen\n pop {r4, pc}");
}
void hard_fault_handler(void) __attribute__((alias("memory_fault_handler")));

/* One instruction at a symbol of its own, with an address in r1 and s0 to s7 known. */
#define TRY(name, instruction)                                                                                         \
    static void name(uint32_t address) {                                                                               \
        register uint32_t r1 __asm("r1") = address;                                                                    \
        __asm volatile(                                                                                                \
            "ldr r2, =before\n vldmia r2, {s0-s7}\n ldr r2, =resume\n adr r3, 2f\n str r3, [r2]\n"                     \
            ".global at_" #name "\n at_" #name ": " instruction                                                        \
            "\n nop\n .balign 4\n 2: mov r4, #0\n msr control, r4\n isb\n ldr r2, =behind\n vstmia r2, {s0-s7}"        \
            : "+r"(r1)                                                                                                 \
            :                                                                                                          \
            : "r2", "r3", "r4", "r5", "memory");                                                                       \
        for (uint32_t i = 0; i < 8u; i++)                                                                              \
            note(behind[i]);                                                                                           \
    }
TRY(load_single, "vldr s0, [r1]")
TRY(load_double, "vldr d0, [r1]")
TRY(load_several, "vldmia r1!, {s0-s3}")
TRY(load_pairs, "vldmia r1!, {d0-d1}")
TRY(load_down, "vldmdb r1!, {s0-s3}")
TRY(load_core, "ldmia r1!, {r4-r5}")
TRY(store_single, "vstr s0, [r1]")
TRY(store_double, "vstr d0, [r1]")
TRY(store_several, "vstmia r1!, {s0-s3}")
TRY(store_down, "vstmdb r1!, {d0-d1}")
TRY(pop, "msr psp, r1\n mov r4, #2\n msr control, r4\n isb\n .global at_vpop\n at_vpop: vpop {s0-s3}\n nop")

static void rule(uint32_t number, uint32_t base, uint32_t rules) {
    MPU_BASE = base | 0x10u | number;
    MPU_RULES = rules | 1u;
}

/* Everything that reads, and everything that writes, at an address and one that goes down to behind it. */
static void loads(uint32_t address) {
    load_single(address);
    load_double(address);
    load_several(address);
    load_pairs(address);
    load_down(address + 16u);
    load_core(address);
}

static void stores(uint32_t address) {
    store_single(address);
    store_double(address);
    store_several(address);
    store_down(address + 16u);
}

int main(void) {
    CPACR |= 0xFu << 20;
    SHCSR = 1u << 16;
    BARRIER();
    const uint32_t middle = (uint32_t)guarded + 1024u;
    for (uint32_t i = 0; i < 8u; i++)
        before[i] = 0x3F800000u + i;
    for (uint32_t i = 0; i < 768u; i++)
        guarded[i] = 0x40000000u + i;
    rule(0, middle, NO_ACCESS | NO_EXECUTE | SIZE(10));
    rule(1, RCC, NO_ACCESS | NO_EXECUTE | SIZE(10));
    MPU_CONTROL = 5u;
    BARRIER();
    loads(middle);
    stores(middle);
    loads(RCC);
    stores(RCC);
    load_several(middle - 8u);  /* It begins outside, */
    load_down(middle + 1032u);  /* comes from above, */
    load_several(middle - 16u); /* and ends before. */
    store_several(middle - 8u);
    rule(0, middle, READ_ONLY | NO_EXECUTE | SIZE(10));
    BARRIER();
    load_single(middle);
    store_single(middle);
    MPU_CONTROL = 0;
    BARRIER();
    for (uint32_t i = 252u; i < 264u; i++)
        note(guarded[i]);
    rule(0, middle, NO_ACCESS | NO_EXECUTE | SIZE(10));
    MPU_CONTROL = 5u;
    BARRIER();
    pop(middle);
    uint32_t stack;
    __asm volatile("mrs %0, psp" : "=r"(stack));
    note(stack);
    return 0;
}
