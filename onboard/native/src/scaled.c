/* Derivatives by errors of bodies in the drawing; see onboard.identification.free_flyer.prediction.scaled. */
#include <math.h>

#include "heft_native.h"

/* exp of our own, as sine and cosine are: fdlibm 5.3, e_exp.c, error below one unit in the last place; NaN outside +-700 */
static double exponential(double x) {
    if (!(fabs(x) < 700.0)) return NAN;
    double shifted = x * 1.44269504088896338700e+00 + 6755399441055744.0, k = shifted - 6755399441055744.0;
    double high = x - k * 6.93147180369123816490e-01, low = k * 1.90821492927058770002e-10, r = high - low, t = r * r;
    double c = r - t * (1.66666666666666019037e-01 +
                        t * (-2.77777777770155933842e-03 +
                             t * (6.61375632143793436117e-05 +
                                  t * (-1.65339022054652515390e-06 + t * 4.13813679705723846039e-08))));
    double y = 1.0 - ((low - (r * c) / (2.0 - c)) - high);
    uint64_t power = (uint64_t)((i64)k + 1023) << 52;
    double scale;
    memcpy(&scale, &power, sizeof scale);
    return y * scale;
}

/* factor exp(t), and r (10,) of z = d t + r; factor is t of z */
static double parts_of(const double *drawn, const double *factor, const double *z, double *r) {
    double t = 0.0;
    for (i64 k = 0; k < 10; k++) t += factor[k] * z[k];
    for (i64 k = 0; k < 10; k++) r[k] = z[k] - t * drawn[k];
    return exponential(t);
}

void scaled_body(const double drawn[10], const double factor[10], const double z[10], double s[10]) {
    double r[10], grown = parts_of(drawn, factor, z, r);
    for (i64 k = 0; k < 10; k++) s[k] = grown * (drawn[k] + r[k]) - drawn[k];
}

/* linear, (10 bodies,): s of z; drawn and factor (bodies, 10) */
HEFT_API int heft_scaled(i64 bodies, const double *drawn, const double *factor, const double *z, double *out, i64 size) {
    if (size != 10 * bodies) return HEFT_SIZE;
    for (i64 b = 0; b < bodies; b++) scaled_body(drawn + 10 * b, factor + 10 * b, z + 10 * b, out + 10 * b);
    return HEFT_OK;
}

int scaled_derivatives(i64 bodies, const double *drawn, const double *factor, const double *z, const i64 *at, i64 states,
                       double *by, i64 size) {
    if (states < 1 || size % states) return HEFT_SIZE;
    for (i64 k = 0; k < 10 * bodies; k++)
        if (at[k] < 0 || at[k] >= states) return HEFT_SIZE;
    for (i64 b = 0; b < bodies; b++) {
        double r[10], grown = parts_of(drawn + 10 * b, factor + 10 * b, z + 10 * b, r);
        for (double *row = by; row < by + size; row += states) {
            double along = 0.0;
            for (i64 k = 0; k < 10; k++) along += row[at[10 * b + k]] * r[k];
            for (i64 k = 0; k < 10; k++) {
                double *one = row + at[10 * b + k];
                *one = (*one + along * factor[10 * b + k]) * grown;
            }
        }
    }
    return HEFT_OK;
}

/* out, (rows,), becomes values + by more: by (rows, columns); four sums beside each other, added at the end */
int heft_plus(i64 columns, const double *values, const double *by, const double *more, double *out, i64 size) {
    for (i64 i = 0; i < size; i++) {
        const double *row = by + columns * i;
        double sums[4] = {0.0, 0.0, 0.0, 0.0};
        i64 k = 0;
        for (; k + 4 <= columns; k += 4)
            for (i64 lane = 0; lane < 4; lane++) sums[lane] += row[k + lane] * more[k + lane];
        for (; k < columns; k++) sums[0] += row[k] * more[k];
        out[i] = values[i] + ((sums[0] + sums[1]) + (sums[2] + sums[3]));
    }
    return HEFT_OK;
}
