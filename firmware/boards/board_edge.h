/* board_edge.h: the edge of a board, as anything that stands in for hardware presents it: pins, volts, bytes and
 * frames, each with its time.
 *
 * Two things have this edge: the emulator (hil_sim/emulator: runs the ARM image) and the host board
 * (firmware/boards/host: the same firmware compiled for this machine). The simulator wires it to coils, fields and
 * links, and cannot tell the two apart.
 *
 * Time is int64_t picoseconds of the one virtual time, since power-on of the rig. Pins are numbered port * 16 + pin
 * (PA0 = 0, PB0 = 16, ...). Which pin does what: boards/pinout.md.
 */
#ifndef GOLDFIELD_BOARD_EDGE_H
#define GOLDFIELD_BOARD_EDGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    uint32_t id; /* 29-bit if extended, else 11-bit. */
    bool extended;
    bool remote;
    uint8_t length; /* 0..8 */
    uint8_t data[8];
} board_frame_t;

/* What a board calls outside. All are called from inside the board's run function, with times that never decrease
 * within one board, except that analog_in times may lie a few microseconds ahead of the last pin_out (a scan
 * sequence). NULL: not connected. */
typedef struct {
    void *context;
    /* Output level of a pin changed (push-pull; a pin switched to output reports its level). */
    void (*pin_out)(void *context, unsigned pin, bool level, int64_t time_ps);
    /* DAC channel (1, 2) changed, volts. */
    void (*analog_out)(void *context, unsigned channel, double volts, int64_t time_ps);
    /* Volts on a pin at the moment the converter's sample-and-hold opens. Not clamped: the converter clamps. */
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

typedef struct {
    /* Run up to (not including) until_ps. BOARD_FAULT: the board stopped for good, report() says why. Exact: run(10
     * ms) equals ten run(1 ms). */
    board_status_t (*run)(board_t *board, int64_t until_ps);
    int64_t (*now)(const board_t *board);
    void (*pin_in)(board_t *board, unsigned pin, bool level, int64_t time_ps);
    /* A byte whose stop bit ends at time_ps arrives, sent at baud (a mismatch beyond 3 % is a framing error). */
    void (*uart_in)(board_t *board, unsigned uart, uint8_t byte, uint32_t baud, int64_t time_ps);
    /* A frame of another node is valid for its receivers at time_ps: after the last but one bit of end of frame, one
     * bit time before its sender hears of it by can_sent (ISO 11898-1, frame validation). */
    void (*can_in)(board_t *board, const board_frame_t *frame, int64_t time_ps);
    /* The board's own mailbox: at time_ps its frame is transmitted (ok: the end of end of frame), or failed for want
     * of an acknowledging node. */
    void (*can_sent)(board_t *board, unsigned mailbox, bool ok, int64_t time_ps);
    /* Why the board stopped, or the violations so far; NUL-terminated, valid until the next call. */
    const char *(*report)(const board_t *board);
    void (*destroy)(board_t *board);
} board_operations_t;

#endif
