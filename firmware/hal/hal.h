/* hal.h: the one door to hardware. An application (firmware/apps) and the core (firmware/core) reach a board only
 * through this header, and each board (firmware/boards/<name>) implements it.
 *
 * Calls, in the order they are made
 *   1. board_start (boards/board.h) gives the board; hal_clock tells what became of its clocks.
 *   2. hal_serial_write_polled sends the first heartbeat; hal_unique_id and hal_parameter_page tell who the board is.
 *   3. hal_chips_start starts the chip engine. From then on the handlers of hal_events_t are called.
 *   4. The main loop calls hal_wait once a turn, hal_watchdog_kick, and the links: hal_serial_write, hal_serial_read,
 *      hal_can_send, hal_can_receive. hal_drive_enable switches the coil drive.
 * hal_t is the board's own type, so many boards live in one process on the host and exactly one on a chip.
 *
 * The chip engine. Time is cut in chips, the chips in blocks of HAL_BLOCK_CHIPS. Hardware (timer and DMA) executes a
 * block while the CPU plans the block after it: the CPU is never in the timing path. All chips are counted from 0
 * since hal_chips_start(), never reset; which chip of the code that is, is the application's affair. At every boundary
 * between blocks, in interrupt context, the board calls
 *   1. samples() with the block that just ended (sensor and anchor), then
 *   2. plan() for the block that follows the one that just started.
 * A board that is late by less than a block (3.03 ms) loses nothing. One that is late by a whole block repeats its old
 * plan: the chip edges of that block are wrong, which hal_counters_t.late_blocks counts once a block. A drive does not
 * go on for a second such block (HAL_FAULT_STALE).
 *
 * Contexts. "Main" is the loop around hal_wait(); "interrupt" is any handler of hal_events_t. All handlers run at one
 * priority except fault, current, edge and middle, which share a higher one and preempt the others; a handler is never
 * re-entered. What must happen at once or at a known time does not wait for them: bridges go off in hardware or in an
 * interrupt above all handlers, and the edges of the sync wire and frames of CAN are stamped above them, so that plan()
 * may take several chips. Functions are callable from main only, unless they say otherwise or are marked [any].
 */
#ifndef GOLDFIELD_HAL_H
#define GOLDFIELD_HAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Ticks of the chip timer in a second, with the clock tree locked to the crystal or to the internal oscillator. */
#define HAL_TICKS_PER_SECOND 168000000u
#define HAL_CHIP_TICKS       16422u /* Nominal length of a chip, ticks: 97.75 us. */
#define HAL_CHIP_TICKS_MIN   16000u /* Shortest planned chip, ticks; plans are clamped, as the sample burst must fit. */
#define HAL_CHIP_TICKS_MAX   16900u /* Longest planned chip, ticks. */
#define HAL_BLOCK_CHIPS      31u    /* Chips in a block: 33 blocks are the 1023 chips of a cycle of degree 10. */
/* Conversions of one axis in a chip; the last of them ends at most 1 us before the nominal end of the chip. */
#define HAL_BURST        8u
#define HAL_AXES         3u      /* Axes of a sensor: x, y, z. */
#define HAL_FRONT_END_HZ 100000u /* Corner of the first-order low-pass before a sensor's converters, Hz. */
/* Coil drives: each has a bridge, a set-point and a current sense; one enable and one fault input serve both. */
#define HAL_CHANNELS             2u
#define HAL_SAMPLE_MAX           4095u /* Full scale of a converter, counts; 0 and 4095 count as saturated. */
#define HAL_UNIQUE_ID_BYTES      12u   /* Length of the chip's unique number. */
#define HAL_PARAMETER_PAGE_BYTES 8192u /* Length of the parameter page. */

typedef struct hal hal_t;

/* ---- The chip engine ---- */

typedef enum {
    HAL_DRIVE_OFF = 0,      /* Both bridge inputs low: the coil's current runs down. */
    HAL_DRIVE_POSITIVE = 1, /* Code bit 0, chip +1. */
    HAL_DRIVE_NEGATIVE = 2  /* Code bit 1, chip -1. */
} hal_drive_t;

