/* What an IMU on the base reads; the error model's equations are in onboard...free_flyer.prediction.imu_errors. */
#include <math.h>
#include <stdlib.h>

#include "heft_native.h"

/* places of the errors */
enum { AXES = 12, TURN = 9, SCALE = 6, DELAY = 24, CLOCK = 25, CROSS = 26, MOUNTING = 32 };
#define SMALL 1e-4    /* rad^2, below which series to the square are exact to rounding: the next term is 2e-13 */

/* R = exp(-hat(m)) and J, of which d(R u) = hat(R u) J dm (Sola, Deray, Atchuthan 2018, equation 145) */
static void turned_by(const double m[3], double R[9], double J[9]) {
    double H[9], HH[9], square = dot(m, m), angle = sqrt(square), a, b, c;
    if (square < SMALL) {
        a = 1.0 - square / 6.0, b = 0.5 - square / 24.0, c = 1.0 / 6.0 - square / 120.0;
    } else {
        double sine = heft_sin(angle);
        a = sine / angle, b = (1.0 - heft_cos(angle)) / square, c = (angle - sine) / (angle * square);
    }
    hat(m, H), times3(H, H, HH);
    for (i64 k = 0; k < 9; k++) {
        double one = k % 4 == 0 ? 1.0 : 0.0;
        R[k] = one - a * H[k] + b * HH[k];
        J[k] = one - b * H[k] + c * HH[k];
    }
}

static void symmetric(const double c[3], double out[9]) {    /* [[0, z, y], [z, 0, x], [y, x, 0]] */
    out[0] = out[4] = out[8] = 0.0;
    out[5] = out[7] = c[0], out[2] = out[6] = c[1], out[1] = out[3] = c[2];
}

/* Gains (2, 3, 3) of rate and specific force, rotations and their J */
static void gains(const double *errors, double E[18], double R[18], double J[18]) {
    for (i64 s = 0; s < 2; s++) {
        double more[9], turn[3];
        for (i64 k = 0; k < 3; k++) turn[k] = errors[AXES * s + TURN + k] + errors[MOUNTING + k];
        turned_by(turn, R + 9 * s, J + 9 * s);
        symmetric(errors + CROSS + 3 * s, more);
        for (i64 k = 0; k < 9; k++)
            E[9 * s + k] = (k % 4 == 0 ? errors[AXES * s + SCALE + k / 4] : 0.0) + more[k] + R[9 * s + k];
    }
}

/* One sensor of an IMU at one time: its three readings, and their derivatives (3, ERRORS), which are zero before */
static void reading(i64 s, const double *true, const double *change, double t, const double *errors, const double *E,
                    const double *R, const double *J, double *values, double *d) {
    const double *own = errors + AXES * s;
    double u[3], late[3], by_clock[3], turned[3], H[9], by_turn[9], cross_axis[9], power = s == 0 ? 1.0 : 2.0;
    for (i64 k = 0; k < 3; k++) {
        u[k] = true[k] - (errors[DELAY] + errors[CLOCK] * t) * change[k] - errors[CLOCK] * power * true[k];
        by_clock[k] = t * change[k] + power * true[k];
    }
    rotate(E, change, late), rotate(E, by_clock, by_clock), rotate(E, u, values);
    rotate(R, u, turned), hat(turned, H), times3(H, J, by_turn), symmetric(u, cross_axis);
    for (i64 k = 0; k < 3; k++) {
        double *row = d + ERRORS * k;
        values[k] += own[k] + t * own[3 + k];
        row[AXES * s + k] = 1.0, row[AXES * s + 3 + k] = t, row[AXES * s + SCALE + k] = u[k];
        for (i64 j = 0; j < 3; j++) {
            row[AXES * s + TURN + j] = row[MOUNTING + j] = by_turn[3 * k + j];
            row[CROSS + 3 * s + j] = cross_axis[3 * k + j];
        }
        row[DELAY] = -late[k], row[CLOCK] = -by_clock[k];
    }
}

static void readings(i64 n, const double *true, const double *change, const double *time_s, const double *errors,
                     double *values, double *d_errors) {
    double E[18], R[18], J[18];
    gains(errors, E, R, J);
    memset(d_errors, 0, (size_t)(6 * ERRORS * n) * sizeof(double));
    for (i64 i = 0; i < n; i++)
        for (i64 s = 0; s < 2; s++)
            reading(s, true + 6 * i + 3 * s, change + 6 * i + 3 * s, time_s[i], errors, E + 9 * s, R + 9 * s, J + 9 * s,
                    values + 6 * i + 3 * s, d_errors + ERRORS * (6 * i + 3 * s));
}

/* Results: values (n, 6), derivatives by the errors (n, 6, ERRORS) */
HEFT_API int heft_imu_reading(i64 n, const double *true, const double *change, const double *time_s, const double *errors,
                              double *out, i64 size) {
    if (size != n * (6 + 6 * ERRORS)) return HEFT_SIZE;
    readings(n, true, change, time_s, errors, out, out + 6 * n);
    return HEFT_OK;
}

