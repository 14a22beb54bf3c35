#include "emulator/memory_hooks.h"

#include "emulator/core_bus.h"
#include "emulator/flash_wait.h"
#include "emulator/it_block.h"
#include "emulator/protection.h"

#define PAGES_ASKED_MAX 20000u /* Questions after which Unicorn's table of pages is taken for too narrow. */

/* Before Unicorn asks about an access it puts the ITSTATE of its instruction back, goes on with the translated block,
 * which needs none, and begins the next block in that state: where the IT block is over long since, instructions would
 * be skipped. So it is taken away again. That of a fetch stays: it is between two blocks, and the next one's own. */
static void forget_it_state(cpu_t *cpu, uc_mem_type type) {
    if (type != UC_MEM_FETCH && type != UC_MEM_FETCH_UNMAPPED && type != UC_MEM_FETCH_PROT) {
        cpu_set_register(cpu, UC_ARM_REG_EPSR, XPSR_THUMB);
    }
}

/* ---- Pages ---- */

/* The default memory map (ARMv7-M manual, B3.1): a program never runs from peripherals and devices. */
static bool never_executes(uint32_t address) {
    return address >> 29 == 2 || address >= 0xA0000000u;
}

/* Unicorn asks what it may do in a page; the rights of regions come on top. */
static bool on_page(uc_engine *uc, uint64_t address, uc_mem_type type, uc_tlb_entry *page, void *user) {
    (void)uc;
    cpu_t *const cpu = user;
    const bool data_only = (address - SRAM_BASE < SRAM_SIZE && !cpu->sram_executable) || address - CCM_BASE < CCM_SIZE;
    cpu->pages_asked++;
    forget_it_state(cpu, type);
    if (type == UC_MEM_FETCH && never_executes((uint32_t)address)) {
        cpu->leave = LEAVE_EXCEPTION;
        cpu->leave_exception = UNICORN_PREFETCH_ABORT;
        return false;
    }
    const bool code = type == UC_MEM_FETCH || (!data_only && !never_executes((uint32_t)address));
    *page = (uc_tlb_entry){.paddr = address, .perms = UC_PROT_READ | UC_PROT_WRITE | (code ? UC_PROT_EXEC : 0)};
    return true;
}

/* Unicorn keeps one page a place, by the lowest bits of its number; it doubles the places if most are in use when it
 * forgets all pages, and has 64 if few were. Pages of memory and peripherals that the program needs all the time then
 * push each other out. So: use many, and let it forget them. */
static void widen_page_table(cpu_t *cpu) {
    uint64_t physical;
    for (unsigned doubling = 0; doubling < 4; doubling++) {
        for (uint32_t page = 0; page < 370; page++) { /* 72 % of 512: it ends with 1,024. */
            (void)uc_vmem_translate(cpu->uc, FLASH_BASE + page * 1024u, UC_PROT_READ, &physical);
        }
        uc_ctl_flush_tlb(cpu->uc);
    }
    cpu->pages_asked = 0;
}

void memory_hooks_before_run(cpu_t *cpu) {
    if (cpu->pages_asked >= PAGES_ASKED_MAX) {
        widen_page_table(cpu);
    }
}

/* ---- Accesses ---- */

static bool on_bad_memory(uc_engine *uc, uc_mem_type type, uint64_t address, int size, int64_t value, void *user) {
    (void)uc;
    cpu_t *const cpu = user;
    cpu->bad_address = (uint32_t)address;
    cpu->forbidden = false;
    forget_it_state(cpu, type);
    if (type == UC_MEM_WRITE_PROT && (uint32_t)address - FLASH_BASE < FLASH_SIZE &&
        protection_allows(cpu, (uint32_t)address, (unsigned)size, MPU_WRITE)) {
        core_bus_flash_store(cpu, (uint32_t)address, (unsigned)size, (uint64_t)value);
        return true; /* Unicorn drops the store. */
    }
    bool admitted = false;
    if (flash_wait_met(cpu, type, (uint32_t)address, (unsigned)size, &admitted)) {
        return admitted;
    }
    const bool protected = type == UC_MEM_READ_PROT || type == UC_MEM_WRITE_PROT || type == UC_MEM_FETCH_PROT;
    return protected && protection_admits(cpu, type, (uint32_t)address, (unsigned)size, (uint64_t)value);
}

