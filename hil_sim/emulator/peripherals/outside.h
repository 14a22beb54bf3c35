/* outside.h: signals from outside of the chip, as they reach its peripherals at their time (inputs.h brings them).
 *
 * Pins are numbered as in board_edge.h; times are picoseconds and never before the machine's present.
 */
#ifndef GOLDFIELD_OUTSIDE_H
#define GOLDFIELD_OUTSIDE_H

#include "emulator/machine.h"

/* gpio.c: the pin is driven to a level. A pin that does not exist is a violation. */
void gpio_pin_in(machine_t *machine, unsigned pin, bool level, int64_t time_ps);

/* usart.c: the stop bit of a byte, sent at a bit rate of baud, ended. */
void usart_byte_in(machine_t *machine, unsigned uart, uint8_t byte, uint32_t baud, int64_t time_ps);

/* can.c: the network of CAN1 has another bit rate from now on. */
void can_network_in(machine_t *machine, uint32_t bit_s);

/* can_receive.c: a frame on the network became valid. */
void can_frame_in(machine_t *machine, const board_frame_t *frame, int64_t time_ps);

/* can_transmit.c: the frame of a mailbox is through (ok), or failed. */
void can_frame_sent(machine_t *machine, unsigned mailbox, bool ok, int64_t time_ps);

/* can_transmit.c: a frame on the network was destroyed by a bit error, its own mailbox's or another node's
 * (BOARD_CAN_LISTENS), and the error flag's delimiter ended. */
void can_error_in(machine_t *machine, unsigned mailbox, int64_t time_ps);

/* rcc.c: the crystal stops, or oscillates again. */
void rcc_crystal_in(machine_t *machine, bool alive);

/* rng.c: the noise source of the random number generator sticks at one level, or is alive again. */
void rng_noise_in(machine_t *machine, bool alive);

/* watchdog.c: a debugger stops the core, or lets it go on; the watchdogs stand still meanwhile if DBGMCU says so, and
 * nothing else can (RM0090 38.16.4). */
void debug_halt_in(machine_t *machine, bool halted);

/* pwr.c: the supply has this voltage from now on. */
void pwr_supply_in(machine_t *machine, double volts);

/* flash_operation.c: cut the supply in a step of the flash, a program or an erase: in the step-th from now on (0: in
 * none), when a fraction of its time, 0 to 1, is over. What it leaves follows the id as well. The supply is back after
 * off_ps, or stays away (0). */
void flash_cut_in(machine_t *machine, uint64_t step, double fraction, uint64_t id, int64_t off_ps);

/* flash_operation.c: steps begun so far; nothing runs any more; the cells, of which each of the first
 * MACHINE_FLASH_SIZE bytes is what they read as, and each of as many more says which bits are weak. */
uint64_t flash_steps_out(const machine_t *machine);
void flash_end_in(machine_t *machine);
void flash_cells_out(machine_t *machine, uint8_t *bytes);
void flash_cells_in(machine_t *machine, const uint8_t *bytes);

#endif
