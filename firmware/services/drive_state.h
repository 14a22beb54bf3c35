/* drive_state.h: what the parts of the drive (drive.h) share: its state. */
#ifndef GOLDFIELD_DRIVE_STATE_H
#define GOLDFIELD_DRIVE_STATE_H

#include "core/drive/current.h"
#include "core/drive/fall.h"
#include "core/drive/latch.h"
#include "core/drive/waveform.h"
#include "hal/hal.h"
#include "services/node.h"
#include "services/timing.h"

#define DRIVE_CHIPS_MAX 2047u /* Most chips in a sync period: one cycle of degree 11 (sync.h). */

/* The current interrupt preempts the others. It alone goes from ARMED to ON; all others go to IDLE, or from IDLE to
 * ARMED. */
typedef enum {
    DRIVE_IDLE = 0,  /* Planned chips are off. */
    DRIVE_ARMED = 1, /* Planned chips carry the waveform from start_chip on; the bridges are still off. */
    DRIVE_ON = 2     /* start_chip has come: the bridges are on. */
} drive_phase_t;

/* The parameters that the drive is made from; they are compared to see whether a PARAM_SET changed one. */
typedef struct {
    waveform_config_t waveform;
    float amplitude_A;    /* Current at level 1, A; 0 for a board that is not armed. */
    float over_current_A; /* Magnitude of current beyond which the drive trips, A. */
    float open_fraction;  /* Least share of the current asked for; below it the coil counts as open. */
    float rms_A, rms_s;   /* Largest root mean square of the current, and over which time. */
    float supply_low_V, supply_high_V;
    float coil_hot_degC, driver_hot_degC; /* 0: not watched. */
} drive_settings_t;

/* A block as it was planned, for the interrupt that measures it. */
typedef struct {
    uint32_t driven[HAL_CHANNELS];                /* Bit i is set if chip i is driven. */
    int16_t asked[HAL_CHANNELS][HAL_BLOCK_CHIPS]; /* Set-point of each chip, counts with the bridge's sign. */
} drive_block_t;

/* The limits of what is measured beside the currents, converter counts. */
typedef struct {
    uint16_t supply_low, supply_high;
    uint16_t coil_hot, driver_hot; /* Fewer are hotter; 0: not watched. */
} drive_limits_t;

#define DRIVE_COMMON HAL_CHANNELS /* The channel of a cause that is not one channel's. */

/* Private but for tests. */
typedef struct {
    node_t *node;
    timing_t *timing;
    current_t current[HAL_CHANNELS];
    fall_t fall[HAL_CHANNELS];
    uint16_t start[HAL_CHANNELS]; /* The currents behind the latest edge, or at the end of the chip before, counts. */
    uint32_t channels;            /* Channels driven, 1 or 2. It changes only while the drive is idle, as do levels. */
    drive_settings_t settings;
    int16_t levels[HAL_CHANNELS][DRIVE_CHIPS_MAX]; /* Level of each chip of the sync period (WAVEFORM_ONE is 1). */
    volatile bool wanted; /* Set by main: the settings are complete, the amplitude is not 0, the clock is good. */
    bool meant;           /* What main has set it to: a bit of one that flips is found. */
    uint8_t halve_from, halve_to; /* The chips of the block being planned that have half their current. */
    bool no_waveform;             /* The settings make no waveform. */
    bool several_levels;          /* Its levels, 0 left aside, have several sizes. */
    drive_block_t blocks[2];      /* The even and the odd block: one is planned while the other runs. */
    volatile uint8_t phase;       /* A drive_phase_t. */
    volatile uint32_t planned;    /* The block that was planned last. */
    volatile uint32_t start_chip; /* Absolute chip with which the drive begins. Chip 0 has none before it that could
                                     switch on, so that a master starts with chip 1. */
    latch_t latch;
    volatile uint8_t channel; /* The channel of the latched cause, or DRIVE_COMMON. */
    drive_limits_t limits;
    uint64_t health_us;                        /* The heartbeat with which DRIVE_HEALTH was sent last, */
    uint8_t urgent_told;                       /* and what was told last that is worth telling at once. */
    volatile uint32_t over_current, open_coil; /* Events since reset. */
    volatile uint32_t cycles;                  /* Sync periods begun, as planned. */
    volatile uint32_t statuses;                /* How often the board's own place in a sync period was planned, */
    uint32_t statuses_told;                    /* and its value when DRIVE_STATUS was sent last. */
    volatile uint8_t sync_blocks;              /* Blocks that have yet to begin before a master's SYNC may leave: the
                                                  sync wire's edge is then past. */
    volatile bool sync_due;                    /* They have begun: SYNC is to be sent. */
    volatile uint32_t sync_cycle;              /* The number of the cycle that it tells. */
} drive_t;

#endif
