/* adc.h: between the parts of the converters' model (RM0090 chapter 13; data sheet DS8626 5.3.21).
 *
 *     adc.c           registers, triggers
 *     adc_sampling.c  channels and pins, volts to codes, times of a conversion
 *     adc_group.c     regular and injected groups: what runs when
 *     adc_multi.c     which converters go together; the common data register
 *
 * One event per conversion; converters that go together share the first one's event. The analog value is asked for when
 * a conversion starts, with the time at which the sampling switch opens; the result is there when the conversion ends.
 */
#ifndef GOLDFIELD_ADC_H
#define GOLDFIELD_ADC_H

#include "emulator/peripherals/model.h"

enum {
    ADC_SR = 0x00,
    ADC_CR1 = 0x04,
    ADC_CR2 = 0x08,
    ADC_SMPR1 = 0x0C,
    ADC_SMPR2 = 0x10,
    ADC_JOFR1 = 0x14,
    ADC_HTR = 0x24,
    ADC_LTR = 0x28,
    ADC_SQR1 = 0x2C,
    ADC_SQR2 = 0x30,
    ADC_SQR3 = 0x34,
    ADC_JSQR = 0x38,
    ADC_JDR1 = 0x3C,
    ADC_DR = 0x4C
};
enum { ADC_CSR = 0x00, ADC_CCR = 0x04, ADC_CDR = 0x08 }; /* Common. */
/* ADC_SR */
#define AWD   1u
#define EOC   2u
#define JEOC  4u
#define JSTRT 8u
#define STRT  16u
#define OVR   32u
/* ADC_CR1 */
#define SCAN    0x100u
#define JAUTO   0x400u
#define DISCEN  0x800u
#define JDISCEN 0x1000u
/* ADC_CR2 */
#define ADON     1u
#define CONT     2u
#define DMA      0x100u
#define DDS      0x200u
#define EOCS     0x400u
#define JSWSTART (1u << 22)
#define SWSTART  (1u << 30)

typedef enum { IDLE, REGULAR, INJECTED } activity_t;

typedef struct {
    model_t model;
    unsigned number; /* 0: ADC1 */
    dma_source_t request;
    activity_t activity;
    /* Its regular sequence was interrupted by an injected one; among converters that go together the first one's flag
     * counts. */
    bool regular_waits;
    unsigned index, injected_index; /* Place in the sequence. */
    uint32_t result;                /* The running conversion's, 12 bits. */
    bool unread, no_more_requests, irq;
    int64_t stable_ps;
    machine_event_t done;
} unit_t;

struct adc {
    unit_t unit[3];
    model_t common;
    uint16_t queue[8]; /* Results that wait for the common data register. */
    unsigned queued;
    bool no_more_requests;
    bool order_lost; /* An overrun left a converter with a result that nobody fetched. */
};

static inline adc_t *adc_of(const unit_t *u) {
    return u->model.chip->adc;
}
static inline bool adc_scans(const unit_t *u) {
    return (reg(&u->model, ADC_CR1) & SCAN) != 0;
}
static inline unsigned adc_resolution(const unit_t *u) {
    return 12 - 2 * field(reg(&u->model, ADC_CR1), 24, 2);
}

/* adc.c */
void adc_interrupt(unit_t *u); /* SR or CR1 has changed. */

/* adc_sampling.c */
/* The channel at a place of a group's sequence, from 0. */
unsigned adc_channel(const unit_t *u, activity_t group, unsigned index);
/* How many conversions a group has. */
unsigned adc_length(const unit_t *u, activity_t group);
/* The pin behind a channel, numbered as in board_edge.h; ADC_NO_PIN if the channel is internal or not there. */
enum { ADC_NO_PIN = 255 };
unsigned adc_pin(const unit_t *u, unsigned channel);
/* Clocks that the sampling switch is closed for a channel; PCLK2 cycles per converter clock. */
unsigned adc_sampling(const unit_t *u, unsigned channel);
int64_t adc_divider(const unit_t *u);
/* The tick of PCLK2 at which a trigger's conversion begins: the first converter clock edge at or after time_ps, plus
 * latency converter clocks. */
int64_t adc_start_tick(const unit_t *u, int64_t time_ps, int64_t latency);
/* The code that a channel gives when its sampling switch opens. */
uint32_t adc_sample(unit_t *u, unsigned channel, int64_t opens_ps);
/* Whether it may convert now; a violation says what is wrong if not. */
bool adc_ready(unit_t *u, const char *what);

/* adc_group.c */
void adc_group_init(unit_t *u);
void adc_start_regular(unit_t *u, int64_t time_ps);
void adc_start_injected(unit_t *u, int64_t time_ps);
void adc_stop(unit_t *u);

/* adc_multi.c */
/* Whether this unit only follows ADC1 in this group. */
bool adc_follows(const unit_t *u, activity_t group);
/* The unit that leads this one's group, itself or ADC1, and how many go together, ADC1 first; 1: alone. */
unit_t *adc_leader(unit_t *u, activity_t group);
unsigned adc_members(const unit_t *leader, activity_t group);
static inline unit_t *adc_member(unit_t *leader, unsigned count, unsigned i) {
    return count == 1 ? leader : &adc_of(leader)->unit[i];
}
/* Whether its regular results go through the common data register. */
bool adc_by_common(const unit_t *u);
/* Keep a result for that register. Returns false if it is full: the result is lost. */
bool adc_common_keep(adc_t *adc, uint32_t result);
/* Ask for DMA after a regular conversion. Returns false if there was nobody to fetch the results. */
bool adc_common_request(adc_t *adc);
uint32_t adc_common_read(adc_t *adc);
void adc_common_forget(adc_t *adc);
/* A result of converters that go together was lost. */
void adc_common_overrun(adc_t *adc);
/* A conversion starts: if there was an overrun and the converters were not started over, the order of what DMA fetches
 * is shifted by up to two results, which is a violation. */
void adc_common_check_order(adc_t *adc);
/* DMA moved the last item that a request line asked for. */
void adc_last_transfer(chip_t *chip, dma_source_t source);

#endif