#define HAL_DRIVE_BITS 2u /* Bits of a chip's drive for one channel: channel c has bits 2 c and 2 c + 1. */
/* Or-ed to a chip's drive: the sync wire is high for this chip, and its rising edge is the chip's start. */
#define HAL_PLAN_SYNC_OUT 0x80u

typedef struct {
    uint16_t period_ticks[HAL_BLOCK_CHIPS]; /* Length of each chip, ticks. */
    /* The hal_drive_t of each channel, with HAL_PLAN_SYNC_OUT or not. A sensor leaves HAL_DRIVE_OFF. */
    uint8_t drive[HAL_BLOCK_CHIPS];
    /* The driver's current, 0..4095 counts of HAL_REFERENCE_PER_COUNT; larger is clamped. A sensor's is ignored. */
    uint16_t set_point[HAL_CHANNELS][HAL_BLOCK_CHIPS];
} hal_plan_t;

/* Raw conversions of one block: [chip][conversion][axis], right-aligned 12 bits. */
typedef uint16_t hal_samples_t[HAL_BLOCK_CHIPS][HAL_BURST][HAL_AXES];

/* When a burst's conversions are held, that is when their sampling ends; ticks, exact to 12. */
typedef struct {
    uint16_t first_ticks;   /* Time from the start of a chip of nominal length to the first conversion, ticks. */
    uint16_t spacing_ticks; /* Time from each conversion to the next, ticks. */
} hal_burst_t;

/* Returns the times of the board's bursts. [any] */
hal_burst_t hal_burst_timing(void);

/* Why the board switched the drive off by itself. */
typedef enum {
    HAL_FAULT_DRIVER = 0, /* The drivers' fault input is active: hardware has switched the bridges off. */
    /* For two chips no coil current was converted, the chips' edges stood still, or nobody had planned them for a
     * block and more, while the drive was on. */
    HAL_FAULT_STALE = 1,
    HAL_FAULT_CLOCK = 2, /* The crystal stopped while running: hal_clock() is no longer HAL_CLOCK_CRYSTAL. */
    HAL_FAULT_SUPPLY = 3 /* The processor's own supply fell below about 2.8 V. */
} hal_fault_t;

typedef struct {
    void *context; /* What every handler gets as its first argument. */

    /* Interrupt: fill *plan for a block (block 0 holds chips 0..30). It is called for blocks 0 and 1 inside
     * hal_chips_start(). It may take at most 3 ms. */
    void (*plan)(void *context, uint32_t block, hal_plan_t *plan);

    /* Interrupt of a sensor or an anchor (NULL otherwise): take the samples of a finished block, which are valid during
     * the call. */
    void (*samples)(void *context, uint32_t block, const hal_samples_t *samples);

    /* Interrupt of a beacon or an anchor (NULL otherwise), once a chip: take the coil currents' converter counts
     * (0..4095; mid-scale 2048 is 0 A; 1 count is HAL_CURRENT_PER_COUNT). All are taken at one moment, a few
     * microseconds before the end of the chip (an anchor: just before its burst). */
    void (*current)(void *context, uint32_t chip, const uint16_t count[HAL_CHANNELS]);

    /* Interrupt of a beacon (NULL otherwise), once a chip, also if it is not driven: take the coil currents
     * HAL_EDGE_US into the chip, counts as those of current(), which comes later in the same chip. */
    void (*edge)(void *context, uint32_t chip, const uint16_t count[HAL_CHANNELS]);

    /* Interrupt of a beacon or an anchor (NULL otherwise), once a chip, also if it is not driven: take the coil
     * currents amid the chip, counts as those of current(). From the chip's start, and from the moment of edge(), more
     * than 2/5 of the time to the moment of current() have passed, and no more than half of it. */
    void (*middle)(void *context, uint32_t chip, const uint16_t count[HAL_CHANNELS]);

    /* Interrupt: the board has switched the drive off by itself, for this reason. It stays off until
     * hal_drive_enable() is told to enable it again. An active fault input is told also if the drive was off, and once:
     * it is told again when it comes after the drive was enabled the next time. */
    void (*fault)(void *context, hal_fault_t fault);

    /* Interrupt: the sync input rose, ticks (0..period-1) after the start of the chip. */
    void (*sync)(void *context, uint32_t chip, uint16_t ticks);
} hal_events_t;

