/* stm32f405.h: inside this board: what its files share. Nothing outside this directory includes it.
 *
 *   interrupts.c   the one board that handlers see, and how a handler is switched on
 *   wait.c         waits with time-outs
 *   clock.c        clock tree, microseconds, tick
 *   reset.c        why the board started, and what outlives a reset
 *   serial.c       USART3 with DMA both ways
 *   bridge.c       outputs to the bridges: on, off, break, two chips without a current
 *   converters.c   the sensor's burst, coil currents, temperatures, supply
 *   chip_engine.c  timers, DMA to their preloads and to the DAC, blocks, sync
 *   can.c          CAN1
 *   random.c       true random numbers
 *   board.c        pins, watchdog, and what is not the others'
 *   guards.c       memory protection
 *   flash_operation.c   a word or a sector of the flash
 *   flash.c        what is saved
 *   alarms.c       crystal or supply fails while the board runs
 *   crash.c        fault report over serial, then reset
 *   startup.c      vector table, reset, .data and .bss
 *   boot/          the boot loader, an image of its own, which has wait.c and flash_operation.c in common
 * A file calls only those above it in this list. Functions are declared below by file.
 *
 * Priorities (a lower number preempts)
 *   0   the end of two chips without a current, a supply that falls: bridges off
 *   1   time stamps of CAN frames and of the sync wire
 *   2   coil currents, temperature, faults of the drive, and frames received on CAN
 *   3   every other handler
 *   4   the 10 ms tick
 * The core's erratum 776924 (VDIV and VSQRT with lazy stacking) asks that a handler has more than two instructions
 * before its return: all have.
 *
 * DMA streams, by priority; no stream is shared
 *   DMA2 stream 4   periods, bridge of channel 0   very high
 *   DMA2 stream 1   bridge of channel 1            very high
 *   DMA2 stream 0   samples                        high
 *   DMA2 stream 7   fuse of the bridges            high
 *   DMA1 stream 2   sync wire                      very high
 *   DMA1 stream 5   set-points to the DAC          very high
 *   DMA1 stream 1   serial in                      medium
 *   DMA1 stream 3   serial out                     low
 * The erratum "DMA2 data corruption when managing AHB and APB peripherals in a concurrent way" (ES0182) does not apply:
 * DMA2 serves APB2 only, and DMA1 APB1 only.
 */
#ifndef STM32F405_BOARD_H
#define STM32F405_BOARD_H

#include "boards/stm32f405/registers.h"
#include "hal/hal.h"

#define RING_CHIPS            (2u * HAL_BLOCK_CHIPS) /* Chips in the chip engine's buffers: two blocks. */
#define SERIAL_RECEIVE_BUFFER 2048u                  /* Received bytes that may wait for main: 10 ms. */

/* Priorities of the interrupts, as above. */
enum { PRIORITY_OFF = 0, PRIORITY_STAMP = 1, PRIORITY_DRIVE = 2, PRIORITY_NORMAL = 3, PRIORITY_TICK = 4 };

/* A moment of the chip engine. */
typedef struct {
    uint32_t chip;  /* Absolute chip. */
    uint32_t ticks; /* Ticks since it started. */
} chip_time_t;

/* What a chip's edge needs, as DMA brings it: preloads of TIM1 from ARR on, and of TIM8 from CCR2 on. */
typedef struct {
    uint16_t reload;     /* Length of the chip less one tick. */
    uint16_t repetition; /* RCR lies between: 0. */
    uint16_t inputs[2];  /* Compares of the bridge's inputs of channel 0. */
} edge_t;
typedef struct {
    uint16_t inputs[2]; /* Compares of the bridge's inputs of channel 1. */
} edge_8_t;
#define EDGE_ITEMS   (sizeof(edge_t) / sizeof(uint16_t)) /* Transfers for each chip. */
#define EDGE_8_ITEMS (sizeof(edge_8_t) / sizeof(uint16_t))

#define SYNC_STAMPS 4u /* Stamped edges of the sync wire that may wait. */

struct hal {
    hal_clock_t clock;
    bool whole;          /* The clock controller answers as silicon does. It is false on a partial model of the chip,
                            where system memory is missing, too. */
    volatile bool woken; /* Something has happened that main may want to look at. */
    hal_role_t role;
    hal_events_t events;
    hal_counters_t counters;

    /* clock.c */
    uint32_t time_low, time_high; /* The latest reading of hal_microseconds(). */

