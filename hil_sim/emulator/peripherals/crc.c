/* crc.c: the CRC unit (RM0090 4.4): polynomial 0x04C11DB7, words most significant bit first. */
#include "emulator/peripherals/model.h"

enum { DR = 0x00, IDR = 0x04, CR = 0x08 };

static const register_layout_t registers[] = {
    {"DR", DR, 0xFFFFFFFF, 0xFFFFFFFF, ACCESS_RW}, {"IDR", IDR, 0, 0xFF, ACCESS_RW}, {"CR", CR, 0, 0x1, ACCESS_WO}};

static void set(model_t *model, uint32_t offset, uint32_t value) {
    if (offset == DR) {
        uint32_t crc = reg(model, DR) ^ value;
        for (unsigned i = 0; i < 32; i++) {
            crc = crc << 1 ^ (crc >> 31 ? 0x04C11DB7u : 0);
        }
        model->value[DR / 4] = crc;
    } else if (offset == IDR) {
        model->value[IDR / 4] = value;
    } else if (value & 1u) {
        model->value[DR / 4] = 0xFFFFFFFFu;
    }
}

void crc_create(chip_t *chip) {
    static const model_description_t description = {.name = "CRC",
                                                    .base = 0x40023000,
                                                    .size = 0x400,
                                                    .bus = BUS_AHB,
                                                    .read_widths = WIDTH_32,
                                                    .write_widths = WIDTH_32,
                                                    .registers = registers,
                                                    .register_count = 3,
                                                    .set = set};
    model_t *const crc = chip_allocate(chip, sizeof *crc);
    model_attach(chip, crc, &description);
}