#define HAL_EDGE_US             4u          /* A sound coil's current has not turned by then, us. */
#define HAL_CURRENT_PER_COUNT   0.0078125f  /* Current for a count of the current sense, A: +-16 A in 4096. */
#define HAL_REFERENCE_PER_COUNT 0.00390625f /* Current for a count of a set-point, A: 16 A in 4096. */

/* A beacon drives, a sensor samples, an anchor does both. The values are those of HEARTBEAT. */
typedef enum { HAL_ROLE_BEACON = 0, HAL_ROLE_SENSOR = 1, HAL_ROLE_ANCHOR = 3 } hal_role_t;
static inline bool hal_role_drives(hal_role_t role) {
    return role != HAL_ROLE_SENSOR;
}
static inline bool hal_role_samples(hal_role_t role) {
    return role != HAL_ROLE_BEACON;
}

/* Start the chip engine. It is called once; the handlers and their context must live for ever. */
void hal_chips_start(hal_t *hal, hal_role_t role, const hal_events_t *events);

/* ---- Coil drive (beacon, anchor) ---- */

/* [any] Enable both bridges, or switch them off. Off acts at once, whatever the plan says.
 * Bridges and set-points change as planned, together at a chip's start. Enabled bridges stay so for two chips beyond
 * each current(), as long as the chips' edges come as well; then the board switches them off (HAL_FAULT_STALE). Half a
 * chip later hardware does, should the processor serve no interrupt any more.
 * Returns whether the bridges are now as asked: they cannot be enabled while the drivers' fault input is active, nor
 * before the chip engine runs. */
bool hal_drive_enable(hal_t *hal, bool enable);

/* [any] Returns whether the drivers' fault input is active now. */
bool hal_drive_fault(const hal_t *hal);

#define HAL_SUPPLY_PER_COUNT 0.0390625f /* Voltage for a count of the supply, V: 160 V in 4096. */

/* What the board measures beside the currents, converter counts 0..4095, each at most one block old. A temperature is
 * that of a thermistor (10 kOhm at 25 degC, B 3950) to ground, below 10 kOhm to the converter's reference: fewer counts
 * are warmer, 2048 is 25 degC, next to 0 a short and next to 4095 an open wire. */
typedef struct {
    uint16_t supply;             /* Supply of the bridges, HAL_SUPPLY_PER_COUNT. */
    uint16_t coil[HAL_CHANNELS]; /* Temperature of each channel's coil. */
    uint16_t driver;             /* Temperature of the driver. */
} hal_monitor_t;

/* [any] Read the latest values. They are 0 until the first current(), and stay 0 on a sensor. */
void hal_monitor(const hal_t *hal, hal_monitor_t *monitor);

/* ---- Links ---- */

typedef struct {
    uint32_t id;     /* Extended identifier, 29 bits. */
    uint8_t length;  /* Bytes of data, 0..8. */
    uint8_t data[8]; /* The data; bytes beyond length mean nothing. */
} hal_frame_t;

/* Start both links at these bit rates, of the protocol's (link_rates.h). Called once, before anything else of this
 * section. */
void hal_links_start(hal_t *hal, uint32_t can_bit_s, uint32_t serial_baud);

#define HAL_SERIAL_BAUD 2000000u /* The highest rate. */
/* Bytes that may wait for the serial port at that rate: 20 ms. At a lower one it is so many fewer. */
#define HAL_SERIAL_BUFFER 4096u

/* Returns the bytes that may wait at a rate. */
static inline uint32_t hal_serial_room(uint32_t baud) {
    return (uint32_t)((uint64_t)HAL_SERIAL_BUFFER * baud / HAL_SERIAL_BAUD);
}

