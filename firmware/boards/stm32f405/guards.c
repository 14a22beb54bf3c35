/* guards.c: what may not be accessed, by the memory protection unit (ARMv7-M, B3.5), and what a debugger stops.
 *
 *   region   from          size     access         against
 *   0        0x00000000    128 MB   none           null pointers, and what is computed from them
 *   1        0x08000000    1 MB     read, execute  writes through a wild pointer
 *   2        0x1FFFF000    4 kB     none           a stack that runs over: it lies at the bottom of RAM, just above
 *   3        0x20000000    128 kB   read, write    jumps into data
 *   4        0x10000000    64 kB    read, write    jumps into data
 *   5        0x08004000    32 kB    read, write    jumps into what is saved (flash.c)
 *   6        the other     384 kB   read, write    jumps into the slot of the other image (images.c)
 *   7        this image's  64 bytes read, write    jumps into the state words of this one
 *
 * Regions 5 to 7 overrule region 1. The flash takes a write there only while flash_operation.c has it unlocked. Regions
 * 5 and 6 are parts of larger ones: an eighth of these each that is switched on. Everything else
 * keeps the default map, whose peripherals are not executed either. A fault handler runs without the unit, so that it
 * can look at anything.
 */

#include "boards/stm32f405/stm32f405.h"

#define ACCESS_NONE  (0u << 24)
#define ACCESS_WRITE (3u << 24)
#define ACCESS_READ  (6u << 24)
#define NORMAL       (2u << 16) /* Memory without side effects, whose accesses may be unaligned; write-through. */
#define SHARED       (1u << 18) /* Other masters, here DMA, access it, too. */
#define SIZE(log2)   (((log2)-1u) << 1)

/* So many eighths of a region, from one on: all others are switched off. */
#define ONLY(first, count) ((0xFFu & ~(((1u << (count)) - 1u) << (first))) << 8)

typedef struct {
    uint32_t base, attributes;
} region_t;

extern const uint32_t image_start[];

_Static_assert(STACK_GUARD_BYTES == 1u << 12, "region 2 is the guard below the stack");

static const region_t regions[] = {
    {0x00000000u, MPU_RASR_XN | ACCESS_NONE | SIZE(27u)},
    {0x08000000u, ACCESS_READ | NORMAL | SIZE(20u)},
    {0x20000000u - STACK_GUARD_BYTES, MPU_RASR_XN | ACCESS_NONE | SIZE(12u)},
    {0x20000000u, MPU_RASR_XN | ACCESS_WRITE | NORMAL | SHARED | SIZE(17u)},
    {0x10000000u, MPU_RASR_XN | ACCESS_WRITE | NORMAL | SIZE(16u)},
    {0x08000000u, MPU_RASR_XN | ACCESS_WRITE | NORMAL | ONLY(2u, 4u) | SIZE(16u)},
    {0x08000000u, MPU_RASR_XN | ACCESS_WRITE | NORMAL | SIZE(20u)}, /* guards_start() adds which eighths. */
    {(uint32_t)image_start, MPU_RASR_XN | ACCESS_WRITE | NORMAL | SIZE(6u)},
};
#define OTHER_SLOT 6u

#define REGIONS (sizeof regions / sizeof regions[0])

void guards_start(void) {
    DBG->DBGMCU_APB1_FZ |=
        DBG_DBGMCU_APB1_FZ_DBG_IWDEG_STOP; /* A processor that a debugger has halted feeds no watchdog. */
    SCB->SHCSR |= SCB_SHCSR_MEMFAULTENA | SCB_SHCSR_BUSFAULTENA | SCB_SHCSR_USGFAULTENA;
    if ((MPU->TYPE >> 8 & 0xFFu) < REGIONS)
        return; /* A partial model of the chip has no such unit. */
    /* An eighth of the flash is a sector: 5 to 7 are the second to the fourth eighth, and 8 to 10 the next three. */
    const uint32_t eighths = (uint32_t)image_start == IMAGE_SLOT_B ? ONLY(1u, SLOT_SECTORS) : ONLY(4u, SLOT_SECTORS);
    for (uint32_t i = 0; i < REGIONS; i++) {
        MPU->RNR = i;
        MPU->RBAR = regions[i].base;
        MPU->RASR = regions[i].attributes | MPU_RASR_ENABLE | (i == OTHER_SLOT ? eighths : 0u);
    }
    MPU->CTRL = MPU_CTRL_ENABLE | MPU_CTRL_PRIVDEFENA;
    __asm volatile("dsb\n\tisb" ::: "memory");
}
