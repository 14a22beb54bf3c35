/* An image that asks the board for chips whose plan test_chip_engine.py knows, and notes in RAM what the board
 * reports. */

#include "boards/board.h"
#include "boards/stm32f405/stm32f405.h"

enum {
    SENSOR = 1,
    MASK_INTERRUPTS = 2,
    STALL = 4,
    LOSE_SAMPLES = 8,
    HANG_ONCE = 16,
    ANCHOR = 32,
    DISABLED = 64, /* The drive stays off. */
    RETRY = 128    /* The drive is enabled again whenever it went off. */
};                 /* First byte of the parameter page. */
enum {
    NOTHING,
    LONG_BLOCKS,      /* Every plan takes 300 us. */
    STOP_CURRENT,     /* From here on in block 10: the converters' trigger, */
    STOP_EDGES,       /* the stream of channel 0's edges, */
    STOP_EDGES_8,     /* that of channel 1's, */
    STOP_SET_POINTS,  /* that of the set-points, */
    STOP_CHIPS,       /* the chip timer stops, */
    HANG_CURRENT,     /* the current's handler hangs, */
    EXCHANGE_SAMPLES, /* the latest samples' axes are exchanged, behind the last burst of a block, */
    SOFTWARE_FAULT    /* the crystal is said to have stopped. */
};                    /* Second byte: what happens. */
#define SYNCS         64u
#define EXCHANGE_CHIP 495u /* The last of a block. */

struct {
    hal_t *hal;
    uint32_t mode;
    uint32_t planned, plan_out_of_order;
    uint32_t samples_right, samples_wrong, blocks_lost, samples_out_of_order, sampled;
    uint32_t currents_right, currents_wrong;
    uint32_t monitors_right, monitors_wrong;
    uint32_t enabled, refused, faults[3], fault_line;
    uint32_t temperature, happened, received;
    uint32_t ports[3][4]; /* MODER, PUPDR, AFRL, AFRH of GPIOA to GPIOC. */
    uint32_t syncs, sync_chip[SYNCS], sync_ticks[SYNCS];
    hal_counters_t counters;
    uint32_t edges_right, edges_wrong;
    uint32_t middles_right, middles_wrong;
} probe;

static void spin(uint32_t microseconds) {
    const uint64_t end = hal_microseconds(probe.hal) + microseconds;
    while (hal_microseconds(probe.hal) < end) {
    }
}

static uint32_t happens;

