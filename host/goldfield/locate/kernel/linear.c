#include "linear.h"

#include <math.h>

#define MOST_SWEEPS 20

/* Part of the matrix's norm that an element off the diagonal may keep. */
#define ROUNDING 1e-17

/* Tangent of a turn whose cosine is 1 but for rounding: no root is taken for it. */
#define SMALL_TURN 1e-9

/* No root is taken, which would wait for the one before: the product of each element and its pivot is kept beside it
 * until the row is done. */
static inline bool factor(size_t n, const double a[][6], double l[][6]) {
    for (size_t i = 0; i < n; ++i) {
        double times_pivot[GF_MOST_UNKNOWNS];
        double pivot = a[i][i];
        for (size_t j = 0; j < i; ++j) {
            double sum = a[i][j];
            for (size_t k = 0; k < j; ++k) {
                sum -= times_pivot[k] * l[j][k];
            }
            times_pivot[j] = sum;
            l[i][j] = sum * l[j][j];
            pivot -= sum * l[i][j];
        }
        if (!(pivot > 0.0 && isfinite(pivot))) {
            return false;
        }
        l[i][i] = 1.0 / pivot; /* only divisions follow */
    }
    return true;
}

static inline void substitute(size_t n, const double l[][6], const double b[], double x[]) {
    for (size_t i = 0; i < n; ++i) {
        double sum = b[i];
        for (size_t k = 0; k < i; ++k) {
            sum -= l[i][k] * x[k];
        }
        x[i] = sum;
    }
    for (size_t i = n; i-- > 0;) {
        double sum = x[i] * l[i][i];
        for (size_t k = i + 1; k < n; ++k) {
            sum -= l[k][i] * x[k];
        }
        x[i] = sum;
    }
}

/* The compiler unrolls the loops of these where it knows how long they are. */
bool gf_factor(size_t n, const double a[][6], double l[][6]) {
    return n == 6 ? factor(6, a, l) : n == 3 ? factor(3, a, l) : factor(n, a, l);
}

void gf_substitute(size_t n, const double l[][6], const double b[], double x[]) {
    if (n == 6) {
        substitute(6, l, b, x);
    } else if (n == 3) {
        substitute(3, l, b, x);
    } else {
        substitute(n, l, b, x);
    }
}

static inline double promise(size_t n, const double l[][6], const double b[]) {
    double along[GF_MOST_UNKNOWNS];
    double sum = 0.0;
    for (size_t i = 0; i < n; ++i) {
        along[i] = b[i];
        for (size_t k = 0; k < i; ++k) {
            along[i] -= l[i][k] * along[k];
        }
        sum += along[i] * along[i] * l[i][i];
    }
    return sum;
}

bool gf_promise(size_t n, const double a[][6], const double b[], double *out) {
    double l[GF_MOST_UNKNOWNS][GF_MOST_UNKNOWNS];
    if (!gf_factor(n, a, l)) {
        return false;
    }
    *out = n == 6 ? promise(6, (const double(*)[6])l, b) : promise(n, (const double(*)[6])l, b);
    return true;
}

bool gf_solve(size_t n, const double a[][6], const double b[], double x[]) {
    double l[GF_MOST_UNKNOWNS][GF_MOST_UNKNOWNS];
    if (!gf_factor(n, a, l)) {
        return false;
    }
    gf_substitute(n, (const double(*)[6])l, b, x);
    return true;
}

static inline void rotate(double *x, double *y, double cosine, double sine) {
    const double old = *x;
    *x = cosine * old - sine * *y;
    *y = sine * old + cosine * *y;
}

static inline void eigen(size_t n, double a[][6], double v[][6]) {
    double norm = 0.0;
    for (size_t i = 0; i < n; ++i) {
        for (size_t j = 0; j < n; ++j) {
            const double size = fabs(a[i][j]);
            v[i][j] = i == j ? 1.0 : 0.0;
            norm = size > norm ? size : norm;
        }
    }
    bool turned = true;
    for (size_t sweep = 0; turned && sweep < MOST_SWEEPS; ++sweep) {
        turned = false;
        for (size_t p = 0; p + 1 < n; ++p) {
            for (size_t q = p + 1; q < n; ++q) {
                if (!(fabs(a[p][q]) > ROUNDING * norm)) {
                    continue;
                }
                turned = true;
                const double apart = a[q][q] - a[p][p];
                double tangent;
                double cosine = 1.0;
                if (fabs(a[p][q]) < SMALL_TURN * fabs(apart)) {
                    tangent = a[p][q] / apart;
                } else {
                    const double ratio = apart / (2.0 * a[p][q]);
                    tangent = copysign(1.0, ratio) / (fabs(ratio) + sqrt(ratio * ratio + 1.0));
                    cosine = 1.0 / sqrt(tangent * tangent + 1.0);
                }
                const double sine = tangent * cosine;
                const double moved = tangent * a[p][q];
                a[p][p] -= moved;
                a[q][q] += moved;
                a[p][q] = 0.0;
                /* Only what stands above the diagonal is kept. */
                for (size_t i = 0; i < p; ++i) {
                    rotate(&a[i][p], &a[i][q], cosine, sine);
                }
                for (size_t i = p + 1; i < q; ++i) {
                    rotate(&a[p][i], &a[i][q], cosine, sine);
                }
                for (size_t i = q + 1; i < n; ++i) {
                    rotate(&a[p][i], &a[q][i], cosine, sine);
                }
                for (size_t i = 0; i < n; ++i) {
                    rotate(&v[i][p], &v[i][q], cosine, sine);
                }
            }
        }
    }
}

void gf_eigen(size_t n, double a[][6], double v[][6]) {
    if (n == 3) {
        eigen(3, a, v);
    } else if (n == 4) {
        eigen(4, a, v);
    } else if (n == 6) {
        eigen(6, a, v);
    } else {
        eigen(n, a, v);
    }
}
