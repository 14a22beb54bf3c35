/* registers.h: the registers of the STM32F405 that this board uses, and only those.
 *
 * Names are those of the reference manual (RM0090) and ST's SVD; tests/firmware/boards/stm32f405/test_registers.py
 * checks every base address, offset and bit against the SVD. A bit constant is named PERIPHERAL_REGISTER_FIELD, with
 * _VALUE behind it if the field has a chosen value. The core's registers (SysTick, NVIC, SCB) are those of the ARMv7-M
 * Architecture Reference Manual, B3.2 to B3.4.
 */
#ifndef STM32F405_REGISTERS_H
#define STM32F405_REGISTERS_H

#include <stdint.h>

/* ---- Clocks ---- */

typedef struct {
    volatile uint32_t CR, PLLCFGR, CFGR, CIR;
    volatile uint32_t AHB1RSTR, AHB2RSTR, AHB3RSTR, reserved0;
    volatile uint32_t APB1RSTR, APB2RSTR, reserved1[2];
    volatile uint32_t AHB1ENR, AHB2ENR, AHB3ENR, reserved2;
    volatile uint32_t APB1ENR, APB2ENR, reserved3[2];
    volatile uint32_t AHB1LPENR, AHB2LPENR, AHB3LPENR, reserved4;
    volatile uint32_t APB1LPENR, APB2LPENR, reserved5[2];
    volatile uint32_t BDCR, CSR;
} RCC_registers;
#define RCC ((RCC_registers *)0x40023800u)

#define RCC_CR_HSION         (1u << 0)
#define RCC_CR_HSIRDY        (1u << 1)
#define RCC_CR_HSEON         (1u << 16)
#define RCC_CR_HSERDY        (1u << 17)
#define RCC_CR_CSSON         (1u << 19)
#define RCC_CR_PLLON         (1u << 24)
#define RCC_CR_PLLRDY        (1u << 25)
#define RCC_PLLCFGR_PLLSRC   (1u << 22) /* 1: crystal. */
#define RCC_CFGR_SW1         (1u << 1)  /* System clock: PLL. */
#define RCC_CFGR_SWS0        (1u << 2)
#define RCC_CFGR_SWS1        (1u << 3)
#define RCC_CFGR_PPRE1_DIV4  (5u << 10)
#define RCC_CFGR_PPRE2_DIV2  (4u << 13)
#define RCC_CIR_CSSF         (1u << 7)
#define RCC_CIR_CSSC         (1u << 23)
#define RCC_AHB1ENR_GPIOAEN  (1u << 0)
#define RCC_AHB1ENR_GPIOBEN  (1u << 1)
#define RCC_AHB1ENR_GPIOCEN  (1u << 2)
#define RCC_AHB1ENR_DMA1EN   (1u << 21)
#define RCC_AHB1ENR_DMA2EN   (1u << 22)
#define RCC_AHB2ENR_RNGEN    (1u << 6)
#define RCC_APB1ENR_TIM2EN   (1u << 0)
#define RCC_APB1ENR_TIM3EN   (1u << 1)
#define RCC_APB1ENR_TIM4EN   (1u << 2)
#define RCC_APB1ENR_TIM7EN   (1u << 5)
#define RCC_APB1ENR_USART3EN (1u << 18)
#define RCC_APB1ENR_CAN1EN   (1u << 25)
#define RCC_APB1ENR_PWREN    (1u << 28)
#define RCC_APB1ENR_DACEN    (1u << 29)
#define RCC_APB2ENR_TIM1EN   (1u << 0)
#define RCC_APB2ENR_TIM8EN   (1u << 1)
#define RCC_APB2ENR_ADC1EN   (1u << 8)
#define RCC_APB2ENR_ADC2EN   (1u << 9)
#define RCC_APB2ENR_ADC3EN   (1u << 10)
#define RCC_APB2RSTR_ADCRST  (1u << 8) /* All converters. */
#define RCC_CSR_RMVF         (1u << 24)
#define RCC_CSR_BORRSTF      (1u << 25)
#define RCC_CSR_PADRSTF      (1u << 26) /* RM0090 calls it PINRSTF. */
#define RCC_CSR_PORRSTF      (1u << 27)
#define RCC_CSR_SFTRSTF      (1u << 28)
#define RCC_CSR_WDGRSTF      (1u << 29) /* RM0090 calls it IWDGRSTF. */
#define RCC_CSR_WWDGRSTF     (1u << 30)
#define RCC_CSR_LPWRRSTF     (1u << 31)

