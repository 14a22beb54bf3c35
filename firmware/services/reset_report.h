/* reset_report.h: what a board tells of its last reset, as RESET_REPORT messages (protocol/framing.md, "Last reset").
 *
 * Calls: reset_report_pack for each item from 0 to RESET_REPORT_ITEMS - 1, in main; what it packs is then sent.
 */
#ifndef GOLDFIELD_RESET_REPORT_H
#define GOLDFIELD_RESET_REPORT_H

#include "hal/hal.h"

#define RESET_REPORT_ITEMS 16u /* Items of a whole report: 2, and 14 of a crash. */

/* Pack an item of a report, which is also the index of its message.
 * Returns the length of the message, or 0 if there is nothing to tell: the last run did not crash. */
uint8_t reset_report_pack(const hal_reset_t *reset, uint32_t item, uint8_t data[8]);

#endif
