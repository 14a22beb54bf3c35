/* rig_board.h: one board of the rig: its analog side as it is configured, and the changes of its pins as an observer
 * gets them. */
#ifndef GOLDFIELD_RIG_BOARD_H
#define GOLDFIELD_RIG_BOARD_H

#include "world/coil.h"
#include "world/front_end.h"

#define RIG_COILS 2 /* Most coils of a board: one for each channel of its drive. */

/* Coil i hangs on channel i. The coils of one board are crossed and do not couple. */
typedef struct {
    unsigned coils; /* How many there are, 0..RIG_COILS. */
    coil_config_t coil[RIG_COILS];
    bool senses; /* There is a front end on the board's field converters. */
    front_end_config_t front_end;
    bool leads; /* Its sync output is on the wire; the sync master's always is. */
} rig_board_config_t;

typedef struct {
    int64_t time_ps;
    uint16_t board;
    uint8_t pin; /* Numbered as in board_edge.h. */
    bool level;  /* Level after the change. */
} rig_pin_change_t;

#endif
