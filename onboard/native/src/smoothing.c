/* Samples under a smoothing kernel, and what the kernel makes of them; see onboard.estimation.smoothing. */
#include <math.h>

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

/* Kernel or derivative of it at a sample, with its quadrature weight */
static double kernel_at(const double *shapes, i64 cells, i64 i, i64 order, double cell) {
    return shapes[(order + 1) * cells + i] * (order == 1 ? -cell : cell);
}

/* Of shapes, (4, ticks, length): a function that weights corrections, the kernel and its two derivatives. Results: weights
 * (ticks, 3, length), the kernel's and the smallest correction that makes of 1, u and u^2 what it makes, of_powers (3, 3);
 * roots of the sums of their squares (3, ticks). Zeros and NaN for a tick that is not valid. */
HEFT_API int heft_weights(i64 ticks, i64 length, const double *u, const double *cell, const double *shapes,
                          const double *valid, const double *of_powers, double width_s, double *out, i64 size) {
    i64 cells = ticks * length;
    if (size != 3 * cells + 3 * ticks) return HEFT_SIZE;
    double *gains = out + 3 * cells;
    for (i64 i = 0; i < ticks; i++) {
        double G[9] = {0.0}, by[9], scale = 1.0;
        const double *place = u + i * length, *weight = cell + i * length;
        memcpy(by, of_powers, sizeof by);    /* (3, 3): rows are orders */
        for (i64 k = 0; k < length; k++) {
            double near = shapes[i * length + k] * weight[k], powers[3] = {1.0, place[k], place[k] * place[k]};
            for (i64 a = 0; a < 9; a++) G[a] += near * powers[a / 3] * powers[a % 3];
            for (i64 a = 0; a < 9; a++)
                by[a] -= kernel_at(shapes, cells, i * length + k, a / 3, weight[k]) * powers[a % 3];
        }
        for (i64 a = 0; a < 3; a++)
            for (i64 b = 0; b < a; b++) {
                double other = by[3 * a + b];
                by[3 * a + b] = by[3 * b + a], by[3 * b + a] = other;
            }
        solve3(G, by, 3);    /* rows are powers now */
        for (i64 order = 0; order < 3; order++) {
            double sum = 0.0, *row = out + (3 * i + order) * length;
            for (i64 k = 0; k < length; k++) {
                double near = shapes[i * length + k] * weight[k];
                double more = by[order] + place[k] * by[3 + order] + place[k] * place[k] * by[6 + order];
                row[k] = (kernel_at(shapes, cells, i * length + k, order, weight[k]) + near * more) / scale;
                if (valid[i] == 0.0) row[k] = 0.0;
                sum += row[k] * row[k];
            }
            gains[order * ticks + i] = valid[i] == 0.0 ? NAN : sqrt(sum);
            scale *= width_s;
        }
    }
    return HEFT_OK;
}

/* Results: sums (orders, ticks, columns) of values (samples, columns), from the sample low (ticks,) of each tick on, with
 * weights (ticks, 3, length) of the first orders */
HEFT_API int heft_weighed(i64 ticks, i64 length, i64 orders, i64 samples, i64 columns, const double *weights,
                          const i64 *low, const double *values, double *out, i64 size) {
    if (orders < 0 || orders > 3 || size != orders * ticks * columns) return HEFT_SIZE;
    memset(out, 0, (size_t)size * sizeof(double));
    for (i64 i = 0; i < ticks; i++) {
        if (low[i] < 0) return HEFT_SIZE;
        for (i64 order = 0; order < orders; order++)
            for (i64 k = 0; k < length && low[i] + k < samples; k++)
                add_times(out + (order * ticks + i) * columns, weights[(3 * i + order) * length + k],
                          values + (low[i] + k) * columns, columns);
    }
    return HEFT_OK;
}
