/* Motion of a free-floating base and its derivatives; equations in onboard.dynamics.free_flight. */
#include <math.h>
#include <stdlib.h>

#include "heft_native.h"

/* d_start = [start, ..] of the momentum where the rate is the start: (3, width) in place */
static void inverse_of_angular(const double inverse[36], double J[9]) {
    for (i64 k = 0; k < 9; k++) J[k] = inverse[6 * (3 + k / 3) + 3 + k % 3];
}

static void rows_times(const double *rows, const double *a, i64 count, double *out) {    /* (count, 6) (6,) */
    for (i64 i = 0; i < count; i++) {
        out[i] = rows[6 * i] * a[0];
        for (i64 k = 1; k < 6; k++) out[i] += rows[6 * i + k] * a[k];
    }
}

static int acts(const heft_push *push) {
    for (i64 k = 0; k < push->count; k++)
        if (push->gain[k] != 0.0) return 1;
    return 0;
}

static void weigh(const double *of_each, const double *gain, i64 rows, i64 count, double *out) {
    for (i64 i = 0; i < rows; i++) {
        out[i] = 0.0;
        for (i64 k = 0; k < count; k++) out[i] += of_each[i * count + k] * gain[k];
    }
}

/* Moment of the push about the centre of mass, (n, 3) */
static void torques(const heft_push *push, i64 n, const double *composite, double *each, double *out) {
    for (i64 i = 0; i < n; i++) {
        double mass_kg, centre_m[3];
        centre_of(composite + 36 * i, &mass_kg, centre_m);
        torque_about_centre(push->of_each + 6 * push->count * i, push->count, centre_m, each);
        weigh(each, push->gain, 3, push->count, out + 3 * i);
    }
}

static void inverses(i64 n, heft_motion *m) {
    int singular = 0;
    for (i64 i = 0; i < n; i++) singular |= invert6(m->composite + 36 * i, m->inverse + 36 * i);
    if (singular)
        for (i64 k = 0; k < 36 * n; k++) m->inverse[k] = NAN;    /* a body that no twist tells from none */
}

static void move_tick(const heft_frames *f, const heft_push *push, i64 i, heft_motion *m) {
    double bias[6], wrench[6], *twist = m->twist + 6 * i;
    const double *inverse = m->inverse + 36 * i, *eta = m->momentum + 3 * i;
    rows_times(inverse, m->relative_momentum + 6 * i, 6, twist);
    for (i64 k = 0; k < 6; k++) twist[k] = dot(inverse + 6 * k + 3, eta) - twist[k];
    move_links(f, i, m, bias);
    if (push && acts(push)) {
        weigh(push->of_each + 6 * push->count * i, push->gain, 6, push->count, wrench);
        add_times(bias, -1.0, wrench, 6);
    }
    rows_times(inverse, bias, 6, m->thrust + 6 * i);
    for (i64 k = 0; k < 6; k++) m->thrust[6 * i + k] = -m->thrust[6 * i + k];
    push_links(f->links, i, m, m->thrust + 6 * i);
}

int move_base(const heft_frames *f, const heft_push *push, double period_s, const double start[3], int by_rate,
              heft_motion *m) {
    i64 n = f->n, count = push ? push->count : 0;
    double *still = malloc((size_t)(6 * n + 3 * count) * sizeof(double)), *torque = still + 3 * n, eta[3], J[9];
    if (!still) return HEFT_MEMORY;
    bodies_at_rest(f, m);
    inverses(n, m);
    for (i64 i = 0; i < n; i++) rows_times(m->inverse + 36 * i + 18, m->relative_momentum + 6 * i, 3, still + 3 * i);
    memcpy(eta, start, sizeof eta);
    if (by_rate) {
        add(eta, still, 3);
        inverse_of_angular(m->inverse, J);
        solve3(J, eta, 1);
    }
    int pushed = push && acts(push);
    if (pushed) torques(push, n, m->composite, torque + 3 * n, torque);
    int code = integrate_momentum(n, m->inverse, still, eta, period_s, pushed ? torque : NULL, m->momentum);
    free(still);
    if (code) return code;
    for (i64 i = 0; i < n; i++) move_tick(f, push, i, m);
    return HEFT_OK;
}

/* Results: those of motion_in */
HEFT_API int heft_move(const heft_frames *f, const heft_push *push, double period_s, const double *start, int by_rate,
                       double *out, i64 size) {
    if (size != motion_size(f->n, f->links) || f->n < 4) return HEFT_SIZE;
    heft_motion m;
    motion_in(out, f->n, f->links, &m);
    return move_base(f, push, period_s, start, by_rate, &m);
}

