/* can.h: between the parts of the bxCAN model (RM0090 chapter 32). CAN1 is on the network; CAN2's registers are there,
 * its pins lead nowhere.
 *
 *     can.c           registers, modes, bit timing, errors
 *     can_transmit.c  mailboxes
 *     can_receive.c   the frame that arrives, the FIFOs
 *     can_filter.c    acceptance filters
 */
#ifndef GOLDFIELD_CAN_H
#define GOLDFIELD_CAN_H

#include "emulator/peripherals/model.h"

enum {
    MCR = 0x00,
    MSR = 0x04,
    TSR = 0x08,
    RF0R = 0x0C,
    RF1R = 0x10,
    IER = 0x14,
    ESR = 0x18,
    BTR = 0x1C,
    TI0R = 0x180,
    RI0R = 0x1B0,
    FMR = 0x200,
    FM1R = 0x204,
    FS1R = 0x20C,
    FFA1R = 0x214,
    FA1R = 0x21C,
    F0R1 = 0x240
};
/* MCR */
#define INRQ         1u
#define SLEEP        2u
#define TXFP         4u
#define RFLM         8u
#define NART         0x10u
#define AWUM         0x20u
#define ABOM         0x40u
#define TTCM         0x80u
#define MASTER_RESET 0x8000u
/* MSR */
#define INAK  1u
#define SLAK  2u
#define ERRI  4u
#define WKUI  8u
#define SLAKI 0x10u
/* ESR */
#define BOFF 4u
/* BTR */
#define LBKM 0x40000000u
#define SILM 0x80000000u

typedef struct {
    can_t *can;
    unsigned number;
    bool pending, submitted;
    uint64_t order;
    machine_event_t retry;
} mailbox_t;

typedef struct {
    uint32_t word[4]; /* RIxR, RDTxR, RDLxR, RDHxR. */
} received_t;

struct can {
    model_t model;
    unsigned number;   /* 0: CAN1 */
    double network_hz; /* Bit rate of the network. */
    mailbox_t mailbox[3];
    received_t fifo[2][3];
    uint64_t orders;
    board_frame_t arriving;
    unsigned transmit_errors, receive_errors;
    bool bus_off;
    machine_event_t mode;    /* A change of mode is through. */
    machine_event_t recover; /* The end of bus-off, if the controller ends it by itself. */
    machine_event_t arrival; /* The frame in arriving is through. */
};

static inline uint32_t *can_value(can_t *c, uint32_t offset) {
    return &c->model.value[offset / 4];
}
static inline bool can_running(const can_t *c) {
    return c->model.clocked && !c->bus_off && (reg(&c->model, MSR) & (INAK | SLAK)) == 0;
}

/* can.c */
double can_bit_rate(const can_t *c, bool nominal); /* bit/s; nominal: with a perfect crystal. */
bool can_rate_fits(const can_t *c);                /* Whether this controller understands the network's bits. */
bool can_has_pin(const can_t *c, bool transmit);
void can_interrupts(can_t *c);            /* A flag or an enable has changed. */
void can_errors(can_t *c, unsigned code); /* Last error code, warning and passive flags, from the counters. */
/* Error counters (ISO 11898-1, 12.1.4.2). A missing acknowledge does not take an error-passive transmitter further; a
 * bit error does, and above 255 the controller is off the bus. */
void can_transmit_failed(can_t *c, bool acknowledge_missing);
void can_transmit_succeeded(can_t *c);
void can_receive_failed(can_t *c);
void can_receive_succeeded(can_t *c);

/* can_transmit.c */
void can_transmit_init(can_t *c);
void can_transmit_restart(can_t *c);
/* Hand over to the network whatever may go now. */
void can_submit(can_t *c, int64_t time_ps);
/* The controller went off the bus: what it asked for is withdrawn, and waits for its return. */
void can_leave_bus(can_t *c, int64_t time_ps);
void can_withdraw(can_t *c, unsigned mailbox, int64_t time_ps);
/* Says so if the network has a frame of these mailboxes: what is asked for (RM0090 32.7.1 ABRQ, 32.9.2 INRQ and SLEEP)
 * waits for the end of a frame that has begun. */
void can_check_idle(const can_t *c, const char *what, unsigned first, unsigned last);
void can_write_mailbox(can_t *c, uint32_t offset, uint32_t word);
uint32_t can_transmit_status(const can_t *c); /* TSR with CODE and LOW. */

/* can_receive.c */
void can_receive_init(can_t *c);
void can_receive_restart(can_t *c);
/* A frame that came in, from the network or looped back: through the filters into a FIFO. */
void can_accept(can_t *c, const board_frame_t *frame);
void can_release(can_t *c, unsigned fifo, uint32_t word); /* RFxR was written. */

#endif
