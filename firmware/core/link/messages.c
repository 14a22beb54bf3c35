#include "core/link/messages.h"

#include "message_table.h"
#include "protocol_hash.h"

uint32_t message_index(uint32_t id) {
    return id >> PROTOCOL_INDEX_SHIFT & 0xFFFu;
}

message_fault_t message_fault(uint32_t id, uint8_t length) {
    const message_shape_t shape = message_table[id >> PROTOCOL_TYPE_SHIFT & 31u];
    const uint32_t index = message_index(id);
    if (!shape.known || index > shape.largest_index) {
        return MESSAGE_FOREIGN;
    }
    return length == shape.length ? MESSAGE_OK : MESSAGE_WRONG_LENGTH;
}
