/* What encoders read, with their errors taken out; see onboard.dynamics.joint_errors.Readings. */
#include "heft_native.h"

/* Rate of change by differences, of one of n numbers that lie so far apart; zero for a period of zero */
static double change(const double *x, i64 i, i64 n, i64 apart, double period_s) {
    const double *at = x + i * apart;
    if (period_s == 0.0 || n < 2) return 0.0;
    if (i == 0) return (at[apart] - at[0]) / period_s;
    if (i == n - 1) return (at[0] - at[-apart]) / period_s;
    return (at[apart] - at[-apart]) / (2.0 * period_s);
}

static void of_function(const heft_readings *r, i64 c, const double each[4], double *own, double *out, i64 apart) {
    const double *errors = r->errors + 6 * r->of[c];
    for (i64 d = 0; d < 3; d++) {
        double *at = out + d * apart + 2 * r->joints + c;
        *at = each[d];
        if (c < r->taken) *at = each[d] * (1.0 + errors[4]) + each[d + 1] * errors[5];
    }
    for (i64 d = 0; c < r->taken && d < 4; d++) own[4 * r->of[c] + d] += each[d] * r->multiples[c];
}

/* Results: q, dq, ddq (n, joints) with the errors taken out, functions (n, 3, 2 x joints + functions); work (joints, 4) */
HEFT_API int heft_corrected(const heft_readings *r, double period_s, double *work, double *out, i64 size) {
    i64 n = r->n, nj = r->joints, apart = 2 * nj + r->functions;
    if (size != n * (3 * nj + 3 * apart)) return HEFT_SIZE;
    double *q = out, *dq = q + n * nj, *ddq = dq + n * nj, *functions = ddq + n * nj;
    for (i64 i = 0; i < n; i++) {
        double *f = functions + 3 * apart * i;
        for (i64 j = 0; j < nj; j++) {
            i64 one = i * nj + j;
            work[4 * j] = r->q[one], work[4 * j + 1] = r->dq[one], work[4 * j + 2] = r->ddq[one];
            work[4 * j + 3] = change(r->ddq + j, i, n, nj, period_s);
        }
        for (i64 c = 0; c < r->functions; c++) {
            const double *at = r->cyclic + 3 * r->functions * i + c, *last = r->cyclic + 2 * r->functions + c;
            double each[4] = {at[0], at[r->functions], at[2 * r->functions], 0.0};
            each[3] = change(last, i, n, 3 * r->functions, period_s);
            of_function(r, c, each, work, f, apart);
        }
        for (i64 j = 0; j < nj; j++) {
            const double *x = work + 4 * j, *errors = r->errors + 6 * j;
            i64 one = i * nj + j;
            q[one] = x[0] * (1.0 + errors[4]) + errors[3] + errors[5] * x[1];
            dq[one] = x[1] * (1.0 + errors[4]) + errors[5] * x[2];
            ddq[one] = x[2] * (1.0 + errors[4]) + errors[5] * x[3];
            for (i64 d = 0; d < 3; d++) f[d * apart + j] = x[d], f[d * apart + nj + j] = x[d + 1];
        }
    }
    return HEFT_OK;
}
