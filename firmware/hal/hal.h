/* hal.h: the one door to hardware.
 *
 * An application (firmware/apps) and the core (firmware/core) reach a board only through this header. Each board
 * (firmware/boards/<name>) implements it; hal_t is the board's own type, so many boards live in one process on the host
 * and exactly one on a chip.
 *
 * The chip engine. Time is cut in chips, the chips in blocks of HAL_BLOCK_CHIPS. Hardware (timer and DMA) executes a
 * block while the CPU plans the block after it: the CPU is never in the timing path. All chips are counted from 0 since
 * hal_chips_start(), never reset; which code chip that is, is the application's affair. At every boundary between
 * blocks, in interrupt context, the board calls
 *   1. samples() with the block that just ended (sensor and anchor), then
 *   2. plan() for the block that follows the one that just started.
 * A board that is late by a whole block repeats its old plan, and counts hal_counters_t.late_blocks: chip edges are
 * then wrong for that block.
 *   late by less than a block (3.03 ms): nothing is lost;   late by more: that block's chips are wrong, counted once a
 *     block.
 *
 * Contexts. "main" is the loop around hal_wait(); "interrupt" is any handler of hal_events_t. All handlers run at one
 * priority except fault and current, which preempt the others; a handler is never re-entered. Functions are callable
 * from main only, unless they say otherwise or are marked [any].
 */
#ifndef GOLDFIELD_HAL_H
#define GOLDFIELD_HAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define HAL_TICKS_PER_SECOND                                                                                           \
    168000000u                    /* Chip timer ticks, with the clock tree locked to crystal or internal oscillator. */
#define HAL_CHIP_TICKS     16422u /* Nominal chip: 97.75 us. */
#define HAL_CHIP_TICKS_MIN 16000u /* A planned period is clamped to this range: the sample burst must fit. */
#define HAL_CHIP_TICKS_MAX 16900u
#define HAL_BLOCK_CHIPS    31u /* 1023 = 33 blocks. */
#define HAL_BURST                                                                                                      \
    8u /* Conversions of one axis in a chip, the last of which ends at most 1 us before the nominal chip end. */
#define HAL_AXES         3u
#define HAL_FRONT_END_HZ 100000u /* Corner of the first-order low-pass before a sensor's converters. */
#define HAL_CHANNELS                                                                                                   \
    2u /* Coil drives: bridge, set-point and current sense each; one enable and one fault input for both. */
#define HAL_SAMPLE_MAX           4095u /* Converter full scale; 0 and 4095 count as saturated. */
#define HAL_UNIQUE_ID_BYTES      12u
#define HAL_PARAMETER_PAGE_BYTES 8192u

typedef struct hal hal_t;

/* ---- The chip engine ---- */

typedef enum {
    HAL_DRIVE_OFF = 0,      /* Both bridge inputs low: the coil's current runs down. */
    HAL_DRIVE_POSITIVE = 1, /* Code bit 0, chip +1. */
    HAL_DRIVE_NEGATIVE = 2  /* Code bit 1, chip -1. */
} hal_drive_t;

#define HAL_DRIVE_BITS 2u /* A chip's drive holds hal_drive_t of channel c in bits 2 c and 2 c + 1. */
#define HAL_PLAN_SYNC_OUT                                                                                              \
    0x80u /* Or-ed to a chip's drive: the sync wire is high for this chip (its rising edge is the chip's start). */

typedef struct {
    uint16_t period_ticks[HAL_BLOCK_CHIPS]; /* Length of each chip. */
    uint8_t drive[HAL_BLOCK_CHIPS]; /* hal_drive_t of each channel, with HAL_PLAN_SYNC_OUT or not. A sensor leaves
                                       HAL_DRIVE_OFF. */
    uint16_t set_point[HAL_CHANNELS]
                      [HAL_BLOCK_CHIPS]; /* The driver's current, 0..4095 counts of HAL_REFERENCE_PER_COUNT; larger is
                                            clamped. A sensor's are ignored. */
} hal_plan_t;