/* The gain, (6, 6) */
HEFT_API int heft_imu_gain(const double *errors, double *out, i64 size) {
    double E[18], R[18], J[18];
    if (size != 36) return HEFT_SIZE;
    gains(errors, E, R, J);
    memset(out, 0, 36 * sizeof(double));
    for (i64 k = 0; k < 18; k++) out[6 * (k / 3) + 3 * (k / 9) + k % 3] = E[k];
    return HEFT_OK;
}

/* values (6,), gain (6, 9) and derivative by the place (3, 3) of the specific force, of a sensor at p with axes R */
static void sensor(const heft_base *b, i64 i, const double R[9], const double p[3], double *values, double *gain,
                   double *by_place) {
    double W[9], WW[9], P[9], WP[9], point[9], Wp[3], turn[9], force[3], back[9], at_place[18];
    const double *w = b->rate + 3 * i;
    hat(w, W), times3(W, W, WW), hat(p, P), times3(W, P, WP), rotate(W, p, Wp), hat(Wp, turn);
    hat(b->acceleration + 3 * i, point);
    add(point, WW, 9);
    rotate(point, p, force);
    add(force, b->specific_force + 3 * i, 3);
    rotate_back(R, w, values), rotate_back(R, force, values + 3);
    for (i64 k = 0; k < 9; k++) back[k] = R[3 * (k % 3) + k / 3], WP[k] += turn[k];
    times3(back, point, by_place);
    times3(back, P, turn);
    for (i64 k = 0; k < 9; k++) at_place[6 * (k / 3) + k % 3] = back[k], at_place[6 * (k / 3) + 3 + k % 3] = -turn[k];
    memset(gain, 0, 27 * sizeof(double));
    for (i64 k = 0; k < 9; k++) gain[9 * (k / 3) + k % 3] = back[k];
    multiply(at_place, b->by_rate + 18 * i, 3, gain + 27, 9, 3, 6, 3);
    multiply(at_place, b->by_wrench + 36 * i, 6, gain + 30, 9, 3, 6, 6);
    times3(back, WP, turn);    /* d(w x (w x p)) = (w x (dw x p)) + dw x (w x p) = -(hat(w) hat(p) + hat(w x p)) dw */
    for (i64 k = 0; k < 9; k++) gain[27 + 9 * (k / 3) + k % 3] -= turn[k];
}

/* Results: values (n, 6), gain (n, 6, 9), derivative by the place (n, 6, 3) */
HEFT_API int heft_sensor(const heft_base *b, const double *R, const double *p, double *out, i64 size) {
    if (size != b->n * (6 + 54 + 18)) return HEFT_SIZE;
    double *values = out, *gain = out + 6 * b->n, *by_place = gain + 54 * b->n;
    memset(by_place, 0, (size_t)(18 * b->n) * sizeof(double));
    for (i64 i = 0; i < b->n; i++) sensor(b, i, R, p, values + 6 * i, gain + 54 * i, by_place + 18 * i + 9);
    return HEFT_OK;
}

int imu_along(const heft_base *b, const double *R, const double *p, const double *errors, i64 samples, double period_s,
              double *by_motion, i64 apart, double *out) {
    i64 n = b->n, inner = n - 2;
    double *work = malloc((size_t)(n * (6 + 9 + 6 + 6 + 1)) * sizeof(double)), c = (double)samples * (double)samples;
    if (!work) return HEFT_MEMORY;
    double *true = work, *by_place = true + 6 * n, *means = by_place + 9 * n, *change = means + 6 * n;
    double *time_s = change + 6 * n, E[18], rotation[18], J[18], *d_place = out + inner * (6 + 6 * ERRORS);
    c = (1.0 - 1.0 / c) / 24.0;
    gains(errors, E, rotation, J);
    memset(d_place, 0, (size_t)(18 * inner) * sizeof(double));
    for (i64 i = 0; i < n; i++) {
        double gain[54], own[54], place[9];
        sensor(b, i, R, p, true + 6 * i, gain, place);
        times3(E + 9, place, by_place + 9 * i);
        multiply(E, gain, 9, own, 9, 3, 3, 9), multiply(E + 9, gain + 27, 9, own + 27, 9, 3, 3, 9);
        double *lines = by_motion + b->total * apart * i;
        const double *along = b->along + 9 * b->total * i;
        for (i64 row = 0; row < 3; row++) {    /* a rate depends on the base's rate alone */
            multiply(own + 9 * row, along, b->total, lines + b->total * row, b->total, 1, 3, b->total);
            multiply(own + 27 + 9 * row, along, b->total, lines + b->total * (3 + row), b->total, 1, 9, b->total);
        }
    }
    for (i64 i = 0; i < inner; i++) {
        time_s[i] = period_s * (double)(i + 1);
        for (i64 k = 0; k < 6; k++) {
            const double *at = true + 6 * (i + 1) + k;
            means[6 * i + k] = tick_mean(c, at, 6), change[6 * i + k] = (at[6] - at[-6]) / (2.0 * period_s);
        }
        for (i64 k = 0; k < 9; k++) d_place[18 * i + 9 + k] = tick_mean(c, by_place + 9 * (i + 1) + k, 9);
    }
    readings(inner, means, change, time_s, errors, out, out + 6 * inner);
    free(work);
    return HEFT_OK;
}
