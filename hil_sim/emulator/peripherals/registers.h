/* registers.h: the register tables of the models, for the models and for the tests that compare them with ST's SVD. */
#ifndef GOLDFIELD_REGISTERS_H
#define GOLDFIELD_REGISTERS_H

#include "emulator/machine.h"

/* ACCESS_RC_W0: bits are cleared by writing 0; ones written to reserved bits are let pass, as `SR = ~FLAG` is ST's
 * own idiom. */
typedef enum { ACCESS_RW, ACCESS_RO, ACCESS_WO, ACCESS_RC_W0 } register_access_t;

typedef struct {
    const char *name;
    uint32_t offset;
    uint32_t reset;
    uint32_t bits; /* The defined bits, read-only ones included; the others are reserved. */
    register_access_t access;
} register_layout_t;

/* The register table of a model. Returns an array that lives as long as the program, its length in count; NULL if there
 * is no such peripheral. */
const register_layout_t *machine_register_table(const machine_t *machine, const char *name, unsigned *count);

#endif
