/* What CMSIS-DSP takes from CMSIS-Core, of which it needs little: the compiler's own intrinsics of the Cortex-M4. */
#ifndef CMSIS_COMPILER_H
#define CMSIS_COMPILER_H

#include <stdint.h>

#define __ASM                __asm
#define __STATIC_INLINE      static inline
#define __STATIC_FORCEINLINE __attribute__((always_inline)) static inline
#define __ALIGNED(x)         __attribute__((aligned(x)))
#define __WEAK               __attribute__((weak))
#define __CLZ(x)             ((uint8_t)__builtin_clz(x))
#define __SSAT(x, bits)      __builtin_arm_ssat((x), (bits))
#define __USAT(x, bits)      __builtin_arm_usat((x), (bits))
#define __QADD(a, b)         __builtin_arm_qadd((a), (b))
#define __QSUB(a, b)         __builtin_arm_qsub((a), (b))
#define __QADD16(a, b)       __builtin_arm_qadd16((a), (b))
#define __QSUB16(a, b)       __builtin_arm_qsub16((a), (b))
#define __SMLAD(a, b, sum)   __builtin_arm_smlad((a), (b), (sum))
#define __SMLALD(a, b, sum)  __builtin_arm_smlald((a), (b), (int64_t)(sum))

#endif
