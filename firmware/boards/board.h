/* board.h: how an image gets its board. The board's start-up code (vector table, .data, .bss, core memory) calls
 * main(); main (firmware/images/beacon.c, sensor.c, anchor.c: one image each) calls board_start() first, and then owns
 * the processor: it never returns.
 *
 * A board that lives in memory (boards/host) does not have this function: it creates as many boards as one likes and
 * calls the applications itself.
 */
#ifndef GOLDFIELD_BOARD_H
#define GOLDFIELD_BOARD_H

#include "hal/hal.h"

/* Places a static variable that begins as zeros and that only the processor touches, never DMA, in the core-coupled
 * memory (STM32F405: 64 KB beside the 128 KB of RAM). */
#define BOARD_CORE_MEMORY __attribute__((section(".bss.core_memory")))

/* Set up clocks, pins and watchdog. It is called once, first of all in main(), and always returns, also on a
 * crippled machine: every wait for hardware has a time-out, and hal_clock() tells what became of the clocks.
 * hal_serial_write_polled() works afterwards, whatever else failed: at HAL_SERIAL_BAUD until hal_links_start(), for a
 * crash. The chip engine stands still until
 * hal_chips_start(), which also sets up the converters; the coil drive is off.
 * Returns the one board of this chip. */
hal_t *board_start(void);

#endif
