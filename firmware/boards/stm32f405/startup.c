/* startup.c: from reset to main(). */

#include "boards/stm32f405/stm32f405.h"

int main(void);

/* These come from the linker script; of the last three, the address is the number. */
extern uint32_t stack_top, data_start[], bss_start[], core_memory_start[];
extern const uint32_t data_load[], data_words, bss_words, core_memory_words;

typedef void (*vector_t)(void);

/* Every entry that is not ours is a fault: it reports itself and the watchdog resets. */
typedef struct {
    uint32_t *stack;
    vector_t reset, nmi, hard_fault, memory_fault, bus_fault, usage_fault, reserved0[4], supervisor_call, debug,
        reserved1, pend_supervisor, tick;
    vector_t irq[IRQ_COUNT];
} vectors_t;

__attribute__((section(".vectors"), used)) static const vectors_t vectors = {
    .stack = &stack_top,
    .reset = Reset_Handler,
    .nmi = NMI_Handler,
    .hard_fault = Fault_Handler,
    .memory_fault = Fault_Handler,
    .bus_fault = Fault_Handler,
    .usage_fault = Fault_Handler,
    .supervisor_call = Fault_Handler,
    .debug = Fault_Handler,
    .pend_supervisor = PendSV_Handler,
    .tick = SysTick_Handler,
    .irq =
        {
            [IRQ_PVD - 1] = Fault_Handler,
            [IRQ_PVD] = PVD_Handler,
            [IRQ_PVD + 1 ... IRQ_DMA1_STREAM1 - 1] = Fault_Handler,
            [IRQ_DMA1_STREAM1] = DMA1_Stream1_Handler,
            [IRQ_DMA1_STREAM3 - 1] = Fault_Handler,
            [IRQ_DMA1_STREAM3] = DMA1_Stream3_Handler,
            [IRQ_DMA1_STREAM3 + 1 ... IRQ_ADC - 1] = Fault_Handler,
            [IRQ_ADC] = ADC_Handler,
            [IRQ_CAN1_TX] = CAN1_TX_Handler,
            [IRQ_CAN1_RX0] = CAN1_RX0_Handler,
            [IRQ_CAN1_RX1] = CAN1_RX1_Handler,
            [IRQ_CAN1_SCE] = CAN1_SCE_Handler,
            [IRQ_TIM1_BRK_TIM9 - 1] = Fault_Handler,
            [IRQ_TIM1_BRK_TIM9] = TIM1_BRK_TIM9_Handler,
            [IRQ_TIM1_BRK_TIM9 + 1 ... IRQ_TIM8_BRK_TIM12 - 1] = Fault_Handler,
            [IRQ_TIM8_BRK_TIM12] = TIM8_BRK_TIM12_Handler,
            [IRQ_TIM8_BRK_TIM12 + 1 ... IRQ_TIM8_CC - 1] = Fault_Handler,
            [IRQ_TIM8_CC] = TIM8_CC_Handler,
            [IRQ_TIM8_CC + 1 ... IRQ_TIM7 - 1] = Fault_Handler,
            [IRQ_TIM7] = TIM7_Handler,
            [IRQ_DMA2_STREAM1 - 1] = Fault_Handler,
            [IRQ_DMA2_STREAM1] = DMA2_Stream1_Handler,
            [IRQ_DMA2_STREAM1 + 1 ... IRQ_COUNT - 1] = Fault_Handler,
        },
};

void Reset_Handler(void) {
    SCB->VTOR = (uint32_t)&vectors;
    SCB->CPACR |= SCB_CPACR_FPU_FULL;
    __asm volatile("dsb\n\tisb" ::: "memory");

    for (uint32_t i = 0; i < (uint32_t)&data_words; i++)
        data_start[i] = data_load[i];
    for (uint32_t i = 0; i < (uint32_t)&bss_words; i++)
        bss_start[i] = 0;
    for (uint32_t i = 0; i < (uint32_t)&core_memory_words; i++)
        core_memory_start[i] = 0; /* The memory's clock runs from reset on. */

    main();
    for (;;)
        __asm volatile("udf #0"); /* main() never returns. */
}
