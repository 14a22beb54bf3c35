/* upkeep.h: what all applications do in the same way: they load their parameters, say hello, take what arrives on both
 * links, send a heartbeat each NODE_HEARTBEAT_US, and feed the watchdog.
 *
 * Heartbeats. The first one leaves at the start, the second within a second, when the board's number tells (spread.h).
 *
 * Calls, in the order they are made (all of them from main)
 *   1. upkeep_start  once, before anything else is started.
 *   2. upkeep_step   once a turn of the main loop.
 *
 * Identity. The board's number is the parameter node that is saved, or of the parameter page. If there is none, it is
 * 1 + CRC-16/CCITT-FALSE(unique id, 12 bytes) mod 4095: the same after each reset. Two of eight unconfigured boards
 * have one number in 0.7 % of cases, which the host sees by their unique ids.
 *
 * Armed. A board starts armed if what it has stored, page or saved set, holds an amplitude and does not say armed = 0:
 * what was flashed or saved with a current goes on with it. A board without an amplitude starts unarmed: a current that
 * it is given later, set or copied from another board, waits for a start (requests.h).
 *
 * Received messages, from either link. SYNC is kept for the application, and whether a DRIVE_STATUS told that its
 * sender is in step; messages of motion of other boards are counted (bus_share.h), requests go to requests.h. All
 * others are ignored. A frame that is no message by its index or its length (messages.h) is ignored and counted,
 * whatever type it has (COUNTER_FOREIGN_FRAMES, COUNTER_WRONG_LENGTH).
 *
 * Time: upkeep_step with nothing to do takes about 150 instructions. It is bounded by UPKEEP_BYTES_A_STEP received
 * bytes, UPKEEP_FRAMES_A_STEP frames, and what the queues hold. Memory: what node.h holds for it.
 */
#ifndef GOLDFIELD_UPKEEP_H
#define GOLDFIELD_UPKEEP_H

#include "hal/hal.h"
#include "services/node.h"

#define UPKEEP_BYTES_A_STEP  1024u /* Most bytes received on serial in one upkeep_step. */
#define UPKEEP_FRAMES_A_STEP 64u   /* Most frames received on CAN in one upkeep_step. */

/* Load the parameters and say hello: a heartbeat leaves on serial by polling before anything else is touched, so that
 * even a crippled machine is heard; the same goes into the queue of CAN, and behind both what the board knows of its
 * last reset. The state is then NODE_STARTING. */
void upkeep_start(node_t *node, hal_t *hal, hal_role_t role);

/* Do one turn: take received messages, send heartbeat and counters if they are due, hand the queues to the board, and
 * feed the watchdog if everything moves (liveness.h). */
void upkeep_step(node_t *node);

#endif
