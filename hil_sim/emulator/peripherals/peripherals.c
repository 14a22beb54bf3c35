#include "emulator/peripherals/peripherals.h"

#include <stdlib.h>

#include "emulator/peripherals/model.h"

/* The destroy function of the model that was attached last: all others are gone when it is called. */
static void destroy(peripheral_t *self) {
    chip_t *const chip = ((model_t *)self)->chip;
    for (unsigned i = 0; i < chip->allocated_count; i++) {
        free(chip->allocated[i]);
    }
    free(chip);
}

void peripherals_create(machine_t *machine) {
    chip_t *const chip = calloc(1, sizeof *chip);
    if (chip == NULL) {
        abort();
    }
    chip->machine = machine;
    chip->config = machine_config(machine);
    chip->edge = machine_edge(machine);
    rcc_create(chip); /* First: chip_of finds it, and its reset sets the clocks that the others use. */
    pwr_create(chip);
    flash_create(chip);
    gpio_create(chip);
    exti_create(chip);
    dma_create(chip);
    adc_create(chip);
    tim_create(chip);
    dac_create(chip);
    usart_create(chip);
    can_create(chip);
    watchdog_create(chip);
    crc_create(chip);
    rng_create(chip);
    chip->models[chip->model_count - 1]->peripheral.destroy = destroy;
}
