#include "emulator/protection.h"

#include <string.h>

enum { PAGE = 1024, GRANULE = 32 };

/* ---- Judging ---- */

/* Handlers of HardFault and NMI, and FAULTMASK, switch the unit off unless HFNMIENA is set. */
static bool unit_works(const cpu_t *cpu) {
    const mpu_t *const mpu = &cpu->system.mpu;
    const bool above = cpu->nvic.active_priority < 0 || (cpu_register(cpu, UC_ARM_REG_FAULTMASK) & 1u) != 0;
    return mpu_enabled(mpu) && (!above || (mpu->control & 2u) != 0);
}

/* Rules do not change within a granule. */
static bool allows(const cpu_t *cpu, uint32_t address, uint32_t size, mpu_access_t access, bool privileged) {
    bool good = true;
    for (uint32_t offset = 0; offset < size && good; offset = ((address + offset) | (GRANULE - 1u)) + 1u - address) {
        good = mpu_allows(&cpu->system.mpu, address + offset, access, privileged);
    }
    return good;
}

/* The registers that say who asks cost calls into Unicorn: they are read last. */
bool protection_allows(const cpu_t *cpu, uint32_t address, unsigned size, mpu_access_t access) {
    if (!mpu_enabled(&cpu->system.mpu)) {
        return true;
    }
    const bool privileged = cpu->nvic.active_priority < NVIC_IDLE_PRIORITY ||
                            (cpu_register(cpu, UC_ARM_REG_CONTROL) & 1u) == 0;
    return allows(cpu, address, size, access, privileged) || !unit_works(cpu);
}

bool protection_allows_frame(const cpu_t *cpu, uint32_t address, uint32_t size, mpu_access_t access, bool privileged) {
    return !mpu_enabled(&cpu->system.mpu) || allows(cpu, address, size, access, privileged) || !unit_works(cpu);
}

bool protection_admits(cpu_t *cpu, uc_mem_type type, uint32_t address, unsigned size, uint64_t value) {
    const mpu_access_t access = type == UC_MEM_WRITE_PROT ? MPU_WRITE : type == UC_MEM_READ_PROT ? MPU_READ : MPU_FETCH;
    if (!cpu->system.mpu.applied) {
        return false;
    }
    uint8_t *const memory = machine_memory(cpu->machine, address, size);
    const bool writable = address >> 24 == SRAM_BASE >> 24 || address >> 24 == CCM_BASE >> 24;
    const bool executable = address >> 24 != CCM_BASE >> 24 &&
                            (address >> 24 != SRAM_BASE >> 24 || cpu->sram_executable);
    if (memory == NULL || (access == MPU_WRITE && !writable) || (access == MPU_FETCH && !executable)) {
        return false;
    }
    if (!protection_allows(cpu, address, size, access)) {
        cpu->forbidden = true;
        return false;
    }
    if (access == MPU_WRITE) {
        memcpy(memory, &value, size);
    }
    return true;
}

/* ---- Pages ---- */

/* What a privileged program may do everywhere in a page; read: somewhere. */
static uint32_t page_rights(const mpu_t *mpu, uint32_t page, uint32_t possible) {
    static const struct {
        mpu_access_t access;
        uint32_t right;
    } kinds[] = {{MPU_READ, UC_PROT_READ}, {MPU_WRITE, UC_PROT_WRITE}, {MPU_FETCH, UC_PROT_EXEC}};
    uint32_t rights = possible;
    const uint32_t step = mpu_uniform(mpu, page, PAGE) ? PAGE : GRANULE;
    for (unsigned i = 0; i < 3; i++) {
        unsigned allowed = 0;
        for (uint32_t offset = 0; offset < PAGE; offset += step) {
            allowed += mpu_allows(mpu, page + offset, kinds[i].access, true) ? 1u : 0u;
        }
        const bool keep = kinds[i].access == MPU_READ ? allowed != 0 : allowed == PAGE / step;
        rights &= keep ? UC_PROT_ALL : ~kinds[i].right;
    }
    return rights;
}

static void set_rights(cpu_t *cpu, uint32_t base, uint32_t size, uint32_t rights, uint32_t possible) {
    uc_mem_protect(cpu->uc, base, size, rights);
    const bool sram = base >> 24 == SRAM_BASE >> 24;
    if (rights != possible && (sram || base >> 24 == CCM_BASE >> 24)) {
        closed_ram_t *const closed = &cpu->closed_ram[sram ? 0 : 1];
        closed->first = closed->last == 0 ? base : closed->first;
        closed->last = base + size - 1u;
    }
}

static void protect(cpu_t *cpu, uint32_t base, uint32_t size, uint32_t possible) {
    const mpu_t *const mpu = &cpu->system.mpu;
    uint32_t start = 0, rights = mpu_enabled(mpu) ? page_rights(mpu, base, possible) : possible;
    for (uint32_t page = PAGE; page < size && mpu_enabled(mpu); page += PAGE) {
        const uint32_t next = page_rights(mpu, base + page, possible);
        if (next != rights) {
            set_rights(cpu, base + start, page - start, rights, possible);
            start = page;
            rights = next;
        }
    }
    set_rights(cpu, base + start, size - start, rights, possible);
}

void protection_apply(cpu_t *cpu) {
    mpu_t *const mpu = &cpu->system.mpu;
    if (!mpu_enabled(mpu) && !mpu->applied) {
        return;
    }
    const uint32_t code = UC_PROT_READ | UC_PROT_EXEC, data = UC_PROT_READ | UC_PROT_WRITE;
    cpu->closed_ram[0].last = cpu->closed_ram[1].last = 0;
    protect(cpu, 0, FLASH_SIZE, code);
    protect(cpu, FLASH_BASE, FLASH_SIZE, code);
    protect(cpu, SYSTEM_MEMORY_BASE, SYSTEM_MEMORY_SIZE, code);
    protect(cpu, SRAM_BASE, SRAM_SIZE, data | (cpu->sram_executable ? (uint32_t)UC_PROT_EXEC : 0u));
    protect(cpu, CCM_BASE, CCM_SIZE, data);
    mpu->applied = mpu_enabled(mpu);
    cpu->flash.closed_loads = cpu->flash.closed_fetches = 0;
    cpu->flash.changed = true;
}

void protection_close(cpu_t *cpu, uint64_t loads, uint64_t fetches, uint64_t which) {
    for (unsigned piece = 0; piece < FLASH_SIZE / FLASH_PIECE; piece++) {
        if ((which >> piece & 1u) != 0) {
            const uint32_t rights = ((loads >> piece & 1u) != 0 ? 0u : (uint32_t)UC_PROT_READ) |
                                    ((fetches >> piece & 1u) != 0 ? 0u : (uint32_t)UC_PROT_EXEC);
            protect(cpu, piece * FLASH_PIECE, FLASH_PIECE, rights);
            protect(cpu, FLASH_BASE + piece * FLASH_PIECE, FLASH_PIECE, rights);
        }
    }
}
