/* install.c: any state of an update, any of its calls; what comes of it is one of these states again. */

/* The source itself, so that the harness can name the steps of a phase, which are private. */
#include "core/boot/install.c"

#include "any.h"

#define WORDS 98304u /* Words of a slot of the STM32F405. */

static uint32_t slot_a[WORDS], slot_b[WORDS]; /* What leaves one does not come into the other. */
static uint8_t key[IMAGE_KEY_BYTES];

static image_flash_t any_flash(void) {
    fill(slot_a, sizeof slot_a);
    fill(slot_b, sizeof slot_b);
    fill(key, sizeof key);
    image_flash_t flash = {.slot = {slot_a, slot_b}, .words = WORDS};
    flash.address[0] = any_word();
    flash.address[1] = any_word();
    flash.board = any_word();
    flash.key = any_up_to(1) != 0u ? key : NULL;
    return flash;
}

/* Any state in which a phase can be between two calls. */
static install_t any_install(install_phase_t phase) {
    install_t install = {.flash = any_flash(), .phase = phase};
    install.running = any_up_to(IMAGE_SLOTS - 1u);
    install.words = Frama_C_unsigned_int_interval(phase == INSTALL_IDLE ? 0u : IMAGE_CODE, WORDS);
    install.forced = any_up_to(1) != 0u;
    install.cursor = any_up_to(length(&install));
    install.step.kind = (install_kind_t)any_up_to(INSTALL_ERASE);
    install.step.slot = any_up_to(IMAGE_SLOTS - 1u);
    install.step.index = any_up_to(install.step.kind == INSTALL_ERASE ? WORDS : IMAGE_STATE_WORDS - 1u);
    install.step.value = any_word();
    return install;
}

/* Whether a state is one of any_install(). */
static void check(const install_t *install) {
    uint32_t steps, last;
    //@ assert install->phase <= INSTALL_FAILED;
    //@ split install->phase;
    steps = length(install);
    //@ split install->step.kind;
    last = install->step.kind == INSTALL_ERASE ? WORDS : IMAGE_STATE_WORDS - 1u;
    //@ assert install->running < IMAGE_SLOTS && install->words <= WORDS;
    //@ assert install->cursor <= steps;
    //@ assert install->step.kind <= INSTALL_ERASE && install->step.slot < IMAGE_SLOTS;
    //@ assert install->step.index <= last;
}

int main(void) {
    install_t opened;
    const image_flash_t flash = any_flash();
    install_open(&opened, &flash, any_up_to(IMAGE_SLOTS - 1u));
    check(&opened);
    for (install_phase_t phase = INSTALL_IDLE; phase <= INSTALL_FAILED; phase++) {
        install_t install = any_install(phase);
        (void)install_phase(&install);
        (void)install_next(&install);
        check(&install);
        install = any_install(phase);
        (void)install_confirm(&install);
        check(&install);
        install = any_install(phase);
        (void)install_begin(&install, any_word(), any_up_to(1) != 0u);
        check(&install);
        install = any_install(phase);
        (void)install_end(&install);
        check(&install);
        const uint32_t index = any_word();
        if (install_takes(&install, index)) {
            //@ assert IMAGE_STATE_WORDS <= index < WORDS;
        }
    }
    return 0;
}
