/* gpio.c: general-purpose ports A to I (RM0090 8.4). */
#include "emulator/peripherals/model.h"
#include "emulator/peripherals/outside.h"

enum {
    MODER = 0x00,
    OTYPER = 0x04,
    OSPEEDR = 0x08,
    PUPDR = 0x0C,
    IDR = 0x10,
    ODR = 0x14,
    BSRR = 0x18,
    LCKR = 0x1C,
    AFRL = 0x20,
    AFRH = 0x24,
    REGISTERS = 10
};
enum { MODE_INPUT, MODE_OUTPUT, MODE_ALTERNATE, MODE_ANALOG };
enum { TOLD_LOW = BOARD_PULL_DOWN + 1, TOLD_HIGH };

#define PORT_REGISTERS(moder, ospeedr, pupdr)                                                                          \
    {                                                                                                                  \
        {"MODER", MODER, moder, 0xFFFFFFFF, ACCESS_RW}, {"OTYPER", OTYPER, 0, 0xFFFF, ACCESS_RW},                      \
            {"OSPEEDR", OSPEEDR, ospeedr, 0xFFFFFFFF, ACCESS_RW}, {"PUPDR", PUPDR, pupdr, 0xFFFFFFFF, ACCESS_RW},      \
            {"IDR", IDR, 0, 0xFFFF, ACCESS_RO}, {"ODR", ODR, 0, 0xFFFF, ACCESS_RW},                                    \
            {"BSRR", BSRR, 0, 0xFFFFFFFF, ACCESS_WO}, {"LCKR", LCKR, 0, 0x1FFFF, ACCESS_RW},                           \
            {"AFRL", AFRL, 0, 0xFFFFFFFF, ACCESS_RW}, {                                                                \
            "AFRH", AFRH, 0, 0xFFFFFFFF, ACCESS_RW                                                                     \
        }                                                                                                              \
    }

/* After reset PA13, 14, 15, PB3 and PB4 belong to the debug port. */
static const register_layout_t registers_a[REGISTERS] = PORT_REGISTERS(0xA8000000, 0x0C000000, 0x64000000);
static const register_layout_t registers_b[REGISTERS] = PORT_REGISTERS(0x00000280, 0x000000C0, 0x00000100);
static const register_layout_t registers_other[REGISTERS] = PORT_REGISTERS(0, 0, 0);

typedef struct {
    model_t model;
    unsigned number;
    uint16_t driven, outside; /* Pins driven from outside, and their levels. */
    uint16_t level;           /* Level of every pin, as seen with the input buffer on. */
    uint8_t told[16];         /* What the outside knows of a pin: its board_pull_t while it is released, or: */
    uint16_t locked;
    unsigned lock_step;
    uint16_t lock_pins;
} port_t;

struct gpio {
    port_t port[GPIO_COUNT];
};

static unsigned mode(const port_t *port, unsigned pin) {
    return field(port->model.value[MODER / 4], 2 * pin, 2);
}

static unsigned alternate(const port_t *port, unsigned pin) {
    return field(port->model.value[(pin < 8 ? AFRL : AFRH) / 4], 4 * (pin % 8), 4);
}

/* What the port does to a pin: its own output, or an alternate function's. */
static pin_output_t output(const port_t *port, unsigned pin) {
    const chip_t *const chip = port->model.chip;
    const uint16_t bit = (uint16_t)(1u << pin);
    pin_output_t driven = OUTPUT_OFF;
    if (mode(port, pin) == MODE_OUTPUT) {
        driven = port->model.value[ODR / 4] & bit ? OUTPUT_HIGH : OUTPUT_LOW;
    } else if (mode(port, pin) == MODE_ALTERNATE && chip->signals.pin_output != NULL) {
        driven = chip->signals.pin_output(chip, port->number * 16 + pin, alternate(port, pin));
    }
    return driven == OUTPUT_HIGH && (port->model.value[OTYPER / 4] & bit) != 0 ? OUTPUT_OFF : driven;
}

/* The register's codes are those of board_pull_t; the reserved one is a violation when it is written. */
static board_pull_t pull(const port_t *port, unsigned pin) {
    const uint32_t code = field(port->model.value[PUPDR / 4], 2 * pin, 2);
    return mode(port, pin) == MODE_ANALOG || code > BOARD_PULL_DOWN ? BOARD_PULL_NONE : (board_pull_t)code;
}

