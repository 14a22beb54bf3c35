/* anchor.c: what is linked into the anchor image. */
#include "apps/anchor.h"
#include "boards/board.h"

/* They are static, since they are far too large for the stack. */
static anchor_t anchor;
static onboard_t onboard BOARD_CORE_MEMORY;
static tracking_t tracking BOARD_CORE_MEMORY;

int main(void) {
    hal_t *hal = board_start();
    anchor_start(&anchor, &onboard, &tracking, hal);
    for (;;) {
        anchor_step(&anchor);
        hal_wait(hal);
    }
}
