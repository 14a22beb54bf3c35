#include "services/requests.h"

#include <string.h>

#include "core/link/messages.h"
#include "goldfield.h"
#include "protocol_hash.h"
#include "services/access.h"
#include "services/parameter_requests.h"
#include "services/reset_report.h"
#include "services/version.h"

/* Indices of COMMAND. */
enum {
    COMMAND_IDENTITY = 0,
    COMMAND_BLINK = 1,
    COMMAND_RESET = 2,
    COMMAND_CLEAR = 3,
    COMMAND_LAST_RESET = 4,
    COMMAND_SAVE = 5,
    COMMAND_START = 6,
    COMMAND_STOP = 7,
    COMMAND_SIGNATURE = 8,
    COMMAND_NUMBER = 9,
    COMMAND_CHALLENGE = 16,
    COMMAND_LOCK = 17
};
/* The commands that change something, a bit each: the board must be unlocked for them. A stop need not: it is safe. */
#define CHANGING                                                                                                       \
    (1u << COMMAND_RESET | 1u << COMMAND_CLEAR | 1u << COMMAND_SAVE | 1u << COMMAND_START | 1u << COMMAND_SIGNATURE |  \
     1u << COMMAND_NUMBER | 1u << UPDATE_BEGIN | 1u << UPDATE_BEGIN_FORCED | 1u << UPDATE_PAGE | 1u << UPDATE_END)
/* Indices of ACCESS. */
enum { ACCESS_FROM_BOARD = 0, ACCESS_TO_BOARD = 1 };
#define ALL_GROUPS   65535u /* The argument with which a start or a stop means the boards of all groups. */
#define NODE_LARGEST 4095u
#define VERSION      (VERSION_MAJOR << 16 | VERSION_MINOR << 8 | VERSION_PATCH) /* As parameter_set.h wants it. */

#define HALF_BYTES (HAL_UNIQUE_ID_BYTES / 2u)
#define BLINK_US   125000u /* Time for which the blinking LED is on, and then off. */
/* Time from the answer to the reset, at 1 Mbit/s: the answer is out by then, behind a full queue too. */
#define RESET_US     50000u
#define MICROSECONDS 1000000u
#define LATE_STEP_US 1000u /* More than the two frames of an identity take at 1 Mbit/s. */
#define LATE_SHIFT   58u   /* 64 such steps: one of 64 pairs of boards has the same, and another one next time. */

/* ---- Identity and last reset ---- */

/* Returns a half of the unique id, the first byte lowest. */
static uint64_t identity_half(const node_t *node, uint32_t which) {
    uint8_t unique[HAL_UNIQUE_ID_BYTES];
    hal_unique_id(node->hal, unique);
    uint64_t half = 0;
    for (uint32_t i = HALF_BYTES; i-- > 0;) {
        half = half << 8 | unique[which * HALF_BYTES + i];
    }
    return half;
}

static void tell_identity(node_t *node, node_links_t link) {
    const uint64_t halves[2] = {identity_half(node, 0), identity_half(node, 1)};
    for (uint32_t i = 0; i < 2; i++) {
        const struct goldfield_identity_t identity = {.half = halves[i], .tag = (uint16_t)(halves[0] ^ halves[1])};
        uint8_t data[8];
        (void)goldfield_identity_pack(data, &identity, sizeof data);
        node_send(node, link, GOLDFIELD_IDENTITY_FRAME_ID, i, data, sizeof data);
    }
}

void requests_tell_last_reset(node_t *node, node_links_t links) {
    const hal_reset_t *reset = hal_last_reset(node->hal);
    for (uint32_t item = 0; item < RESET_REPORT_ITEMS; item++) {
        uint8_t data[8];
        const uint8_t length = reset_report_pack(reset, item, data);
        if (length > 0) {
            node_send(node, links, GOLDFIELD_RESET_REPORT_FRAME_ID, item, data, length);
        }
    }
}

/* ---- Commands ---- */

static void answer_with(node_t *node, node_links_t link, uint32_t index, uint32_t status, uint32_t value) {
    const struct goldfield_command_answer_t answer = {.status = (uint8_t)status, .value = value};
    uint8_t data[8];
    const uint8_t length = (uint8_t)goldfield_command_answer_pack(data, &answer, sizeof data);
    node_send(node, link, GOLDFIELD_COMMAND_ANSWER_FRAME_ID, index, data, length);
}

static void answer_command(node_t *node, node_links_t link, uint32_t index, uint32_t status) {
    answer_with(node, link, index, status, 0);
}

