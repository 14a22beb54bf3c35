/* peripherals.c: create and attach every model. Models that are not here yet answer as a chip without them. */
#include "machine.h"

bool rcc_enabled(const machine_t *machine, const char *name) { (void)machine; (void)name; return false; }
double rcc_bus_clock(const machine_t *machine, const char *name) { (void)machine; (void)name; return 16e6; }
double rcc_timer_clock(const machine_t *machine, const char *name) { (void)machine; (void)name; return 16e6; }
void dma_request(machine_t *machine, const char *source, bool level) { (void)machine; (void)source; (void)level; }
void dma_request_pulse(machine_t *machine, const char *source) { (void)machine; (void)source; }
void adc_trigger(machine_t *machine, const char *source, int64_t time_ps) { (void)machine; (void)source; (void)time_ps; }
bool gpio_level(const machine_t *machine, unsigned pin) { (void)machine; (void)pin; return false; }
bool gpio_is_alternate(const machine_t *machine, unsigned pin, unsigned af) { (void)machine; (void)pin; (void)af; return false; }
bool gpio_is_analog(const machine_t *machine, unsigned pin) { (void)machine; (void)pin; return false; }
void tim_pin_edge(machine_t *machine, unsigned pin, bool level, int64_t time_ps) { (void)machine; (void)pin; (void)level; (void)time_ps; }
void exti_pin_edge(machine_t *machine, unsigned pin, bool level, int64_t time_ps) { (void)machine; (void)pin; (void)level; (void)time_ps; }
void gpio_pin_in(machine_t *machine, unsigned pin, bool level, int64_t time_ps) { (void)machine; (void)pin; (void)level; (void)time_ps; }
void usart_byte_in(machine_t *machine, unsigned uart, uint8_t byte, uint32_t baud, int64_t time_ps) { (void)machine; (void)uart; (void)byte; (void)baud; (void)time_ps; }
void can_frame_in(machine_t *machine, const board_frame_t *frame, int64_t time_ps) { (void)machine; (void)frame; (void)time_ps; }
void can_frame_sent(machine_t *machine, unsigned mailbox, bool ok, int64_t time_ps) { (void)machine; (void)mailbox; (void)ok; (void)time_ps; }
void peripherals_create(machine_t *machine) { (void)machine; }
