/* host_board.h: a goldfield board in this machine's memory. The applications of firmware/apps, unchanged, run behind
 * firmware/hal/hal.h, and the outside sees the same edge as that of the emulator: pins of boards/pinout.md, volts,
 * bytes and frames, each with its time.
 *
 * Calls: host_board_create makes a board, host_board_flash may give it flash that outlives it, host_board_operations
 * runs it (board_edge.h) and destroys it.
 *
 * What it keeps of the hardware: the local clock with its error in ppm (every edge lies on one of its 168 MHz ticks),
 * chips with planned periods, pins and set-points that change exactly at chip starts, eight conversions a chip on each
 * axis with the spacing of a converter clocked at 21 MHz, one conversion of both coil currents a chip, 12 bits with
 * clamping, byte times at 2 Mbaud, three CAN mailboxes that leave in order, sync capture in ticks, time stamps of
 * frames in ticks.
 *
 * What it does not keep: instructions take no time. Handlers and the main loop's iteration run at the instant of their
 * event, and so do words that are programmed and slots that are erased. So there are no late blocks and converter
 * overruns here, and hal_wait() and board_start() do not exist (the main loop is run from outside). What a board cannot
 * do to itself, host_board_fail() does to it.
 *
 * Contexts: boards share nothing. Each may run in its own thread, one board in one thread at a time. Memory: one
 * allocation a board of 212 KiB, and one for the inputs that wait for their time, which grows with them.
 */
#ifndef GOLDFIELD_HOST_BOARD_H
#define GOLDFIELD_HOST_BOARD_H

#include "boards/board_edge.h"
#include "boards/host/host_config.h"

/* Make a board that gets power at power_on_ps; its application starts at that moment. config and edge are copied;
 * edge->context must outlive the board. Returns NULL if there is no memory or crystal_ppm is out of range. */
board_t *host_board_create(const host_board_config_t *config, const board_edge_t *edge, int64_t power_on_ps);

/* Give a board its flash, before it runs. *flash is copied, and what it points at must outlive the board. */
void host_board_flash(board_t *board, const host_flash_t *flash);

/* Give a board slots for images, before it runs, as host_board_flash() does. */
void host_board_images(board_t *board, const host_images_t *images);

/* Make something fail, or mend it, at the board's present. */
void host_board_fail(board_t *board, host_failure_t failure, bool active);

/* Let the crystal have another error from the board's present on, as warmth does.
 * Returns false if crystal_ppm is out of range. */
bool host_board_crystal(board_t *board, double crystal_ppm);

/* How the outside acts on the board. run() costs a few microseconds of this machine for a chip and always returns
 * BOARD_OK; report() is empty. A pin, a port or a mailbox that the board does not have is ignored. */
extern const board_operations_t host_board_operations;

#endif
