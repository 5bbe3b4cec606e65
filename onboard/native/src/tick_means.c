/* Means of a channel's samples over ticks; see onboard.flight.estimate.readings.signals. */
#include <float.h>
#include <math.h>

#include "heft_native.h"

typedef struct {
    i64 count, ticks, columns, gap;                 /* samples, ticks, columns, the reason of a gap */
    const double *times_s, *at_s, *values;          /* (count,) rising, (ticks,), (count, columns) */
    const double *delays_s, *noise;                 /* (columns,) each */
    const i64 *wrong;                               /* (count,) bits of reasons */
} heft_samples;

/* The first sample that is not before a time */
static i64 first_from(const heft_samples *s, double delay_s, double time_s) {
    i64 low = 0, high = s->count;
    while (low < high) {
        i64 middle = low + (high - low) / 2;
        if (s->times_s[middle] - delay_s < time_s)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

/* Of the straight line through the samples from low to high, its value at the tick's middle, and its noise */
static void line(const heft_samples *s, i64 column, i64 low, i64 high, double at_s, double *value, double *sigma) {
    double samples = (double)(high - low), middle_s = 0.0, spread = 0.0, squares = 0.0, delay_s = s->delays_s[column];
    for (i64 k = low; k < high; k++) middle_s += (s->times_s[k] - delay_s) - at_s;
    middle_s /= samples;
    for (i64 k = low; k < high; k++) {
        double away_s = (s->times_s[k] - delay_s) - at_s - middle_s;
        spread += away_s * away_s;
    }
    spread = spread > DBL_MIN ? spread : DBL_MIN;
    *value = 0.0;
    for (i64 k = low; k < high; k++) {
        double away_s = (s->times_s[k] - delay_s) - at_s - middle_s, weight = 1.0 / samples - middle_s * away_s / spread;
        squares += weight * weight;
        *value += weight * s->values[k * s->columns + column];
    }
    *sigma = s->noise[column] * sqrt(squares);
}

/* Results: means and their noise (ticks, columns) each, reasons not to use them (ticks,); NaN of those. A tick with fewest
 * samples or fewer has a gap. */
HEFT_API int heft_tick_means(const heft_samples *s, double half_s, double fewest, double *out, i64 size) {
    i64 n = s->ticks, columns = s->columns;
    if (size != n * (2 * columns + 1)) return HEFT_SIZE;
    double *values = out, *sigma = out + n * columns, *refused = sigma + n * columns;
    for (i64 i = 0; i < n; i++) {
        i64 reasons = 0, low = 0, high = 0;
        for (i64 c = 0; c < columns; c++) {
            if (c == 0 || s->delays_s[c] != s->delays_s[c - 1]) {
                low = first_from(s, s->delays_s[c], s->at_s[i] - half_s);
                high = first_from(s, s->delays_s[c], s->at_s[i] + half_s);
                if (!((double)(high - low) > fewest)) reasons |= s->gap;
                for (i64 k = low; k < high; k++) reasons |= s->wrong[k];
            }
            if (!reasons) line(s, c, low, high, s->at_s[i], values + i * columns + c, sigma + i * columns + c);
        }
        refused[i] = (double)reasons;
        for (i64 c = 0; reasons && c < columns; c++) values[i * columns + c] = sigma[i * columns + c] = NAN;
    }
    return HEFT_OK;
}
