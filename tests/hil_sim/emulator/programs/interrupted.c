/* A workload of IT blocks, floating point, flags, multiples, exclusives and table branches, which SysTick interrupts
 * after every k-th instruction, k given at 0xE0000 (0: never). Its final state must not depend on that. The handler
 * leaves other values in every register that hardware saves. */
#include "runtime.h"

#define DISTANCE REGISTER(0x000E0000u)
#define ROUNDS   100u
volatile uint32_t handler_count;
static uint32_t memory[64] __attribute__((aligned(8)));
static uint32_t process_stack[128] __attribute__((aligned(8)));

/* The count restarts with the first of the last two stores; the other clears what became pending before; then come
 * bx lr and k instructions of the workload. */
__attribute__((naked)) void systick_handler(void) {
    __asm volatile(
        "ldr r0, =handler_count\n ldr r1, [r0]\n adds r1, #1\n str r1, [r0]\n"
        "mvn r2, r1\n mov r12, r1\n vmov s0, s1, r1, r2\n vmov s15, r2\n vmov.f32 s7, #2.5\n vadd.f32 s3, s7, s7\n"
        "movs r3, #0\n cmp r3, #1\n ldr r0, =0xE000E018\n ldr r1, =0xE000ED04\n mov r2, #0x02000000\n str r3, [r0]\n "
        "str r2, [r1]\n bx lr\n .ltorg");
}

__attribute__((naked, used, noinline)) void workload(uint32_t rounds, uint32_t *area) {
    __asm volatile(
        "push {r4-r11, lr}\n vpush {s16-s31}\n"
        "mov r10, r0\n mov r11, r1\n ldr r4, =0x9E3779B9\n movs r5, #0\n ldr r6, =0x12345678\n movs r7, #0\n mov r8, "
        "#0\n mov r9, #0\n"
        "vmov.f32 s16, #1.0\n vmov.f32 s17, #0.5\n vmov.f32 s0, #1.5\n vmov.f32 s1, #-2.0\n"
        "1:\n"
        "muls r4, r6, r4\n add r4, r4, r10, lsl #3\n ror r6, r6, #7\n eor r6, r4\n"
        "tst r4, #8\n itete eq\n addeq r5, r5, r4\n subne r5, r5, r6\n eoreq r7, r5\n rsbne r7, r7, #0\n"
        "cmp r5, r6\n ittet lt\n addlt r8, #1\n strlt r8, [r11, #4]\n ldrge r8, [r11, #8]\n movlt r9, r5\n"
        "vmov s2, r4\n vcvt.f32.s32 s2, s2\n vmul.f32 s2, s2, s17\n vadd.f32 s0, s0, s2\n vcmp.f32 s0, s1\n vmrs "
        "APSR_nzcv, fpscr\n"
        "itt gt\n vmovgt.f32 s0, s17\n vaddgt.f32 s1, s1, s16\n"
        "vdiv.f32 s3, s0, s16\n vstr s3, [r11, #12]\n vldr s18, [r11, #12]\n vfma.f32 s19, s18, s17\n"
        "sadd8 r0, r4, r5\n sel r1, r4, r6\n qadd r2, r4, r6\n umull r0, r3, r0, r1\n adds r0, r2\n adcs r9, r3\n"
        "stmdb sp!, {r0-r9}\n ldmia sp!, {r0-r7, r8, r9}\n strd r4, r5, [r11, #16]\n ldrd r5, r4, [r11, #16]\n"
        "2: ldrex r0, [r11]\n add r0, r4\n strex r1, r0, [r11]\n cmp r1, #0\n bne 2b\n"
        "and r0, r4, #3\n tbb [pc, r0]\n 3: .byte (4f-3b)/2, (5f-3b)/2, (6f-3b)/2, (4f-3b)/2\n"
        "4: adds r7, #1\n b 7f\n 5: subs r7, #3\n it cs\n bcs 7f\n 6: eor r7, r7, r5\n 7:\n"
        "and r0, r10, #31\n add r1, r11, #32\n ldr r2, [r1, r0, lsl #2]\n adc r2, r2, r7\n str r2, [r1, r0, lsl #2]\n"
        "bl 8f\n subs r10, #1\n bne.w 1b\n b 9f\n"
        "8: push {r4, lr}\n lsrs r4, r4, #3\n it cs\n addcs r5, r4\n pop {r4, pc}\n"
        "9: mrs r0, apsr\n vmrs r1, fpscr\n add r11, #160\n stmia r11!, {r0-r9}\n vstmia r11!, {s0-s3}\n vstmia r11!, "
        "{s16-s19}\n"
        "vpop {s16-s31}\n pop {r4-r11, pc}\n .ltorg");
}

int main(void) {
    CPACR = 0xF00000u;
    BARRIER();
    if (DISTANCE != 0) {
        SYSTICK_RELOAD = DISTANCE + 2u;
        SYSTICK_COUNT = 0;
        SYSTICK_CONTROL = 7;
    }
    workload(ROUNDS, memory);
    uint32_t control = 2;
    __asm volatile("msr psp, %0\n msr control, %1\n isb" ::"r"(process_stack + 127), "r"(control));
    workload(ROUNDS, memory);
    __asm volatile("msr control, %0\n isb" ::"r"(0));
    SYSTICK_CONTROL = 0;
    for (unsigned i = 0; i < 64; i++) {
        note(memory[i]);
    }
    return 0;
}
