/* Vectors, 3 x 3 matrices (row by row) and spatial vectors (linear, angular) of doubles, in a fixed order of operations.
 *
 * Every sum is a loop that is written out; with -ffp-contract=off and without -ffast-math a compiler may not change its
 * order, so that all of them make the same bits.
 */
#ifndef HEFT_ALGEBRA_H
#define HEFT_ALGEBRA_H

#include <stdint.h>
#include <string.h>

typedef int64_t i64;

static inline void cross(const double a[3], const double b[3], double out[3]) {
    double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2], z = a[0] * b[1] - a[1] * b[0];
    out[0] = x, out[1] = y, out[2] = z;
}

static inline double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static inline void add(double *to, const double *a, i64 count) {
    for (i64 k = 0; k < count; k++) to[k] += a[k];
}

static inline void sum_of(const double *a, const double *b, double *out, i64 count) {
    for (i64 k = 0; k < count; k++) out[k] = a[k] + b[k];
}

/* to += by a, which are not the same */
static inline void add_times(double *restrict to, double by, const double *restrict a, i64 count) {
    for (i64 k = 0; k < count; k++) to[k] += by * a[k];
}

static inline void rotate(const double R[9], const double a[3], double out[3]) {
    double x = dot(R, a), y = dot(R + 3, a), z = dot(R + 6, a);
    out[0] = x, out[1] = y, out[2] = z;
}

static inline void rotate_back(const double R[9], const double a[3], double out[3]) {
    double x = R[0] * a[0] + R[3] * a[1] + R[6] * a[2], y = R[1] * a[0] + R[4] * a[1] + R[7] * a[2];
    double z = R[2] * a[0] + R[5] * a[1] + R[8] * a[2];
    out[0] = x, out[1] = y, out[2] = z;
}

/* out (rows, columns) = a (rows, inner) b (inner, columns), whose rows lie so many doubles apart; out is neither of them.
 * Inlined where inner is a constant: its loop is unrolled then, and the one over the columns can be done two or four at a
 * time, which changes no sum. */
static inline __attribute__((always_inline)) void multiply(const double *restrict a, const double *restrict b, i64 b_apart,
                                                           double *restrict out, i64 out_apart, i64 rows, i64 inner,
                                                           i64 columns) {
    for (i64 i = 0; i < rows; i++)
        for (i64 j = 0; j < columns; j++) {
            double sum = a[i * inner] * b[j];
            for (i64 k = 1; k < inner; k++) sum += a[i * inner + k] * b[k * b_apart + j];
            out[i * out_apart + j] = sum;
        }
}

static inline void times3(const double a[9], const double b[9], double out[9]) { multiply(a, b, 3, out, 3, 3, 3, 3); }

static inline void hat(const double a[3], double out[9]) {
    out[0] = out[4] = out[8] = 0.0;
    out[1] = -a[2], out[2] = a[1], out[3] = a[2], out[5] = -a[0], out[6] = -a[1], out[7] = a[0];
}

/* V x U of motion vectors (Featherstone's crm); out may be U */
static inline void cross_motion(const double V[6], const double U[6], double out[6]) {
    double a[3], b[3];
    cross(V + 3, U, a);
    cross(V, U + 3, b);
    cross(V + 3, U + 3, out + 3);
    sum_of(a, b, out, 3);
}

/* V x* F of a force vector (crf); out may be F */
static inline void cross_force(const double V[6], const double F[6], double out[6]) {
    double a[3], b[3];
    cross(V, F, a);
    cross(V + 3, F + 3, b);
    cross(V + 3, F, out);
    sum_of(b, a, out + 3, 3);
}

/* A symmetric tensor XX XY YY XZ YZ ZZ times a vector */
static inline void tensor_times(const double J[6], const double a[3], double out[3]) {
    double x = J[0] * a[0] + J[1] * a[1] + J[3] * a[2], y = J[1] * a[0] + J[2] * a[1] + J[4] * a[2];
    double z = J[3] * a[0] + J[4] * a[1] + J[5] * a[2];
    out[0] = x, out[1] = y, out[2] = z;
}

static inline void tensor_matrix(const double J[6], double out[9]) {
    out[0] = J[0], out[1] = out[3] = J[1], out[4] = J[2], out[2] = out[6] = J[3], out[5] = out[7] = J[4], out[8] = J[5];
}

#endif
