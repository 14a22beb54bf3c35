/* mpu.h: the memory protection unit (ARMv7-M architecture reference manual, B3.5): eight regions with subregions.
 *
 * mpu_read() and mpu_write() are its registers; mpu_allows() judges an access, and mpu_apply() lets Unicorn stop at the
 * pages in which something is forbidden, upon each change.
 *
 * Enforced are the core's accesses to peripherals, its reads, writes and fetches in memories, also those of the
 * floating-point unit, and the frames of exceptions. Unicorn protects pages of 1 KB: where rules change within one,
 * writes and fetches are judged by their exact address, but reads are all allowed; a read that is allowed is not judged
 * again in its page until the rules change or a read is refused; a fetch is judged when its code is translated. An
 * unprivileged program is judged in memories only where a page is restricted for the privileged too. Not enforced:
 * memory attributes (TEX, S, C, B), LDRT and STRT. The private peripheral bus is always open.
 */
#ifndef GOLDFIELD_MPU_H
#define GOLDFIELD_MPU_H

#include <stdbool.h>
#include <stdint.h>

enum { MPU_REGIONS = 8 };

typedef enum { MPU_READ, MPU_WRITE, MPU_FETCH } mpu_access_t;

typedef struct {
    uint32_t control, number;
    uint32_t base[MPU_REGIONS], attributes[MPU_REGIONS]; /* RBAR's address, RASR. */
    uint32_t first[MPU_REGIONS], beyond[MPU_REGIONS]; /* What each holds: an address, and so many behind it; 0: none. */
    unsigned used;                                    /* One more than the highest region that holds anything. */
    bool applied;                                     /* Unicorn's pages have rules. */
} mpu_t;

/* Registers at 0xE000ED90..0xE000EDB8. Return false if there is none; *changed: the rules did. */
bool mpu_read(const mpu_t *mpu, uint32_t address, uint32_t *value);
bool mpu_write(mpu_t *mpu, uint32_t address, uint32_t value, bool *changed);

static inline bool mpu_enabled(const mpu_t *mpu) {
    return (mpu->control & 1u) != 0;
}

/* Whether the same rules hold for each address of an aligned block, whose size is a power of two. */
bool mpu_uniform(const mpu_t *mpu, uint32_t address, uint32_t size);

/* Whether the rules allow an access to one address, for a privileged program or any. */
bool mpu_allows(const mpu_t *mpu, uint32_t address, mpu_access_t access, bool privileged);

#endif
