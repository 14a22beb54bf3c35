/* What stands for Monocypher's check of a signature: it reads the signature, the key and the message, and answers
 * anything. */
#include "third_party/monocypher/monocypher-ed25519.h"

#include "any.h"

int crypto_ed25519_check(const uint8_t signature[64], const uint8_t public_key[32], const uint8_t *message,
                         size_t message_size) {
    //@ assert \valid_read(signature + (0 .. 63)) && \valid_read(public_key + (0 .. 31));
    //@ assert \valid_read(message + (0 .. message_size - 1));
    return (int)any_up_to(1) - 1;
}