/* What derivatives are made of, a tick at a time */
typedef struct {
    i64 n, c, own, width, total, local;    /* columns of parameters, and errors, and pushes with the start; all; local */
    double *along, *by_rate, *by_wrench, *d_momentum, *screws;
    double *H, *fixed, *forcing;           /* (6, width - 3), (n, 3, width - 3) each */
} slopes;

static int is_one(const double basis[100]) {
    for (i64 k = 0; k < 100; k++)
        if (basis[k] != (k % 11 == 0 ? 1.0 : 0.0)) return 0;
    return 1;
}

static void columns_of(const heft_frames *f, const heft_motion *m, const heft_columns *unknown, const heft_errors *errors,
                       const double *const *seats, const double *functions, i64 i, slopes *s) {
    double *Y = s->along + 9 * s->total * i + 3 * s->total + 3;
    i64 apart = s->width - 3, nl = f->links;
    for (i64 k = 0; k < unknown->count; k++) {
        i64 one = i * nl + unknown->links[k];
        const double *basis = unknown->bases + 100 * k;
        link_columns(f->R + 9 * one, f->p + 3 * one, m->V + 6 * one, m->A + 6 * one, is_one(basis) ? NULL : basis,
                     s->H + 10 * k, apart, Y + 10 * k, s->total);
    }
    if (!errors) return;
    for (i64 j = 0; j < errors->joints; j++) {
        i64 one = i * errors->joints + j;
        displaced_by(seats[0] + 9 * one, seats[1] + 6 * one, seats[2] + 6 * one, seats[3] + 6 * one, m->twist + 6 * i,
                     m->rate + 6 * i, s->screws + 72 * one);
    }
    errors_into(errors, nl, m->parts + PARTS * nl * i, s->screws + 72 * errors->joints * i,
                functions + 3 * errors->functions * i, s->H + s->c, apart, Y + s->c, s->total);
}

/* Derivative of the torque of a push by chi, through the centre of mass: F x dr, dr = (d(m r) - r dm) / m */
static void torque_by_centre(const heft_frames *f, const heft_motion *m, const heft_columns *unknown, const double F[3],
                             i64 i, double *forcing, i64 apart) {
    double mass_kg, r[3];
    centre_of(m->composite + 36 * i, &mass_kg, r);
    for (i64 k = 0; k < unknown->count; k++) {
        i64 one = i * f->links + unknown->links[k];
        const double *basis = unknown->bases + 100 * k;
        for (i64 j = 0; j < 10; j++) {
            double h[3] = {basis[10 + j], basis[20 + j], basis[30 + j]}, d[3], out[3];
            rotate(f->R + 9 * one, h, d);
            for (i64 x = 0; x < 3; x++) d[x] = (d[x] + basis[j] * (f->p[3 * one + x] - r[x])) / mass_kg;
            cross(F, d, out);
            for (i64 x = 0; x < 3; x++) forcing[x * apart + 10 * k + j] += out[x];
        }
    }
}

static void push_columns(const heft_frames *f, const heft_motion *m, const heft_columns *unknown, const heft_push *push,
                         i64 i, slopes *s) {
    i64 apart = s->width - 3, count = push->count;
    const double *of_each = push->of_each + 6 * count * i;
    double mass_kg, centre_m[3], wrench[6], *forcing = s->forcing + 3 * apart * i;
    for (i64 row = 0; row < 6; row++)
        for (i64 k = 0; k < count; k++)
            s->along[s->total * (9 * i + 3 + row) + 3 + s->own + k] = -of_each[row * count + k];
    centre_of(m->composite + 36 * i, &mass_kg, centre_m);
    torque_about_centre(of_each, count, centre_m, s->H);    /* which is not needed any more */
    for (i64 row = 0; row < 3; row++) add(forcing + row * apart + s->own, s->H + row * count, count);
    if (!acts(push)) return;
    weigh(of_each, push->gain, 6, count, wrench);
    torque_by_centre(f, m, unknown, wrench, i, forcing, apart);
}

static void forced(const heft_motion *m, i64 i, slopes *s) {
    i64 columns = s->width - 3;
    double E[9], *fixed = s->fixed + 3 * columns * i, *forcing = s->forcing + 3 * columns * i;
    multiply(m->inverse + 36 * i + 18, s->H, columns, fixed, columns, 3, 6, columns);
    for (i64 k = 0; k < 3 * columns; k++) fixed[k] = -fixed[k];
    hat(m->momentum + 3 * i, E);
    multiply(E, fixed, columns, forcing, columns, 3, 3, columns);
    double by[36];
    multiply(m->inverse + 36 * i, m->slope + 18 * i, 3, by, 3, 6, 6, 3);
    for (i64 k = 0; k < 18; k++) s->by_rate[18 * i + k] = -by[k];
    for (i64 k = 0; k < 36; k++) s->by_wrench[36 * i + k] = -m->inverse[36 * i + k];
}