static void happen(void) {
    probe.happened = chip_now().chip;
    switch (happens) {
    case STOP_CURRENT:
        TIM4->CCER &= ~TIM_CCER_CC1E;
        break;
    case STOP_EDGES:
        DMA2->S[4].CR &= ~DMA_S0CR_EN;
        break;
    case STOP_EDGES_8:
        DMA2->S[1].CR &= ~DMA_S0CR_EN;
        break;
    case STOP_SET_POINTS:
        DMA1->S[5].CR &= ~DMA_S0CR_EN;
        break;
    case STOP_CHIPS:
        TIM1->CR1 = 0;
        break;
    case SOFTWARE_FAULT:
        bridge_trip(HAL_FAULT_CLOCK);
        break;
    default:
        break;
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
    if (happens == LONG_BLOCKS)
        spin(300);
    if (block == 10)
        happen();
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
    probe.happened = happens == HANG_CURRENT && chip == 300 ? chip : probe.happened;
    while (happens == HANG_CURRENT && chip == 300) {
    }
    hal_monitor_t monitor;
    hal_monitor(probe.hal, &monitor);
    const uint32_t base = chip % 3000u + 100u;
    if (monitor.coil[0] == base && monitor.coil[1] == base + 200u && monitor.supply == base + 400u &&
        monitor.driver == base + 600u)
        probe.monitors_right++;
    else
        probe.monitors_wrong++;
    const uint32_t expected = chip * 8u * 5u % 4000u + 50u;
    if (count[0] == expected && count[1] == expected + 20u)
        probe.currents_right++;
    else
        probe.currents_wrong++;
}

static void edge(void *context, uint32_t chip, const uint16_t count[HAL_CHANNELS]) {
    (void)context;
    const uint32_t expected = chip * 7u % 3000u + 300u;
    if (count[0] == expected && count[1] == expected + 30u)
        probe.edges_right++;
    else
        probe.edges_wrong++;
}

static void middle(void *context, uint32_t chip, const uint16_t count[HAL_CHANNELS]) {
    (void)context;
    hal_monitor_t monitor;
    hal_monitor(probe.hal, &monitor);
    const uint32_t expected = chip * 11u % 3000u + 200u, base = chip % 3000u + 107u;
    if (count[0] == expected && count[1] == expected + 40u && monitor.coil[0] == base &&
        monitor.coil[1] == base + 200u && monitor.supply == base + 400u && monitor.driver == base + 600u)
        probe.middles_right++;
    else
        probe.middles_wrong++;
}

static void sync(void *context, uint32_t chip, uint16_t ticks) {
    (void)context;
    if (probe.syncs < SYNCS) {
        probe.sync_chip[probe.syncs] = chip;
        probe.sync_ticks[probe.syncs] = ticks;
    }
    probe.syncs++;
}

static void fault(void *context, hal_fault_t cause) {
    (void)context;
    probe.faults[cause]++;
}

int main(void) {
    probe.hal = board_start();
    hal_links_start(probe.hal, 1000000u, HAL_SERIAL_BAUD);
    probe.mode = hal_parameter_page(probe.hal)[0];
    happens = hal_parameter_page(probe.hal)[1];
    const GPIO_registers *ports[3] = {GPIOA, GPIOB, GPIOC};
    for (unsigned i = 0; i < 3; i++) {
        probe.ports[i][0] = ports[i]->MODER;
        probe.ports[i][1] = ports[i]->PUPDR;
        probe.ports[i][2] = ports[i]->AFRL;
        probe.ports[i][3] = ports[i]->AFRH;
    }
    const hal_role_t role = (probe.mode & ANCHOR)   ? HAL_ROLE_ANCHOR
                            : (probe.mode & SENSOR) ? HAL_ROLE_SENSOR
                                                    : HAL_ROLE_BEACON;
    const hal_events_t events = {
        .plan = plan,
        .samples = hal_role_samples(role) ? samples : NULL,
        .current = hal_role_drives(role) ? current : NULL,
        .edge = role == HAL_ROLE_BEACON ? edge : NULL,
        .middle = hal_role_drives(role) ? middle : NULL,
        .fault = fault,
        .sync = sync,
    };
    hal_chips_start(probe.hal, role, &events);
    bool on = false;
    for (;;) {
        if (!(probe.mode & DISABLED) && hal_role_drives(role) && (!on || (probe.mode & RETRY))) {
            const bool was = (TIM1->BDTR & TIM_BDTR_MOE) != 0;
            if (!was && hal_drive_enable(probe.hal, true)) {
                on = true;
                probe.enabled++;
            } else if (!was) {
                probe.refused++;
            }
        }
        while (happens == EXCHANGE_SAMPLES && chip_now().chip == EXCHANGE_CHIP) {
            if (TIM1->CNT > 16300u) {
                uint16_t *last = board.samples[(EXCHANGE_CHIP / HAL_BLOCK_CHIPS) & 1u][HAL_BLOCK_CHIPS - 1u][7];
                const uint16_t x = last[0];
                last[0] = last[1];
                last[1] = last[2];
                last[2] = x;
                happens = NOTHING;
            }
        }
        uint8_t bytes[64];
        for (size_t count; (count = hal_serial_read(probe.hal, bytes, sizeof bytes)) > 0;)
            probe.received += (uint32_t)count;
        probe.fault_line = hal_drive_fault(probe.hal);
        if (probe.mode & MASK_INTERRUPTS) { /* Interrupts late by up to 40 us, most of the time. */
            __asm volatile("cpsid i" ::: "memory");
            spin(40);
            __asm volatile("cpsie i" ::: "memory");
        } else if (happens != EXCHANGE_SAMPLES) {
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
