/* The angular momentum along an even grid of ticks, and what it depends on; see onboard.dynamics.free_flight. */
#include <stdlib.h>

#include "heft_native.h"

/* Half-way between ticks, by cubics through four points: (n, width) to (n - 1, width) */
static void midpoints(i64 n, i64 width, const double *x, double *out) {
    for (i64 i = 0; i < n - 1; i++)
        for (i64 k = 0; k < width; k++) {
            const double *at = x + i * width + k;
            double before, after;
            if (i > 0)
                before = at[-width];
            else
                before = at[0] * 4.0 - at[width] * 6.0 + at[2 * width] * 4.0 - at[3 * width];
            if (i < n - 2)
                after = at[2 * width];
            else
                after = at[width] * 4.0 - at[0] * 6.0 + at[-width] * 4.0 - at[-2 * width];
            out[i * width + k] = (9.0 * (at[0] + at[width]) - before - after) / 16.0;
        }
}

/* eta x (J eta - k); the stage is J, row by row, and k */
static void momentum_rate(const double eta[3], const double stage[12], double out[3]) {
    double w[3];
    rotate(stage, eta, w);
    for (i64 k = 0; k < 3; k++) w[k] -= stage[9 + k];
    cross(eta, w, out);
}

static void runge_kutta(double eta[3], double h, const double *before, const double *middle, const double *after) {
    double at[3], slope[4][3];
    momentum_rate(eta, before, slope[0]);
    for (i64 stage = 1; stage < 4; stage++) {
        for (i64 k = 0; k < 3; k++) at[k] = eta[k] + (stage < 3 ? 0.5 * h : h) * slope[stage - 1][k];
        momentum_rate(at, stage < 3 ? middle : after, slope[stage]);
    }
    for (i64 k = 0; k < 3; k++) eta[k] += h / 6.0 * (slope[0][k] + 2.0 * (slope[1][k] + slope[2][k]) + slope[3][k]);
}

static void integrate(i64 n, const double *stages, const double *middles, double h, const double *torque, double *eta) {
    for (i64 i = 0; i < n - 1; i++) {
        double now[3];
        memcpy(now, eta + 3 * i, sizeof now);
        if (torque) add_times(now, 0.5 * h, torque + 3 * i, 3);
        runge_kutta(now, h, stages + 12 * i, middles + 12 * i, stages + 12 * (i + 1));
        if (torque) add_times(now, 0.5 * h, torque + 3 * (i + 1), 3);
        memcpy(eta + 3 * (i + 1), now, sizeof now);
    }
}

int integrate_momentum(i64 n, const double *inverse, const double *still, const double start[3], double h,
                       const double *torque, double *eta) {
    double *stages = malloc((size_t)(12 * (2 * n - 1)) * sizeof(double)), *middles = stages + 12 * n;
    if (!stages) return HEFT_MEMORY;
    for (i64 i = 0; i < n; i++) {
        for (i64 k = 0; k < 9; k++) stages[12 * i + k] = inverse[36 * i + 6 * (3 + k / 3) + 3 + k % 3];
        memcpy(stages + 12 * i + 9, still + 3 * i, 3 * sizeof(double));
    }
    midpoints(n, 12, stages, middles);
    memcpy(eta, start, 3 * sizeof(double));
    integrate(n, stages, middles, h, torque, eta);
    free(stages);
    return HEFT_OK;
}

/* 1 + by a, (3, 3) */
static void one_and(double by, const double a[9], double out[9]) {
    for (i64 k = 0; k < 9; k++) out[k] = (k % 4 == 0 ? 1.0 : 0.0) + by * a[k];
}

static void step_of(const double *before, const double *middle, const double *after, double h, double step[9]) {
    double k2[9], k3[9], k4[9], one[9];
    one_and(0.5 * h, before, one), times3(middle, one, k2);
    one_and(0.5 * h, k2, one), times3(middle, one, k3);
    one_and(h, k3, one), times3(after, one, k4);
    for (i64 k = 0; k < 9; k++)
        step[k] = (k % 4 == 0 ? 1.0 : 0.0) + h / 6.0 * (before[k] + 2.0 * (k2[k] + k3[k]) + k4[k]);
}

/* dS/dt = A S + [0 forcing], A = hat(eta) J - hat(w); the forcing by trapezoids */
int integrate_sensitivity(i64 n, i64 width, const heft_motion *m, const double *forcing, double h, double *S) {
    i64 forced = width - 3;
    double *A = malloc((size_t)(9 * (2 * n - 1) + 3 * width) * sizeof(double));
    if (!A) return HEFT_MEMORY;
    double *middle = A + 9 * n, *pushed = middle + 9 * (n - 1);
    for (i64 i = 0; i < n; i++) {
        double J[9], E[9], W[9];
        for (i64 k = 0; k < 9; k++) J[k] = m->inverse[36 * i + 6 * (3 + k / 3) + 3 + k % 3];
        hat(m->momentum + 3 * i, E), hat(m->twist + 6 * i + 3, W), times3(E, J, A + 9 * i);
        for (i64 k = 0; k < 9; k++) A[9 * i + k] -= W[k];
    }
    midpoints(n, 9, A, middle);
    for (i64 i = 0; i < n - 1; i++) {
        double step[9], *after = S + 3 * width * (i + 1);
        const double *next = forcing + 3 * forced * (i + 1);
        step_of(A + 9 * i, middle + 9 * i, A + 9 * (i + 1), h, step);
        multiply(step, S + 3 * width * i, width, after, width, 3, 3, width);
        multiply(step, forcing + 3 * forced * i, forced, pushed, forced, 3, 3, forced);
        for (i64 row = 0; row < 3; row++)
            for (i64 k = 0; k < forced; k++)
                after[row * width + 3 + k] += 0.5 * h * (pushed[row * forced + k] + next[row * forced + k]);
    }
    free(A);
    return HEFT_OK;
}

/* Of a momentum alone, or one forced at each tick: results (n, 3, width). start (3, width) */
HEFT_API int heft_sensitivity(i64 n, i64 width, const double *inverse, const double *momentum, const double *twist,
                              const double *forcing, const double *start, double h, double *out, i64 size) {
    if (size != 3 * n * width || n < 4 || width < 3) return HEFT_SIZE;
    heft_motion m = {.inverse = (double *)inverse, .momentum = (double *)momentum, .twist = (double *)twist};
    memcpy(out, start, (size_t)(3 * width) * sizeof(double));
    return integrate_sensitivity(n, width, &m, forcing, h, out);
}

/* eta, (n, 3), from J in inverse (n, 6, 6) and k, (n, 3) */
HEFT_API int heft_momentum(i64 n, const double *inverse, const double *still, const double *start, double h, double *out,
                           i64 size) {
    if (size != 3 * n || n < 4) return HEFT_SIZE;
    return integrate_momentum(n, inverse, still, start, h, NULL, out);
}