typedef struct {
    volatile uint32_t ACR, KEYR, OPTKEYR, SR, CR, OPTCR;
} FLASH_registers;
#define FLASH ((FLASH_registers *)0x40023C00u)

#define FLASH_ACR_LATENCY_5 (5u << 0)
#define FLASH_ACR_PRFTEN    (1u << 8)
#define FLASH_ACR_ICEN      (1u << 9)
#define FLASH_ACR_DCEN      (1u << 10)
#define FLASH_ACR_ICRST     (1u << 11)
#define FLASH_ACR_DCRST     (1u << 12)
#define FLASH_SR_WRPERR     (1u << 4)
#define FLASH_SR_PGAERR     (1u << 5)
#define FLASH_SR_PGPERR     (1u << 6)
#define FLASH_SR_PGSERR     (1u << 7)
#define FLASH_SR_BSY        (1u << 16)
#define FLASH_CR_PG         (1u << 0)
#define FLASH_CR_SER        (1u << 1)
#define FLASH_CR_SNB_1      (1u << 3) /* Sector 1; sector 2 is twice that. */
#define FLASH_CR_PSIZE_32   (2u << 8)
#define FLASH_CR_STRT       (1u << 16)
#define FLASH_CR_LOCK       (1u << 31)

typedef struct {
    volatile uint32_t CR, CSR;
} PWR_registers;
#define PWR ((PWR_registers *)0x40007000u)

#define PWR_CR_PVDE    (1u << 4)
#define PWR_CR_PLS_2V7 (5u << 5)
#define PWR_CSR_PVDO   (1u << 2)

/* ---- Debugging ---- */

typedef struct {
    volatile uint32_t DBGMCU_IDCODE, DBGMCU_CR, DBGMCU_APB1_FZ;
} DBG_registers;
#define DBG ((DBG_registers *)0xE0042000u)

#define DBG_DBGMCU_APB1_FZ_DBG_IWDEG_STOP (1u << 12) /* RM0090 calls it DBG_IWDG_STOP. */

/* ---- Pins ---- */

typedef struct {
    volatile uint32_t MODER, OTYPER, OSPEEDR, PUPDR, IDR, ODR, BSRR, LCKR, AFRL, AFRH;
} GPIO_registers;
#define GPIOA ((GPIO_registers *)0x40020000u)
#define GPIOB ((GPIO_registers *)0x40020400u)
#define GPIOC ((GPIO_registers *)0x40020800u)

typedef struct {
    volatile uint32_t IMR, EMR, RTSR, FTSR, SWIER, PR;
} EXTI_registers;
#define EXTI ((EXTI_registers *)0x40013C00u)

/* ---- DMA ---- */

typedef struct {
    volatile uint32_t CR, NDTR, PAR, M0AR, M1AR, FCR;
} DMA_stream_registers;

typedef struct {
    volatile uint32_t LISR, HISR, LIFCR, HIFCR;
    DMA_stream_registers S[8];
} DMA_registers;
#define DMA1 ((DMA_registers *)0x40026000u)
#define DMA2 ((DMA_registers *)0x40026400u)