/* Tells the result of a challenge that was asked for, or of an answer to it. */
static void answer_access(node_t *node, node_links_t link, access_result_t result) {
    static const uint8_t statuses[] = {
        [ACCESS_OPEN] = GOLDFIELD_COMMAND_ANSWER_STATUS_OK_CHOICE,
        [ACCESS_WRONG] = GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE,
        [ACCESS_LATE] = GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE,
        [ACCESS_WAIT] = GOLDFIELD_COMMAND_ANSWER_STATUS_WAIT_CHOICE,
        [ACCESS_NO_RANDOM] = GOLDFIELD_COMMAND_ANSWER_STATUS_NO_RANDOM_CHOICE,
    };
    if (result != ACCESS_NOTHING) {
        answer_command(node, link, COMMAND_CHALLENGE, statuses[result]);
    }
}

static void challenge(node_t *node, node_links_t link, bool named) {
    uint64_t number;
    const access_result_t result = named ? access_challenge(&node->access, node_link_index(link), &number)
                                         : ACCESS_WRONG;
    if (result != ACCESS_NUMBER) {
        answer_access(node, link, result);
        return;
    }
    const struct goldfield_access_t message = {.low = (uint32_t)number, .high = (uint32_t)(number >> 32)};
    uint8_t data[8];
    const uint8_t length = (uint8_t)goldfield_access_pack(data, &message, sizeof data);
    node_send(node, link, GOLDFIELD_ACCESS_FRAME_ID, ACCESS_FROM_BOARD, data, length);
}

static void take_access(node_t *node, node_links_t link, const frame_t *frame) {
    struct goldfield_access_t message = {0};
    (void)goldfield_access_unpack(&message, frame->data, frame->length); /* The length has been seen to. */
    const uint64_t answer = (uint64_t)message.high << 32 | message.low;
    const access_result_t result = access_answer(&node->access, node_link_index(link), answer);
    node->counters[COUNTER_WRONG_ANSWERS] = node_count(node->counters[COUNTER_WRONG_ANSWERS], result == ACCESS_WRONG);
    answer_access(node, link, result);
}

static void reset_soon(node_t *node) {
    node->resetting = node->under_way = true;
    node->reset_us = hal_microseconds(node->hal) + (uint64_t)RESET_US * node->slow;
}

/* Begins a save, which is answered at its end, once though it be asked for again meanwhile. */
static void begin_save(node_t *node, node_links_t link, bool named, bool may_pause) {
    if (node->saving != NODE_NO_LINK && named) {
        return;
    }
    if (!named || node->resetting || update_holds(&node->update) || !parameters_intact(&node->parameters)) {
        answer_command(node, link, COMMAND_SAVE, GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE);
    } else if (node->drive_on && !may_pause) {
        answer_command(node, link, COMMAND_SAVE, GOLDFIELD_COMMAND_ANSWER_STATUS_COIL_ON_CHOICE);
    } else {
        node->drive_hold = true;
        node->saving = link;
        node->under_way = true;
        storage_save(&node->storage, &node->parameters, VERSION);
    }
}

/* Goes on with a save. The application has told in this turn whether its drive is on, and it was held before. */
static void step_save(node_t *node) {
    if (node->drive_on) {
        return;
    }
    const storage_result_t result = storage_step(&node->storage);
    uint32_t status = GOLDFIELD_COMMAND_ANSWER_STATUS_FLASH_FAILED_CHOICE;
    switch (result) {
    case STORAGE_KEPT:
    case STORAGE_RESTART:
        if (storage_is_kept(&node->storage)) {
            status = result == STORAGE_KEPT ? GOLDFIELD_COMMAND_ANSWER_STATUS_OK_CHOICE
                                            : GOLDFIELD_COMMAND_ANSWER_STATUS_OK_RESTARTS_CHOICE;
        }
        break;
    case STORAGE_FAILED:
    case STORAGE_STRANDED:
        break;
    default:
        return; /* Busy, or a word that is no result: the next turn tells. */
    }
    answer_command(node, node->saving, COMMAND_SAVE, status);
    node->saving = NODE_NO_LINK;
    if (result == STORAGE_RESTART || result == STORAGE_STRANDED) {
        reset_soon(node); /* The drive is held until then. */
    } else {
        node->drive_hold = false;
    }
}

/* Answers a command of an update, or keeps its link for the answer that is to come. */
static void take_update(node_t *node, node_links_t link, uint32_t index, uint32_t argument, bool named) {
    if (node->saving != NODE_NO_LINK || node->resetting) {
        answer_command(node, link, index, GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE);
        return;
    }
    const update_answer_t answer = update_command(&node->update, index, argument, named, hal_microseconds(node->hal));
    if (answer.action == UPDATE_ANSWER) {
        answer_with(node, link, index, answer.status, answer.value);
        if (answer.status == GOLDFIELD_COMMAND_ANSWER_STATUS_OK_RESTARTS_CHOICE) {
            reset_soon(node);
        }
    } else {
        node->updating = link;
        node->update_index = index;
    }
    node->drive_hold = update_holds(&node->update);
    node->under_way |= node->drive_hold;
}