/* Raw conversions of one block: [chip][conversion][axis], right-aligned 12 bits. */
typedef uint16_t hal_samples_t[HAL_BLOCK_CHIPS][HAL_BURST][HAL_AXES];

/* When a burst's conversions are held (their sampling ends): the first, after the start of a chip of nominal length,
 * and from each to the next; ticks, exact to 12. */
typedef struct {
    uint16_t first_ticks, spacing_ticks;
} hal_burst_t;
hal_burst_t hal_burst_timing(void);

typedef struct {
    void *context; /* Handed back to every handler. */

    /* Interrupt. Fill *plan for block (block 0 holds chips 0..30). Called for blocks 0 and 1 inside
     * hal_chips_start(). At most 3 ms of work. */
    void (*plan)(void *context, uint32_t block, hal_plan_t *plan);

    /* Interrupt, sensor and anchor (NULL otherwise). The samples of a finished block; valid during the call. */
    void (*samples)(void *context, uint32_t block, const hal_samples_t *samples);

    /* Interrupt, beacon and anchor (NULL otherwise). Once a chip: the coil currents' converter counts (0..4095;
     * mid-scale 2048 is 0 A; 1 count is HAL_CURRENT_PER_COUNT), all taken at one moment, a few microseconds before
     * the end of chip (an anchor: just before its burst). */
    void (*current)(void *context, uint32_t chip, const uint16_t count[HAL_CHANNELS]);

    /* Interrupt. The driver's fault input went active. The board has already disabled the drive. */
    void (*fault)(void *context);

    /* Interrupt. Rising edge of the sync input: it came ticks (0..period-1) after the start of chip. */
    void (*sync)(void *context, uint32_t chip, uint16_t ticks);
} hal_events_t;

#define HAL_CURRENT_PER_COUNT   0.0078125f  /* A per count of the current sense: +-16 A in 4096. */
#define HAL_REFERENCE_PER_COUNT 0.00390625f /* A per count of a set-point: 16 A in 4096. */

/* A beacon drives, a sensor samples, an anchor does both. As in HEARTBEAT. */
typedef enum { HAL_ROLE_BEACON = 0, HAL_ROLE_SENSOR = 1, HAL_ROLE_ANCHOR = 3 } hal_role_t;
static inline bool hal_role_drives(hal_role_t role) {
    return role != HAL_ROLE_SENSOR;
}
static inline bool hal_role_samples(hal_role_t role) {
    return role != HAL_ROLE_BEACON;
}

/* Start the chip engine. The handlers and their context must live for ever. Call once. */
void hal_chips_start(hal_t *hal, hal_role_t role, const hal_events_t *events);

/* ---- Coil drive (beacon, anchor) ---- */

/* [any] Enable of both bridges. Off acts at once (one register write), whatever the plan says. Bridges and
 * set-points change as planned, together at a chip's start. */
void hal_drive_enable(hal_t *hal, bool enable);

/* ---- Links ---- */

typedef struct {
    uint32_t id;    /* 29-bit extended identifier. */
    uint8_t length; /* 0..8 */
    uint8_t data[8];
} hal_frame_t;

/* Queue bytes for the serial port, all or none. False if they do not fit now. Bound: one copy. The buffer holds
 * HAL_SERIAL_BUFFER bytes (20 ms). */
#define HAL_SERIAL_BUFFER 4096u
bool hal_serial_write(hal_t *hal, const uint8_t *bytes, size_t count);

/* Send bytes by polling, without interrupts or DMA: for the first heartbeat and for crash reports. Gives up after a
 * bounded wait for each byte. */
void hal_serial_write_polled(hal_t *hal, const uint8_t *bytes, size_t count);

/* Take up to capacity received bytes; returns how many. */
size_t hal_serial_read(hal_t *hal, uint8_t *bytes, size_t capacity);

