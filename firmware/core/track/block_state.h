/* block_state.h: the state of a moving sensor, and what is done with it: move it by small errors, tell two of them
 * apart, and let time pass. Turns are taken as what they are, rotation vectors, of any length.
 *
 * Time: about 150 instructions a call.
 */
#ifndef GOLDFIELD_BLOCK_STATE_H
#define GOLDFIELD_BLOCK_STATE_H

#define BLOCK_STATES 18u /* Errors of the state: six vectors, in this order. */

/* Where the vectors begin among the errors. */
enum { BLOCK_P = 0, BLOCK_THETA = 3, BLOCK_V = 6, BLOCK_W = 9, BLOCK_E = 12, BLOCK_B = 15 };

typedef struct {
    float position_m[3], quaternion[4];   /* Attitude x, y, z, w: B_site = R B_sensor. */
    float velocity_m_s[3], rate_rad_s[3]; /* In the site's frame. */
    float ambient_uT[3];                  /* Ambient field in the site's frame. */
    float offset_uT[3];                   /* Offset of the sensor in its own frame. */
} block_state_t;

/* Compute a state that differs from another, or from what it was itself, by errors; the one of the attitude is a
 * rotation vector in the site's frame. */
void block_state_move(const block_state_t *from, const float errors[BLOCK_STATES], block_state_t *state);

/* Compute the errors by which a state differs from another. An angle of 1 rad is told 2e-5 of itself too short, one of
 * 2 rad 0.8 %, half a turn 16 %. */
void block_state_subtract(const block_state_t *state, const block_state_t *other, float errors[BLOCK_STATES]);

/* Let so many seconds pass at constant velocity and turn rate; turn becomes the rotation by which it turned. */
void block_state_advance(block_state_t *state, float seconds, float turn[3][3]);

#endif