static void take_update_data(node_t *node, uint32_t index, const frame_t *frame) {
    struct goldfield_update_data_t block = {0};
    (void)goldfield_update_data_unpack(&block, frame->data, frame->length);
    update_data(&node->update, index, block.first, block.second, hal_microseconds(node->hal));
}

/* Goes on with an update, or with the trial of this image. The application has told in this turn whether its drive is
 * on, and it was held before. */
static void step_update(node_t *node) {
    const update_answer_t answer = update_step(&node->update, node->drive_on, hal_microseconds(node->hal));
    if (answer.action == UPDATE_ANSWER) {
        answer_with(node, node->updating, node->update_index, answer.status, answer.value);
    } else if (answer.action == UPDATE_RESET && !node->resetting) {
        reset_soon(node);
    }
    if (!node->resetting) {
        node->drive_hold = update_holds(&node->update);
    }
}

static void set_unsigned(node_t *node, uint32_t id, uint32_t bits) {
    const parameter_value_t value = {.kind = PARAMETER_UNSIGNED, .bits = bits};
    if (parameters_set(&node->parameters, id, value) == PARAMETER_OK) {
        node->parameters_changed = true;
    }
}

/* Returns whether a start or a stop with this argument is for this board. */
static bool concerns(const node_t *node, uint32_t group) {
    return group == 0 || group == ALL_GROUPS || group == parameters_unsigned(&node->parameters, PARAMETER_GROUP);
}

/* The commands below return whether they are carried out; a refusal changes nothing. What changes a parameter asks
 * again whether the board is unlocked: one instruction that goes wrong on the way here does not open it. */

static bool start(node_t *node, node_links_t link, bool named, uint32_t group) {
    const bool commissioned = node->role != HAL_ROLE_SENSOR &&
                              parameters_float(&node->parameters, PARAMETER_AMPLITUDE) > 0.0f;
    if (!commissioned || (group == 0 && !named) || !access_granted(&node->access, node_link_index(link))) {
        return false;
    }
    set_unsigned(node, PARAMETER_ARMED, 1);
    return true;
}

static bool stop(node_t *node) {
    set_unsigned(node, PARAMETER_ARMED, 0);
    return true;
}

static void blink(node_t *node, uint32_t seconds) {
    node->blinking = node->under_way = true;
    node->blink_end_us = hal_microseconds(node->hal) + (uint64_t)seconds * MICROSECONDS;
}

static bool sign(node_t *node, bool named, uint32_t seconds) {
    if (!named || (!node->drive_on && seconds > 0)) {
        return false;
    }
    node->signing = seconds > 0;
    blink(node, seconds);
    return true;
}

static bool carry_out(node_t *node, node_links_t link, uint32_t index, uint32_t argument, bool named) {
    switch (index) {
    case COMMAND_BLINK:
        blink(node, argument);
        return true;
    case COMMAND_RESET:
        if (named) {
            reset_soon(node);
        }
        return named;
    case COMMAND_CLEAR:
        node->clear_wanted |= named && !node->clear_refused;
        return named && !node->clear_refused;
    case COMMAND_START:
        return start(node, link, named, argument);
    case COMMAND_STOP:
        return stop(node);
    case COMMAND_SIGNATURE:
        return sign(node, named, argument);
    default:
        return named && argument >= 1u && argument <= NODE_LARGEST; /* COMMAND_NUMBER acts behind its answer. */
    }
}

/* Has an answer to all nodes wait for a while that differs from board to board, and from time to time. */
static void answer_late(node_t *node, node_links_t *late, node_links_t link, uint64_t own) {
    const uint64_t now_us = hal_microseconds(node->hal);
    const uint64_t mixed = (own ^ now_us) * 0x9E3779B97F4A7C15u; /* The golden ratio of 2^64: all bits reach the top. */
    *late = (node_links_t)(*late | link);
    node->late_us = now_us + (mixed >> LATE_SHIFT) * LATE_STEP_US * node->can_slow;
    node->under_way = true;
}

static void tell_late(node_t *node) {
    if (node->identity_late != NODE_NO_LINK) {
        tell_identity(node, node->identity_late);
    }
    if (node->reset_late != NODE_NO_LINK) {
        requests_tell_last_reset(node, node->reset_late);
    }
    node->identity_late = node->reset_late = NODE_NO_LINK;
}

