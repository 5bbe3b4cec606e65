/* A component of the wrench through a cut of the arm, and its derivatives; see onboard.dynamics.cut_wrench. */
#include "heft_native.h"

void cut_weights(const heft_moving *b, const heft_cut *cut, i64 i, double u[6]) {
    i64 one = i * b->links + cut->carried_by;
    const double *R = b->R + 9 * one;
    double p[3], force[3], moment[3], across[3];
    rotate(R, cut->p, p);
    add(p, b->p + 3 * one, 3);
    rotate(cut->R, cut->projection, force), rotate(R, force, force);
    rotate(cut->R, cut->projection + 3, moment), rotate(R, moment, moment);
    cross(moment, p, across);    /* m . (M - p x F) = m . M - (m x p) . F */
    for (i64 k = 0; k < 3; k++) u[k] = force[k] - across[k], u[3 + k] = moment[k];
}

static double six(const double *u, const double *a, i64 apart) {
    double out = u[0] * a[0];
    for (i64 k = 1; k < 6; k++) out += u[k] * a[k * apart];
    return out;
}

static void slopes_of(const heft_moving *b, const heft_cut *cut, const double *all, const double u[6], i64 i, double *out) {
    double gain[9], I[36], pull[6], slope[18];
    const double *along = b->along + 9 * b->total * i;
    inertia_matrix(all, I);
    for (i64 k = 0; k < 6; k++) pull[k] = six(u, I + k, 6);
    slope_of(all, b->twist + 6 * i, slope);
    for (i64 k = 0; k < 3; k++) gain[k] = six(u, slope + k, 3) + six(pull, b->by_rate + 18 * i + k, 3);
    for (i64 k = 0; k < 6; k++) gain[3 + k] = six(pull, b->by_wrench + 36 * i + k, 6);
    multiply(gain, along, b->total, out, b->total, 1, 9, b->total);
    for (i64 c = 0; c < cut->columns; c++)
        if (cut->is_beyond[c] != 0.0) out[3 + c] += six(u, along + 3 * b->total + 3 + c, b->total);
}

/* Results: values (n,), then derivatives (n, total); work (6, 4 x joints + functions) */
HEFT_API int heft_cut_wrench(const heft_moving *b, const heft_cut *cut, const heft_errors *errors, double *work,
                             double *out, i64 size) {
    if (size != b->n * (1 + b->total)) return HEFT_SIZE;
    i64 columns = errors ? 4 * errors->joints + errors->functions : 0;
    for (i64 i = 0; i < b->n; i++) {
        double all[PARTS], u[6], *line = out + b->n + b->total * i;
        cut_weights(b, cut, i, u);
        weighted_sum(b->parts + PARTS * b->links * i, cut->group, b->links, all);
        out[i] = six(u, all + WRENCH, 1);
        slopes_of(b, cut, all, u, i, line);
        if (!errors) continue;
        errors_into(errors, b->links, b->parts + PARTS * b->links * i, b->screws + 72 * errors->joints * i,
                    b->functions + 3 * errors->functions * i, NULL, 0, work, columns);
        for (i64 c = 0; c < columns; c++) line[3 + cut->columns + c] += six(u, work + c, columns);
    }
    return HEFT_OK;
}
