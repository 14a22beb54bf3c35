/* machine.h: what the processor side offers to the peripheral models, and what a model looks like.
 *
 * A model is a file named after the peripheral, or a few whose names begin with it and a header that tells them apart.
 * It is written from the vendor's register description (RM0090, the SVD), never from the driver. It holds its state in
 * its own struct, allocated by its create function; no globals.
 *
 * Strictness. What the reference manual forbids or leaves undefined is a violation: access to a peripheral whose clock
 * is off in RCC, a reserved bit written 1 (or a must-be-kept bit changed), a wrong order of enabling, an access of
 * unsupported width, an unmapped address, an overrun that loses data (ADC OVR, USART ORE, CAN FOVR: these set their
 * flags as well). machine_violation() records it, and under emulator_config_t.strict stops the board.
 */
#ifndef GOLDFIELD_MACHINE_H
#define GOLDFIELD_MACHINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "boards/board_edge.h"
#include "emulator/emulator.h"

typedef struct machine machine_t; /* One chip: processor, buses, peripherals. board_t is a machine_t. */

/* ---- A peripheral model ---- */

typedef struct peripheral peripheral_t;
struct peripheral {
    const char *name;    /* As in the SVD: "TIM1", "DMA2". */
    uint32_t base, size; /* Address range, size a multiple of 4. */
    machine_t *machine;
    void *state;
    /* width is 1, 2 or 4 bytes; offset is from base and aligned to width. debug is true for accesses that must have
     * no side effects. */
    uint32_t (*read)(peripheral_t *self, uint32_t offset, unsigned width);
    void (*write)(peripheral_t *self, uint32_t offset, uint32_t value, unsigned width);
    void (*reset)(peripheral_t *self); /* Power-on or system reset, and RCC's RSTR bit. */
    void (*destroy)(peripheral_t *self);
};

/* Add a model to the bus. The peripheral must live as long as the machine. Up to 64. */
void machine_attach(machine_t *machine, peripheral_t *peripheral);
peripheral_t *machine_peripheral(machine_t *machine, const char *name); /* NULL if there is none. */

/* ---- Time. All clocks derive from RCC, which calls machine_set_core_clock() when the system clock changes. ---- */

/* The present, picoseconds; inside an access: the time of that instruction. */
int64_t machine_now(const machine_t *machine);
/* The core runs at hz (a double: crystal error included) from now on. */
void machine_set_core_clock(machine_t *machine, double hz);
double machine_core_clock(const machine_t *machine);
const emulator_config_t *machine_config(const machine_t *machine);
const board_edge_t *machine_edge(const machine_t *machine);

/* Events: a callback at an exact time, in order of time; equal times in order of scheduling. An event fires before
 * the first instruction that starts at or after its time. Scheduling a pending event moves it. The struct belongs to
 * the model. */
typedef struct machine_event machine_event_t;
struct machine_event {
    void (*fire)(void *context, int64_t time_ps);
    void *context;
    int64_t time_ps;    /* Read-only to models. */
    uint64_t order;     /* Internal. */
    int32_t heap_index; /* Internal; initialise with machine_event_init. */
};
void machine_event_init(machine_event_t *event, void (*fire)(void *context, int64_t time_ps), void *context);
void machine_schedule(machine_t *machine, machine_event_t *event, int64_t time_ps);
void machine_cancel(machine_t *machine, machine_event_t *event);

/* ---- Interrupts: level of the peripheral's request line to the NVIC (position as in RM0090 table 62, 0 = WWDG).
 * ---- */
void machine_irq(machine_t *machine, unsigned position, bool level);

/* Reset request by a watchdog. flags: the bits to set in RCC_CSR. Takes effect before the next instruction. */
void machine_reset_request(machine_t *machine, uint32_t csr_flags);
/* For RCC, inside its reset function: the flags of the requests that led to this reset (a request by software
 * included); 0 at power-on and for RSTR bits. */
uint32_t machine_reset_flags(const machine_t *machine);

/* ---- Memory as a bus master (DMA) sees it. False: bus error (unmapped). Peripheral registers are reached through
 * the same calls. ---- */
bool machine_bus_read(machine_t *machine, uint32_t address, unsigned width, uint32_t *value);
bool machine_bus_write(machine_t *machine, uint32_t address, unsigned width, uint32_t value);

/* ---- Violations ---- */
void machine_violation(machine_t *machine, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* ---- Between models (signals inside the chip) ---- */

/* RCC answers: is the peripheral's bus clock on; its bus clock and its timers' clock in Hz (crystal error included).
 * name as in the SVD. */
bool rcc_enabled(const machine_t *machine, const char *name);
double rcc_bus_clock(const machine_t *machine, const char *name);
double rcc_timer_clock(const machine_t *machine, const char *name);

/* A pulse on a request line to the DMA controllers, mapped to (controller, stream, channel) by RM0090 tables 42 and 43.
 * source is e.g. "TIM1_UP", "TIM1_CH4", "ADC1", "USART1_TX". */
void dma_request_pulse(machine_t *machine, const char *source);

/* GPIO: level at a pin (input or output); alternate-function inputs subscribe to edges. */
bool gpio_level(const machine_t *machine, unsigned pin);
/* True when the pin is in alternate mode af. */
bool gpio_is_alternate(const machine_t *machine, unsigned pin, unsigned af);
bool gpio_is_analog(const machine_t *machine, unsigned pin);
/* Called by GPIO for each input edge (from outside or a looped output): timers capture, EXTI. */
void tim_pin_edge(machine_t *machine, unsigned pin, bool level, int64_t time_ps);
void exti_pin_edge(machine_t *machine, unsigned pin, bool level, int64_t time_ps);

/* From outside, called by the machine's board_operations_t. */
void gpio_pin_in(machine_t *machine, unsigned pin, bool level, int64_t time_ps);
void usart_byte_in(machine_t *machine, unsigned uart, uint8_t byte, uint32_t baud, int64_t time_ps);
void can_frame_in(machine_t *machine, const board_frame_t *frame, int64_t time_ps);
void can_frame_sent(machine_t *machine, unsigned mailbox, bool ok, int64_t time_ps);

/* peripherals.c: create and attach every model. Called once by emulator_create, after the processor exists. */
void peripherals_create(machine_t *machine);

#endif
