#include "core/pose/pose_live.h"

static const pose_verdict_t UNKNOWN = {.row = POSE_NOBODY, .reason = POSE_REASON_PENDING};

void pose_live_forget(pose_live_t *live) {
    live->verdict = UNKNOWN;
    live->busy = live->reviewing = false;
}

void pose_live_begin(pose_live_t *live, const pose_site_t *site, const pose_field_t *fields, pose_t *pose) {
    live->review_age++;
    live->age++;
    if (live->age > POSE_LIVE_CYCLES) {
        live->verdict = UNKNOWN;
    }
    pose_begin(site, fields, true, &live->verdict, &live->work, pose);
    live->busy = true;
}

bool pose_live_step(pose_live_t *live, pose_t *pose) {
    live->busy = !pose_step(&live->work, pose);
    if (!live->busy && live->work.alarmed && !live->reviewing) {
        pose_review(&live->work, &live->review, &live->reviewed);
        live->review_age = 0;
        live->reviewing = true;
    }
    return !live->busy;
}

bool pose_live_spare(pose_live_t *live) {
    if (!live->reviewing) {
        return false;
    }
    if (pose_step(&live->review, &live->reviewed)) {
        live->reviewing = false;
        live->age = live->review_age;
        live->verdict = (pose_verdict_t){.row = live->reviewed.left_out, .reason = live->reviewed.reason};
    }
    return true;
}
