/* parameter_requests.h: the messages by which a host reads, sets and describes the parameters of a board. requests.h
 * takes them, and calls this module from main.
 *
 * PARAM_SET and PARAM_GET are answered by PARAM_VALUE on the link they came from, with the value that is in force then;
 * a new node number acts after its answer. A board with a key sets nothing for who has not unlocked it on that link,
 * and tells of the key itself only whether it has one. PARAM_DESCRIBE is answered by the description of the first
 * parameter from the index on that this role uses, at most 8 messages (framing.md, "Descriptions").
 */
#ifndef GOLDFIELD_PARAMETER_REQUESTS_H
#define GOLDFIELD_PARAMETER_REQUESTS_H

#include <stdint.h>

#include "core/link/frame.h"
#include "services/node.h"

/* Set the parameter that a PARAM_SET means, and answer. */
void parameter_requests_set(node_t *node, node_links_t link, uint32_t index, const frame_t *frame);

/* Answer a PARAM_GET. */
void parameter_requests_get(node_t *node, node_links_t link, uint32_t index);

/* Answer a PARAM_DESCRIBE. */
void parameter_requests_describe(node_t *node, node_links_t link, uint32_t index);

#endif
