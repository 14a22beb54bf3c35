#ifndef RUNTIME_H
#define RUNTIME_H
#include <stdint.h>
#define RESULTS 8192u
extern uint32_t results[RESULTS], result_count;
extern volatile uint32_t finished;
void note(uint32_t value); /* Append to results. */
void finish(void);
#define REGISTER(address)          (*(volatile uint32_t *)(address))
#define CPACR                      REGISTER(0xE000ED88u)
#define ICSR                       REGISTER(0xE000ED04u)
#define AIRCR                      REGISTER(0xE000ED0Cu)
#define CCR                        REGISTER(0xE000ED14u)
#define SHCSR                      REGISTER(0xE000ED24u)
#define CFSR                       REGISTER(0xE000ED28u)
#define HFSR                       REGISTER(0xE000ED2Cu)
#define MMFAR                      REGISTER(0xE000ED34u)
#define BFAR                       REGISTER(0xE000ED38u)
#define MPU_CONTROL                REGISTER(0xE000ED94u)
#define MPU_BASE                   REGISTER(0xE000ED9Cu)
#define MPU_RULES                  REGISTER(0xE000EDA0u)
#define ISER                       REGISTER(0xE000E100u)
#define ICER                       REGISTER(0xE000E180u)
#define ISPR                       REGISTER(0xE000E200u)
#define ICPR                       REGISTER(0xE000E280u)
#define IABR                       REGISTER(0xE000E300u)
#define PRIORITY(n)                (*(volatile uint8_t *)(0xE000E400u + (n)))
#define SYSTEM_PRIORITY(exception) (*(volatile uint8_t *)(0xE000ED14u + (exception)))
#define SYSTICK_CONTROL            REGISTER(0xE000E010u)
#define SYSTICK_RELOAD             REGISTER(0xE000E014u)
#define SYSTICK_COUNT              REGISTER(0xE000E018u)
/* What MPU_RULES holds: who may do what with a region, and how large it is, as the logarithm of its bytes. */
#define NO_ACCESS  0u
#define READ_ONLY  (6u << 24)
#define NO_EXECUTE (1u << 28)
#define SIZE(log)  (((log)-1u) << 1)
#define BARRIER()  __asm volatile("dsb\n isb" ::: "memory")
#endif
