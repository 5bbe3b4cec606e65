/* Whitened lines of an IMU over ticks and their derivatives; see onboard.identification.free_flyer.prediction.imu_errors. */
#include <stdlib.h>

#include "heft_native.h"

enum { LINES = 6, MOTION = 9 };

/* What an IMU reads at the middles of ticks, and what of that was measured */
typedef struct {
    i64 ticks, total, count, used;
    const double *gains;                        /* (2, 3, 3) reading of rate and specific force per true one */
    const double *gain, *along;                 /* (ticks, 6, 9) true ones by the motion, (ticks, 9, total) */
    const double *values, *d_errors;            /* (ticks, 6), (ticks, 6, ERRORS) */
    const double *measured, *sigma;             /* (ticks, 6) each */
    const i64 *places, *use;                    /* (count,) among total + ERRORS; (used,) ticks, ascending */
} heft_read_ticks;

static int fits(const heft_read_ticks *r, i64 size) {
    i64 before = -1;
    if (r->ticks < 0 || r->total < 0 || r->count < 0 || r->used < 0 || size != LINES * r->used * (1 + r->count)) return 0;
    for (i64 k = 0; k < r->count; k++)
        if (r->places[k] < 0 || r->places[k] >= r->total + ERRORS) return 0;
    for (i64 k = 0; k < r->used; before = r->use[k++])
        if (r->use[k] <= before || r->use[k] >= r->ticks) return 0;
    return 1;
}

/* Derivatives of the readings at the middle of a tick by all that they depend on, (6, total + ERRORS) */
static void middle(const heft_read_ticks *r, i64 i, double *out) {
    i64 width = r->total + ERRORS;
    const double *gain = r->gain + LINES * MOTION * i, *along = r->along + MOTION * r->total * i;
    double own[LINES * MOTION];
    multiply(r->gains, gain, MOTION, own, MOTION, 3, 3, MOTION);
    multiply(r->gains + 9, gain + 3 * MOTION, MOTION, own + 3 * MOTION, MOTION, 3, 3, MOTION);
    for (i64 row = 0; row < 3; row++) {    /* a rate depends on the base's rate alone */
        multiply(own + MOTION * row, along, r->total, out + width * row, width, 1, 3, r->total);
        multiply(own + MOTION * (3 + row), along, r->total, out + width * (3 + row), width, 1, MOTION, r->total);
    }
    for (i64 line = 0; line < LINES; line++)
        memcpy(out + width * line + r->total, r->d_errors + ERRORS * (LINES * i + line), ERRORS * sizeof *out);
}

/* Predicted less measured over sigma of the ticks to use, means over each: middle plus c times the second difference, which
 * the first and the last have not. Results: (6 used,), then derivatives (6 used, count) */
HEFT_API int heft_whitened(const heft_read_ticks *r, double c, double *out, i64 size) {
    if (!fits(r, size)) return HEFT_SIZE;
    i64 width = r->total + ERRORS, block = LINES * width, done = 0;
    double *work = malloc((size_t)(3 * block + width) * sizeof(double)), *mean = work + 3 * block;
    if (!work) return HEFT_MEMORY;
    double *residual = out, *row = out + LINES * r->used;
    for (i64 k = 0; k < r->used; k++) {
        i64 i = r->use[k], inner = i > 0 && i + 1 < r->ticks;
        if (done < i - 1) done = i - 1;
        for (; done <= i + inner; done++) middle(r, done, work + block * (done % 3));
        for (i64 line = 0; line < LINES; line++) {
            i64 at = LINES * i + line;
            const double *now = work + block * (i % 3) + width * line, *after = work + block * ((i + 1) % 3) + width * line;
            const double *before = work + block * ((i + 2) % 3) + width * line;
            double value = inner ? tick_mean(c, r->values + at, LINES) : r->values[at], sigma = r->sigma[at];
            if (inner)
                for (i64 q = 0; q < width; q++) mean[q] = now[q] + c * (after[q] - 2.0 * now[q] + before[q]);
            else
                memcpy(mean, now, (size_t)width * sizeof *mean);
            *residual++ = (value - r->measured[at]) / sigma;
            for (i64 q = 0; q < r->count; q++) *row++ = mean[r->places[q]] / sigma;
        }
    }
    free(work);
    return HEFT_OK;
}