/* The bits of every stream's CR, named after stream 0. */
#define DMA_S0CR_EN                (1u << 0)
#define DMA_S0CR_TEIE              (1u << 2)
#define DMA_S0CR_HTIE              (1u << 3)
#define DMA_S0CR_TCIE              (1u << 4)
#define DMA_S0CR_DIR_TO_PERIPHERAL (1u << 6)
#define DMA_S0CR_CIRC              (1u << 8)
#define DMA_S0CR_MINC              (1u << 10)
#define DMA_S0CR_PSIZE_16          (1u << 11)
#define DMA_S0CR_PSIZE_32          (2u << 11)
#define DMA_S0CR_MSIZE_16          (1u << 13)
#define DMA_S0CR_MSIZE_32          (2u << 13)
#define DMA_S0CR_PL_MEDIUM         (1u << 16)
#define DMA_S0CR_PL_HIGH           (2u << 16)
#define DMA_S0CR_PL_VERY_HIGH      (3u << 16)
#define DMA_S0CR_CHSEL_4           (4u << 25)
#define DMA_S0CR_CHSEL_5           (5u << 25)
#define DMA_S0CR_CHSEL_6           (6u << 25)
#define DMA_S0CR_CHSEL_7           (7u << 25)

#define DMA_LISR_HTIF1 (1u << 10)
#define DMA_LISR_TCIF1 (1u << 11)
#define DMA_LISR_TEIF3 (1u << 25)
#define DMA_LISR_TCIF3 (1u << 27)
/* All five flags of a stream. */
#define DMA_LIFCR_STREAM0 0x0000003Du
#define DMA_LIFCR_STREAM1 0x00000F40u
#define DMA_LIFCR_STREAM2 0x003D0000u
#define DMA_LIFCR_STREAM3 0x0F400000u
#define DMA_HIFCR_STREAM4 0x0000003Du
#define DMA_HIFCR_STREAM5 0x00000F40u
#define DMA_HIFCR_STREAM7 0x0F400000u

/* ---- Timers ---- */

typedef struct {
    volatile uint32_t CR1, CR2, SMCR, DIER, SR, EGR, CCMR1_Output, CCMR2_Output, CCER, CNT, PSC, ARR, RCR, CCR1, CCR2,
        CCR3, CCR4, BDTR, DCR, DMAR;
} TIM_registers;
#define TIM1 ((TIM_registers *)0x40010000u)
#define TIM8 ((TIM_registers *)0x40010400u)
#define TIM2 ((TIM_registers *)0x40000000u) /* 32 bits wide; has neither RCR nor BDTR. */
#define TIM3 ((TIM_registers *)0x40000400u) /* Has neither RCR nor BDTR. */
#define TIM4 ((TIM_registers *)0x40000800u) /* As TIM3. */
#define TIM7 ((TIM_registers *)0x40001400u) /* Counts only: it has no channels. */

#define TIM_CR1_CEN              (1u << 0)
#define TIM_CR1_URS              (1u << 2) /* Only the end of the count is an update to tell of, not UG. */
#define TIM_CR1_OPM              (1u << 3)
#define TIM_CR1_ARPE             (1u << 7)
#define TIM_CR2_MMS_OC4REF       (7u << 4)
#define TIM_SMCR_SMS_RESET       (4u << 0)
#define TIM_DIER_UIE             (1u << 0)
#define TIM_DIER_CC1IE           (1u << 1)
#define TIM_DIER_BIE             (1u << 7)
#define TIM_DIER_UDE             (1u << 8)
#define TIM_DIER_CC4DE           (1u << 12)
#define TIM_SR_UIF               (1u << 0)
#define TIM_SR_BIF               (1u << 7)
#define TIM_EGR_UG               (1u << 0)
#define TIM_EGR_BG               (1u << 7)
#define TIM_CCMR1_CC1S_TI1       (1u << 0)
#define TIM_CCMR1_IC1F_8_SAMPLES (3u << 4)
#define TIM_CCMR1_OC1PE          (1u << 3)
#define TIM_CCMR1_OC1M_PWM1      (6u << 4)
#define TIM_CCMR1_OC1M_PWM2      (7u << 4)
#define TIM_CCMR1_OC2PE          (1u << 11)
#define TIM_CCMR1_OC2M_PWM1      (6u << 12)
#define TIM_CCMR2_OC3PE          (1u << 3)
#define TIM_CCMR2_OC3M_ACTIVE    (5u << 4)
#define TIM_CCMR2_OC3M_PWM1      (6u << 4)
#define TIM_CCMR2_OC4M_PWM1      (6u << 12)
#define TIM_CCER_CC1E            (1u << 0)
#define TIM_CCER_CC1NE           (1u << 2)
#define TIM_CCER_CC2E            (1u << 4)
#define TIM_CCER_CC2NE           (1u << 6)
#define TIM_CCER_CC3NE           (1u << 10)
#define TIM_BDTR_LOCK_3          (3u << 8)
#define TIM_BDTR_OSSI            (1u << 10)
#define TIM_BDTR_BKE             (1u << 12)
#define TIM_BDTR_MOE             (1u << 15)
#define TIM_DCR_DBA_ARR          (11u << 0) /* The register where a burst begins, by its number. */
#define TIM_DCR_DBA_CCR2         (14u << 0)
#define TIM_DCR_DBL_2            (1u << 8) /* The registers of a burst, less one. */
#define TIM_DCR_DBL_4            (3u << 8)

