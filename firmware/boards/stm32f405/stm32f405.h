/* stm32f405.h: inside this board: what its files share. Nothing outside this directory includes it.
 *
 *   interrupts.c   the one board that handlers see, and how a handler is switched on
 *   clock.c        clock tree, waits with time-outs, microseconds, tick
 *   reset.c        why the board started, and what outlives a reset
 *   serial.c       USART1 with DMA both ways
 *   converters.c   the sensor's burst, coil currents, temperature
 *   chip_engine.c  TIM1, TIM8, DMA to pins and DAC, blocks, sync
 *   can.c          CAN1
 *   board.c        pins, watchdog, and what is not the others'
 *   guards.c       memory protection
 *   alarms.c       crystal or supply fails while the board runs
 *   crash.c        fault report over serial, then reset
 *   startup.c      vector table, reset, .data and .bss
 * A file calls only those above it in this list. Functions are declared below by file.
 *
 * Priorities (a lower number preempts)
 *   0   time stamps of CAN frames
 *   1   coil currents, temperature, driver fault, and alarms
 *   2   every other handler
 *   3   the 10 ms tick
 * The core's erratum 776924 (VDIV and VSQRT with lazy stacking) asks that a handler has more than two instructions
 * before its return: all have.
 *
 * DMA streams, by priority; no stream is shared
 *   DMA2 stream 5   chip edges                   very high
 *   DMA2 stream 4   chip periods                 high
 *   DMA2 stream 0   samples                      high
 *   DMA2 stream 2   serial in                    medium
 *   DMA2 stream 7   serial out                   low
 *   DMA1 stream 5   set-points to the DAC        alone; DMA1 reaches neither GPIO nor APB2
 * The erratum "DMA2 data corruption when managing AHB and APB peripherals in a concurrent way" (ES0182) can write the
 * same word twice to an AHB peripheral, which is harmless to BSRR.
 */
#ifndef STM32F405_BOARD_H
#define STM32F405_BOARD_H

#include "boards/stm32f405/registers.h"
#include "hal/hal.h"

#define RING_CHIPS            (2u * HAL_BLOCK_CHIPS) /* Chips in the chip engine's buffers: two blocks. */
#define SERIAL_RECEIVE_BUFFER 2048u                  /* Received bytes that may wait for main: 10 ms. */
#define CAN_RECEIVE_BUFFER    32u /* Received frames that may wait for main: 3.5 ms of the shortest with 8 bytes. */
#define CAN_STAMPS            8u  /* Stamped frames that may wait (hal.h). */

/* Priorities of the interrupts, as above. */
enum { PRIORITY_STAMP = 0, PRIORITY_DRIVE = 1, PRIORITY_NORMAL = 2, PRIORITY_TICK = 3 };

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
    uint32_t block;                  /* The running block, as far as the block interrupt has come. */
    volatile uint32_t first_chip;    /* Its first chip: 31 * block, odd when block is odd. */
    uint32_t words[RING_CHIPS];      /* Read by DMA: words for BSRR. */
    uint32_t periods[RING_CHIPS];    /* Read by DMA: values for ARR. */
    uint32_t set_points[RING_CHIPS]; /* Read by DMA: words for DHR12RD. */
    hal_plan_t plan;                 /* The plan that the application fills. */

    /* converters.c */
    bool sampling;                 /* The samples in the buffer are complete and in step. */
    volatile bool temperature_due; /* The injected conversion is that of the temperature. JSQR says so, too, but would
                                      have to be read in each chip. */
    uint16_t temperature_count;    /* Its latest result, counts; 0: there is none. */
    hal_samples_t samples[2];      /* Written by DMA: the even and the odd block. */

    /* serial.c */
    volatile uint32_t sent, written; /* Bytes since reset: freed by the DMA, put in by main. */
    volatile uint32_t sending;       /* Bytes in the running transfer. */
    volatile uint32_t receive_wraps; /* How often DMA has filled the receive buffer. */
    uint32_t taken;                  /* Bytes since reset that main took. */
    uint8_t transmit[HAL_SERIAL_BUFFER];
    uint8_t receive[SERIAL_RECEIVE_BUFFER];

    /* can.c */
    volatile uint32_t can_put, can_taken; /* Frames since reset: put in by the interrupt, taken by main. */
    bool can_off;                         /* The controller is off the bus. */
    hal_frame_t can_frames[CAN_RECEIVE_BUFFER];
    hal_frame_t can_mailbox[3];              /* The frame that was handed to each mailbox. */
    uint32_t can_stamp_put, can_stamp_taken; /* Stamps since reset, from the stamping interrupts to plan. */
    hal_stamp_t can_stamps[CAN_STAMPS];
    uint32_t can_stamped_put, can_stamped_taken; /* Frames since reset that were received there, to main. */
    hal_frame_t can_stamped[CAN_STAMPS];
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

/* ---- clock.c ---- */

/* Poll until (*address & mask) == value, at most tries times (about 6 cycles each). Returns false if it did not
 * happen. */
bool wait_for(const volatile uint32_t *address, uint32_t mask, uint32_t value, uint32_t tries);
hal_clock_t clock_start(void);

/* Go on without the crystal, which has stopped: 0.3 ms at 16 MHz, then as if it had never started. Returns false if the
 * PLL does not lock. */
bool clock_fall_back(hal_t *hal);
void clock_start_tick(hal_clock_t clock);

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

void serial_start(hal_t *hal);

/* ---- converters.c ---- */

#define CHIP_RELOAD_TICKS 8000u /* When DMA fetches the next chip's period (CC4), ticks after each chip's start. */

typedef struct {
    uint32_t chip;  /* Absolute chip. */
    uint32_t ticks; /* Ticks since it started. */
} chip_time_t;

void converters_start(const hal_t *hal);

/* Take the result of injected conversions that have ended. Returns true if the counts are those of the coil currents,
 * false if it was the temperature. */
bool converters_take(hal_t *hal, uint16_t count[HAL_CHANNELS]);

/* Start the temperature and check that the samples are in step with the chips, at a block boundary. Samples of the
 * finished block that are not good read 0, which counts as saturated. */
void converters_block(hal_t *hal, uint32_t finished, chip_time_t now);

/* ---- chip_engine.c ---- */

/* Read the chip engine's time, from handlers of normal priority or higher only: the block interrupt must not run to
 * its end meanwhile. Costs about 40 instructions. Returns the present. */
chip_time_t chip_now(const hal_t *hal);

/* ---- can.c ---- */

void can_start(const hal_t *hal);

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
void TIM1_CC_Handler(void);
void USART1_Handler(void);
void EXTI15_10_Handler(void);
void DMA2_Stream2_Handler(void);
void DMA2_Stream5_Handler(void);
void DMA2_Stream7_Handler(void);

#endif
