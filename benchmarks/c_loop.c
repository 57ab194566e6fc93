/* The exact overlap test as one would write it by hand in C: the yardstick of
 * benchmarks.against_c. One loop over float32 arrays, component after component:
 * C, e, K, a are (3, n), U and V (3, 3, n), in the letters of benchmarks.scenes.
 * out[p] is 1 where pair p overlaps.
 *
 * Nearest point of the box |x_i| <= e_i to k in the metric N = S^-1 (Closest-Features
 * in its leanest form): for each order (i, j, l) clip one coordinate after the other at
 * its conditional optimum; the smallest of the six values q is compared with 1. All is
 * reckoned from k: d = x - k, lo = -e - k, hi = e - k. S is the shape matrix
 * R diag(a^2) R^T and A its adjugate D2 N, neither by inversion.
 *
 * Scalars only, no small arrays: a compiler vectorises the loop as it stands.
 */

#include <stddef.h>
#include <stdint.h>

#define V3(x, i) x[(ptrdiff_t)(i) * n + p]
#define M3(x, i, j) x[(ptrdiff_t)(3 * (i) + (j)) * n + p]
#define CLIP(x, lo, hi) ((x) < (lo) ? (lo) : (x) > (hi) ? (hi) : (x))
#define MIN(x, y) ((x) < (y) ? (x) : (y))

/* Row i of R = U^T V, k and the bounds. */
#define POSE(i)                                                               \
    float u0##i = M3(U, 0, i), u1##i = M3(U, 1, i), u2##i = M3(U, 2, i);      \
    float R##i##0 = u0##i * v00 + u1##i * v10 + u2##i * v20;                  \
    float R##i##1 = u0##i * v01 + u1##i * v11 + u2##i * v21;                  \
    float R##i##2 = u0##i * v02 + u1##i * v12 + u2##i * v22;                  \
    float k##i = u0##i * c0 + u1##i * c1 + u2##i * c2;                        \
    float e##i = V3(e, i), lo##i = -e##i - k##i, hi##i = e##i - k##i

/* R_i diag(w) R_j. */
#define FORM(w, i, j)                                                         \
    (R##i##0 * w##0 * R##j##0 + R##i##1 * w##1 * R##j##1                      \
     + R##i##2 * w##2 * R##j##2)

/* The entries ij of both matrices. */
#define ENTRY(i, j)                                                           \
    float S##i##j = FORM(s, i, j), S##j##i = S##i##j;                         \
    float A##i##j = FORM(t, i, j), A##j##i = A##i##j

/* Diagonal entries, their reciprocals, and x_i on the nearest plane. */
#define PLANE(i)                                                              \
    float S##i##i = FORM(s, i, i), A##i##i = FORM(t, i, i);                   \
    float per_S##i = 1 / S##i##i, per_A##i = 1 / A##i##i;                     \
    float d##i = CLIP(0, lo##i, hi##i), q##i = d##i * d##i * per_S##i;        \
    float at##i = d##i * per_S##i

/* x_i is on its plane; x_j next, x_l last. */
#define ORDER(i, j, l)                                                        \
    do {                                                                      \
        float t_j = S##j##i * at##i;                                          \
        float d_j = CLIP(t_j, lo##j, hi##j), r_j = d_j - t_j;                 \
        float t_l = -(A##l##i * d##i + A##l##j * d_j) * per_A##l;             \
        float r_l = CLIP(t_l, lo##l, hi##l) - t_l;                            \
        float value = q##i + S##i##i * per_A##l * r_j * r_j                   \
                      + A##l##l * per_D2 * r_l * r_l;                         \
        q = MIN(q, value);                                                    \
    } while (0)

void overlaps(ptrdiff_t n, int threads, const float *restrict C,
              const float *restrict U, const float *restrict e,
              const float *restrict K, const float *restrict V,
              const float *restrict a, uint8_t *restrict out) {
#pragma omp parallel for simd num_threads(threads) schedule(static)
    for (ptrdiff_t p = 0; p < n; p++) {
        float v00 = M3(V, 0, 0), v01 = M3(V, 0, 1), v02 = M3(V, 0, 2);
        float v10 = M3(V, 1, 0), v11 = M3(V, 1, 1), v12 = M3(V, 1, 2);
        float v20 = M3(V, 2, 0), v21 = M3(V, 2, 1), v22 = M3(V, 2, 2);
        float c0 = V3(K, 0) - V3(C, 0);
        float c1 = V3(K, 1) - V3(C, 1);
        float c2 = V3(K, 2) - V3(C, 2);
        POSE(0);
        POSE(1);
        POSE(2);
        float s0 = V3(a, 0) * V3(a, 0);
        float s1 = V3(a, 1) * V3(a, 1);
        float s2 = V3(a, 2) * V3(a, 2);
        float t0 = s1 * s2, t1 = s2 * s0, t2 = s0 * s1;
        float per_D2 = 1 / (s0 * t0);
        ENTRY(0, 1);
        ENTRY(1, 2);
        ENTRY(2, 0);
        PLANE(0);
        PLANE(1);
        PLANE(2);
        float q = 2;
        ORDER(0, 1, 2);
        ORDER(0, 2, 1);
        ORDER(1, 0, 2);
        ORDER(1, 2, 0);
        ORDER(2, 0, 1);
        ORDER(2, 1, 0);
        out[p] = q <= 1;
    }
}