/* Hand a frame to a free CAN mailbox. False if all three are busy. Frames of this node leave in the order of calls. */
bool hal_can_send(hal_t *hal, const hal_frame_t *frame);

/* Take the oldest received CAN frame. False if there is none. */
bool hal_can_receive(hal_t *hal, hal_frame_t *frame);

/* Time stamps. The board stamps each frame of these two types (SYNC and FOLLOW_UP of protocol/framing.md), sent or
 * received, when it ends, in an interrupt of the highest priority. All boards on the bus see the end of a frame at
 * one moment, so stamps of one frame on several boards are one moment on several clocks. */
#define HAL_CAN_TYPE_MASK 0x1F000000u
#define HAL_CAN_STAMP_0   0x01000000u
#define HAL_CAN_STAMP_1   0x07000000u

static inline bool hal_can_stamped(uint32_t id) {
    return (id & HAL_CAN_TYPE_MASK) == HAL_CAN_STAMP_0 || (id & HAL_CAN_TYPE_MASK) == HAL_CAN_STAMP_1;
}

typedef struct {
    hal_frame_t frame;
    bool sent;     /* By this board, and somebody acknowledged it. Else received. */
    uint32_t chip; /* The frame's last bit ended ticks after the start of this chip. Less than two chips. */
    uint32_t ticks;
} hal_stamp_t;

/* Interrupt, from plan() only: take the oldest stamp. False if there is none. The board keeps 8; frames that it
 * cannot stamp for certain (two ended before it looked, the chip engine stands, the 8 are not taken) have none. A
 * received frame comes by hal_can_receive() as well, with a stamp or without; before others that were received
 * earlier.
 *   common error of all boards: how long it takes to get into the interrupt; board to board only its jitter counts
 *     (sync.h), and the way along the cable, 5 ns/m. */
bool hal_can_stamp(hal_t *hal, hal_stamp_t *stamp);

/* ---- Housekeeping ---- */

typedef enum { HAL_CLOCK_CRYSTAL = 0, HAL_CLOCK_INTERNAL = 1, HAL_CLOCK_SLOW = 2 } hal_clock_t;
/* CRYSTAL: 168 MHz from the crystal. INTERNAL: the crystal did not start, 168 MHz from the internal oscillator (1 %).
 * SLOW: the PLL did not lock, 16 MHz: links only, hal_chips_start() does nothing. */
hal_clock_t hal_clock(const hal_t *hal);

typedef struct {
    uint32_t serial_overruns; /* Received bytes lost. */
    uint32_t can_errors;      /* Error frames and bus-off events. */
    uint32_t can_overruns;    /* Received frames lost. */
    uint32_t late_blocks;
    uint32_t converter_overruns;
    uint32_t watchdog_resets; /* 1 if the watchdog caused the last reset. */
} hal_counters_t;
void hal_counters(const hal_t *hal, hal_counters_t *counters);

/* [any] Microseconds since reset, from a free-running timer; never goes back. Must be called at least once in 35
 * minutes. */
uint64_t hal_microseconds(hal_t *hal);

/* Processor temperature, 0.1 degC. Sensor: at most one cycle old. */
int16_t hal_temperature(const hal_t *hal);

void hal_unique_id(const hal_t *hal, uint8_t id[HAL_UNIQUE_ID_BYTES]);

/* The parameter page in flash (framing.md), HAL_PARAMETER_PAGE_BYTES long, readable for ever. */
const uint8_t *hal_parameter_page(const hal_t *hal);

/* Restart the watchdog's 500 ms. */
void hal_watchdog_kick(hal_t *hal);

/* Sleep until something happened (interrupt; a current() alone need not count) since the last call; returns at once
 * if something already did. Never longer than one block once the chip engine runs; before that at most 10 ms. */
void hal_wait(hal_t *hal);

#endif
