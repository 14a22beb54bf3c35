/* pose_report.h: a pose as the messages POSE_POSITION, POSE_ATTITUDE, POSE_QUALITY and POSE_INTEGRITY
 * (protocol/framing.md, "Poses of the sensor"). The call is pose_report, once for each pose.
 *
 * Contexts: main only. Time: about 1,700 instructions.
 */
#ifndef GOLDFIELD_POSE_REPORT_H
#define GOLDFIELD_POSE_REPORT_H

#include "core/pose/pose_result.h"
#include "services/node.h"

#define POSE_REPORT_MESSAGES 4u /* Messages of a pose. */
#define POSE_REPORT_CYCLE    0u /* Index of the pose of a whole cycle. */

/* Queue the messages of a pose on the given links. cycle is the number of its cycle; index is POSE_REPORT_CYCLE, or 1 +
 * the code chip at whose end the pose is. A failed pose has no position and no attitude. */
void pose_report(const pose_t *pose, uint32_t cycle, uint32_t index, node_t *node, node_links_t links);

#endif
