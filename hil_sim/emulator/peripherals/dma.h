/* dma.h: between the parts of the DMA controllers' model (RM0090 chapter 10).
 *
 *     dma.c         registers, flags, what a stream may be set to
 *     dma_arbiter.c whose request a controller serves, and when
 *     dma_stream.c  how a stream moves items
 *     dma_map.c     which request lines reach which stream
 */
#ifndef GOLDFIELD_DMA_H
#define GOLDFIELD_DMA_H

#include "emulator/peripherals/model.h"

enum { LISR = 0x00, HISR = 0x04, LIFCR = 0x08, HIFCR = 0x0C, STREAM0 = 0x10, STREAM_SIZE = 0x18 };
enum { SCR = 0x00, SNDTR = 0x04, SPAR = 0x08, SM0AR = 0x0C, SM1AR = 0x10, SFCR = 0x14 }; /* A stream's. */
enum { FEIF = 1, DMEIF = 4, TEIF = 8, HTIF = 16, TCIF = 32 };
enum { PERIPHERAL_TO_MEMORY, MEMORY_TO_PERIPHERAL, MEMORY_TO_MEMORY };
/* SxCR */
#define EN     1u
#define CIRC   (1u << 8)
#define PINC   (1u << 9)
#define MINC   (1u << 10)
#define PINCOS (1u << 15)
#define DBM    (1u << 18)
#define CT     (1u << 19)

typedef struct {
    dma_source_t source[3]; /* DMA_NONE where there is none. */
} dma_cell_t;

typedef struct dma_stream {
    dma_t *dma;
    uint32_t *value;     /* The stream's six registers. */
    uint32_t programmed; /* What software last wrote to NDTR. */
    unsigned number, irq;
    bool enabled, line;
    const dma_cell_t *cell;
    /* Latched when EN is set. */
    unsigned direction, psize, msize; /* Sizes in bytes. */
    unsigned burst;                   /* Bytes of one memory burst. */
    bool direct;
    unsigned threshold;
    uint32_t reload, peripheral_step;
    int64_t item_ps; /* Time that the controller is busy with an item. */
    /* Moving. */
    uint32_t peripheral_offset, memory_offset, memory_left; /* Bytes. */
    bool memory_target;                                     /* Buffer that the memory side works on. */
    uint8_t fifo[16];
    unsigned fifo_count;
    unsigned turns; /* Items since its request last fell. */
    machine_event_t done;
} dma_stream_t;

struct dma {
    model_t model;
    unsigned number; /* 0: DMA1 */
    dma_stream_t stream[8];
    bool serving, asked; /* An item is being moved; it has brought about a request. */
    bool waiting;        /* Requests wait for the end of an item. */
    int64_t busy_until_ps;
    machine_event_t next;
};

/* dma.c */
const char *dma_name(const dma_stream_t *s); /* Its controller's name. */
void dma_raise(dma_stream_t *s, uint32_t flag);

/* dma_stream.c */
void dma_stream_init(dma_stream_t *s);
void dma_disable(dma_stream_t *s);
void dma_bus_error(dma_stream_t *s, const char *what,
                   uint32_t address); /* A transfer error: says so, stops the stream, raises TEIF. */
void dma_fill(dma_stream_t *s);
void dma_drain(dma_stream_t *s);                         /* FIFO to memory. */
void dma_transfer(dma_stream_t *s, dma_source_t source); /* Move an item. */

/* dma_arbiter.c */
void dma_arbiter_init(dma_t *dma);
void dma_arbiter_restart(dma_t *dma);
void dma_serve(chip_t *chip, dma_source_t source); /* A request came, or its stream was enabled. */
int64_t dma_item_time(const dma_stream_t *s);

/* dma_map.c */
const dma_cell_t *dma_cell(unsigned controller, unsigned channel, unsigned stream);

#endif
