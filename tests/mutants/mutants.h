/* mutants.h: how an instrumented source asks which mutant it is to be.
 *
 * Two builds are made of one source. In the first, gf_mutant selects one mutant at run time, 0 selects none. In the
 * second, with GF_TRACE, none ever acts, but gf_infected tells which would have made a difference where it stands: a
 * test that infects no mutant cannot kill it. Both are compiled with this file in front.
 */
#ifndef GOLDFIELD_MUTANTS_H
#define GOLDFIELD_MUTANTS_H

/* Whether a mutant's place has operands that are real numbers: the compiler alone knows. */
typedef struct {
    int mutant, real;
} gf_kind_t;

extern int gf_mutant;
extern unsigned char gf_infected[];

#ifdef GF_TRACE
#define GF_ON(number)                (gf_infected[number] = 1, 0)
#define GF_TRY(number, value, other) ((void)(gf_infected[number] |= (unsigned char)((other) != (value))))
#else
#define GF_ON(number)                __builtin_expect(gf_mutant == (number), 0)
#define GF_TRY(number, value, other) ((void)(GF_ON(number) ? ((value) = (other)) : (value)))
#endif

#define GF_REAL(value) (__builtin_classify_type(value) == 8)
#define GF_KIND(number, value)                                                                                         \
    { static const gf_kind_t gf_kind __attribute__((section("gf_kinds"), used)) = {number, GF_REAL(value)}; }

/* A constant that is a little more: one more, or a tenth. */
#define GF_MORE(value) __builtin_choose_expr(GF_REAL(value), (value)*1.1f, (value) + 1)

#endif
