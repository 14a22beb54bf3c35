/* The beacon image. */
#include "apps/beacon.h"
#include "boards/board.h"

static beacon_t beacon; /* Static: far too large for the stack. */

int main(void) {
    hal_t *hal = board_start();
    beacon_start(&beacon, hal);
    for (;;) {
        beacon_step(&beacon);
        hal_wait(hal);
    }
}