/* ---- Converters ---- */

typedef struct {
    volatile uint32_t SR, CR1, CR2, SMPR1, SMPR2, JOFR1, JOFR2, JOFR3, JOFR4, HTR, LTR, SQR1, SQR2, SQR3, JSQR, JDR1,
        JDR2, JDR3, JDR4, DR;
} ADC_registers;
#define ADC1 ((ADC_registers *)0x40012000u)
#define ADC2 ((ADC_registers *)0x40012100u)
#define ADC3 ((ADC_registers *)0x40012200u)

#define ADC_SR_EOC               (1u << 1)
#define ADC_SR_JEOC              (1u << 2)
#define ADC_CR1_EOCIE            (1u << 5)
#define ADC_CR1_JEOCIE           (1u << 7)
#define ADC_CR1_SCAN             (1u << 8)
#define ADC_CR2_ADON             (1u << 0)
#define ADC_CR2_JEXTSEL_TIM4_CC1 (6u << 16)
#define ADC_CR2_JEXTEN_RISING    (1u << 20)
#define ADC_CR2_JSWSTART         (1u << 22)
#define ADC_CR2_EXTSEL_TIM3_CC1  (7u << 24)
#define ADC_CR2_EXTEN_RISING     (1u << 28)

typedef struct {
    volatile uint32_t CSR, CCR, CDR;
} C_ADC_registers;
#define C_ADC ((C_ADC_registers *)0x40012300u)

#define C_ADC_CSR_OVR1                 (1u << 5)
#define C_ADC_CSR_OVR2                 (1u << 13)
#define C_ADC_CSR_OVR3                 (1u << 21)
#define C_ADC_CCR_MULT_TRIPLE_COMBINED (0x11u << 0) /* Regular simultaneous and injected simultaneous. */
#define C_ADC_CCR_DDS                  (1u << 13)
#define C_ADC_CCR_DMA_MODE1            (1u << 14)
#define C_ADC_CCR_ADCPRE_DIV4          (1u << 16)
#define C_ADC_CCR_TSVREFE              (1u << 23)

typedef struct {
    volatile uint32_t CR, SWTRIGR, DHR12R1, DHR12L1, DHR8R1, DHR12R2, DHR12L2, DHR8R2, DHR12RD;
} DAC_registers;
#define DAC ((DAC_registers *)0x40007400u)

#define DAC_CR_EN1        (1u << 0)
#define DAC_CR_BOFF1      (1u << 1)
#define DAC_CR_TEN1       (1u << 2)
#define DAC_CR_TSEL1_TIM8 (1u << 3)
#define DAC_CR_DMAEN1     (1u << 12)
#define DAC_CR_EN2        (1u << 16)
#define DAC_CR_BOFF2      (1u << 17)
#define DAC_CR_TEN2       (1u << 18)
#define DAC_CR_TSEL2_TIM8 (1u << 19)

/* ---- Links ---- */

typedef struct {
    volatile uint32_t SR, DR, BRR, CR1, CR2, CR3, GTPR;
} USART_registers;
#define USART3 ((USART_registers *)0x40004800u)

