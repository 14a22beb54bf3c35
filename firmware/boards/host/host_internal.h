/* host_internal.h: the state of a host board, shared by its three files, each of which calls only those below it:
 *   host_board.c   time, inputs from outside, the application, the operations of board_edge.h
 *   host_engine.c  the chip engine, with its converters
 *   host_hal.c     the functions of hal.h, the present, and the pins */
#ifndef GOLDFIELD_HOST_INTERNAL_H
#define GOLDFIELD_HOST_INTERNAL_H

#include <stddef.h>

#include "boards/board_edge.h"
#include "boards/host/host_config.h"

/* Pins, numbered port * 16 + pin (boards/pinout.md). */
enum {
    PIN_CURRENT_0 = 0,           /* PA0 */
    PIN_FIELD_X = 1,             /* PA1; y and z follow. */
    PIN_SYNC_OUT = 7,            /* PA7 */
    PIN_BRIDGE_1 = 16,           /* PB0: input 1 of channel 1's bridge; input 2 follows. */
    PIN_LED = 20,                /* PB4 */
    PIN_FAULT = 28,              /* PB12, on one wire with PA6. */
    PIN_BRIDGE_0 = 29,           /* PB13: input 1 of channel 0's bridge; input 2 follows. */
    PIN_ENABLE = 31,             /* PB15 */
    PIN_SUPPLY = 32,             /* PC0: supply of the bridges. */
    PIN_COIL_TEMPERATURE_0 = 33, /* PC1 */
    PIN_DRIVER_TEMPERATURE = 34, /* PC2 */
    PIN_COIL_TEMPERATURE_1 = 35, /* PC3 */
    PIN_CURRENT_1 = 36,          /* PC4 */
    PIN_SYNC_IN = 38             /* PC6 */
};

enum {
    SERIAL_PORT = 3,      /* USART3. */
    MAILBOXES = 3,        /* Mailboxes of the CAN controller. */
    RECEIVE_BYTES = 1024, /* Received bytes that may wait for main. */
    RECEIVE_FRAMES = 64,  /* Received frames that may wait for main. */
    STAMPS = 8            /* Stamped frames that may wait (hal.h). */
};

/* Durations in ticks of the 168 MHz timer. The converters run at 21 MHz, 8 ticks a clock; they sample for 15 clocks
 * and convert for 12. */
enum {
    SAMPLE_TICKS = 15 * 8,          /* Time from the start of a conversion to the end of its sampling. */
    CONVERSION_TICKS = 27 * 8,      /* A whole conversion. */
    EDGE_TICKS = HAL_EDGE_US * 168, /* Time from a chip's start to the sampling of the currents behind its edge. */
    MIDDLE_TICKS = 8192,            /* Time from the currents amid the chip to those before its end. */
    BURST_MARGIN_TICKS = 84,        /* Time from the last conversion's end to the planned end of the chip, 0.5 us. */
    WATCHDOG_TICKS = 84000000,      /* The watchdog strikes so long after it was last kicked, 500 ms. */
    IDLE_TICKS = 1680000            /* The longest sleep before the chip engine runs, 10 ms. */
};

typedef enum { INPUT_PIN, INPUT_BYTE, INPUT_FRAME, INPUT_SENT } input_kind_t;

/* Something from outside that waits for its time. */
typedef struct {
    int64_t time_ps;
    input_kind_t kind;
    uint32_t number; /* The pin or mailbox; the byte's bit rate. */
    bool level;      /* The pin's level; the mailbox's success. */
    uint8_t byte;
    hal_frame_t frame;
} input_t;

/* Most events of a chip: three looks at the currents of two events each, a sensor's samplings, the next chip's start.
 */
#define CHIP_EVENTS (2 * 3 + HAL_BURST + 1)

/* The chip engine. It goes through the events of a chip in order: its conversions, then its end. */
typedef struct {
    bool running;
    hal_role_t role;
    hal_events_t events;
    hal_plan_t plan[2];              /* Plans of the block under way and of the next, by parity of the block. */
    uint32_t block;                  /* The block under way. */
    uint32_t chip;                   /* The chip under way, counted since hal_chips_start(). */
    uint32_t chip_in_block;          /* Its place in the block. */
    int64_t chip_start;              /* The tick at which it began. */
    uint32_t event;                  /* The next event within the chip: host_engine.c numbers them, */
    int64_t next_tick;               /* and its tick. */
    uint32_t current_events;         /* How many events of the chip are looks at the currents. */
    uint32_t last_event;             /* The number of its last. */
    uint32_t after[CHIP_EVENTS + 1]; /* When each is, ticks after the chip's start. */
    uint32_t bridges; /* The bridges' inputs that the outside has been told; 0: none since the engine began. */
    uint16_t current[HAL_CHANNELS];   /* The conversions of the currents that end shortly. */
    hal_monitor_t monitor;            /* What is measured together with them. */
    uint32_t unmeasured;              /* Chips without such a conversion while the drive is on. */
    uint16_t set_point[HAL_CHANNELS]; /* The set-points that the outside has been told. */
    hal_samples_t samples;            /* The samples of the block so far. */
} engine_t;

