#include "rig/serial_line.h"

#include <stdlib.h>
#include <string.h>

#include "rig/array.h"

static void push(byte_queue_t *queue, const uint8_t *bytes, size_t count) {
    if (queue->first > 0 && queue->first + queue->count + count > queue->capacity) {
        memmove(queue->bytes, queue->bytes + queue->first, queue->count);
        queue->first = 0;
    }
    queue->bytes = array_reserve(queue->bytes, &queue->capacity, queue->first + queue->count + count, 1);
    memcpy(queue->bytes + queue->first + queue->count, bytes, count);
    queue->count += count;
}

static size_t pop(byte_queue_t *queue, uint8_t *bytes, size_t capacity) {
    const size_t count = queue->count < capacity ? queue->count : capacity;
    if (count > 0) {
        memcpy(bytes, queue->bytes + queue->first, count);
        queue->first += count;
        queue->count -= count;
    }
    if (queue->count == 0) {
        queue->first = 0;
    }
    return count;
}

void serial_line_init(serial_line_t *line, uint32_t baud) {
    *line = (serial_line_t){.byte_ps = INT64_C(10000000000000) / baud, .baud = baud};
}

void serial_line_free(serial_line_t *line) {
    free(line->from_board.bytes);
    free(line->to_board.bytes);
}

void serial_line_received(serial_line_t *line, uint8_t byte) {
    push(&line->from_board, &byte, 1);
}

size_t serial_line_read(serial_line_t *line, uint8_t *bytes, size_t capacity) {
    return pop(&line->from_board, bytes, capacity);
}

void serial_line_write(serial_line_t *line, const uint8_t *bytes, size_t count, int64_t time_ps) {
    if (count == 0) {
        return;
    }
    if (line->to_board.count == 0 && time_ps + line->byte_ps > line->next_ps) {
        line->next_ps = time_ps + line->byte_ps;
    }
    push(&line->to_board, bytes, count);
}

bool serial_line_next(serial_line_t *line, int64_t until_ps, uint8_t *byte, int64_t *end_ps) {
    if (line->to_board.count == 0 || line->next_ps >= until_ps) {
        return false;
    }
    (void)pop(&line->to_board, byte, 1);
    *end_ps = line->next_ps;
    line->next_ps += line->byte_ps;
    return true;
}

size_t serial_line_waiting(const serial_line_t *line) {
    return line->to_board.count;
}
