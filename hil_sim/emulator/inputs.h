/* inputs.h: signals from outside of the chip, as board_operations_t offers them.
 *
 * Each waits in the machine's event heap for its time; one that is not in the future acts at once. A board_t here is a
 * machine_t, with or without a processor.
 */
#ifndef GOLDFIELD_INPUTS_H
#define GOLDFIELD_INPUTS_H

#include "emulator/machine.h"

void inputs_pin(board_t *board, unsigned pin, bool level, int64_t time_ps);
void inputs_uart(board_t *board, unsigned uart, uint8_t byte, uint32_t baud, int64_t time_ps);
void inputs_can(board_t *board, const board_frame_t *frame, int64_t time_ps);
/* The bit rate of the network, from now on. */
void inputs_can_rate(board_t *board, uint32_t bit_s);
void inputs_can_sent(board_t *board, unsigned mailbox, bool ok, int64_t time_ps);

void inputs_can_error(board_t *board, unsigned mailbox, int64_t time_ps);
/* The crystal stops, or oscillates again. */
void inputs_crystal(board_t *board, bool alive, int64_t time_ps);
/* The noise source of the random number generator sticks at one level, or is alive again. */
void inputs_noise(board_t *board, bool alive, int64_t time_ps);
/* The chip's supply (VDD, VDDA) has this voltage from a time on; 3.3 V from power-on. */
void inputs_supply(board_t *board, double volts, int64_t time_ps);

/* A debugger stops the core, or lets it go on. */
void inputs_halt(board_t *board, bool halted, int64_t time_ps);

/* Free the signals of a machine that is about to be destroyed, those that wait included. */
void inputs_destroy(machine_t *machine);

#endif
