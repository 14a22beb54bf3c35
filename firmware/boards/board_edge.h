/* board_edge.h: the edge of a board, as anything that stands in for hardware presents it: pins, volts, bytes and
 * frames, each with its time. The simulator wires it to coils, fields and links.
 *
 * Two things have this edge, and the simulator cannot tell them apart: the emulator (hil_sim/emulator: it runs the ARM
 * image) and the host board (firmware/boards/host: the same firmware compiled for this machine).
 *
 * Calls. The implementation makes a board from a board_edge_t. The simulator then calls run of board_operations_t
 * again and again, and between the calls pin_in, uart_in, can_in and can_sent for what comes from outside; the board
 * calls board_edge_t from inside run for what goes out.
 *
 * Units. Time is int64_t picoseconds of the one virtual time, since power-on of the rig. Pins are numbered port * 16 +
 * pin (PA0 = 0, PB0 = 16, ...); boards/pinout.md says which pin does what.
 */
#ifndef GOLDFIELD_BOARD_EDGE_H
#define GOLDFIELD_BOARD_EDGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    uint32_t id;     /* Identifier: 29 bits if extended, else 11. */
    bool extended;   /* The identifier is extended. */
    bool remote;     /* A remote frame, which has no data. */
    uint8_t length;  /* Bytes of data, 0..8. */
    uint8_t data[8]; /* The data; bytes beyond length mean nothing. */
} board_frame_t;

/* The pull inside the chip at a pin, some 40 kOhm. */
typedef enum { BOARD_PULL_NONE, BOARD_PULL_UP, BOARD_PULL_DOWN } board_pull_t;

/* What a board calls outside. All are called from inside the board's run function, with times that never decrease
 * within one board, except that analog_in times may lie a few microseconds ahead of the last pin_out (a scan
 * sequence). A call that is NULL is not connected. */
typedef struct {
    void *context;
    /* The output level of a pin changed (push-pull; a pin switched to output reports its level). */
    void (*pin_out)(void *context, unsigned pin, bool level, int64_t time_ps);
    /* The board lets go of a pin, or changes the pull of one that it does not drive. Which level the pin takes from now
     * on is the outside's to decide: its own pull if there is one (stronger than the chip's), else the chip's, else
     * either level. At power-on every pin is released without pull, and no call says so. */
    void (*pin_release)(void *context, unsigned pin, board_pull_t pull, int64_t time_ps);
    /* The output of DAC channel 1 or 2 changed, volts. */
    void (*analog_out)(void *context, unsigned channel, double volts, int64_t time_ps);
    /* Returns the volts on a pin at the moment when the converter's sample-and-hold opens. They need not be clamped,
     * since the converter clamps. */
    double (*analog_in)(void *context, unsigned pin, int64_t time_ps);
    /* A byte has left a serial port; time_ps is the end of its stop bit. uart is 1..6. */
    void (*uart_out)(void *context, unsigned uart, uint8_t byte, int64_t time_ps);
    /* A CAN frame was handed to mailbox (0..2) and wants the bus from time_ps on. The network answers with
     * board_can_sent(). */
    void (*can_request)(void *context, unsigned mailbox, const board_frame_t *frame, int64_t time_ps);
    /* The mailbox's request was withdrawn (abort). */
    void (*can_abort)(void *context, unsigned mailbox, int64_t time_ps);
} board_edge_t;

/* How the outside acts on a board. Each implementation offers this table. A time lies at or after the board's
 * present; earlier times act at once. */
typedef struct board board_t;
typedef enum { BOARD_OK = 0, BOARD_FAULT = 1 } board_status_t;
enum {
    BOARD_CAN_LISTENS = 3,    /* In place of a mailbox. */
    BOARD_CAN_BIT_S = 1000000 /* Bit rate of the CAN bus until can_rate() tells another. */
};

/* Both may be too early; INT64_MIN if nobody knows. */
typedef struct {
    int64_t due_ps;  /* Before then run does nothing but let the board's present go on. */
    int64_t asks_ps; /* Before then the board asks nothing of the CAN bus, and its sync output stays. */
} board_ahead_t;

typedef struct {
    /* Run up to (not including) until_ps. It is exact: run(10 ms) equals ten run(1 ms). Returns BOARD_FAULT if the
     * board stopped for good; report() then says why. */
    board_status_t (*run)(board_t *board, int64_t until_ps);
    /* Returns the board's present. */
    int64_t (*now)(const board_t *board);
    /* The level of a pin changes from outside. */
    void (*pin_in)(board_t *board, unsigned pin, bool level, int64_t time_ps);
    /* A byte whose stop bit ends at time_ps arrives, sent at baud (a mismatch beyond 3 % is a framing error). */
    void (*uart_in)(board_t *board, unsigned uart, uint8_t byte, uint32_t baud, int64_t time_ps);
    /* A frame of another node is valid for its receivers at time_ps: after the last but one bit of end of frame, one
     * bit time before its sender hears of it by can_sent (ISO 11898-1, frame validation). */
    void (*can_in)(board_t *board, const board_frame_t *frame, int64_t time_ps);
    /* The frame of the board's own mailbox has been transmitted at time_ps (ok: the end of end of frame), or has failed
     * for want of an acknowledging node. */
    void (*can_sent)(board_t *board, unsigned mailbox, bool ok, int64_t time_ps);
    /* A bit error destroyed a frame on the network, and the delimiter of the error flag ended at time_ps. mailbox is
     * the board's own that was sending, or BOARD_CAN_LISTENS. NULL: the board counts no errors; a frame of its own then
     * fails by can_sent. */
    void (*can_error)(board_t *board, unsigned mailbox, int64_t time_ps);
    /* The CAN bus has this bit rate from the board's present on. A board of another rate has no part in it. NULL: the
     * board has a part in any. */
    void (*can_rate)(board_t *board, uint32_t bit_s);
    /* Returns why the board stopped, or the violations so far; NUL-terminated, valid until the next call. */
    const char *(*report)(const board_t *board);
    /* Free the board; NULL does nothing. */
    void (*destroy)(board_t *board);
    /* Returns what the board does next if nothing comes from outside. The converters of a board that tells look at no
     * time beyond its present. NULL: nobody knows. */
    board_ahead_t (*ahead)(const board_t *board);
} board_operations_t;

#endif
