/* config.h: what makes one board different from another of its kind. */
#ifndef GOLDFIELD_EMULATOR_CONFIG_H
#define GOLDFIELD_EMULATOR_CONFIG_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    double crystal_ppm;      /* Error of this board's 8 MHz crystal, parts in a million. */
    double internal_ppm;     /* Error of its 16 MHz internal oscillator, the same (10,000 is 1 %). */
    bool crystal_dead;       /* The crystal never starts. */
    uint8_t unique_id[12];   /* The chip's unique identification, as at 0x1FFF7A10. */
    double temperature_degc; /* The die's temperature, which the internal sensor shows. */
    bool strict;             /* A violation (machine.h) stops the board with BOARD_FAULT; else it is only recorded. */
    bool stop_at_fault;      /* So does a fault of the processor; else the board enters its handler. */
    double cycles_per_instruction; /* What each instruction takes, in steps of 1/256; 0 is taken as 1. */
    bool cycles_by_class;          /* Instead: costs by class of instruction, flash and buses counted (cycles.h). */
} emulator_config_t;

#endif
