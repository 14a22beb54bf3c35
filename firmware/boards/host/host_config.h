/* host_config.h: what makes one host board different from another. host_board_create() takes it, and host_board_flash()
 * its flash. */
#ifndef GOLDFIELD_HOST_CONFIG_H
#define GOLDFIELD_HOST_CONFIG_H

#include "hal/hal.h"

typedef struct {
    hal_role_t role;         /* Which application runs. */
    double crystal_ppm;      /* Error of this board's clock, whichever it is, within +-100,000; positive is fast. */
    hal_clock_t clock;       /* What hal_clock() tells; with HAL_CLOCK_SLOW the chip engine does not start. */
    double temperature_degc; /* Temperature of the processor, degC. */
    uint8_t unique_id[HAL_UNIQUE_ID_BYTES]; /* What hal_unique_id() tells. */
    uint64_t random_seed;                   /* hal_random() tells numbers that depend on it and on the unique id. */
    /* The page in flash (protocol/framing.md); erased flash is all 0xFF. */
    uint8_t parameter_page[HAL_PARAMETER_PAGE_BYTES];
} host_board_config_t;

/* Flash for what is saved (hal.h), in place of the board's own, which is erased and lost with the board. Each function
 * carries out what it is told in the memory of slot, or a part of it, or nothing; it returns false if the power is lost
 * meanwhile: the board then is dead, touches nothing any more, and says nothing. */
typedef struct {
    void *context;
    uint32_t *slot[HAL_FLASH_SLOTS]; /* HAL_FLASH_WORDS words each. */
    bool (*program)(void *context, uint32_t slot, uint32_t index, uint32_t value);
    bool (*erase)(void *context, uint32_t slot);
} host_flash_t;

/* Slots for images (hal.h), of which a board has none by itself. Functions as above. */
typedef struct {
    void *context;
    hal_images_t images;
    bool (*program)(void *context, uint32_t slot, uint32_t index, uint32_t value);
    bool (*erase)(void *context, uint32_t slot, uint32_t words);
} host_images_t;

/* What can be made to fail in a running board (host_board_fail). */
typedef enum {
    HOST_FAILURE_MAIN_HANGS = 0,    /* The main loop does nothing; after a reset the application starts, and hangs. */
    HOST_FAILURE_CURRENT_STOPS = 1, /* Coil currents are not converted any more. */
    HOST_FAILURE_NO_RANDOM = 2,     /* hal_random() has no number. */
    HOST_FAILURES = 3
} host_failure_t;

#endif
