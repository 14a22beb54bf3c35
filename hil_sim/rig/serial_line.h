/* serial_line.h: the far side of one board's serial port: what the board has sent and nobody has read yet, and what
 * waits to be sent to it.
 *
 * The board's side calls serial_line_received() for each byte that it sends and serial_line_next() for those that it
 * gets; the host's side calls serial_line_read() and serial_line_write().
 *
 * Bytes to the board follow each other back to back, ten bits each, from the moment of writing (or the end of what
 * waits). Times are picoseconds. Both queues grow as needed; nothing is lost here. Time of a call: in proportion to the
 * bytes.
 */
#ifndef GOLDFIELD_SERIAL_LINE_H
#define GOLDFIELD_SERIAL_LINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    uint8_t *bytes;
    size_t first, count, capacity;
} byte_queue_t;

typedef struct {
    byte_queue_t from_board, to_board;
    int64_t byte_ps; /* Length of a byte: ten bits. */
    int64_t next_ps; /* End of the stop bit of the first byte that waits. */
    uint32_t baud;   /* Bits per second. */
} serial_line_t;

/* Make an idle line with empty queues. */
void serial_line_init(serial_line_t *line, uint32_t baud);
void serial_line_free(serial_line_t *line);

/* The board has sent a byte. */
void serial_line_received(serial_line_t *line, uint8_t byte);

/* Take the oldest bytes that the board has sent, at most capacity of them. Returns how many. */
size_t serial_line_read(serial_line_t *line, uint8_t *bytes, size_t capacity);

/* Send bytes to the board from time_ps on, or behind what waits. */
void serial_line_write(serial_line_t *line, const uint8_t *bytes, size_t count, int64_t time_ps);

/* Take the next byte for the board if its stop bit ends before until_ps; *end_ps is when. Returns whether there is one.
 */
bool serial_line_next(serial_line_t *line, int64_t until_ps, uint8_t *byte, int64_t *end_ps);

/* Returns how many bytes wait to be sent to the board. */
size_t serial_line_waiting(const serial_line_t *line);

#endif
