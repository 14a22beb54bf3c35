/* anchor.c: what is linked into the anchor image. */
#include "apps/anchor.h"
#include "boards/board.h"

static anchor_t anchor; /* It is static, since it is far too large for the stack. */

int main(void) {
    hal_t *hal = board_start();
    anchor_start(&anchor, hal);
    for (;;) {
        anchor_step(&anchor);
        hal_wait(hal);
    }
}
