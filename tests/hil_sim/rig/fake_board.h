/* fake_board.h: the smallest board that has the edge of board_edge.h, to test the rig without firmware.
 *
 * Beacon: bridge on, set-point 10 A, chips from a small LFSR, the coil current sampled before each chip's end; the sync
 * output rises with every FAKE_CYCLE-th chip; one CAN frame a cycle. A beacon with periods drives both channels
 * instead: 10 A times cosine and sine of so many turns in FAKE_CYCLE chips, by set-points and bridge. Sensor: eight
 * conversions of three axes before each chip's end. A board that is both drives its coil and samples the field. All
 * keep their samples, and write on the serial port what they hear (bytes, sync edges, CAN frames, outcomes of their
 * own) as text with its time.
 */
#ifndef FAKE_BOARD_H
#define FAKE_BOARD_H

#include "boards/board_edge.h"

#define FAKE_CYCLE 31
#define FAKE_BURST 8

typedef struct {
    bool drives, senses; /* Beacon, sensor, or both. */
    bool still;          /* A beacon that keeps its bridge positive. */
    unsigned periods;    /* 0: one channel, chips. */
    double ppm;
    uint32_t can_id;
    int64_t stops_at_ps; /* 0: never. */
} fake_config_t;

typedef struct {
    int64_t time_ps;
    double volts[3]; /* Field x, y, z if it senses, else the currents' senses of channels 0 and 1. */
} fake_sample_t;

board_t *fake_create(const fake_config_t *config, const board_edge_t *edge, int64_t power_on_ps);
size_t fake_samples(const board_t *board, const fake_sample_t **samples);
extern const board_operations_t fake_operations;

#endif