typedef struct {
    uint8_t bytes[HAL_SERIAL_BUFFER];
    uint32_t head, count; /* The first byte that waits, and how many wait. */
    int64_t byte_end;     /* The tick at which the byte at the head has left. */
    int64_t byte_ticks;   /* Length of a byte, ten bits. */
} transmitter_t;

struct hal {
    /* Nothing happens on the board before due_ps, unless something comes from outside; INT64_MIN: nobody knows. */
    int64_t due_ps, now_ps;
    board_edge_t edge;
    host_board_config_t config;
    int64_t power_on_ps;
    uint64_t tick_q32;     /* Length of a tick, ps times 2^32, since the crystal last changed: */
    int64_t since_ps;      /* that was at this time, */
    int64_t since_tick;    /* at this tick. */
    int64_t tick_ps, tick; /* A time and its tick: as a rule the present, which is asked for again and again. */
    bool reset_wanted;     /* The application has asked for a reset, which comes at the end of its turn. */
    bool awake;            /* There was an interrupt since the main loop last ran. */
    uint32_t serial_baud;  /* The board's rates; 0 until its links start. */
    uint32_t can_bit_s;
    uint32_t bus_bit_s; /* Bit rate of the bus that the board is on. */
    int64_t idle_tick;  /* The latest end of the present sleep. */
    int64_t kick_tick;  /* The watchdog was last kicked. */
    bool failed[HOST_FAILURES];
    engine_t engine;
    bool pin_out[64];             /* The levels that the outside has been told, */
    uint64_t pins_driven;         /* of these pins: the others float since power-on. */
    bool fault_level, sync_level; /* The levels of the two inputs. */
    transmitter_t transmitter;
    uint8_t received[RECEIVE_BYTES];
    uint32_t received_head, received_count;
    hal_frame_t frames[RECEIVE_FRAMES];
    uint32_t frames_head, frames_count;
    /* The mailboxes are a ring whose oldest alone the outside sees: frames leave in order, whatever identifiers. */
    hal_frame_t mailbox[MAILBOXES];
    uint32_t mailbox_head, mailbox_count;
    hal_stamp_t stamps[STAMPS];
    uint32_t stamps_head, stamps_count;
    hal_counters_t counters;
    hal_reset_t reset; /* This, and what the services keep, outlive a reset. */
    uint32_t retained[HAL_RETAINED_WORDS];
    uint64_t random_state; /* Where hal_random() stands; 0: it was not asked yet. */
    host_flash_t flash;    /* Where it is; without functions it is own_flash. */
    host_images_t images;
    uint32_t own_flash[HAL_FLASH_SLOTS][HAL_FLASH_WORDS];
    bool dead;       /* The power was lost within a step of the flash. */
    input_t *inputs; /* What waits for its time, sorted by time; equal times in order of arrival. */
    size_t inputs_head, inputs_count, inputs_capacity;
};

__extension__ typedef unsigned __int128 wide_t;

/* Returns the tick under way at a time, since power-on; the time is not before the crystal last changed. */
static inline int64_t host_tick_at(const hal_t *hal, int64_t time_ps) {
    return hal->since_tick + (int64_t)(((wide_t)(uint64_t)(time_ps - hal->since_ps) << 32) / hal->tick_q32);
}

/* Returns the time of a tick, rounded up, so that host_tick_at() gives the tick back. */
static inline int64_t host_time(const hal_t *hal, int64_t tick) {
    const wide_t product = (wide_t)(uint64_t)(tick - hal->since_tick) * hal->tick_q32;
    return hal->since_ps + (int64_t)((product + 0xFFFFFFFFu) >> 32);
}

/* Returns the present in ticks of the board's clock since power-on. */
int64_t host_tick(const hal_t *hal);

/* The present goes on to a tick, unless it is there already. */
void host_go_to(hal_t *hal, int64_t tick);

/* Set an output, and tell the outside if its level changes. */
void host_pin_write(hal_t *hal, unsigned pin, bool level);

/* Gives the bridges' inputs the levels of the present chip, or, with the drive off, none: they follow the enable. */
void host_bridges_write(hal_t *hal);

/* Returns the tick of the next chip that begins a block or changes the sync output. */
int64_t host_engine_change(const engine_t *engine);

/* Let the engine's events happen one after the other, up to a tick, or until the main loop or the serial line has
 * something to do. */
void host_engine_run(hal_t *hal, int64_t last_tick);

/* The sync input has risen: tell the application, if the engine runs. */
void host_engine_sync(hal_t *hal);

/* Give the outside the oldest frame of the mailboxes. */
void host_can_request(hal_t *hal);

#endif
