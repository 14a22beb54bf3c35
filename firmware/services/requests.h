/* requests.h: what a host asks of a board, and what the board answers: its parameters read, set and described, and the
 * commands.
 *
 * Calls, in the order they are made (all of them from main)
 *   1. requests_take             for each message that is not the application's own, from either link.
 *   2. requests_step             in each turn in which requests_due, before messages are taken: it goes on with what a
 *                                command has begun.
 *      requests_tell_last_reset  once behind the first heartbeat; a command asks for it again.
 *
 * Parameters. PARAM_SET, PARAM_GET and PARAM_DESCRIBE to this node or to node 0 go to parameter_requests.h.
 *
 * COMMAND lets the board tell its unique id or its last reset, blink with its LED, reset itself, clear what keeps its
 * drive off, save its parameters, start or stop, show its signature, take another number, or take a new image
 * (framing.md, "Commands" and "Updates").
 *
 * What all nodes are asked for, identity and last reset, a board tells after up to 64 ms, a time of its own: frames of
 * two boards with one number have the same identifier, and destroy each other on CAN when they begin together.
 *
 * Start and stop set the parameter armed, as a PARAM_SET does: a stop acts in the turn of the main loop in which it is
 * taken, as drive_configure switches the bridges off at once. A board without an amplitude refuses a start. While
 * node.signing is set the drive halves its current in every other cycle (drive.h), so that a sensor sees which board
 * is meant.
 *
 * Saving (storage.h). The bridges must be off, as the processor stands still for each word: a board that drives its
 * coil refuses, unless it is told that it may pause. drive_hold keeps the drive off from the moment that a save is
 * accepted until it is answered. A save for which a slot is erased ends with a reset, as the chip engine has lost its
 * step. requests_step goes on with a save only in a turn that began with it: the application has then told whether its
 * drive is on.
 *
 * Updates (update.h). COMMAND 10 to 15 and UPDATE_DATA bring a new image; the drive is held meanwhile, and until a new
 * image has confirmed itself. An update and a save exclude each other.
 *
 * Memory: what node.h holds for it.
 */
#ifndef GOLDFIELD_REQUESTS_H
#define GOLDFIELD_REQUESTS_H

#include "core/link/frame.h"
#include "services/node.h"

/* Answer a message that came on a link, if it is a request to this board: a message by its index and its length
 * (messages.h). All others are ignored. */
void requests_take(node_t *node, node_links_t link, const frame_t *frame);

/* Returns whether requests_step is to be called: a command is being carried out. It is inline for the idle turn of the
 * main loop. */
static inline bool requests_due(const node_t *node) {
    return node->under_way;
}

/* Go on with a save or an update, blink, and reset the board when it is time to. */
void requests_step(node_t *node);

/* Queue what the board knows of its last reset on the given links: a few RESET_REPORT, framing.md, "Last reset". */
void requests_tell_last_reset(node_t *node, node_links_t links);

#endif