static void take_command(node_t *node, node_links_t link, uint32_t index, const frame_t *frame) {
    struct goldfield_command_t command = {0};
    const uint64_t own = identity_half(node, 0) ^ identity_half(node, 1);
    (void)goldfield_command_unpack(&command, frame->data, frame->length); /* The length has been seen to. */
    if (command.board != 0 && command.board != own) {
        return;
    }
    if (index != message_index(frame->id)) {
        return; /* Looked at twice: one instruction that goes wrong carries out no other command. */
    }
    update_heard(&node->update);
    if (index == COMMAND_IDENTITY || index == COMMAND_LAST_RESET) {
        answer_late(node, index == COMMAND_IDENTITY ? &node->identity_late : &node->reset_late, link, own);
        if ((frame->id & PROTOCOL_NODE_MASK) != 0u) {
            tell_late(node); /* It alone is asked. */
        }
        return;
    }
    const bool named = command.board == own && (frame->id & PROTOCOL_NODE_MASK) == node->id;
    if (index == COMMAND_CHALLENGE) {
        challenge(node, link, named);
        return;
    }
    if ((index == COMMAND_START || index == COMMAND_STOP) && !concerns(node, command.argument)) {
        return;
    }
    if (index < 32u && (CHANGING >> index & 1u) != 0u && !access_granted(&node->access, node_link_index(link))) {
        answer_command(node, link, index, GOLDFIELD_COMMAND_ANSWER_STATUS_LOCKED_CHOICE);
        return;
    }
    if (index >= UPDATE_BEGIN && index <= UPDATE_TELL) {
        take_update(node, link, index, command.argument, named);
        return;
    }
    if (index == COMMAND_SAVE) {
        begin_save(node, link, named, command.argument != 0);
        return;
    }
    uint32_t status = GOLDFIELD_COMMAND_ANSWER_STATUS_UNKNOWN_CHOICE;
    if (index == COMMAND_LOCK) {
        access_lock(&node->access, node_link_index(link));
        status = GOLDFIELD_COMMAND_ANSWER_STATUS_OK_CHOICE;
    } else if (index <= COMMAND_NUMBER) {
        status = carry_out(node, link, index, command.argument, named) ? GOLDFIELD_COMMAND_ANSWER_STATUS_OK_CHOICE
                                                                       : GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE;
    }
    answer_command(node, link, index, status);
    if (index == COMMAND_NUMBER && status == GOLDFIELD_COMMAND_ANSWER_STATUS_OK_CHOICE &&
        access_granted(&node->access, node_link_index(link))) {
        set_unsigned(node, PARAMETER_NODE, command.argument);
        node->id = command.argument;
    }
}

void requests_take(node_t *node, node_links_t link, const frame_t *frame) {
    const uint32_t message = frame->id & ~((1u << PROTOCOL_TYPE_SHIFT) - 1u);
    const uint32_t index = message_index(frame->id);
    const uint32_t to = frame->id & PROTOCOL_NODE_MASK;
    if (to != 0 && to != node->id) {
        return;
    }
    if (message == GOLDFIELD_PARAM_SET_FRAME_ID) {
        parameter_requests_set(node, link, index, frame);
    } else if (message == GOLDFIELD_PARAM_GET_FRAME_ID) {
        parameter_requests_get(node, link, index);
    } else if (message == GOLDFIELD_PARAM_DESCRIBE_FRAME_ID) {
        parameter_requests_describe(node, link, index);
    } else if (message == GOLDFIELD_COMMAND_FRAME_ID) {
        take_command(node, link, index, frame);
    } else if (message == GOLDFIELD_UPDATE_DATA_FRAME_ID) {
        take_update_data(node, index, frame);
    } else if (message == GOLDFIELD_ACCESS_FRAME_ID && index == ACCESS_TO_BOARD && to != 0u) {
        take_access(node, link, frame);
    }
}

/* Blinks, or resets the board, if it is time to. */
static void act(node_t *node) {
    const uint64_t now_us = hal_microseconds(node->hal);
    if (node->blinking) {
        node->blinking = now_us < node->blink_end_us;
        node->signing = node->signing && node->blinking;
        hal_led(node->hal, !node->blinking || now_us / BLINK_US % 2u == 0u);
    }
    if (now_us >= node->late_us) {
        tell_late(node);
    }
    if (node->resetting && now_us >= node->reset_us) {
        hal_reset(node->hal);
    }
}

void requests_step(node_t *node) {
    if (node->saving != NODE_NO_LINK) {
        step_save(node);
    }
    if (update_holds(&node->update)) {
        step_update(node);
    }
    act(node);
    node->under_way = node->saving != NODE_NO_LINK || update_holds(&node->update) || node->blinking ||
                      node->resetting || node->identity_late != NODE_NO_LINK || node->reset_late != NODE_NO_LINK;
}
