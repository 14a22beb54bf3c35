/* boot.c: the boot loader: it looks which of the two images is to be started (core/boot/select.h), and starts it.
 *
 * It runs on the internal oscillator, 16 MHz, as the processor wakes up, and leaves the processor as it found it: no
 * clock, no pin, no interrupt and none of the flags that tell the cause of the reset is changed for an image, and the
 * memory that outlives a reset is not touched. It has no variables beside its stack. An image on trial starts with a
 * watchdog of 2 s, so that one that hangs before it has its own comes to an end.
 *
 * The public key lies at the end of the boot loader's sector, written by whoever programs it: a mark, the key, and its
 * CRC-32. Without a key no new image is started; the one that a probe has written is.
 *
 * If there is no image the LED flashes, five times a second. So it does if the boot loader itself runs into a fault.
 */

#include <stddef.h>

#include "boards/stm32f405/stm32f405.h"
#include "core/boot/select.h"
#include "core/storage/crc32.h"

#define FLASH_TURNS  400000u /* Turns of a loop of about four cycles in 0.1 s. */
#define WATCH_TRIES  10000u
#define LED          4u /* PB4, which an image has, too (pinout.md). */
#define MODE_OUTPUT  1u
#define VECTOR_COUNT 16u

typedef void (*entry_t)(void);

extern uint32_t stack_top;

/* Nothing can be started: somebody has to come with a probe. */
static __attribute__((noreturn)) void signal_for_ever(void) {
    RCC->AHB1ENR |= RCC_AHB1ENR_GPIOBEN;
    (void)RCC->AHB1ENR; /* A peripheral answers two cycles after its clock is on (ES0182). */
    GPIOB->MODER = (GPIOB->MODER & ~(3u << 2u * LED)) | MODE_OUTPUT << 2u * LED;
    for (;;) {
        GPIOB->ODR ^= 1u << LED;
        for (uint32_t i = 0; i < FLASH_TURNS; i++)
            __asm volatile("nop");
    }
}

static void fault(void) {
    signal_for_ever();
}

/* Returns the public key; NULL: there is none. */
static const uint8_t *find_key(void) {
    const key_place_t *const place = (const key_place_t *)KEY_PLACE;
    const bool good = place->mark == KEY_MARK && crc32(0, place->key, IMAGE_KEY_BYTES) == place->crc;
    return good ? place->key : NULL;
}

/* Returns where a slot begins; it is read anew at each call, as two of them are compared. */
static volatile uint32_t *begin_of(uint32_t slot) {
    static volatile uint32_t *const begins[IMAGE_SLOTS] = {(volatile uint32_t *)IMAGE_SLOT_A,
                                                           (volatile uint32_t *)IMAGE_SLOT_B};
    volatile uint32_t *const volatile *const begin = &begins[slot];
    return *begin;
}

/* Whether both slots are looked at where they are: an instruction that went wrong would hide one of them, and the image
 * in the other one, however old, would start as if there were no newer. */
static bool slots_in_place(const image_flash_t *flash) {
    return flash->slot[0] == begin_of(0) && flash->slot[1] == begin_of(1);
}

/* Returns where a word of a slot lies, once both are read again and lead there, too; NULL: they do not. An instruction
 * that went wrong would reject the image in the other slot, or start it. */
static volatile uint32_t *place_of(const volatile uint32_t *slot, const volatile uint32_t *index) {
    volatile uint32_t *const place = begin_of(*slot) + *index;
    return place == begin_of(*slot) + *index ? place : NULL;
}

static void program(const select_step_t *step) {
    volatile uint32_t *const place = place_of(&step->slot, &step->index);
    if (place != NULL)
        (void)flash_program(place, step->value);
}

/* Starts the watchdog of an image on trial. */
static void watch(void) {
    IWDG->KR = IWDG_KR_KEY_START;
    IWDG->KR = IWDG_KR_KEY_UNLOCK;
    IWDG->PR = IWDG_PR_PR_DIV16;
    IWDG->RLR = WATCHDOG_RELOAD_LONG;
    (void)wait_for(&IWDG->SR, IWDG_SR_PVU | IWDG_SR_RVU, 0, WATCH_TRIES);
    IWDG->KR = IWDG_KR_KEY_RELOAD;
}

/* Hands the processor over to an image, which begins with this vector table. */
static __attribute__((noreturn)) void start(const volatile uint32_t *table) {
    SCB->VTOR = (uint32_t)table;
    __asm volatile("dsb\n\tisb\n\tmsr msp, %0\n\tbx %1" ::"r"(table[0]), "r"(table[1]) : "memory");
    __builtin_unreachable();
}

__attribute__((noreturn)) void Reset_Handler(void) {
    const image_flash_t flash = {
        .slot = {(const uint32_t *)IMAGE_SLOT_A, (const uint32_t *)IMAGE_SLOT_B},
        .address = {IMAGE_SLOT_A, IMAGE_SLOT_B},
        .words = IMAGE_BYTES / sizeof(uint32_t),
        .board = BOARD_KIND,
        .key = find_key(),
    };
    select_t select;
    select_open(&select, &flash);
    if (!slots_in_place(&select.flash))
        signal_for_ever();
    for (select_step_t step = select_next(&select); step.wanted; step = select_next(&select))
        program(&step);
    const select_choice_t choice = select_choice(&select);
    static const uint32_t code = IMAGE_CODE;
    const volatile uint32_t *const table = place_of(&choice.slot, &code);
    if (!choice.found || table == NULL)
        signal_for_ever();
    if (choice.trial)
        watch();
    start(table);
}

/* All that is not the start is a fault, since no interrupt is ever switched on. */
__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    entry_t entries[VECTOR_COUNT - 1u];
} vectors = {.stack = &stack_top, .entries = {[0] = Reset_Handler, [1 ... VECTOR_COUNT - 2u] = fault}};