    /* chip_engine.c */
    uint32_t block;                     /* The running block, as far as the block interrupt has come. */
    volatile uint32_t first_chip;       /* Its first chip: 31 * block, odd when block is odd. */
    volatile uint32_t chips_since_plan; /* Coil currents since the start of the block in which a plan was made last. */
    edge_t edges[RING_CHIPS];           /* Read by DMA. */
    edge_8_t edges_8[RING_CHIPS];       /* Read by DMA. */
    uint16_t sync_levels[RING_CHIPS];   /* Read by DMA: compares of the sync wire. */
    uint32_t set_points[RING_CHIPS];    /* Read by DMA: words for DHR12RD. */
    uint32_t sync_put, sync_taken;      /* Edges since reset: put in by the stamping interrupt, taken by PendSV. */
    chip_time_t sync_stamps[SYNC_STAMPS];
    hal_plan_t plan; /* The plan that the application fills. */

    /* bridge.c */
    uint32_t faults;           /* Faults that are not yet told: bit 1 << hal_fault_t. */
    bool enabled;              /* The bridges were switched on, and nobody has switched them off but a break. */
    uint16_t fuse[RING_CHIPS]; /* Read by DMA: words for EGR of TIM1. */

    /* converters.c */
    bool edge_taken;                  /* The currents behind an edge came since those before the end of a chip. */
    bool sampling;                    /* The samples in the buffer are complete and in step. */
    volatile bool temperature_wanted; /* A block has begun: it is to start behind a beacon's next edge. */
    volatile bool temperature_due; /* The injected conversion is that of the temperature. JSQR says so, too, but would
                                      have to be read in each chip. */
    uint16_t temperature_count;    /* Its latest result, counts; 0: there is none. */
    hal_monitor_t monitor;         /* The latest results. */
    hal_samples_t samples[2];      /* Written by DMA: the even and the odd block. */

    /* serial.c */
    volatile uint32_t sent, written; /* Bytes since reset: freed by the DMA, put in by main. */
    volatile uint32_t sending;       /* Bytes in the running transfer. */
    volatile uint32_t receive_wraps; /* How often DMA has filled the receive buffer. */
    uint32_t taken;                  /* Bytes since reset that main took. */
    bool receive_overrun;            /* The USART's flag was up when main looked last. */
    uint32_t transmit_room;          /* Bytes of transmit that the rate allows. */
    uint8_t transmit[HAL_SERIAL_BUFFER];
    uint8_t receive[SERIAL_RECEIVE_BUFFER];
};

/* ---- interrupts.c ---- */

extern hal_t board; /* The one board of this chip: interrupt handlers have no argument. */
void interrupt_enable(unsigned irq, unsigned priority);

/* Switch interrupts off. Calls nest. Returns what interrupts_restore() needs. */
static inline uint32_t interrupts_off(void) {
    uint32_t primask;
    __asm volatile("mrs %0, primask\n\tcpsid i" : "=r"(primask)::"memory");
    return primask;
}
static inline void interrupts_restore(uint32_t primask) {
    __asm volatile("msr primask, %0" ::"r"(primask) : "memory");
}
/* Make sure that DMA which is started after the call sees what was written before it. */
static inline void memory_barrier(void) {
    __asm volatile("dsb" ::: "memory");
}

/* ---- wait.c ---- */

/* Poll until (*address & mask) == value, at most tries times (about 6 cycles each). Returns false if it did not
 * happen. */
bool wait_for(const volatile uint32_t *address, uint32_t mask, uint32_t value, uint32_t tries);

/* ---- The flash ---- */

/* Slots of the images, and the place of the public key: the boot loader has them, too. */
#define IMAGE_SLOT_A  0x08020000u /* Sectors 5 to 7. */
#define IMAGE_SLOT_B  0x08080000u /* Sectors 8 to 10. */
#define IMAGE_BYTES   0x60000u
#define SECTOR_BYTES  0x20000u /* From sector 5 on. */
#define SLOT_A_SECTOR 5u
#define SLOT_SECTORS  3u
#define BOARD_KIND    1u /* What the headers of images for this board tell. */
#define KEY_PLACE     0x08003FC0u
#define KEY_MARK      0x594B4647u /* "GFKY" */

/* What lies at KEY_PLACE. */
typedef struct {
    uint32_t mark;
    uint8_t key[32];
    uint32_t crc; /* CRC-32 of the key. */
} key_place_t;

/* ---- flash_operation.c ---- */

/* Program a word of the flash. Nothing can be read from the flash meanwhile.
 * Returns false if the flash says that it did not. */
bool flash_program(volatile uint32_t *place, uint32_t value);

/* Erase a sector (0 to 11). Returns false as flash_program() does. */
bool flash_erase(uint32_t sector);

/* ---- clock.c ---- */

#define SLOW_HZ 16000000u /* Clock without the PLL, Hz. */

hal_clock_t clock_start(void);

/* Go on without the crystal, which has stopped: 0.3 ms at 16 MHz, then as if it had never started. Returns false if the
 * PLL does not lock. */
bool clock_fall_back(hal_t *hal);
void clock_start_tick(hal_clock_t clock);

/* ---- board.c ---- */

