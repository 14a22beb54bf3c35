/* Programs and erases its own flash (RM0090, 3.6), by the argument: from code in the flash or in RAM, with exceptions
 * and peripherals going on beside. Sectors 6 and 7, at 0x08040000 and 0x08060000, are the playground. */
#include "runtime.h"

#define ARGUMENT    REGISTER(0x080E0000u)
#define FLASH_ACR   REGISTER(0x40023C00u)
#define FLASH_KEYR  REGISTER(0x40023C04u)
#define FLASH_SR    REGISTER(0x40023C0Cu)
#define FLASH_CR    REGISTER(0x40023C10u)
#define RCC_APB1ENR REGISTER(0x40023840u)
#define TIM2_CR1    REGISTER(0x40000000u)
#define TIM2_CNT    REGISTER(0x40000024u)
#define IWDG_KEY    REGISTER(0x40003000u)
#define VTOR        REGISTER(0xE000ED08u)
#define DEMCR       REGISTER(0xE000EDFCu)
#define DWT_CTRL    REGISTER(0xE0001000u)
#define CYCLES      REGISTER(0xE0001004u)
#define RCC_CSR     REGISTER(0x40023874u)
#define TARGET      REGISTER(0x08040000u)
#define NEXT        REGISTER(0x08040004u)
#define OTHER       REGISTER(0x08060000u)
#define BSY         (1u << 16)
#define IN_RAM      __attribute__((section(".ram_code"), noinline, long_call))

static void unlock(void) {
    FLASH_KEYR = 0x45670123u;
    FLASH_KEYR = 0xCDEF89ABu;
}

static void start_clocks(void) {
    RCC_APB1ENR |= 1u;
    (void)RCC_APB1ENR;
    TIM2_CR1 = 1;
    DEMCR |= 1u << 24;
    CYCLES = 0;
    DWT_CTRL |= 1u;
}

static volatile uint32_t ticks, ram_ticks;
void systick_handler(void) {
    ticks++;
}

IN_RAM static void handler_in_ram(void) {
    ram_ticks++;
}

static void start_ticks(void) {
    SYSTICK_RELOAD = 15999; /* 1 ms. */
    SYSTICK_COUNT = 0;
    SYSTICK_CONTROL = 7;
}

static uint32_t vectors_in_ram[128] __attribute__((aligned(512)));
static void move_vectors(int handler_too) {
    for (uint32_t i = 0; i < 20; i++) {
        vectors_in_ram[i] = REGISTER(0x08000000u + 4u * i);
    }
    if (handler_too) {
        vectors_in_ram[15] = (uint32_t)handler_in_ram;
    }
    VTOR = (uint32_t)vectors_in_ram;
}

static void choose(uint32_t sector) {
    FLASH_CR = 2u << 8 | sector << 3 | 2u;
}

static void erase(uint32_t sector) {
    choose(sector);
    FLASH_CR |= 1u << 16;
}

static void program(volatile uint32_t *to, uint32_t value) {
    FLASH_CR = 2u << 8 | 1u;
    *to = value;
}

/* Turns of the wait for the end, and what the clocks say then. */
IN_RAM static uint32_t erase_from_ram(void) {
    FLASH_CR |= 1u << 16;
    uint32_t turns = 0;
    while ((FLASH_SR & BSY) != 0) {
        turns++;
    }
    return turns;
}

IN_RAM static uint32_t load_during_erase(void) {
    FLASH_CR |= 1u << 16;
    const uint32_t busy = FLASH_SR & BSY;
    const uint32_t value = OTHER;
    return (busy != 0 ? 0x10000u : 0) | (FLASH_SR & BSY) | (value & 0xFFFFu);
}

IN_RAM static uint32_t program_from_ram(uint32_t count) {
    uint32_t turns = 0;
    for (uint32_t i = 0; i < count; i++) {
        *(volatile uint32_t *)(0x08060000u + 4u * i) = i;
        while ((FLASH_SR & BSY) != 0) {
            turns++;
        }
    }
    return turns;
}

static __attribute__((noinline)) uint32_t timer_in_flash(void) {
    return TIM2_CNT;
}

IN_RAM static uint32_t call_during_erase(uint32_t (*called)(void)) {
    const uint32_t before = called();
    FLASH_CR |= 1u << 16;
    return called() - before;
}

static void words_from_flash(void) {
    note(TARGET);
    const uint32_t before = CYCLES, timer = TIM2_CNT;
    program(&TARGET, 0x12345678u);
    note(FLASH_SR);
    note(CYCLES - before);
    note(TIM2_CNT - timer);
    program(&TARGET, 0xFFFF0000u);
    note(TARGET);
    note(NEXT);
}

static void erase_from_flash(void) {
    program(&TARGET, 0);
    start_ticks();
    const uint32_t timer = TIM2_CNT;
    erase(6);
    note(FLASH_SR);
    note(TIM2_CNT - timer);
    note(ticks);
    note(TARGET);
}

static void erase_beside_ticks(int vectors, int handler) {
    if (vectors) {
        move_vectors(handler);
    }
    choose(6);
    start_ticks();
    const uint32_t timer = TIM2_CNT, turns = erase_from_ram();
    note(TIM2_CNT - timer);
    note(turns);
    note(ticks);
    note(ram_ticks);
}

static void wait_for_watchdog(void) {
    note(RCC_CSR & 0xFE000000u);
    if ((RCC_CSR & 1u << 29) != 0) {
        note(TARGET);
        finish();
    }
    program(&TARGET, 0);
    IWDG_KEY = 0xCCCCu; /* 512 ms. */
    erase(6);
    note(TARGET);
}

/* Cache on, or off and reset, over an erase. */
static void stale(int reset) {
    FLASH_ACR = 0x600u;
    note(OTHER);
    erase(6);
    if (reset) {
        FLASH_ACR = 0;
        FLASH_ACR = 0x1800u;
        FLASH_ACR = 0;
    }
    program(&TARGET, 0xCAFEu);
    note(TARGET);
    note(NEXT);
}

int main(void) {
    unlock();
    start_clocks();
    switch (ARGUMENT) {
    case 1:
        words_from_flash();
        break;
    case 2:
        erase_from_flash();
        break;
    case 3:
        erase_beside_ticks(0, 0);
        break;
    case 4:
        erase_beside_ticks(1, 0);
        break;
    case 5:
        erase_beside_ticks(1, 1);
        break;
    case 6: {
        program(&OTHER, 0xFFFF5AA5u);
        choose(6);
        const uint32_t timer = TIM2_CNT;
        note(load_during_erase());
        note(TIM2_CNT - timer);
        break;
    }
    case 7:
        wait_for_watchdog();
        break;
    case 8:
        stale(0);
        break;
    case 9:
        stale(1);
        break;
    case 10:
        FLASH_CR = 2u << 8 | 1u;
        note(program_from_ram(100) > 100);
        for (uint32_t i = 0; i < 3; i++) {
            note((&OTHER)[99 + i]);
        }
        break;
    case 11:
        choose(6);
        note(timer_in_flash() != 0);
        note(call_during_erase(timer_in_flash));
        break;
    default: { /* Writes code, runs it, erases it, writes other code, runs that. */
        for (uint32_t answer = 41; answer < 43; answer++) {
            program(&TARGET, 0x47702000u | answer); /* MOVS R0, #answer; BX LR. */
            note(((uint32_t(*)(void))0x08040001u)());
            erase(6);
        }
    }
    }
}
