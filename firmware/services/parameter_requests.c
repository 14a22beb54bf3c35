#include "services/parameter_requests.h"

#include <string.h>

#include "core/link/messages.h"
#include "goldfield.h"
#include "protocol_hash.h"
#include "services/access.h"

#define TEXT_CHARACTERS 7u /* Characters in one PARAM_TEXT. */

static void answer_parameter(node_t *node, node_links_t link, uint32_t index, parameter_status_t status) {
    parameter_value_t value;
    (void)parameters_get(&node->parameters, index, &value);
    if (access_secret(index)) {
        value.bits = access_keyed(&node->access);
    }
    struct goldfield_param_value_t answer = {
        .kind = value.kind, .status = (uint8_t)status, .value_unsigned = value.bits};
    /* The packer takes the member that belongs to the kind. */
    memcpy(&answer.value_signed, &value.bits, sizeof value.bits);
    memcpy(&answer.value_float, &value.bits, sizeof value.bits);
    uint8_t data[8];
    const uint8_t length = (uint8_t)goldfield_param_value_pack(data, &answer, sizeof data);
    node_send(node, link, GOLDFIELD_PARAM_VALUE_FRAME_ID, index, data, length);
}

void parameter_requests_set(node_t *node, node_links_t link, uint32_t index, const frame_t *frame) {
    struct goldfield_param_set_t set = {0};
    (void)goldfield_param_set_unpack(&set, frame->data, frame->length); /* The length has been seen to. */
    parameter_value_t value = {.kind = set.kind, .bits = set.value_unsigned};
    if (set.kind == PARAMETER_SIGNED) {
        memcpy(&value.bits, &set.value_signed, sizeof value.bits);
    } else if (set.kind == PARAMETER_FLOAT) {
        memcpy(&value.bits, &set.value_float, sizeof value.bits);
    }
    parameter_status_t status = PARAMETER_LOCKED;
    if (access_granted(&node->access, node_link_index(link))) {
        /* Asked twice: one instruction that goes wrong does not unlock the board, nor change another parameter. */
        if (access_granted(&node->access, node_link_index(link)) && index == message_index(frame->id)) {
            status = parameters_set(&node->parameters, index, value);
        }
    }
    answer_parameter(node, link, index, status);
    if (status == PARAMETER_OK) {
        if (access_secret(index)) {
            access_rekeyed(&node->access, node_link_index(link));
        }
        node->parameters_changed = true;
        node->id = (uint16_t)parameters_unsigned(&node->parameters, PARAMETER_NODE);
    }
}

void parameter_requests_get(node_t *node, node_links_t link, uint32_t index) {
    parameter_value_t value;
    answer_parameter(node, link, index, parameters_get(&node->parameters, index, &value));
}

/* Returns seven characters of a text as a message, zeros behind its end; the first character is the lowest byte. */
static struct goldfield_param_text_t text_part(const char *text, uint32_t length, uint32_t part) {
    const uint32_t begin = part * TEXT_CHARACTERS, left = length - begin;
    uint8_t characters[8] = {0};
    memcpy(characters, text + begin, left < TEXT_CHARACTERS ? left : TEXT_CHARACTERS);
    struct goldfield_param_text_t message = {.part = (uint8_t)part, .last = left <= TEXT_CHARACTERS};
    memcpy(&message.characters_0_to_3, characters, sizeof message.characters_0_to_3);
    memcpy(&message.characters_4_to_6, characters + 4, 4);
    return message;
}

void parameter_requests_describe(node_t *node, node_links_t link, uint32_t index) {
    uint8_t data[8];
    const parameter_entry_t *entry = parameters_next(index, node->role);
    if (entry == NULL) {
        const struct goldfield_param_description_t none = {.kind = GOLDFIELD_PARAM_DESCRIPTION_KIND_NONE_CHOICE};
        (void)goldfield_param_description_pack(data, &none, sizeof data);
        node_send(node, link, GOLDFIELD_PARAM_DESCRIPTION_FRAME_ID, index, data, sizeof data);
        return;
    }
    const struct goldfield_param_description_t description = {
        .kind = entry->kind,
        .at_start = entry->at_start,
        .stride = entry->stride,
        .elements = entry->elements,
        .rows = entry->rows,
        .excluded = entry->excluded,
        .value_default = entry->initial,
    };
    (void)goldfield_param_description_pack(data, &description, sizeof data);
    node_send(node, link, GOLDFIELD_PARAM_DESCRIPTION_FRAME_ID, entry->first_id, data, sizeof data);
    const struct goldfield_param_range_t range = {.minimum = entry->minimum, .maximum = entry->maximum};
    (void)goldfield_param_range_pack(data, &range, sizeof data);
    node_send(node, link, GOLDFIELD_PARAM_RANGE_FRAME_ID, entry->first_id, data, sizeof data);
    const uint32_t length = (uint32_t)strlen(entry->text);
    for (uint32_t part = 0; part * TEXT_CHARACTERS < length; part++) {
        const struct goldfield_param_text_t text = text_part(entry->text, length, part);
        (void)goldfield_param_text_pack(data, &text, sizeof data);
        node_send(node, link, GOLDFIELD_PARAM_TEXT_FRAME_ID, entry->first_id, data, sizeof data);
    }
}
