/* Samples under a smoothing kernel, and what the kernel makes of them; see onboard.estimation.smoothing. */
#include "heft_native.h"

typedef struct {
    i64 samples, ticks, length;                 /* length: of the longest window */
    const double *times_s, *at_s;               /* (samples,) rising, (ticks,) */
    const i64 *low, *high;                      /* (ticks,) the samples of each tick's window */
} heft_windows;

static double larger(double a, double b) { return a > b ? a : b; }

/* Results: places of the samples in widths of the kernel and their quadrature weights, (ticks, length) each, zero beyond
 * the window; whether all neighbours of a window that is not empty and its edges are no further apart than gap_s, (ticks,). */
HEFT_API int heft_under(const heft_windows *w, double width_s, double gap_s, double *out, i64 size) {
    i64 last = w->samples - 1, cells = w->ticks * w->length;
    const double *t = w->times_s;
    if (last < 1 || size != 2 * cells + w->ticks) return HEFT_SIZE;
    for (i64 i = 0; i < w->ticks; i++) {
        i64 low = w->low[i], high = w->high[i];
        if (low < 0 || high > last + 1 || high - low > w->length) return HEFT_SIZE;
        double *u = out + i * w->length, *cell = u + cells, at_s = w->at_s[i], apart_s = 0.0;
        for (i64 k = 0; k < w->length; k++) {
            i64 s = low + k;
            int inside = s < high;
            double weight = 0.0;
            if (inside) weight = s == 0 ? t[1] - t[0] : s == last ? t[last] - t[last - 1] : 0.5 * (t[s + 1] - t[s - 1]);
            u[k] = inside ? (t[s] - at_s) / width_s : 0.0, cell[k] = weight / width_s;
            if (inside && k) apart_s = larger(apart_s, t[s] - t[s - 1]);
        }
        if (low < high) {
            apart_s = larger(apart_s, t[low] - (at_s - 0.5 * width_s));
            apart_s = larger(apart_s, (at_s + 0.5 * width_s) - t[high - 1]);
        }
        out[2 * cells + i] = low < high && apart_s <= gap_s;
    }
    return HEFT_OK;
}

/* Results: functions that are polynomials on each of so many intervals of -1/2..1/2 and zero beyond, at count places,
 * (functions, count); coefficients (powers, functions, intervals), of the place in the interval from 0 to 1. */
HEFT_API int heft_pieces(const double *coefficients, i64 powers, i64 functions, i64 intervals, const double *u, i64 count,
                         double *out, i64 size) {
    if (powers < 1 || intervals < 1 || size != functions * count) return HEFT_SIZE;
    double most = (double)intervals;
    for (i64 i = 0; i < count; i++) {
        double place = (u[i] + 0.5) * most;
        int inside = place >= 0.0 && place <= most;
        i64 interval = !inside ? 0 : place < most ? (i64)place : intervals - 1;
        place -= (double)interval;
        for (i64 f = 0; f < functions; f++) {
            const double *of = coefficients + f * intervals + interval;
            double value = of[(powers - 1) * functions * intervals];
            for (i64 p = powers - 2; p >= 0; p--) value = value * place + of[p * functions * intervals];
            out[f * count + i] = inside ? value : 0.0;
        }
    }
    return HEFT_OK;
}

/* Of shapes, (4, ticks, length): a function that weights corrections, the kernel and its two derivatives. Results: the
 * latter three with quadrature weights (ticks, 3, length), the first one by parts; powers of the places (ticks, length, 3);
 * and these weighted with the first shape. */
HEFT_API int heft_kernels(i64 ticks, i64 length, const double *u, const double *cell, const double *shapes, double *out,
                          i64 size) {
    i64 cells = ticks * length;
    if (size != 9 * cells) return HEFT_SIZE;
    double *powers = out + 3 * cells, *weighted = powers + 3 * cells;
    for (i64 i = 0; i < cells; i++) {
        double *kernel = out + i / length * 3 * length + i % length, near = shapes[i] * cell[i], square = u[i] * u[i];
        for (i64 order = 0; order < 3; order++)
            kernel[order * length] = shapes[(order + 1) * cells + i] * (order == 1 ? -cell[i] : cell[i]);
        powers[3 * i] = 1.0, powers[3 * i + 1] = u[i], powers[3 * i + 2] = square;
        weighted[3 * i] = near, weighted[3 * i + 1] = u[i] * near, weighted[3 * i + 2] = square * near;
    }
    return HEFT_OK;
}