/* Queue bytes for the serial port, all or none. Costs one copy. Returns false if they do not fit now. */
bool hal_serial_write(hal_t *hal, const uint8_t *bytes, size_t count);

/* Returns how many bytes of hal_serial_write() wait, those that are being sent included. */
uint32_t hal_serial_waiting(const hal_t *hal);

/* Send bytes by polling, without interrupts or DMA, for the first heartbeat and for crash reports. It gives up after a
 * bounded wait for each byte. */
void hal_serial_write_polled(hal_t *hal, const uint8_t *bytes, size_t count);

/* Take up to capacity received bytes. Returns how many it took. */
size_t hal_serial_read(hal_t *hal, uint8_t *bytes, size_t capacity);

/* Hand a frame to a free CAN mailbox. Frames of this node leave in the order of the calls. Returns false if all three
 * mailboxes are busy. */
bool hal_can_send(hal_t *hal, const hal_frame_t *frame);

/* Take the oldest received CAN frame. Returns false if there is none. */
bool hal_can_receive(hal_t *hal, hal_frame_t *frame);

/* Time stamps. The board stamps each frame of these two types (SYNC and FOLLOW_UP of protocol/framing.md), sent or
 * received, when it ends, in an interrupt of the highest priority. All boards on the bus see the end of a frame at one
 * moment, so stamps of one frame on several boards are one moment on several clocks. */
#define HAL_CAN_TYPE_MASK 0x1F000000u
#define HAL_CAN_STAMP_0   0x01000000u
#define HAL_CAN_STAMP_1   0x07000000u

static inline bool hal_can_stamped(uint32_t id) {
    return (id & HAL_CAN_TYPE_MASK) == HAL_CAN_STAMP_0 || (id & HAL_CAN_TYPE_MASK) == HAL_CAN_STAMP_1;
}

typedef struct {
    hal_frame_t frame;
    bool sent;      /* True: this board sent the frame, and somebody acknowledged it. False: it was received. */
    uint32_t chip;  /* Absolute chip after whose start the time counts. */
    uint32_t ticks; /* Time from that start to the end of the frame's last bit, ticks: less than two chips. */
} hal_stamp_t;

/* Interrupt, from plan() only: take the oldest stamp. The board keeps 8. Frames that it cannot stamp for certain (two
 * ended before it looked, the chip engine stands, the 8 are not taken) have none. A received frame comes by
 * hal_can_receive() as well, with a stamp or without, before others that were received earlier.
 * The time to get into the interrupt is an error that all boards have in common; from board to board only its jitter
 * counts (sync.h), and the way along the cable, 5 ns/m.
 * Returns false if there is no stamp. */
bool hal_can_stamp(hal_t *hal, hal_stamp_t *stamp);

/* ---- Housekeeping ---- */

typedef enum {
    HAL_CLOCK_CRYSTAL = 0,  /* 168 MHz from the crystal. */
    HAL_CLOCK_INTERNAL = 1, /* The crystal did not start: 168 MHz from the internal oscillator (1 %). */
    HAL_CLOCK_SLOW = 2      /* The PLL did not lock: 16 MHz, links only; hal_chips_start() does nothing. */
} hal_clock_t;

/* Returns what the board runs on: it changes from the crystal to the internal oscillator if the crystal stops. */
hal_clock_t hal_clock(const hal_t *hal);

/* ---- What outlives a reset ---- */

/* Why the board started. */
typedef enum {
    HAL_RESET_POWER_ON = 0,  /* Power came on. What was remembered is lost. */
    HAL_RESET_BROWN_OUT = 1, /* The supply of the processor dipped. What was remembered may be lost. */
    HAL_RESET_PIN = 2,       /* The reset pin was pulled: by a button, a debug probe or another chip. */
    HAL_RESET_SOFTWARE = 3,  /* hal_reset() was called, or a debug probe asked for it. */
    HAL_RESET_WATCHDOG = 4,  /* The watchdog was not kicked in time: the firmware hung or crashed. */
    HAL_RESET_WINDOW = 5,   /* The window watchdog, which this firmware does not start, was not kicked in its window. */
    HAL_RESET_LOW_POWER = 6 /* A sleep mode was entered that the option bytes forbid. */
} hal_reset_cause_t;

