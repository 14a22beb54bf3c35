/* thermistor.h: what a thermistor's converter counts mean. It has 10 kOhm at 25 degC and B 3950, lies between pin and
 * ground, and has 10 kOhm to the converter's reference: fewer counts are warmer.
 *
 * Both functions go through one table with a step of 10 K and straight lines between, whose error is below 0.7 K.
 */
#ifndef GOLDFIELD_THERMISTOR_H
#define GOLDFIELD_THERMISTOR_H

#include <stdint.h>

#define THERMISTOR_MIN_DEGC (-40.0f) /* Colder is told as this: an open wire, too. */
#define THERMISTOR_MAX_DEGC 150.0f   /* Warmer is told as this: a short, too. */

/* Returns the temperature of a count, degC. */
float thermistor_degC(uint16_t count);

/* Returns the count of a temperature, which is limited to the range. */
uint16_t thermistor_count(float degC);

#endif
