/* A base on an air bearing, and its derivatives; see onboard.dynamics.air_bearing. */
#include <math.h>
#include <stdlib.h>

#include "heft_native.h"

enum { STATES = 4, AXES = 3, SAGS = 3, TILTS = 2 };
static const double FASTEST = 1e3;  /* m/s, rad/s, rad; beyond it the integration is stopped */

/* The run at ticks and half-way between, m = 2 ticks - 1 */
typedef struct {
    i64 ticks, free, pucks;
    const double *inverse, *known;  /* (m, 3, 3) of the inertia; (m, 3, 3) what a is without drag, of 1, w, w^2 */
    const double *growth, *over;    /* (m,) of all drags, (m, SAGS) its polynomials */
    const double *columns;          /* (m, 3, 6, free) of the wrench */
    const double *puck;             /* (pucks, 4) place, Fv, Fc */
    const double *others;           /* start (3,), tilt (2,), rounding squared, period */
} heft_table;


/* Accelerations: x is the velocity, the yaw rate and the yaw */
static void accelerate(const heft_table *t, i64 at, const double *x, double a[AXES]) {
    double force[AXES] = {0.0, 0.0, 0.0}, w = x[2], rounding = t->others[5];
    for (i64 i = 0; i < t->pucks; i++) {
        const double *puck = t->puck + 4 * i;
        double ux = x[0] - w * puck[1], uy = x[1] + w * puck[0];
        double share = puck[2] + puck[3] / sqrt(ux * ux + uy * uy + rounding);
        force[0] -= share * ux, force[1] -= share * uy, force[2] -= share * (puck[0] * uy - puck[1] * ux);
    }
    const double *inverse = t->inverse + 9 * at, *known = t->known + 9 * at;
    for (i64 i = 0; i < AXES; i++)
        a[i] = t->growth[at] * dot(inverse + 3 * i, force) + known[3 * i] + w * (known[3 * i + 1] + w * known[3 * i + 2]);
}

/* d state / dt */
static void change(const heft_table *t, const double *x, const double a[AXES], double out[STATES]) {
    double c = heft_cos(x[3]), s = heft_sin(x[3]), tilt_x = t->others[3], tilt_y = t->others[4];
    out[0] = a[0] + x[2] * x[1] + (c * tilt_x + s * tilt_y);
    out[1] = a[1] - x[2] * x[0] + (c * tilt_y - s * tilt_x);
    out[2] = a[2], out[3] = x[2];
}

static void rate(const heft_table *t, i64 at, const double *x, double by, const double *along, double out[STATES]) {
    double ahead[STATES], a[AXES];
    for (i64 k = 0; k < STATES; k++) ahead[k] = x[k] + by * along[k];
    accelerate(t, at, ahead, a);
    change(t, ahead, a, out);
}

/* States and their rates at ticks, (ticks, 4) each, by the fourth-order Runge-Kutta rule; NaN once they diverge */
static void integrate(const heft_table *t, double *states, double *rates) {
    double h = t->others[6], x[STATES] = {t->others[0], t->others[1], t->others[2], 0.0};
    for (i64 tick = 0; tick < t->ticks; tick++) {
        double *k1 = rates + STATES * tick, k2[STATES], k3[STATES], k4[STATES];
        memcpy(states + STATES * tick, x, sizeof x);
        rate(t, 2 * tick, x, 0.0, x, k1);
        if (tick + 1 == t->ticks) break;
        rate(t, 2 * tick + 1, x, 0.5 * h, k1, k2);
        rate(t, 2 * tick + 1, x, 0.5 * h, k2, k3);
        rate(t, 2 * tick + 2, x, h, k3, k4);
        for (i64 k = 0; k < STATES; k++) {
            x[k] += h / 6.0 * (k1[k] + 2.0 * (k2[k] + k3[k]) + k4[k]);
            if (!(fabs(x[k]) < FASTEST)) x[0] = x[1] = x[2] = x[3] = NAN;
        }
    }
}