#define USART_SR_ORE    (1u << 3)
#define USART_SR_TXE    (1u << 7)
#define USART_CR1_RE    (1u << 2)
#define USART_CR1_TE    (1u << 3)
#define USART_CR1_UE    (1u << 13)
#define USART_CR1_OVER8 (1u << 15)
#define USART_CR3_DMAR  (1u << 6)
#define USART_CR3_DMAT  (1u << 7)

typedef struct {
    volatile uint32_t TIR, TDTR, TDLR, TDHR;
} CAN_mailbox_registers;

typedef struct {
    volatile uint32_t MCR, MSR, TSR, RF0R, RF1R, IER, ESR, BTR, reserved0[88];
    CAN_mailbox_registers T[3];
    volatile uint32_t RI0R, RDT0R, RDL0R, RDH0R, RI1R, RDT1R, RDL1R, RDH1R, reserved1[12];
    volatile uint32_t FMR, FM1R, reserved2, FS1R, reserved3, FFA1R, reserved4, FA1R, reserved5[8];
    volatile uint32_t F0R1, F0R2, F1R1, F1R2, F2R1, F2R2;
} CAN_registers;
#define CAN1 ((CAN_registers *)0x40006400u)

#define CAN_MCR_INRQ   (1u << 0)
#define CAN_MCR_TXFP   (1u << 2)
#define CAN_MCR_ABOM   (1u << 6)
#define CAN_MSR_INAK   (1u << 0)
#define CAN_MSR_ERRI   (1u << 2)
#define CAN_TSR_RQCP0  (1u << 0)
#define CAN_TSR_TXOK0  (1u << 1)
#define CAN_TSR_RQCP1  (1u << 8)
#define CAN_TSR_TXOK1  (1u << 9)
#define CAN_TSR_RQCP2  (1u << 16)
#define CAN_TSR_TXOK2  (1u << 17)
#define CAN_TSR_CODE   (3u << 24)
#define CAN_TSR_TME0   (1u << 26)
#define CAN_TSR_TME1   (1u << 27)
#define CAN_TSR_TME2   (1u << 28)
#define CAN_RF0R_FMP0  (3u << 0)
#define CAN_RF0R_FOVR0 (1u << 4)
#define CAN_RF0R_RFOM0 (1u << 5)
#define CAN_RF1R_FMP1  (3u << 0)
#define CAN_RF1R_FOVR1 (1u << 4)
#define CAN_RF1R_RFOM1 (1u << 5)
#define CAN_IER_TMEIE  (1u << 0)
#define CAN_IER_FMPIE0 (1u << 1)
#define CAN_IER_FMPIE1 (1u << 4)
#define CAN_IER_BOFIE  (1u << 10)
#define CAN_IER_LECIE  (1u << 11)
#define CAN_IER_ERRIE  (1u << 15)
#define CAN_ESR_BOFF   (1u << 2)
#define CAN_ESR_LEC    (7u << 4)
#define CAN_TI0R_TXRQ  (1u << 0)
#define CAN_TI0R_RTR   (1u << 1)
#define CAN_TI0R_IDE   (1u << 2)
#define CAN_FMR_FINIT  (1u << 0)

/* ---- Watchdog ---- */

typedef struct {
    volatile uint32_t KR, PR, RLR, SR;
} IWDG_registers;
#define IWDG ((IWDG_registers *)0x40003000u)

#define IWDG_KR_KEY_UNLOCK 0x5555u
#define IWDG_KR_KEY_RELOAD 0xAAAAu
#define IWDG_KR_KEY_START  0xCCCCu
#define IWDG_PR_PR_DIV16   (2u << 0)
#define IWDG_PR_PR_DIV64   (4u << 0)
#define IWDG_SR_PVU        (1u << 0)
#define IWDG_SR_RVU        (1u << 1)

/* ---- Random numbers ---- */

typedef struct {
    volatile uint32_t CR, SR, DR;
} RNG_registers;
#define RNG ((RNG_registers *)0x50060800u)

#define RNG_CR_RNGEN (1u << 2)
#define RNG_SR_DRDY  (1u << 0)
#define RNG_SR_SECS  (1u << 2)
#define RNG_SR_CEIS  (1u << 5)
#define RNG_SR_SEIS  (1u << 6)

