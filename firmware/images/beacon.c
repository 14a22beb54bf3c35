/* beacon.c: what is linked into the beacon image. */
#include "apps/beacon.h"
#include "boards/board.h"

static beacon_t beacon; /* It is static, since it is far too large for the stack. */

int main(void) {
    hal_t *hal = board_start();
    beacon_start(&beacon, hal);
    for (;;) {
        beacon_step(&beacon);
        hal_wait(hal);
    }
}
