/* board_slot.h: a board's slot in the rig: what its pins, converters and links are wired to. Internal to the rig.
 *
 * board_slot_init() makes the edge with which the board is created; from then on the board's outputs act on the slot's
 * coils, serial line and lists, and its converters read them. lockstep.c empties the lists between two steps.
 *
 * Pins (boards/pinout.md), with i the channel: bridge inputs PB13/PB14 and PB0/PB1, set-points DAC channel 1 + i,
 * current senses PA0 and PC4, coil thermistors PC1 and PC3; PC0 is the supply and PC2 the driver's thermistor; PB15
 * enables both bridges, their fault is one wire on PB12 and PA6; PA7 and PC6 are the sync wire's ends; the field is on
 * PA1 to PA3, serial is USART3.
 *
 * A pin that the board has let go of takes the level of its pull-down outside (the enable and the sync output have
 * one), else of the chip's pull, else either level, drawn from the rig's seed.
 *
 * During a step only the thread that runs the board touches its slot; others look at its coils as sensing.h says.
 */
#ifndef GOLDFIELD_BOARD_SLOT_H
#define GOLDFIELD_BOARD_SLOT_H

#include "boards/board_edge.h"
#include "rig/rig_board.h"
#include "rig/serial_line.h"
#include "world/sensing.h"

enum {
    BOARD_PIN_SYNC_IN = 38,
    BOARD_PIN_SYNC_OUT = 7,
    BOARD_PIN_ENABLE = 31,
    BOARD_PIN_FAULT = 28,
    BOARD_PIN_FAULT_TOO = 6,
    BOARD_SERIAL_PORT = 3
};

/* What the board asked of the CAN bus. */
typedef struct {
    bool abort; /* It takes back the mailbox's request; else it makes one. */
    unsigned mailbox;
    board_frame_t frame;
    int64_t time_ps;
} board_slot_request_t;

/* A thermistor as it was last looked at; 0 V: nobody has yet. */
typedef struct {
    double temperature_degC, volts;
} slot_thermistor_t;

typedef struct {
    unsigned number;       /* The board's. */
    board_status_t status; /* What its last step returned. */
    uint64_t seed;         /* The rig's. */
    int64_t lead_ps;       /* How far the board runs ahead of the rig's present. */
    board_edge_t edge;
    board_t *instance;
    const board_operations_t *operations;
    unsigned coils;                              /* How many coils it has, */
    unsigned first_coil;                         /* the number of the first among all of the rig, */
    coil_t *coil;                                /* and the first itself. */
    uint64_t sense_stream[RIG_COILS];            /* Noise of their current senses. */
    slot_thermistor_t thermistor[RIG_COILS + 1]; /* Those of the coils, then the driver's. */
    sensing_t sensing;
    bool senses;                          /* sensing is in use. */
    bool leads;                           /* Its sync output is on the wire. */
    bool sync_cut;                        /* Fault: its sync input is not connected. */
    bool can_cut;                         /* Fault: it is not on the bus. */
    bool coil_hot[RIG_COILS], driver_hot; /* Faults. */
    bool pull_downs_lost;                 /* Fault: the pull-downs outside are not there. */
    uint64_t levels, driven;              /* By pin: its level, and whether the board drives it. */
    uint64_t releases;                    /* Pins that were let go of so far. */
    serial_line_t serial;
    board_slot_request_t *requests; /* Requests not yet handed to the bus, in order of time. */
    size_t request_count, request_capacity;
    rig_pin_change_t *sync_changes; /* Changes of its sync output, not yet handed on. */
    size_t sync_count, sync_capacity;
    bool watch;                /* Keep the changes of its pins. */
    rig_pin_change_t *changes; /* Those that nobody has taken yet begin at change_first. */
    size_t change_first, change_count, change_capacity;
} board_slot_t;

/* Make a slot with its edge, and its coils; coil points to config->coils of them. The caller fills in what else the
 * slot has. */
void board_slot_init(board_slot_t *slot, unsigned number, uint64_t seed, const rig_board_config_t *config,
                     coil_t *coil);

/* Returns what the board does next if nothing comes from outside. */
board_ahead_t board_slot_ahead(const board_slot_t *slot);

/* The drivers' fault wire is low (active) or pulled up. */
void board_slot_driver_fault(board_slot_t *slot, bool active, int64_t time_ps);

/* The board has no power: its pins float. */
void board_slot_power_lost(board_slot_t *slot, int64_t time_ps);

/* Make or mend the fault of pull-downs that are not there. */
void board_slot_lose_pull_downs(board_slot_t *slot, bool lost, int64_t time_ps);

/* Free what the slot holds; the board and the coils are the caller's. */
void board_slot_free(board_slot_t *slot);

#endif
