#include "core/link/challenge.h"

#include <string.h>

#include "third_party/monocypher/monocypher-ed25519.h"
#include "third_party/monocypher/monocypher.h"

#define HASH_BYTES   64u
#define NUMBER_BYTES 8u

static const char purpose[] = "goldfield access 1"; /* Without the zero at its end. */
#define PURPOSE_BYTES (sizeof purpose - 1u)

uint64_t challenge_answer(const uint8_t key[CHALLENGE_KEY_BYTES], const uint8_t unique_id[CHALLENGE_ID_BYTES],
                          uint64_t number) {
    uint8_t message[PURPOSE_BYTES + CHALLENGE_ID_BYTES + NUMBER_BYTES], hash[HASH_BYTES];
    memcpy(message, purpose, PURPOSE_BYTES);
    memcpy(message + PURPOSE_BYTES, unique_id, CHALLENGE_ID_BYTES);
    for (uint32_t i = 0; i < NUMBER_BYTES; i++) {
        message[PURPOSE_BYTES + CHALLENGE_ID_BYTES + i] = (uint8_t)(number >> (8u * i));
    }
    crypto_sha512_hmac(hash, key, CHALLENGE_KEY_BYTES, message, sizeof message);
    uint64_t answer = 0;
    for (uint32_t i = NUMBER_BYTES; i-- > 0;) {
        answer = answer << 8 | hash[i];
    }
    crypto_wipe(hash, sizeof hash);
    return answer;
}
