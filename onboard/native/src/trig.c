/* Sine and cosine of our own, so that no processor's mathematics library changes an estimate.
 *
 * The argument is reduced by multiples of pi/2 in three parts (Cody and Waite 1980), exactly so for |x| < 2^20 rad; beyond
 * it the answer is NaN, for no joint is told so far. Polynomials: Sun Microsystems' fdlibm 5.3 (k_sin.c, k_cos.c), whose
 * error is below one unit in the last place.
 */
#include <math.h>

#include "heft_native.h"

#ifndef HEFT_KEY
#define HEFT_KEY "unknown"
#endif
#if defined(__clang__)
#define HEFT_COMPILER __VERSION__
#else
#define HEFT_COMPILER "GCC " __VERSION__
#endif

static double sin_kernel(double x, double y) {
    double z = x * x, v = z * x;
    double r = 8.33333333332248946124e-03 +
               z * (-1.98412698298579493134e-04 +
                    z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)));
    return x - ((z * (0.5 * y - v * r) - y) - v * -1.66666666666666324348e-01);
}

static double cos_kernel(double x, double y) {
    double z = x * x;
    double r = z * (4.16666666666666019037e-02 +
                    z * (-1.38888888888741095749e-03 +
                         z * (2.48015872894767294178e-05 +
                              z * (-2.75573143513906633035e-07 +
                                   z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
    double half = 0.5 * z, w = 1.0 - half;
    return w + (((1.0 - w) - half) + (z * r - x * y));
}

/* x = quarter pi/2 + out[0] + out[1]; quarter of 0 to 3, or -1 where x is too large or not finite */
static int reduced(double x, double out[2]) {
    if (!(fabs(x) < 1048576.0)) return -1;
    double shifted = x * 6.36619772367581382433e-01 + 6755399441055744.0, k = shifted - 6755399441055744.0;  /* nearest */
    double a = x - k * 1.57079632673412561417e+00, t = k * 6.07710050630396597660e-11, b = a - t;
    double w = k * 2.02226624871116645580e-21 - ((a - b) - t), c = b - w;
    double u = k * 8.47842766036889956997e-32 - ((b - c) - w);
    out[0] = c - u;
    out[1] = (c - out[0]) - u;
    return (int)((i64)k & 3);
}

static double turned(double x, int ahead) {
    double r[2] = {0.0, 0.0};
    int quarter = reduced(x, r);
    if (quarter < 0) return NAN;
    switch ((quarter + ahead) & 3) {
        case 0: return sin_kernel(r[0], r[1]);
        case 1: return cos_kernel(r[0], r[1]);
        case 2: return -sin_kernel(r[0], r[1]);
        default: return -cos_kernel(r[0], r[1]);
    }
}

double heft_sin(double x) { return turned(x, 0); }

double heft_cos(double x) { return turned(x, 1); }

/* Which source this was made from, and by what */
HEFT_API const char *heft_identity(void) { return HEFT_KEY ", " HEFT_COMPILER; }
