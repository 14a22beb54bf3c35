/* sensor.c: what is linked into the sensor image. */
#include "apps/sensor.h"
#include "boards/board.h"

/* They are static, since they are far too large for the stack. */
static sensor_t sensor;
static acquire_t acquire BOARD_CORE_MEMORY;
static onboard_t onboard;
static tracking_t tracking BOARD_CORE_MEMORY;

int main(void) {
    hal_t *hal = board_start();
    sensor_start(&sensor, &acquire, &onboard, &tracking, hal);
    for (;;) {
        sensor_step(&sensor);
        hal_wait(hal);
    }
}
