/* A covariance some ticks later; see onboard.identification.free_flyer.prediction.imu_prediction. */
#include <stdlib.h>

#include "heft_native.h"

/* Sum of the rows of C, (count, count), with weights, most of which are zero */
static void weighted_rows(const double *row, i64 count, const double *C, double *sum) {
    memset(sum, 0, (size_t)count * sizeof(double));
    for (i64 j = 0; j < count; j++)
        if (row[j] != 0.0) add_times(sum, row[j], C + count * j, count);
}

/* Results: D T C T' D + diag(more) of a symmetric C (p, p), D = diag(left), T one but in the rows changes (c,), which are
 * F (c, p). Exactly symmetric. */
HEFT_API int heft_carried(i64 p, i64 c, const i64 *changes, const double *F, const double *C, const double *left,
                          const double *more, double *out, i64 size) {
    if (p < 0 || c < 0 || size != p * p) return HEFT_SIZE;
    double *moved = malloc((size_t)(c * p + c * c + 1) * sizeof(double)), *inner = moved + c * p;
    if (!moved) return HEFT_MEMORY;
    for (i64 k = 0; k < c; k++)
        if (changes[k] < 0 || changes[k] >= p) {
            free(moved);
            return HEFT_SIZE;
        }
    for (i64 k = 0; k < c; k++) weighted_rows(F + p * k, p, C, moved + p * k);
    memset(inner, 0, (size_t)(c * c) * sizeof(double));
    for (i64 l = 0; l < c; l++)
        for (i64 j = 0; j < p; j++)    /* most are zero here, too */
            for (i64 k = 0; F[p * l + j] != 0.0 && k < c; k++) inner[c * k + l] += moved[p * k + j] * F[p * l + j];
    memcpy(out, C, (size_t)size * sizeof(double));
    for (i64 k = 0; k < c; k++)
        for (i64 j = 0; j < p; j++) out[p * changes[k] + j] = out[p * j + changes[k]] = moved[p * k + j];
    for (i64 k = 0; k < c; k++)
        for (i64 l = 0; l < c; l++) out[p * changes[k] + changes[l]] = 0.5 * (inner[c * k + l] + inner[c * l + k]);
    for (i64 i = 0; i < p; i++) {
        for (i64 j = 0; j < i; j++)
            out[p * i + j] = out[p * j + i] = 0.5 * (out[p * i + j] + out[p * j + i]) * (left[i] * left[j]);
        out[(p + 1) * i] = out[(p + 1) * i] * (left[i] * left[i]) + more[i];
    }
    free(moved);
    return HEFT_OK;
}