/* to (columns,) += a (6,) b (6, columns), which is not to: six products at once to each element */
static void add_products(const double *restrict a, const double *restrict b, double *restrict to, i64 columns) {
    for (i64 j = 0; j < columns; j++) {
        double sum = to[j];
        for (i64 k = 0; k < 6; k++) sum += a[k] * b[columns * k + j];
        to[j] = sum;
    }
}

/* Slope of the state's rate by the state F (4, 4), and derivatives of a by the parameters D (3, width), at one point */
static void derive(const heft_table *t, i64 at, const double *x, double a[AXES], double F[16], double *D, i64 width) {
    const double *inverse = t->inverse + 9 * at, *known = t->known + 9 * at, *over = t->over + SAGS * at;
    double w = x[2], basis[6] = {0.0, 0.0, 0.0, 1.0, w, w * w}, growth = t->growth[at], stiff[9] = {0.0};
    double of_drag[AXES] = {0.0, 0.0, 0.0};
    double *by_columns = D + AXES, *by_drag = by_columns + t->free, *by_sag = by_drag + 2 * t->pucks;
    accelerate(t, at, x, a);
    memcpy(basis, a, AXES * sizeof *a);
    memset(D, 0, (size_t)(AXES * width) * sizeof *D);
    for (i64 i = 0; i < AXES; i++) {
        for (i64 j = 0; j < AXES; j++) {
            double by_wrench[6];
            for (i64 k = 0; k < 6; k++) by_wrench[k] = -inverse[3 * i + j] * basis[k];
            add_products(by_wrench, t->columns + 6 * (3 * at + j) * t->free, by_columns + i * width, t->free);
        }
    }
    for (i64 one = 0; one < t->pucks; one++) {
        const double *puck = t->puck + 4 * one;
        double px = puck[0], py = puck[1], u[2] = {x[0] - w * py, x[1] + w * px};
        double size = sqrt(u[0] * u[0] + u[1] * u[1] + t->others[5]), J[6] = {1.0, 0.0, -py, 0.0, 1.0, px};
        double cubed = puck[3] / (size * size * size), share = puck[2] + puck[3] / size;
        double by_slip[4] = {cubed * u[0] * u[0] - share, cubed * u[0] * u[1], cubed * u[0] * u[1], cubed * u[1] * u[1] - share};
        double pull[AXES] = {-u[0], -u[1], -(px * u[1] - py * u[0])}, half[6];
        multiply(by_slip, J, 3, half, 3, 2, 2, 3);
        for (i64 i = 0; i < AXES; i++) {
            double viscous = growth * dot(inverse + 3 * i, pull), coulomb = viscous / size;
            by_drag[i * width + 2 * one] = viscous, by_drag[i * width + 2 * one + 1] = coulomb;
            of_drag[i] += viscous * puck[2] + coulomb * puck[3];
            for (i64 j = 0; j < AXES; j++) stiff[3 * i + j] += J[i] * half[j] + J[3 + i] * half[3 + j];
        }
    }
    memset(F, 0, 16 * sizeof *F);
    for (i64 i = 0; i < AXES; i++) {
        for (i64 k = 0; k < SAGS; k++) by_sag[i * width + k] = of_drag[i] * over[k];
        for (i64 j = 0; j < AXES; j++)
            F[4 * i + j] = growth * (inverse[3 * i] * stiff[j] + inverse[3 * i + 1] * stiff[3 + j] + inverse[3 * i + 2] * stiff[6 + j]);
        F[4 * i + 2] += known[3 * i + 1] + 2.0 * known[3 * i + 2] * w;
    }
}

/* The slope of a, as it is in F, completed to that of the state's rate; own, (2, 2): of the velocity by the tilt */
static void complete(const heft_table *t, const double *x, double F[16], double own[4]) {
    double c = heft_cos(x[3]), s = heft_sin(x[3]), tilt_x = t->others[3], tilt_y = t->others[4];
    F[1] += x[2], F[2] += x[1], F[4] -= x[2], F[6] -= x[0];
    F[3] = c * tilt_y - s * tilt_x, F[7] = -c * tilt_x - s * tilt_y, F[14] = 1.0;
    own[0] = c, own[1] = s, own[2] = -s, own[3] = c;
}

