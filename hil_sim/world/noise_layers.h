/* noise_layers.h: the layers of the Ziggurat that noise_normal() draws from, of Doornik 2005 ("An improved Ziggurat
 * method to generate normal random samples").
 *
 * The area below f(x) = exp(-x^2 / 2), x above 0, is cut in NOISE_LAYERS layers of the same area, one on the other.
 * Layer i above the lowest reaches from 0 to noise_layers[i], and its upper edge meets the curve at noise_layers[i +
 * 1]; the lowest is a rectangle as wide as noise_layers[1], and the tail beyond. noise_layers[0] is how wide a
 * rectangle of the lowest layer's height and area is.
 */
#ifndef GOLDFIELD_WORLD_NOISE_LAYERS_H
#define GOLDFIELD_WORLD_NOISE_LAYERS_H

#define NOISE_LAYERS 256

extern const double noise_layers[NOISE_LAYERS + 1];

#endif
