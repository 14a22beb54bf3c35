/*
 * Analog inputs of a board under test that are answered without Python, as most of them never change: a sample of one
 * that asks Python takes twenty times as long. The table is the context of the board's edge.
 */
#include "analog_pins.h"

double analog_pins_in(void *context, unsigned pin, int64_t time_ps) {
    const analog_pins_t *const pins = context;
    const analog_pin_t *const own = &pins->pin[pin];
    return time_ps < own->until_ps ? own->volts : pins->ask(pins, pin, time_ps);
}