/* One of the points that a step has */
typedef struct {
    double F[16], own[4], A[12], a[AXES], *D;
} point;

static void look(const heft_table *t, i64 at, const double *x, point *p, i64 width) {
    derive(t, at, x, p->a, p->F, p->D, width);
    memcpy(p->A, p->F, sizeof p->A);
    complete(t, x, p->F, p->own);
}

/* dS/dt at a point, (4, width): F S + B */
static void turn(const point *p, const double *S, double *out, i64 width) {
    multiply(p->F, S, width, out, width, STATES, STATES, width);
    add(out, p->D, AXES * width);
    for (i64 k = 0; k < TILTS; k++) {
        out[width - TILTS + k] += p->own[k];
        out[2 * width - TILTS + k] += p->own[2 + k];
    }
}

/* S over a step of a tick; work (3, 4, width) */
static void carry(const point *before, const point *middle, const point *after, double h, double *S, double *work, i64 width) {
    i64 size = STATES * width;
    double *sum = work, *k = work + size, *ahead = k + size;
    const point *at[4] = {before, middle, middle, after};
    const double share[4] = {0.0, 0.5 * h, 0.5 * h, h}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    memset(sum, 0, (size_t)size * sizeof *sum);
    for (i64 stage = 0; stage < 4; stage++) {
        memcpy(ahead, S, (size_t)size * sizeof *S);
        if (stage) add_times(ahead, share[stage], k, size);
        turn(at[stage], ahead, k, width);
        add_times(sum, weight[stage], k, size);
    }
    add_times(S, h / 6.0, sum, size);
}

/* Results: states (ticks, 4); a (ticks, 3); along (ticks, 9, width): of rate, specific force and angular acceleration */
HEFT_API int heft_predict_table(const heft_table *t, double *out, i64 size) {
    i64 n = t->ticks, width = AXES + t->free + 2 * t->pucks + SAGS + TILTS;
    if (n < 1 || size != n * (STATES + AXES + 9 * width)) return HEFT_SIZE;
    double *states = out, *forces = out + STATES * n, *along = forces + AXES * n, h = t->others[6];
    double *work = calloc((size_t)(STATES * n + (3 * AXES + 4 * STATES) * width), sizeof *work);
    if (!work) return HEFT_MEMORY;
    double *rates = work, *S = rates + STATES * n, *scratch = S + STATES * width;
    point points[3], *before = points, *middle = points + 1, *after = points + 2;
    for (i64 k = 0; k < 3; k++) points[k].D = scratch + 3 * STATES * width + k * AXES * width;
    integrate(t, states, rates);
    for (i64 k = 0; k < AXES; k++) S[k * width + k] = 1.0;
    look(t, 0, states, before, width);
    memset(along, 0, (size_t)(9 * n * width) * sizeof *along);
    for (i64 tick = 0;; tick++) {
        double *here = along + 9 * width * tick, total[AXES * STATES];
        memcpy(forces + AXES * tick, before->a, sizeof before->a);
        memcpy(total, before->A, sizeof total);
        memcpy(here + 2 * width, S + 2 * width, (size_t)width * sizeof *S);
        for (i64 i = 0; i < AXES; i++) {
            double *row = here + (i < 2 ? 3 + i : 8) * width;
            multiply(total + STATES * i, S, width, row, width, 1, STATES, width);
            add(row, before->D + i * width, width);
        }
        if (tick + 1 == n) break;
        const double *x = states + STATES * tick, *r = rates + STATES * tick;
        double half_way[STATES];
        for (i64 k = 0; k < STATES; k++)
            half_way[k] = 0.5 * (x[STATES + k] + x[k]) + h / 8.0 * (r[k] - r[STATES + k]);
        look(t, 2 * tick + 1, half_way, middle, width);
        look(t, 2 * tick + 2, x + STATES, after, width);
        carry(before, middle, after, h, S, scratch, width);
        point *free_one = before;
        before = after, after = free_one;
    }
    free(work);
    return HEFT_OK;
}