#define WATCHDOG_RELOAD      999u  /* The watchdog's 500 ms. */
#define WATCHDOG_RELOAD_LONG 4095u /* 2 s: 1.4 to 3.9 s of its oscillator. */

/* Give the watchdog four times as long as watchdog_set() does: 8 s, 5.6 to 15.4 s, with WATCHDOG_RELOAD_LONG. */
void watchdog_set_slow(uint32_t reload);

/* Give the watchdog, which runs, another time, and feed it. It takes five cycles of its oscillator, 0.2 ms. */
void watchdog_set(uint32_t reload);

/* ---- guards.c ---- */

#define STACK_GUARD_BYTES 4096u /* How far below the stack an access meets its guard. */

/* Forbid what the program never does, so that it is a fault. */
void guards_start(void);

/* ---- alarms.c ---- */

/* Watch the supply, and the crystal if the board runs on it. */
void alarms_start(const hal_t *hal);

/* ---- reset.c ---- */

/* Find out why the board started, before anybody asks. Called once. */
void reset_start(hal_t *hal);

/* Write into the diary how long the board has run. */
void reset_note_uptime(hal_t *hal);

/* Keep a crash for the next run. */
void reset_crash(const hal_crash_t *crash);

/* ---- serial.c ---- */

/* Let the port send at HAL_SERIAL_BAUD, by polling. */
void serial_start(const hal_t *hal);

/* Set its rate, and let it receive. */
void serial_open(hal_t *hal, uint32_t baud);

/* ---- bridge.c ---- */

/* Drive all outputs to the bridges low, with the channels of TIM1 and TIM8 as they will be. Call it when the break
 * inputs are theirs, and before the outputs are. */
void bridge_start(void);

/* Have a break of TIM1 or TIM8 tell fault(), once. */
void bridge_arm(void);

/* Switch the bridges off and have fault() called at PRIORITY_DRIVE; callable from any context, NMI among them. */
void bridge_trip(hal_fault_t cause);

/* Returns whether a break has switched the bridges off, and nobody has been told yet. */
bool bridge_lost(void);

/* Start the fuse that switches the bridges off when no coil current moves it on. Call it before the timers run. */
void bridge_fuse_start(const hal_t *hal);

/* Leave the bridges on for two chips from now, and the fuse whole until the middle of the third. */
void bridge_watch(void);

/* ---- converters.c ---- */

#define MIDDLE_TICKS 8000u /* The middle of a chip, ticks after its start: nothing converts, no edge is near. */

void converters_start(hal_t *hal);

/* When the coil currents were converted that converters_take() gives. */
typedef enum {
    LOOK_NONE = 0,   /* They were not: it was the temperature, or nothing, or the chips stand. */
    LOOK_MIDDLE = 1, /* Amid the chip. */
    LOOK_END = 2     /* Before its end. */
} look_t;

/* Take the result of injected conversions, if they have ended. Returns of what moment the counts are. */
look_t converters_take(hal_t *hal, uint16_t count[HAL_CHANNELS]);

/* Take the coil currents behind a beacon's edge, if they are there. Returns whether they are. */
bool converters_take_edge(const hal_t *hal, uint16_t count[HAL_CHANNELS]);

/* Start the temperature if it is due. It is called behind a beacon's edge. */
void converters_behind_edge(hal_t *hal);

/* Start the temperature (a beacon's only becomes due), and check that the samples are in step with the chips, at a
 * block boundary. Samples of the finished block that are not good read 0, which counts as saturated. */
void converters_block(hal_t *hal, uint32_t finished, chip_time_t now);

/* ---- chip_engine.c ---- */

/* Drive the sync wire low. */
void sync_wire_start(void);

/* Read the chip engine's time; callable from any context. Costs about 35 instructions, and up to 100 ticks more right
 * behind a chip's middle. Returns the present, as it was before that wait. */
chip_time_t chip_now(void);

/* ---- can.c ---- */

void can_start(const hal_t *hal, uint32_t bit_s);

/* Take no frames, or take them again: while the processor stands still they would run over. They are acknowledged. */
void can_deaf(bool deaf);

/* The vector table's entries. */
void Reset_Handler(void);
void NMI_Handler(void);
void Fault_Handler(void);
void SysTick_Handler(void);
void PVD_Handler(void);
void ADC_Handler(void);
void CAN1_TX_Handler(void);
void CAN1_RX0_Handler(void);
void CAN1_RX1_Handler(void);
void CAN1_SCE_Handler(void);
void PendSV_Handler(void);
void TIM1_BRK_TIM9_Handler(void);
void TIM7_Handler(void);
void TIM8_BRK_TIM12_Handler(void);
void TIM8_CC_Handler(void);
void DMA1_Stream1_Handler(void);
void DMA1_Stream3_Handler(void);
void DMA2_Stream1_Handler(void);

#endif
