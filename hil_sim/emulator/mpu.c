#include "emulator/mpu.h"

#include <stddef.h>

#define TYPE_EIGHT_REGIONS  0x00000800u
#define CONTROL_BITS        7u
#define CONTROL_BACKGROUND  4u /* PRIVDEFENA */
#define RBAR_VALID          0x10u
#define RBAR_ADDRESS        0xFFFFFFE0u
#define RASR_BITS           0x173FFF3Fu
#define RASR_ENABLE         1u
#define RASR_NO_EXECUTE     (1u << 28)
#define PRIVATE_BUS         0xE0000000u
#define PRIVATE_BUS_SIZE    0x00100000u
#define SMALLEST_SUBREGIONS 256u /* A region below this size has none. */

enum { TYPE = 0xE000ED90, CONTROL = 0xE000ED94, NUMBER = 0xE000ED98, RBAR = 0xE000ED9C, LAST = 0xE000EDB8 };

/* RBAR, RASR and their three aliases alternate. */
static bool is_base(uint32_t address) {
    return ((address - RBAR) & 4u) == 0;
}

bool mpu_read(const mpu_t *mpu, uint32_t address, uint32_t *value) {
    if (address < TYPE || address > LAST) {
        return false;
    }
    *value = address == TYPE      ? TYPE_EIGHT_REGIONS
             : address == CONTROL ? mpu->control
             : address == NUMBER  ? mpu->number
             : is_base(address)   ? mpu->base[mpu->number] | mpu->number
                                  : mpu->attributes[mpu->number];
    return true;
}

static void take_region(mpu_t *mpu, unsigned i) {
    const unsigned log_size = (mpu->attributes[i] >> 1 & 31u) + 1u;
    const bool holds = (mpu->attributes[i] & RASR_ENABLE) != 0 && log_size >= 5;
    mpu->beyond[i] = holds ? (uint32_t)((UINT64_C(1) << log_size) - 1u) : 0;
    mpu->first[i] = mpu->base[i] & ~mpu->beyond[i];
    mpu->used = MPU_REGIONS;
    while (mpu->used > 0 && mpu->beyond[mpu->used - 1u] == 0) {
        mpu->used--;
    }
}

bool mpu_write(mpu_t *mpu, uint32_t address, uint32_t value, bool *changed) {
    if (address < TYPE || address > LAST) {
        return false;
    }
    const bool was_enabled = mpu_enabled(mpu);
    if (address == CONTROL) {
        mpu->control = value & CONTROL_BITS;
    } else if (address == NUMBER) {
        mpu->number = value % MPU_REGIONS;
    } else if (address > NUMBER && is_base(address)) {
        if ((value & RBAR_VALID) != 0) {
            mpu->number = value & 0xFu & (MPU_REGIONS - 1u);
        }
        mpu->base[mpu->number] = value & RBAR_ADDRESS;
        take_region(mpu, mpu->number);
    } else if (address > NUMBER) {
        mpu->attributes[mpu->number] = value & RASR_BITS;
        take_region(mpu, mpu->number);
    }
    *changed = (was_enabled || mpu_enabled(mpu)) && address != NUMBER && address != TYPE;
    return true;
}

/* The region of the highest number that holds the address; NULL: none does. */
static const uint32_t *find(const mpu_t *mpu, uint32_t address) {
    for (unsigned i = mpu->used; i-- > 0;) {
        const uint32_t offset = address - mpu->first[i];
        if (offset > mpu->beyond[i] || mpu->beyond[i] == 0) {
            continue;
        }
        const uint64_t size = (uint64_t)mpu->beyond[i] + 1u;
        if (size >= SMALLEST_SUBREGIONS && (mpu->attributes[i] >> (8u + (unsigned)(offset / (size / 8u))) & 1u) != 0) {
            continue; /* The subregion is switched off. */
        }
        return &mpu->attributes[i];
    }
    return NULL;
}

bool mpu_uniform(const mpu_t *mpu, uint32_t address, uint32_t size) {
    for (unsigned i = 0; i < MPU_REGIONS; i++) {
        const bool meets = address - mpu->first[i] <= mpu->beyond[i] || mpu->first[i] - address < size;
        if (meets && mpu->beyond[i] != 0 && (uint64_t)mpu->beyond[i] + 1u < UINT64_C(8) * size) {
            return false;
        }
    }
    return true;
}

/* AP: 1 and up let the privileged read, 1, 2 and 3 write; the others less (table B3-15). */
static bool permits(uint32_t attributes, mpu_access_t access, bool privileged) {
    const unsigned permission = attributes >> 24 & 7u;
    const bool writes = privileged ? permission >= 1 && permission <= 3 : permission == 3;
    const bool reads = privileged ? permission != 0 && permission != 4
                                  : permission == 2 || permission == 3 || permission >= 6;
    return access == MPU_WRITE ? writes : reads && (access == MPU_READ || (attributes & RASR_NO_EXECUTE) == 0);
}

bool mpu_allows(const mpu_t *mpu, uint32_t address, mpu_access_t access, bool privileged) {
    if (!mpu_enabled(mpu) || address - PRIVATE_BUS < PRIVATE_BUS_SIZE) {
        return true;
    }
    const uint32_t *const attributes = find(mpu, address);
    if (attributes == NULL) {
        return (mpu->control & CONTROL_BACKGROUND) != 0 && privileged;
    }
    return permits(*attributes, access, privileged);
}