/* A pin that nobody drives and nothing pulls reads low; on silicon it may read anything. */
static bool compute_level(const port_t *port, unsigned pin) {
    const uint16_t bit = (uint16_t)(1u << pin);
    const pin_output_t driven = output(port, pin);
    if (driven == OUTPUT_LOW || driven == OUTPUT_HIGH) {
        return driven == OUTPUT_HIGH;
    }
    if (port->driven & bit) {
        return (port->outside & bit) != 0;
    }
    return pull(port, pin) == BOARD_PULL_UP;
}

/* Tell the outside what the chip does to a pin, if it does not know. */
static void tell(port_t *port, unsigned pin, int64_t time_ps) {
    const board_edge_t *const edge = port->model.chip->edge;
    const pin_output_t driven = output(port, pin);
    const uint8_t now = driven == OUTPUT_LOW ? TOLD_LOW : driven == OUTPUT_HIGH ? TOLD_HIGH : (uint8_t)pull(port, pin);
    if (driven == OUTPUT_UNSEEN || port->told[pin] == now) {
        return;
    }
    port->told[pin] = now;
    if (now >= TOLD_LOW && edge->pin_out) {
        edge->pin_out(edge->context, port->number * 16 + pin, now == TOLD_HIGH, time_ps);
    } else if (now < TOLD_LOW && edge->pin_release) {
        edge->pin_release(edge->context, port->number * 16 + pin, (board_pull_t)now, time_ps);
    }
}

/* Recompute some pins, tell the outside and the inside what changed. */
static void update(port_t *port, uint16_t pins, int64_t time_ps) {
    chip_t *const chip = port->model.chip;
    for (unsigned pin = 0; pins >> pin; pin++) {
        const uint16_t bit = (uint16_t)(1u << pin);
        if ((pins & bit) == 0) {
            continue;
        }
        const bool level = compute_level(port, pin), was = (port->level & bit) != 0;
        port->level = (uint16_t)(level ? port->level | bit : port->level & ~bit);
        tell(port, pin, time_ps);
        if (level != was) {
            for (unsigned i = 0; i < CHIP_PIN_LISTENERS && chip->signals.pin_edge[i] != NULL; i++) {
                chip->signals.pin_edge[i](chip, port->number * 16 + pin, level, time_ps);
            }
        }
    }
}

static uint16_t analog_pins(const port_t *port) {
    uint16_t pins = 0;
    for (unsigned pin = 0; pin < 16; pin++) {
        pins = (uint16_t)(pins | (mode(port, pin) == MODE_ANALOG ? 1u << pin : 0));
    }
    return pins;
}

static uint32_t get(model_t *model, uint32_t offset) {
    port_t *const port = (port_t *)model;
    switch (offset) {
    case IDR:
        return port->level & (uint32_t)~analog_pins(port);
    case BSRR:
        return 0;
    case LCKR:
        if (port->lock_step == 3) { /* The sequence ends with a read of LCKK. */
            port->locked = port->lock_pins;
            model->value[LCKR / 4] = port->locked | 1u << 16;
            port->lock_step = 0;
        }
        return reg(model, LCKR);
    default:
        return reg(model, offset);
    }
}

static void write_lock(port_t *port, uint32_t value) {
    static const bool key[3] = {true, false, true};
    if (port->locked) {
        machine_violation(port->model.machine, "%s_LCKR: written after the port was locked", model_name(&port->model));
        return;
    }
    const bool first = port->lock_step == 0;
    if ((value >> 16 != 0) != key[port->lock_step % 3] || (!first && (uint16_t)value != port->lock_pins)) {
        port->lock_step = 0;
        if (value >> 16 == 0) {
            port->model.value[LCKR / 4] = value;
        }
        return;
    }
    port->lock_pins = (uint16_t)value;
    port->lock_step++;
}

/* Fields of locked pins must not change. bits: width of a pin's field; first: its first pin. */
static bool locked_changed(const port_t *port, uint32_t offset, uint32_t value, unsigned bits, unsigned first) {
    const uint32_t changed = value ^ port->model.value[offset / 4];
    for (unsigned pin = 0; pin < 16 && changed != 0; pin++) {
        if ((port->locked >> pin & 1u) && pin >= first && (pin - first) * bits < 32 &&
            field(changed, (pin - first) * bits, bits) != 0) {
            machine_violation(port->model.machine, "%s: configuration of locked pin %u changed",
                              model_name(&port->model), pin);
            return true;
        }
    }
    return false;
}

