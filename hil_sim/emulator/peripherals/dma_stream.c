/* dma_stream.c: how a stream moves items. Memory-to-memory transfers end as a whole, when their event comes, and do not
 * take part in the arbitration.
 */
#include "emulator/peripherals/dma.h"

#include <string.h>

void dma_disable(dma_stream_t *s) {
    chip_t *const chip = s->dma->model.chip;
    s->value[SCR / 4] &= ~EN;
    s->enabled = false;
    machine_cancel(chip->machine, &s->done);
    if (s->direction != MEMORY_TO_MEMORY && s->cell != NULL) {
        for (unsigned i = 0; i < 3; i++) {
            if (chip->lines.stream[s->cell->source[i]] == s) {
                chip->lines.stream[s->cell->source[i]] = NULL;
            }
        }
    }
}

void dma_bus_error(dma_stream_t *s, const char *what, uint32_t address) {
    machine_violation(s->dma->model.machine, "%s stream %u: bus error at the %s 0x%08X", dma_name(s), s->number, what,
                      (unsigned)address);
    dma_disable(s);
    dma_raise(s, TEIF);
}

static bool memory_access(dma_stream_t *s, bool write, unsigned width, uint32_t *value) {
    const uint32_t address = s->value[(s->memory_target ? SM1AR : SM0AR) / 4] + s->memory_offset;
    machine_t *const machine = s->dma->model.machine;
    if (address >> 24 == 0x10u || !(write ? machine_bus_write(machine, address, width, *value)
                                          : machine_bus_read(machine, address, width, value))) {
        dma_bus_error(s, address >> 24 == 0x10u ? "CCM, which no DMA reaches:" : "memory address", address);
        return false;
    }
    if (s->value[SCR / 4] & MINC) {
        s->memory_offset += width;
    }
    s->memory_left -= width;
    return true;
}

static bool peripheral_access(dma_stream_t *s, bool write, uint32_t *value) {
    const uint32_t address = s->value[SPAR / 4] + s->peripheral_offset;
    machine_t *const machine = s->dma->model.machine;
    if (!(write ? machine_bus_write(machine, address, s->psize, *value)
                : machine_bus_read(machine, address, s->psize, value))) {
        dma_bus_error(s, "peripheral address", address);
        return false;
    }
    s->peripheral_offset += s->peripheral_step;
    return true;
}

static void memory_wrap(dma_stream_t *s) {
    s->memory_offset = 0;
    s->memory_left = s->reload * s->psize;
    if (s->value[SCR / 4] & DBM) {
        s->memory_target = !s->memory_target;
    }
}

/* Memory to FIFO: as much as fits, in whole bursts. In direct mode the FIFO holds one item. */
void dma_fill(dma_stream_t *s) {
    const unsigned capacity = s->direct ? s->psize : 16u;
    while (s->enabled && s->fifo_count + s->burst <= capacity) {
        if (s->memory_left == 0) {
            if ((s->value[SCR / 4] & (CIRC | DBM)) == 0) {
                return;
            }
            memory_wrap(s);
        }
        for (unsigned done = 0; done < s->burst && s->memory_left != 0; done += s->msize) {
            uint32_t value = 0;
            if (!memory_access(s, false, s->msize, &value)) {
                return;
            }
            memcpy(s->fifo + s->fifo_count, &value, s->msize);
            s->fifo_count += s->msize;
        }
    }
}

void dma_drain(dma_stream_t *s) {
    unsigned at = 0;
    while (at < s->fifo_count && s->enabled) {
        uint32_t value = 0;
        const unsigned left = s->fifo_count - at,
                       width = left < s->msize ? s->psize
                                               : s->msize; /* The end of an odd block goes in smaller items. */
        memcpy(&value, s->fifo + at, width);
        if (!memory_access(s, true, width, &value)) {
            return;
        }
        at += width;
    }
    s->fifo_count = 0;
}

static void count(dma_stream_t *s, dma_source_t source) {
    uint32_t left = s->value[SNDTR / 4] - 1;
    s->value[SNDTR / 4] = left;
    if (left == s->reload / 2 && left != 0) {
        dma_raise(s, HTIF);
    }
    if (left != 0) {
        return;
    }
    s->peripheral_offset = 0;
    s->dma->model.chip->signals.last_transfer(s->dma->model.chip, source);
    if (s->value[SCR / 4] & (CIRC | DBM)) {
        s->value[SNDTR / 4] = s->reload;
        if (s->value[SCR / 4] & DBM) {
            s->value[SCR / 4] ^= CT;
        }
        if (s->direction == PERIPHERAL_TO_MEMORY) {
            memory_wrap(s);
        }
    } else {
        dma_disable(s);
    }
    dma_raise(s, TCIF);
}

void dma_transfer(dma_stream_t *s, dma_source_t source) {
    uint32_t value = 0;
    if (s->direction == PERIPHERAL_TO_MEMORY) {
        if (!peripheral_access(s, false, &value)) {
            return;
        }
        if (s->direct) {
            if (!memory_access(s, true, s->psize, &value)) {
                return;
            }
        } else {
            memcpy(s->fifo + s->fifo_count, &value, s->psize);
            s->fifo_count += s->psize;
            if (s->fifo_count >= s->threshold || s->value[SNDTR / 4] == 1) {
                dma_drain(s);
            }
        }
    } else {
        memcpy(&value, s->fifo, s->psize);
        if (s->fifo_count < s->psize || !peripheral_access(s, true, &value)) {
            return;
        }
        s->fifo_count -= s->psize;
        memmove(s->fifo, s->fifo + s->psize, s->fifo_count);
        if (s->direct || 16u - s->fifo_count >= s->threshold) {
            dma_fill(s);
        }
    }
    if (s->enabled) {
        count(s, source);
    }
}

static void copy_memory(void *context, int64_t time_ps) {
    dma_stream_t *const s = context;
    (void)time_ps;
    while (s->enabled) {
        uint32_t value = 0;
        if (!peripheral_access(s, false, &value)) {
            return;
        }
        memcpy(s->fifo + s->fifo_count, &value, s->psize);
        s->fifo_count += s->psize;
        if (s->fifo_count >= s->threshold || s->value[SNDTR / 4] == 1) {
            dma_drain(s);
        }
        if (s->enabled) {
            count(s, DMA_NONE);
        }
    }
}

void dma_stream_init(dma_stream_t *s) {
    machine_event_init(&s->done, copy_memory, s);
}
