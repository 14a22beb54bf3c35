/*
 * What a board's analog inputs lie at (analog_pins.c, analog_pins.py).
 */
#ifndef ANALOG_PINS_H
#define ANALOG_PINS_H

#include <stdint.h>

enum { ANALOG_PINS = 64 };

typedef struct {
    double volts;
    int64_t until_ps; /* Before then the pin lies at volts; from then on, ask() is asked. */
} analog_pin_t;

typedef struct analog_pins {
    analog_pin_t pin[ANALOG_PINS];
    /* Returns the volts of a pin that is not known; it may write pin[] to be asked later. */
    double (*ask)(const struct analog_pins *pins, unsigned pin, int64_t time_ps);
} analog_pins_t;

/* Returns the volts on a pin: what board_edge_t.analog_in is set to. The context is an analog_pins_t. */
double analog_pins_in(void *context, unsigned pin, int64_t time_ps);

#endif