/* ---- Processor core ---- */

typedef struct {
    volatile uint32_t CTRL, LOAD, VAL, CALIB;
} SYSTICK_registers;
#define SYSTICK                ((SYSTICK_registers *)0xE000E010u)
#define SYSTICK_CTRL_ENABLE    (1u << 0)
#define SYSTICK_CTRL_TICKINT   (1u << 1)
#define SYSTICK_CTRL_CLKSOURCE (1u << 2) /* 1: processor clock. */

typedef struct {
    volatile uint32_t ISER[8], reserved0[24];
    volatile uint32_t ICER[8], reserved1[24];
    volatile uint32_t ISPR[8], reserved2[24];
    volatile uint32_t ICPR[8], reserved3[24];
    volatile uint32_t IABR[8], reserved4[56];
    volatile uint8_t IPR[240];
} NVIC_registers;
#define NVIC ((NVIC_registers *)0xE000E100u)

typedef struct {
    volatile uint32_t CPUID, ICSR, VTOR, AIRCR, SCR, CCR, SHPR1, SHPR2, SHPR3, SHCSR, CFSR, HFSR, DFSR, MMFAR, BFAR,
        AFSR, reserved0[18], CPACR;
} SCB_registers;
#define SCB                ((SCB_registers *)0xE000ED00u)
#define SCB_CPACR_FPU_FULL (15u << 20)
/* Faults that have an exception of their own, rather than the hard fault. */
#define SCB_SHCSR_MEMFAULTENA (1u << 16)
#define SCB_SHCSR_BUSFAULTENA (1u << 17)
#define SCB_SHCSR_USGFAULTENA (1u << 18)
#define SCB_CFSR_MSTKERR      (1u << 4) /* The frame of an exception met a memory protection region. */
#define SCB_CFSR_MMARVALID    (1u << 7)
#define SCB_CFSR_STKERR       (1u << 12) /* The frame of an exception met a bus fault. */
#define SCB_CFSR_BFARVALID    (1u << 15)
#define SCB_ICSR_PENDSVSET    (1u << 28)
/* The system resets; the upper half is the key without which nothing is written (PM0214, 4.4.5). */
#define SCB_AIRCR_SYSRESETREQ (0x05FAu << 16 | 1u << 2)

typedef struct {
    volatile uint32_t TYPE, CTRL, RNR, RBAR, RASR;
} MPU_registers;
#define MPU                 ((MPU_registers *)0xE000ED90u)
#define MPU_CTRL_ENABLE     (1u << 0)
#define MPU_CTRL_PRIVDEFENA (1u << 2) /* What no region covers has the default map. */
#define MPU_RASR_ENABLE     (1u << 0)
#define MPU_RASR_XN         (1u << 28) /* No instruction is fetched from there. */

/* Positions of the interrupts in the vector table (RM0090, table 62). */
enum {
    IRQ_PVD = 1,
    IRQ_DMA1_STREAM1 = 12,
    IRQ_DMA1_STREAM3 = 14,
    IRQ_ADC = 18,
    IRQ_CAN1_TX = 19,
    IRQ_CAN1_RX0 = 20,
    IRQ_CAN1_RX1 = 21,
    IRQ_CAN1_SCE = 22,
    IRQ_TIM1_BRK_TIM9 = 24,
    IRQ_TIM8_BRK_TIM12 = 43,
    IRQ_TIM8_CC = 46,
    IRQ_TIM7 = 55,
    IRQ_DMA2_STREAM1 = 57,
    IRQ_COUNT = 82
};

/* ---- What ST wrote into system memory (RM0090, 39.1; data sheet, 5.3.22) ---- */

#define UNIQUE_ID ((const volatile uint32_t *)0x1FFF7A10u) /* Three words. */
/* Counts of the temperature sensor at 30 and at 110 degC, 3.3 V. */
#define TEMPERATURE_CALIBRATION ((const volatile uint16_t *)0x1FFF7A2Cu)

#endif
