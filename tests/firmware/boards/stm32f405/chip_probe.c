/* An image that asks the board for chips whose plan test_chip_engine.py knows, and notes in RAM what the board
 * reports. */

#include "boards/board.h"
#include "boards/stm32f405/registers.h"

enum {
    SENSOR = 1,
    MASK_INTERRUPTS = 2,
    STALL = 4,
    LOSE_SAMPLES = 8,
    HANG_ONCE = 16,
    ANCHOR = 32
}; /* First byte of the parameter page. */
#define SYNCS 64u

struct {
    hal_t *hal;
    uint32_t mode;
    uint32_t planned, plan_out_of_order;
    uint32_t samples_right, samples_wrong, blocks_lost, samples_out_of_order, sampled;
    uint32_t currents_right, currents_wrong;
    uint32_t syncs, sync_chip[SYNCS], sync_ticks[SYNCS];
    hal_counters_t counters;
    uint32_t temperature;
} probe;

static void spin(uint32_t microseconds) {
    const uint64_t end = hal_microseconds(probe.hal) + microseconds;
    while (hal_microseconds(probe.hal) < end) {
    }
}

static void plan(void *context, uint32_t block, hal_plan_t *out) {
    (void)context;
    if (block != probe.planned++)
        probe.plan_out_of_order++;
    for (uint32_t i = 0; i < HAL_BLOCK_CHIPS; i++) {
        const uint32_t chip = block * HAL_BLOCK_CHIPS + i;
        out->period_ticks[i] = (uint16_t)((probe.mode & STALL) ? HAL_CHIP_TICKS : 16350u + chip * 37u % 131u);
        const uint32_t mixed = chip * 2654435761u;
        out->drive[i] = (uint8_t)((mixed >> 16) % 3u | (mixed >> 8 & 0xFFu) % 3u << HAL_DRIVE_BITS |
                                  (chip % 100u == 7u ? HAL_PLAN_SYNC_OUT : 0u));
        out->set_point[0][i] = (uint16_t)(chip * 29u % 4200u); /* Some beyond 4095. */
        out->set_point[1][i] = (uint16_t)(chip * 53u % 4096u);
    }
    if ((probe.mode & STALL) && block == 20)
        spin(4000);
    if ((probe.mode & LOSE_SAMPLES) && block == 10)
        DMA2->S[0].CR &= ~DMA_S0CR_EN;
}

static void samples(void *context, uint32_t block, const hal_samples_t *in) {
    (void)context;
    if (block != probe.sampled++)
        probe.samples_out_of_order++;
    uint32_t wrong = 0, zero = 0;
    for (uint32_t chip = 0; chip < HAL_BLOCK_CHIPS; chip++) {
        for (uint32_t i = 0; i < HAL_BURST; i++) {
            for (uint32_t axis = 0; axis < HAL_AXES; axis++) {
                const uint32_t value = (*in)[chip][i][axis];
                if (value == 0)
                    zero++;
                if (value != (((block * HAL_BLOCK_CHIPS + chip) * HAL_BURST + i) * 5u + axis * 1000u) % 4000u + 50u)
                    wrong++;
            }
        }
    }
    const uint32_t all = HAL_BLOCK_CHIPS * HAL_BURST * HAL_AXES;
    if (zero == all)
        probe.blocks_lost++;
    else {
        probe.samples_wrong += wrong;
        probe.samples_right += all - wrong;
    }
}

static void current(void *context, uint32_t chip, const uint16_t count[HAL_CHANNELS]) {
    (void)context;
    const uint32_t expected = chip * 8u * 5u % 4000u + 50u;
    if (count[0] == expected && count[1] == expected + 20u)
        probe.currents_right++;
    else
        probe.currents_wrong++;
}

static void sync(void *context, uint32_t chip, uint16_t ticks) {
    (void)context;
    if (probe.syncs < SYNCS) {
        probe.sync_chip[probe.syncs] = chip;
        probe.sync_ticks[probe.syncs] = ticks;
    }
    probe.syncs++;
}

static void fault(void *context, hal_fault_t fault_cause) {
    (void)fault_cause;
    (void)context;
}

int main(void) {
    probe.hal = board_start();
    probe.mode = hal_parameter_page(probe.hal)[0];
    const hal_role_t role = (probe.mode & ANCHOR)   ? HAL_ROLE_ANCHOR
                            : (probe.mode & SENSOR) ? HAL_ROLE_SENSOR
                                                    : HAL_ROLE_BEACON;
    const hal_events_t events = {
        .plan = plan,
        .samples = hal_role_samples(role) ? samples : NULL,
        .current = hal_role_drives(role) ? current : NULL,
        .fault = fault,
        .sync = sync,
    };
    hal_chips_start(probe.hal, role, &events);
    for (;;) {
        if (probe.mode & MASK_INTERRUPTS) { /* Interrupts late by up to 40 us, most of the time. */
            __asm volatile("cpsid i" ::: "memory");
            spin(40);
            __asm volatile("cpsie i" ::: "memory");
        } else {
            hal_wait(probe.hal);
        }
        hal_counters(probe.hal, &probe.counters);
        probe.temperature = (uint32_t)(int32_t)hal_temperature(probe.hal);
        if ((probe.mode & HANG_ONCE) && probe.counters.watchdog_resets == 0)
            for (;;) {
            }
        hal_watchdog_kick(probe.hal);
    }
}
