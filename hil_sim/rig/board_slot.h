/* board_slot.h: a board's place in the rig: what its pins, converters and links are wired to. Internal to the rig
 * (lockstep.h).
 *
 * Pins (boards/pinout.md), with i the channel: bridge inputs PC6/PC7 and PC4/PC5, set-points DAC channel 1 + i, current
 * senses PA0 and PA6; PC9 enables both bridges, PC10 is their fault; PC8 and PA10 are the sync wire's ends; the field
 * is on PA1 to PA3.
 *
 * During a step only the thread that runs the board touches its slot; others look at its coils as sensing.h says.
 */
#ifndef GOLDFIELD_BOARD_SLOT_H
#define GOLDFIELD_BOARD_SLOT_H

#include "rig/lockstep.h"
#include "rig/serial_line.h"
#include "world/sensing.h"

enum { SEAT_PIN_SYNC_IN = 10, SEAT_PIN_SYNC_OUT = 40, SEAT_PIN_ENABLE = 41, SEAT_PIN_FAULT = 42, SEAT_SERIAL_PORT = 1 };

/* What the board asked of the CAN bus. */
typedef struct {
    bool abort;
    unsigned mailbox;
    board_frame_t frame;
    int64_t time_ps;
} board_slot_wish_t;

typedef struct {
    unsigned number; /* Of the board. */
    uint64_t seed;
    int64_t lead_ps; /* How far it runs ahead of the rig's present. */
    board_edge_t edge;
    board_t *instance;
    const board_operations_t *operations;
    board_status_t status;
    unsigned coils;
    coil_t *coil; /* The first of its coils. */
    bool senses;
    sensing_t sensing; /* If it does. */
    bool sync_cut;
    serial_line_t serial;
    board_slot_wish_t *wishes;
    size_t wish_count, wish_capacity;
    rig_pin_change_t *sync_changes; /* Of the sync output, not yet handed on. */
    size_t sync_count, sync_capacity;
    bool watch;
    rig_pin_change_t *changes; /* Watched pins. */
    size_t change_first, change_count, change_capacity;
} board_slot_t;

/* A slot with its edge and coils; coil points to config.coils of them. The caller fills what else it has. */
void board_slot_init(board_slot_t *slot, unsigned number, uint64_t seed, const rig_board_config_t *config,
                     coil_t *coil);
void board_slot_free(board_slot_t *slot);

#endif