/* Derivative of the rate, (3, total) */
static void rate_columns(const heft_motion *m, i64 i, slopes *s) {
    i64 w = s->width, columns = w - 3, first = s->own - s->local;    /* of the local ones, without the start */
    double J[9], *out = s->along + 9 * s->total * i;
    inverse_of_angular(m->inverse + 36 * i, J);
    multiply(J, s->d_momentum + 3 * w * i, w, out, s->total, 3, 3, w);
    for (i64 row = 0; row < 3; row++) {
        double *line = out + row * s->total;
        for (i64 k = 0; s->local && k < s->local; k++) line[w + k] = line[3 + first + k], line[3 + first + k] = 0.0;
        for (i64 k = 0; s->local && k < 3; k++) line[w + s->local + k] = J[3 * row + k];
        add(line + 3, s->fixed + (3 * i + row) * columns, columns);
    }
}

static int derive(const heft_frames *f, const heft_motion *m, const heft_columns *unknown, const heft_errors *errors,
                  const double *const *seats, const double *functions, const heft_push *push, double period_s,
                  int by_rate, slopes *s) {
    i64 columns = s->width - 3, first = s->own - s->local;
    for (i64 i = 0; i < s->n; i++) {
        memset(s->H, 0, (size_t)(6 * columns) * sizeof(double));
        columns_of(f, m, unknown, errors, seats, functions, i, s);
        forced(m, i, s);
        if (push) push_columns(f, m, unknown, push, i, s);
        for (i64 row = 0; row < 3; row++)
            memset(s->forcing + (3 * i + row) * columns + first, 0, (size_t)s->local * sizeof(double));
    }
    double J[9], *start = s->d_momentum;
    memset(start, 0, (size_t)(3 * s->width) * sizeof(double));
    for (i64 k = 0; k < 3; k++) start[k * s->width + k] = 1.0;
    if (by_rate) {
        for (i64 row = 0; row < 3; row++)
            for (i64 k = 0; k < columns; k++) start[row * s->width + 3 + k] = -s->fixed[row * columns + k];
        inverse_of_angular(m->inverse, J);
        solve3(J, start, s->width);
    }
    int code = integrate_sensitivity(s->n, s->width, m, s->forcing, period_s, s->d_momentum);
    for (i64 i = 0; !code && i < s->n; i++) rate_columns(m, i, s);
    return code;
}

/* Results: those of motion_in, then along (n, 9, total), derivatives by rate (n, 6, 3) and wrench (n, 6, 6), d_momentum
 * (n, 3, width), screws (n, joints, 6, 12). seats: R, V, A of the joints' seats, and screws; functions (n, 3, functions);
 * errors and push may be NULL. */
HEFT_API int heft_predict_base(const heft_frames *f, const heft_columns *unknown, const heft_errors *errors,
                               const double *const *seats, const double *functions, i64 local, const heft_push *push,
                               double period_s, const double *start, int by_rate, double *out, i64 size) {
    i64 n = f->n, joints = errors ? errors->joints : 0, pushes = push ? push->count : 0;
    slopes s = {.n = n, .c = 10 * unknown->count, .local = local};
    s.own = s.c + (errors ? 4 * joints + errors->functions : 0);
    s.width = 3 + s.own + pushes;
    s.total = s.width + (local ? local + 3 : 0);
    i64 moving = motion_size(n, f->links), columns = s.width - 3;
    if (local < 0 || local > s.own - s.c) return HEFT_SIZE;
    if (n < 4 || size != moving + n * (9 * s.total + 54 + 3 * s.width + 72 * joints)) return HEFT_SIZE;
    i64 row = columns > pushes ? columns : pushes;
    double *work = malloc((size_t)(6 * row + 6 * n * columns + 1) * sizeof(double));
    if (!work) return HEFT_MEMORY;
    heft_motion m;
    motion_in(out, n, f->links, &m);
    s.along = out + moving;
    s.by_rate = s.along + 9 * s.total * n, s.by_wrench = s.by_rate + 18 * n;
    s.d_momentum = s.by_wrench + 36 * n, s.screws = s.d_momentum + 3 * s.width * n;
    s.H = work, s.fixed = work + 6 * row, s.forcing = s.fixed + 3 * n * columns;
    memset(s.along, 0, (size_t)(9 * s.total * n) * sizeof(double));
    int code = move_base(f, push, period_s, start, by_rate, &m);
    if (!code) code = derive(f, &m, unknown, errors, seats, functions, push, period_s, by_rate, &s);
    free(work);
    return code;
}
