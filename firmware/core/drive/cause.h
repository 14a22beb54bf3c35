/* cause.h: why a drive was switched off. The numbers are those of DRIVE_HEALTH.cause on the wire. */
#ifndef GOLDFIELD_CAUSE_H
#define GOLDFIELD_CAUSE_H

typedef enum {
    CAUSE_NONE = 0,
    CAUSE_OVER_CURRENT = 1, /* A coil's current was above the limit, whether its chip was driven or not. */
    CAUSE_OPEN_COIL = 2,    /* A coil's current stayed below a share of what was asked. */
    CAUSE_DRIVER = 3,       /* The drivers' fault input is active. */
    CAUSE_STALE = 4,        /* No current was measured for two chips while the bridge was on. */
    CAUSE_EXCESS = 5,       /* A current far above what was asked, or one that fell too fast: a coil or turns of it are
                               shorted, or a driver has run away. */
    CAUSE_OVERLOAD = 6,     /* The mean square of the current was above its limit (I2t). */
    CAUSE_COIL_HOT = 7,
    CAUSE_DRIVER_HOT = 8,
    CAUSE_SUPPLY_LOW = 9,
    CAUSE_SUPPLY_HIGH = 10,
    CAUSE_CLOCK = 11,   /* The crystal stopped. */
    CAUSE_WATCHDOG = 12 /* The watchdog had to reset the board too often while it drove, or the processor erred. */
} cause_t;

#endif