#define HAL_RESET_CAUSES 7u /* How many causes there are. */
#define HAL_CRASH_STACK  8u /* Words of the stack that a crash keeps. */

/* The last moment of a program that ended in a fault. The registers are those of the ARMv7-M manual (B3.2). */
typedef struct {
    uint32_t exception;              /* Number of the exception: 3 to 6 are faults, from 16 on interrupts; 0: none. */
    uint32_t pc, lr;                 /* The interrupted program stood there; 0 if the stack did not take them. */
    uint32_t sp;                     /* Its stack pointer at the exception's entry. */
    uint32_t cfsr, hfsr;             /* Fault status registers. */
    uint32_t address;                /* The address that could not be accessed; 0 if the processor does not know it. */
    uint32_t stack[HAL_CRASH_STACK]; /* What lay above the exception's frame; of a stack that ran over, its latest
                                        return addresses. */
    bool stack_overflow;             /* The stack ran over its end. */
} hal_crash_t;

typedef struct {
    hal_reset_cause_t cause;           /* Why the board started this time. */
    uint32_t uptime_s;                 /* How long it had run before, s; 0 if it does not know. */
    uint32_t stalled;                  /* What was noted last before the watchdog struck (hal_note_stalled). */
    uint32_t counts[HAL_RESET_CAUSES]; /* Resets since power-on by their causes, this one among them. */
    hal_crash_t crash;                 /* The fault that the last run ended with; exception is 0 if there was none. */
} hal_reset_t;

/* Note for the next run which parts stand still (a bit each, services/liveness.h), as the watchdog may strike soon;
 * 0: all move. */
void hal_note_stalled(hal_t *hal, uint32_t stalled);

/* Returns why the board started and what became of its last run. It does not change until the next reset. */
const hal_reset_t *hal_last_reset(const hal_t *hal);

#define HAL_RETAINED_WORDS 16u /* Words that outlive a reset. */

/* Returns HAL_RETAINED_WORDS words for the services, which outlive every reset but loss of power: they are 0 after
 * power-on, and otherwise what was written last, even an instant before the watchdog struck. */
uint32_t *hal_retained(hal_t *hal);

/* ---- Counters and clocks ---- */

/* Events since reset. */
typedef struct {
    uint32_t serial_overruns;    /* Received bytes that were lost. */
    uint32_t can_errors;         /* Error frames and bus-off events. */
    uint32_t can_overruns;       /* Received frames that were lost. */
    uint32_t late_blocks;        /* Blocks that repeated an old plan. */
    uint32_t converter_overruns; /* Overruns of the sensor's converters, whose samples are lost. */
    uint32_t watchdog_resets;    /* Resets by the watchdog since power-on. */
    uint32_t supply_dips;        /* How often the processor's supply fell below about 2.8 V. */
} hal_counters_t;

/* Read the counters. */
void hal_counters(const hal_t *hal, hal_counters_t *counters);

/* [any] Must be called at least once in 35 minutes. Returns the microseconds since reset, from a free-running timer,
 * which never goes back. */
uint64_t hal_microseconds(hal_t *hal);

/* Returns the temperature of the processor, 0.1 degC; a sensor's is at most one cycle old. */
int16_t hal_temperature(const hal_t *hal);

/* Switch the board's LED, which hal_chips_start() switches on. */
void hal_led(hal_t *hal, bool on);

/* [any] Switch both bridges off, then restart the board as its reset pin does. It may return: the caller then has
 * nothing more to do than to leave its turn of the main loop, or its handler. */
void hal_reset(hal_t *hal);

/* Read the chip's unique number. */
void hal_unique_id(const hal_t *hal, uint8_t id[HAL_UNIQUE_ID_BYTES]);

