/* Faults, one after the other: the handler notes what the processor tells of each, then the program goes on at
 * `resume`. Each fault makes six notes: exception, CFSR, HFSR, its address register (0: none is valid), the stacked PC,
 * and r0. */
#include "runtime.h"

#define ACTLR  REGISTER(0xE000E008u)
#define FAULTS (7u << 16)

#define FULL (3u << 24)

uint32_t resume;
__attribute__((aligned(1024))) uint8_t guarded[2048];
__attribute__((aligned(1024))) uint16_t code[512];

__attribute__((used)) void fault_seen(uint32_t *frame) {
    uint32_t ipsr;
    __asm volatile("mrs %0, ipsr" : "=r"(ipsr));
    const uint32_t cfsr = CFSR;
    note(ipsr);
    note(cfsr);
    note(HFSR);
    note((cfsr & 0x80u) != 0 ? MMFAR : (cfsr & 0x8000u) != 0 ? BFAR : 0);
    note((cfsr & 0x10u) != 0 ? 0 : frame[6]);
    note(frame[0]);
    if ((cfsr & 0x10u) != 0) {
        finish(); /* There is no frame to return to. */
    }
    CFSR = cfsr;
    HFSR = HFSR;
    frame[6] = resume & ~1u;
    frame[7] &= ~0x0600FC00u;
}

__attribute__((naked)) void hard_fault_handler(void) {
    __asm volatile(
        "tst lr, #4\n ite eq\n mrseq r0, msp\n mrsne r0, psp\n push {r4, lr}\n bl fault_seen\n pop {r4, pc}");
}
void memory_fault_handler(void) __attribute__((alias("hard_fault_handler")));
void bus_fault_handler(void) __attribute__((alias("hard_fault_handler")));
void usage_fault_handler(void) __attribute__((alias("hard_fault_handler")));

/* One instruction that may fault, at a symbol of its own; r0 holds 0x77 before. */
#define TRY(name, instruction)                                                                                         \
    static uint32_t name(uint32_t address) {                                                                           \
        register uint32_t r0 __asm("r0") = 0x77u;                                                                      \
        register uint32_t r1 __asm("r1") = address;                                                                    \
        __asm volatile("ldr r2, =resume\n adr r3, 2f\n str r3, [r2]\n .global at_" #name "\n at_" #name                \
                       ": " instruction "\n nop\n .balign 4\n 2: nop"                                                  \
                       : "+r"(r0)                                                                                      \
                       : "r"(r1)                                                                                       \
                       : "r2", "r3", "lr", "memory");                                                                  \
        return r0;                                                                                                     \
    }
TRY(load, "ldr r0, [r1]")
TRY(load_disabled, "ldr r0, [r1]")
TRY(store, "str r0, [r1]")
TRY(store_unbuffered, "str r0, [r1]")
TRY(store_peripheral, "str r0, [r1]")
TRY(undefined, "udf #3")
TRY(read_inside, "ldr r0, [r1]")
TRY(write_inside, "str r0, [r1]")
TRY(write_read_only, "str r0, [r1]")
TRY(read_register, "ldr r0, [r1]")
TRY(call, "blx r1")
TRY(divide, "udiv r0, r0, r1")
TRY(divide_signed, "sdiv r0, r0, r1")
TRY(unaligned_word, "ldr r0, [r1]")
TRY(unaligned_half, "ldrsh r0, [r1]")
TRY(unaligned_store, "str r0, [r1]")
TRY(unaligned_byte, "ldrb r0, [r1]")

static void rule(uint32_t number, uint32_t base, uint32_t rules) {
    MPU_BASE = base | 0x10u | number;
    MPU_RULES = rules | 1u;
}

static void bus_faults(void) {
    SHCSR = FAULTS;
    load(0x60000000u);
    store(0x60000010u);
    store_peripheral(0x40018000u);
    ACTLR = 2u;
    store_unbuffered(0x60000020u);
    ACTLR = 0;
    undefined(0);
    SHCSR = 0;
    load_disabled(0x60000030u);
    SHCSR = FAULTS;
}

static void forbidden(void) {
    const uint32_t array = (uint32_t)guarded;
    rule(0, 0x08000400u, NO_ACCESS | NO_EXECUTE | SIZE(10));
    rule(1, array + 256u, READ_ONLY | NO_EXECUTE | SIZE(8));
    rule(2, 0x40023800u, NO_ACCESS | NO_EXECUTE | SIZE(10));
    rule(3, array + 1024u, FULL | NO_EXECUTE | SIZE(8) | 0xFE00u); /* All but its first eighth is switched off. */
    MPU_CONTROL = 5u;
    BARRIER();
    note(load(0x080003FCu) != 0x77u);
    read_inside(0x08000400u);
    note(load(0x08000800u) != 0x77u);
    store(array + 252u);
    write_read_only(array + 256u);
    write_inside(array + 508u);
    store(array + 512u);
    note(*(volatile uint32_t *)(array + 252u));
    note(*(volatile uint32_t *)(array + 512u));
    note(*(volatile uint32_t *)(array + 256u));
    note(*(volatile uint32_t *)(array + 508u));
    read_register(0x40023800u);
    note(load(0x40023C00u) != 0x77u);
}

/* What CCR forbids, and the same when it does not. */
static void traps(void) {
    const uint32_t odd = (uint32_t)guarded + 1u;
    *(volatile uint32_t *)guarded = 0x44332211u;
    *(volatile uint32_t *)(guarded + 4) = 0x88776655u;
    note(divide(0));
    note(unaligned_word(odd));
    note(unaligned_half(odd));
    CCR |= 1u << 4;
    BARRIER();
    divide(0);
    divide_signed(0);
    note(divide(7u));
    note(unaligned_word(odd));
    CCR = (CCR & ~(1u << 4)) | 1u << 3;
    BARRIER();
    note(divide(0));
    unaligned_word(odd);
    unaligned_half(odd);
    unaligned_store(odd);
    note(unaligned_byte(odd));
    note(unaligned_half(odd + 1u));
    CCR &= ~(1u << 3);
    BARRIER();
    note(unaligned_word(odd + 2u));
}

static void execute_never(void) {
    code[0] = 0x2055u; /* movs r0, #0x55 */
    code[1] = 0x4770u; /* bx lr */
    note(call((uint32_t)code | 1u));
    rule(4, (uint32_t)code, FULL | NO_EXECUTE | SIZE(10));
    BARRIER();
    note(call((uint32_t)code | 1u));
    MPU_CONTROL = 0;
    BARRIER();
    note(call((uint32_t)code | 1u));
}

static void frame_forbidden(void) {
    SYSTEM_PRIORITY(11) = 0x40u; /* Below MemManage. */
    MPU_CONTROL = 5u;
    BARRIER();
    __asm volatile("msr psp, %0\n mov r0, #2\n msr control, r0\n isb\n svc #1" ::"r"((uint32_t)guarded + 512u) : "r0");
}

int main(void) {
    bus_faults();
    forbidden();
    execute_never();
    traps();
    frame_forbidden();
    return 0;
}