static void set(model_t *model, uint32_t offset, uint32_t value) {
    port_t *const port = (port_t *)model;
    const int64_t now = machine_now(model->machine);
    const uint32_t old = reg(model, offset);
    switch (offset) {
    case BSRR: {
        const uint32_t odr = (reg(model, ODR) & ~(value >> 16)) | (value & 0xFFFFu); /* Set wins. */
        const uint16_t changed = (uint16_t)(odr ^ reg(model, ODR));
        model->value[ODR / 4] = odr;
        update(port, changed, now);
        return;
    }
    case ODR:
        model->value[ODR / 4] = value;
        update(port, (uint16_t)(old ^ value), now);
        return;
    case LCKR:
        write_lock(port, value);
        return;
    case PUPDR:
        for (unsigned pin = 0; pin < 16; pin++) {
            if (field(value, 2 * pin, 2) == 3) {
                machine_violation(model->machine, "%s_PUPDR: pin %u set to the reserved value 3", model_name(model),
                                  pin);
            }
        }
        break;
    default:
        break;
    }
    const unsigned bits = offset == OTYPER ? 1 : offset >= AFRL ? 4 : 2;
    if (locked_changed(port, offset, value, bits, offset == AFRH ? 8 : 0)) {
        return;
    }
    const bool routes = (offset == MODER || offset >= AFRL) && value != old;
    if (routes) {
        model->chip->signals.pin_routing(model->chip, false);
    }
    model->value[offset / 4] = value;
    if (offset != OSPEEDR) {
        update(port, 0xFFFF, now);
    }
    if (routes) {
        model->chip->signals.pin_routing(model->chip, true);
    }
}

static void restart(model_t *model) {
    port_t *const port = (port_t *)model;
    port->locked = port->lock_pins = 0;
    port->lock_step = 0;
    for (unsigned pin = 0; pin < 16; pin++) { /* Silent inside: whoever listens there is in reset too. */
        const bool level = compute_level(port, pin);
        port->level = (uint16_t)(level ? port->level | 1u << pin : port->level & ~(1u << pin));
        tell(port, pin, machine_now(model->machine));
    }
    model->chip->signals.pin_routing(model->chip, true);
}

void gpio_create(chip_t *chip) {
    static const char *const names[GPIO_COUNT] = {"GPIOA", "GPIOB", "GPIOC", "GPIOD", "GPIOE",
                                                  "GPIOF", "GPIOG", "GPIOH", "GPIOI"};
    struct storage {
        gpio_t gpio;
        model_description_t description[GPIO_COUNT];
    } *const storage = chip_allocate(chip, sizeof *storage);
    chip->gpio = &storage->gpio;
    for (unsigned i = 0; i < GPIO_COUNT; i++) {
        storage->description[i] = (model_description_t){.name = names[i],
                                                        .base = 0x40020000u + 0x400u * i,
                                                        .size = 0x400,
                                                        .bus = BUS_AHB,
                                                        .read_widths = WIDTH_ANY,
                                                        .write_widths = WIDTH_ANY,
                                                        .registers = i == 0   ? registers_a
                                                                     : i == 1 ? registers_b
                                                                              : registers_other,
                                                        .register_count = REGISTERS,
                                                        .get = get,
                                                        .set = set,
                                                        .restart = restart};
        chip->gpio->port[i].number = i;
        model_attach(chip, &chip->gpio->port[i].model, &storage->description[i]);
    }
}

/* ---- The outside and the other models ---- */

bool chip_pin_is_alternate(const chip_t *chip, unsigned pin, unsigned af) {
    if (pin / 16 >= GPIO_COUNT) {
        return false;
    }
    const port_t *const port = &chip->gpio->port[pin / 16];
    return mode(port, pin % 16) == MODE_ALTERNATE && alternate(port, pin % 16) == af;
}

bool chip_pin_is_analog(const chip_t *chip, unsigned pin) {
    return pin / 16 < GPIO_COUNT && mode(&chip->gpio->port[pin / 16], pin % 16) == MODE_ANALOG;
}

bool chip_pin_level(const chip_t *chip, unsigned pin) {
    return (chip->gpio->port[pin / 16].level >> pin % 16 & 1u) != 0;
}

void chip_pin_driven(chip_t *chip, unsigned pin, int64_t time_ps) {
    update(&chip->gpio->port[pin / 16], (uint16_t)(1u << pin % 16), time_ps);
}

void gpio_pin_in(machine_t *machine, unsigned pin, bool level, int64_t time_ps) {
    chip_t *const chip = chip_of(machine);
    if (pin / 16 >= GPIO_COUNT) {
        machine_violation(machine, "GPIO: there is no pin %u", pin);
        return;
    }
    port_t *const port = &chip->gpio->port[pin / 16];
    const uint16_t bit = (uint16_t)(1u << pin % 16);
    port->driven |= bit;
    port->outside = (uint16_t)(level ? port->outside | bit : port->outside & ~bit);
    update(port, bit, time_ps);
}
