/* The anchor image. */
#include "apps/anchor.h"
#include "boards/board.h"

static anchor_t anchor; /* Static: far too large for the stack. */

int main(void) {
    hal_t *hal = board_start();
    anchor_start(&anchor, hal);
    for (;;) {
        anchor_step(&anchor);
        hal_wait(hal);
    }
}
