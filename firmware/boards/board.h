/* board.h: how an image gets its board.
 *
 * The board's start-up code (vector table, .data, .bss, core memory) calls main(); main (firmware/images/beacon.c,
 * sensor.c, anchor.c: one image each) calls board_start() first, and then owns the processor: it never returns.
 *
 * A board that lives in memory (boards/host) does not have this function: it creates as many boards as one likes and
 * calls the applications itself.
 */
#ifndef GOLDFIELD_BOARD_H
#define GOLDFIELD_BOARD_H

#include "hal/hal.h"

/* For a static variable that begins as zeros and that only the processor touches, never DMA: it goes to the
 * core-coupled memory (STM32F405: 64 KB beside the 128 KB of RAM). */
#define BOARD_CORE_MEMORY __attribute__((section(".bss.core_memory")))

/* Set up clocks, pins, links, watchdog and converters; returns the one board of this chip. Call once, first of all
 * in main(). Always returns, also on a crippled machine: every wait for hardware has a time-out, and hal_clock()
 * tells what became of the clocks. hal_serial_write_polled() works afterwards, whatever else failed. The chip engine
 * stands still until hal_chips_start(); the coil drive is off. */
hal_t *board_start(void);

#endif
