/* config.h: what makes one board different from another of its kind. */
#ifndef GOLDFIELD_EMULATOR_CONFIG_H
#define GOLDFIELD_EMULATOR_CONFIG_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    double crystal_ppm;       /* Error of this board's 12 MHz crystal, parts in a million. */
    double internal_ppm;      /* Error of its 16 MHz internal oscillator, the same (10,000 is 1 %). */
    double crystal_ppm_per_K; /* What its error grows by with the temperature, */
    double crystal_ppm_per_s; /* and with time, from virtual time 0 on: ageing, and warming that is not modelled. */
    bool crystal_dead;        /* The crystal never starts. */
    uint8_t unique_id[12];    /* The chip's unique identification, as at 0x1FFF7A10. */
    double temperature_degc;  /* The temperature of die and crystal at virtual time 0; the internal sensor shows it. */
    double temperature_K_per_s; /* How fast it rises. */
    double dac_load_Ohm;        /* Resistance from each analog output to ground; 0: outputs are ideal (dac.c). */
    uint64_t memory_seed;       /* What the memories hold at power-on follows it, unique_id and the time; 0: zeros. */
                                /* So do random numbers (rng.c), with 0 as well. */
    uint32_t option_bytes;      /* As FLASH_OPTCR shows them; 0: as from the factory, 0x0FFFAAED. */
    uint16_t revision;          /* REV_ID of the silicon; 0 is taken as 0x1007. Revision A is 0x1000, Z 0x1001. */
    bool strict;        /* A violation (machine.h) stops the board with BOARD_FAULT; else it is only recorded. */
    bool stop_at_fault; /* So does a fault of the processor; else the board enters its handler. */
    double cycles_per_instruction; /* What each instruction takes, in steps of 1/256; 0 is taken as 1. */
    bool cycles_by_class;          /* Instead: costs by class of instruction, flash and buses counted (cycles.h). */
} emulator_config_t;

#endif
