/* dma.h: between dma.c and its request map. */
#ifndef GOLDFIELD_DMA_H
#define GOLDFIELD_DMA_H

#include "model.h"

typedef struct {
    dma_source_t source[3]; /* DMA_NONE where there is none. */
} dma_cell_t;

const dma_cell_t *dma_cell(unsigned controller, unsigned channel, unsigned stream);

#endif
