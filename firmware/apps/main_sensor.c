/* The sensor image. */
#include "sensor.h"
#include "board.h"

static sensor_t sensor; /* Static: far too large for the stack. */

int main(void) {
    hal_t *hal = board_start();
    sensor_start(&sensor, hal);
    for (;;) {
        sensor_step(&sensor);
        hal_wait(hal);
    }
}
