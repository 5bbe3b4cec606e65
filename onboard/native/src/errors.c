/* Columns of momentum and wrench: of links' parameters, and of errors of joints; see onboard.dynamics.joint_errors. */
#include "heft_native.h"

/* Momentum columns of a twist in the link's own axes about its origin, (6, 10): l = m v + w x h, k = I w - v x h */
static void momentum_columns(const double U[6], double out[60]) {
    const double *v = U, *w = U + 3;
    double W[9], V[9];
    hat(w, W), hat(v, V);
    memset(out, 0, 60 * sizeof(double));
    for (i64 i = 0; i < 3; i++) {
        out[10 * i] = v[i];
        for (i64 j = 0; j < 3; j++) {
            out[10 * i + 1 + j] = W[3 * i + j];
            out[10 * (i + 3) + 1 + j] = -V[3 * i + j];
        }
    }
    double *k = out + 30;    /* XX XY YY XZ YZ ZZ are columns 4 to 9 */
    k[4] = w[0], k[5] = w[1], k[7] = w[2];
    k[15] = w[0], k[16] = w[1], k[18] = w[2];
    k[27] = w[0], k[28] = w[1], k[29] = w[2];
}

/* Columns in base axes about the base's origin, in the directions of the basis, NULL for the parameters themselves */
static void put_columns(const double R[9], const double p[3], const double *own, const double *basis, double *out,
                        i64 apart) {
    double turned[60], mixed[60];
    for (i64 half = 0; half < 2; half++) multiply(R, own + 30 * half, 10, turned + 30 * half, 10, 3, 3, 10);
    for (i64 j = 0; j < 10; j++) {
        double force[3] = {turned[j], turned[10 + j], turned[20 + j]}, moment[3];
        cross(p, force, moment);
        for (i64 k = 0; k < 3; k++) turned[10 * (3 + k) + j] += moment[k];
    }
    if (basis) multiply(turned, basis, 10, mixed, 10, 6, 10, 10);
    for (i64 i = 0; i < 6; i++) memcpy(out + i * apart, (basis ? mixed : turned) + 10 * i, 10 * sizeof(double));
}

/* A twist of the base's origin as that of a link's, in its axes */
static void in_link(const double R[9], const double p[3], const double V[6], double own[6]) {
    double at[3];
    cross(V + 3, p, at);
    add(at, V, 3);
    rotate_back(R, at, own);
    rotate_back(R, V + 3, own + 3);
}

void link_columns(const double R[9], const double p[3], const double V[6], const double A[6], const double *basis,
                  double *H, i64 H_apart, double *Y, i64 Y_apart) {
    double own[6], change[6], momentum[60], wrench[60];
    in_link(R, p, V, own);
    momentum_columns(own, momentum);
    if (H) put_columns(R, p, momentum, basis, H, H_apart);
    if (!Y) return;
    in_link(R, p, A, change);
    momentum_columns(change, wrench);
    for (i64 j = 0; j < 10; j++) {
        double column[6];
        for (i64 k = 0; k < 6; k++) column[k] = momentum[10 * k + j];
        cross_force(own, column, column);
        for (i64 k = 0; k < 6; k++) wrench[10 * k + j] = column[k] + wrench[10 * k + j];
    }
    put_columns(R, p, wrench, basis, Y, Y_apart);
}

void displaced_by(const double *seat_R, const double *seat_V, const double *seat_A, const double screw[6],
                  const double twist[6], const double rate[6], double U[72]) {
    double X[6], change[6], carried[6];
    sum_of(seat_V, twist, X, 6);
    cross_motion(twist, seat_V, carried);
    for (i64 k = 0; k < 6; k++) change[k] = seat_A[k] + rate[k] + carried[k];
    for (i64 s = 0; s < 4; s++) {
        double S[6] = {0.0}, first[6], second[6], more[6];
        for (i64 k = 0; k < 6; k++) S[k] = s == 3 ? screw[k] : k < 3 ? seat_R[3 * k + s] : 0.0;
        cross_motion(X, S, first);
        cross_motion(X, first, second);
        cross_motion(change, S, more);
        for (i64 k = 0; k < 6; k++)
            U[12 * k + s] = S[k], U[12 * k + 4 + s] = first[k], U[12 * k + 8 + s] = second[k] + more[k];
    }
}

static void column_of(const double *U, i64 at, double out[6]) {
    for (i64 k = 0; k < 6; k++) out[k] = U[12 * k + at];
}

/* What lies beyond a joint, all; of its four screws the wrenches (4, 6), momenta (4, 6), and of a rate and an acceleration
 * of the joint the wrenches slide and turn, (6,) */
typedef struct {
    double wrench[4][6], momentum[4][6], slide[6], turn[6];
} beyond_joint;

static void of_joint(const double *all, const double *U, double stays, beyond_joint *out) {
    double held[6];
    for (i64 k = 0; k < 6; k++) held[k] = stays * all[WRENCH + k];
    for (i64 s = 0; s < 4; s++) {
        double S[6], X[6], XX[6], a[6], b[6], c[6], d[6];
        column_of(U, s, S), column_of(U, 4 + s, X), column_of(U, 8 + s, XX);
        cross_force(X, all + MOMENTUM, a), change_times(all, X, b), inertia_times(all, XX, c), cross_force(S, held, d);
        for (i64 k = 0; k < 6; k++) out->wrench[s][k] = a[k] + b[k] + c[k] + d[k];
        cross_force(S, all + MOMENTUM, a), inertia_times(all, X, b);
        sum_of(a, b, out->momentum[s], 6);
        if (s < 3) continue;
        change_times(all, S, c), inertia_times(all, S, out->turn);
        for (i64 k = 0; k < 6; k++) out->slide[k] = a[k] + 2.0 * b[k] + c[k];
    }
}

/* Column of a function (values and two derivatives) in the order of the errors */
static i64 place_of(const heft_errors *e, i64 function) {
    if (function >= 2 * e->joints) return 4 * e->joints + function;
    return function < e->joints ? 6 * function + 4 : 6 * (function - e->joints) + 5;
}

/* One tick: parts (links, PARTS), U (joints, 6, 12), functions (3, functions); H and Y (6, 6 x joints + cyclic) */
void errors_into(const heft_errors *e, i64 links, const double *parts, const double *U, const double *functions,
                 double *H, i64 H_apart, double *Y, i64 Y_apart) {
    const double *f = functions, *df = f + e->functions, *ddf = df + e->functions;
    for (i64 j = 0; j < e->joints; j++) {
        double all[PARTS];
        beyond_joint of;
        weighted_sum(parts, e->beyond + links * j, links, all);
        of_joint(all, U + 72 * j, e->stays[j], &of);
        for (i64 k = 0; k < 6; k++)
            for (i64 s = 0; s < 4; s++) {
                Y[k * Y_apart + 6 * j + s] = of.wrench[s][k];
                if (H) H[k * H_apart + 6 * j + s] = of.momentum[s][k];
            }
        for (i64 c = 0; c < e->functions; c++) {
            if (e->of[c] != j) continue;
            i64 at = place_of(e, c);
            for (i64 k = 0; k < 6; k++) {
                Y[k * Y_apart + at] = of.wrench[3][k] * f[c] + of.slide[k] * df[c] + of.turn[k] * ddf[c];
                if (H) H[k * H_apart + at] = of.momentum[3][k] * f[c] + of.turn[k] * df[c];
            }
        }
    }
}