static void on_access(uc_engine *uc, uc_mem_type type, uint64_t address, int size, int64_t value, void *user) {
    (void)uc;
    (void)value;
    cpu_t *const cpu = user;
    forget_it_state(cpu, type);
    if (size > 1 && (address & ((unsigned)size - 1u)) != 0 && cpu->fault.exception == 0) {
        core_bus_unaligned(cpu, (uint32_t)address, (unsigned)size, type == UC_MEM_WRITE);
    }
}

/* ---- Rules ---- */

/* Accesses that a region does not let pass. */
static uc_err hook_memory(cpu_t *cpu, uc_hook *hook, uint32_t first, uint32_t last) {
    return uc_hook_add(cpu->uc, hook, UC_HOOK_MEM_INVALID, (void *)on_bad_memory, cpu, first, last);
}

static void watch_ram(cpu_t *cpu) {
    for (unsigned i = 0; i < sizeof cpu->closed_ram / sizeof cpu->closed_ram[0]; i++) {
        closed_ram_t *const closed = &cpu->closed_ram[i];
        if (closed->hook != 0) {
            uc_hook_del(cpu->uc, closed->hook);
            closed->hook = 0;
        }
        if (closed->last != 0) {
            hook_memory(cpu, &closed->hook, closed->first, closed->last);
        }
    }
    uc_ctl_flush_tlb(cpu->uc); /* It may store at once into pages that it knows. */
}

static void watch_alignment(cpu_t *cpu) {
    const bool wanted = (cpu->system.ccr & CCR_UNALIGN_TRP) != 0;
    if (wanted == cpu->alignment_watched) {
        return;
    }
    if (wanted) {
        uc_hook_add(cpu->uc, &cpu->alignment_hook, UC_HOOK_MEM_READ | UC_HOOK_MEM_WRITE, (void *)on_access, cpu, 1, 0);
    } else {
        uc_hook_del(cpu->uc, cpu->alignment_hook);
    }
    uc_ctl_flush_tb(cpu->uc); /* Code that is translated already looks at no access. */
    cpu->alignment_watched = wanted;
}

void memory_hooks_follow_rules(cpu_t *cpu) {
    protection_apply(cpu);
    watch_ram(cpu);
    watch_alignment(cpu);
}

bool memory_hooks_open_sram(cpu_t *cpu) {
    if (cpu->sram_executable || cpu->pc - SRAM_BASE >= SRAM_SIZE) {
        return false;
    }
    cpu->sram_executable = true;
    if (cpu->system.mpu.applied) {
        protection_apply(cpu);
        watch_ram(cpu);
        return true;
    }
    return uc_mem_protect(cpu->uc, SRAM_BASE, SRAM_SIZE, UC_PROT_ALL) == UC_ERR_OK;
}

uc_err memory_hooks_create(cpu_t *cpu) {
    static const uint32_t outside_of_ram[][2] = {
        {0, CCM_BASE - 1u}, {CCM_BASE + CCM_SIZE, SRAM_BASE - 1u}, {SRAM_BASE + SRAM_SIZE, UINT32_MAX}};
    uc_err error = UC_ERR_OK;
    for (unsigned i = 0; i < 3 && error == UC_ERR_OK; i++) {
        error = hook_memory(cpu, &cpu->memory_hooks[i], outside_of_ram[i][0], outside_of_ram[i][1]);
    }
    if (error == UC_ERR_OK) {
        error = uc_ctl_tlb_mode(cpu->uc, UC_TLB_VIRTUAL); /* on_page() is asked in place of Unicorn's own rules. */
    }
    if (error == UC_ERR_OK) {
        error = uc_hook_add(cpu->uc, &cpu->page_hook, UC_HOOK_TLB_FILL, (void *)on_page, cpu, 1, 0);
    }
    return error;
}
