#include "services/reset_report.h"

#include <string.h>

#include "goldfield.h"

enum { ITEM_CAUSE = 0, ITEM_COUNTS = 1, ITEM_REGISTERS = 2 };

#define REGISTERS (RESET_REPORT_ITEMS - ITEM_REGISTERS)

_Static_assert(REGISTERS == 6u + HAL_CRASH_STACK, "each register and each word of the stack has an item");

static uint8_t count_of(const hal_reset_t *reset, hal_reset_cause_t cause) {
    const uint32_t count = reset->counts[cause];
    return count > UINT8_MAX ? UINT8_MAX : (uint8_t)count;
}

static void put_cause(const hal_reset_t *reset, struct goldfield_reset_report_t *report) {
    report->cause = (uint8_t)reset->cause;
    report->crashed = reset->crash.exception != 0;
    report->stack_overflow = reset->crash.stack_overflow;
    report->exception = (uint16_t)(reset->crash.exception & 0x1FFu);
    report->stalled = (uint8_t)(reset->stalled & 0x7Fu);
    report->uptime = reset->uptime_s;
}

static void put_counts(const hal_reset_t *reset, struct goldfield_reset_report_t *report) {
    report->resets_power_on = count_of(reset, HAL_RESET_POWER_ON);
    report->resets_brown_out = count_of(reset, HAL_RESET_BROWN_OUT);
    report->resets_pin = count_of(reset, HAL_RESET_PIN);
    report->resets_software = count_of(reset, HAL_RESET_SOFTWARE);
    report->resets_watchdog = count_of(reset, HAL_RESET_WATCHDOG);
    report->resets_window = count_of(reset, HAL_RESET_WINDOW);
    report->resets_low_power = count_of(reset, HAL_RESET_LOW_POWER);
}

/* The packer takes the member that belongs to the item; all of them have the same place in the message. */
static void put_register(const hal_crash_t *crash, uint32_t which, struct goldfield_reset_report_t *report) {
    uint32_t registers[REGISTERS] = {crash->pc, crash->lr, crash->sp, crash->cfsr, crash->hfsr, crash->address};
    memcpy(&registers[6], crash->stack, sizeof crash->stack);
    uint32_t *const members[REGISTERS] = {
        &report->pc,      &report->lr,      &report->sp,      &report->cfsr,    &report->hfsr,
        &report->address, &report->stack_0, &report->stack_1, &report->stack_2, &report->stack_3,
        &report->stack_4, &report->stack_5, &report->stack_6, &report->stack_7,
    };
    *members[which] = registers[which];
}

uint8_t reset_report_pack(const hal_reset_t *reset, uint32_t item, uint8_t data[8]) {
    struct goldfield_reset_report_t report = {.item = (uint8_t)item};
    if (item == ITEM_CAUSE) {
        put_cause(reset, &report);
    } else if (item == ITEM_COUNTS) {
        put_counts(reset, &report);
    } else if (item >= RESET_REPORT_ITEMS || reset->crash.exception == 0) {
        return 0;
    } else {
        put_register(&reset->crash, item - ITEM_REGISTERS, &report);
    }
    return (uint8_t)goldfield_reset_report_pack(data, &report, 8);
}