/* Read a number of 64 bits from the processor's generator of true random numbers. It takes a few microseconds, bounded.
 * Returns false if the generator has none, fails its test, or repeats itself: *number then means nothing. */
bool hal_random(hal_t *hal, uint64_t *number);

/* Returns the parameter page in flash (framing.md), HAL_PARAMETER_PAGE_BYTES long, readable for ever. */
const uint8_t *hal_parameter_page(const hal_t *hal);

/* ---- Flash for what is saved ---- */

/* Two slots of flash, which nothing of the image lies in. They are read like memory; a word is programmed from all
 * ones, and programming it once more clears further bits (core/storage/store.h asks for no more).
 *
 * While the flash is busy nothing else can be read from it, and the program lies in it: main and every interrupt stand
 * still, at most 0.1 ms for a word (16 us as a rule) and 0.5 s for an erasure (0.25 s). The coil drive must be off, and
 * it does stay so. A word delays the stamp of a frame on CAN, or an interrupt, by that much, and costs nothing else. An
 * erasure costs every block of chips meanwhile, what serial and CAN receive, and the chip engine's step: behind it the
 * caller has nothing to do but hal_reset(), unless it comes before hal_chips_start(). Other boards that follow this
 * one's sync wire lose it until then. */
#define HAL_FLASH_SLOTS 2u
#define HAL_FLASH_WORDS 4096u /* Words of a slot: 16 KiB. */

/* Returns the words of a slot (0 or 1), readable for ever. */
const uint32_t *hal_flash_slot(const hal_t *hal, uint32_t slot);

/* Program a word of a slot. The caller looks whether the word then reads as it should.
 * Returns false if the flash says that it did not, if the processor's supply is too low for it (2.7 V), or for a slot
 * or an index that there is not. */
bool hal_flash_program(hal_t *hal, uint32_t slot, uint32_t index, uint32_t value);

/* Erase a slot: all its words read UINT32_MAX. The watchdog has 2 s meanwhile, and is fed behind it.
 * Returns false as hal_flash_program() does. */
bool hal_flash_erase(hal_t *hal, uint32_t slot);

/* ---- Flash for images ---- */

#define HAL_IMAGE_SLOTS       2u
#define HAL_IMAGE_STATE_WORDS 16u /* Words of the running image's slot that may be programmed: core/boot/image.h. */

/* Where the images lie that the boot loader chooses from: they are read like memory. */
typedef struct {
    const uint32_t *slot[HAL_IMAGE_SLOTS];
    uint32_t address[HAL_IMAGE_SLOTS]; /* What the images' headers must say of that. */
    uint32_t words;                    /* Words of a slot; 0: this board has none. */
    uint32_t running;                  /* The slot whose image runs. */
    uint32_t board;                    /* Kind of this hardware, as the images' headers tell it. */
    const uint8_t *key;                /* Public key of who may sign images, 32 bytes; NULL: there is none. */
} hal_images_t;

/* Returns the board's images. */
hal_images_t hal_images(const hal_t *hal);

/* Program a word of a slot: any of the slot that does not run, or one of the running one's state words. What
 * hal_flash_program() says of time and of the coil drive holds.
 * Returns false if it did not take, or for a word that may not be programmed. */
bool hal_image_program(hal_t *hal, uint32_t slot, uint32_t index, uint32_t value);

/* Erase the first words of the slot that does not run, and as many more as the flash's sectors have. Everything stands
 * still meanwhile, for 1 s each 128 KiB, at most 2 s; what hal_flash_erase() says of the chip engine holds.
 * Returns false as hal_image_program() does. */
bool hal_image_erase(hal_t *hal, uint32_t slot, uint32_t words);

/* Restart the watchdog's 500 ms. */
void hal_watchdog_kick(hal_t *hal);

/* Sleep until something has happened since the last call: an interrupt, of which a current() alone need not count. It
 * returns at once if something already has. It never sleeps longer than one block once the chip engine runs, and at
 * most 10 ms before that. */
void hal_wait(hal_t *hal);

#endif
