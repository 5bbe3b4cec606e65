/* What the instruments of a free-flyer show over some ticks, from all unknowns of its flight; equations in
 * onboard.identification.free_flyer.prediction: imu_prediction, moving_base, further. */
#include <stdlib.h>

#include "heft_native.h"

enum { PAYLOAD = 3, PUSHES = 12, HERE = 0, THERE = 1, LENGTH = 2, RUN = 3 };
/* of an instrument: its errors among all unknowns; its place there, or the joint whose torque it is, -1 for none */
enum { ERRORS_AT = 0, PLACE_AT = 1, OF_JOINT = 1, SAMPLES = 2, NUMBERS = 3 };

typedef struct {
    i64 states, unknowns, joints, links, thrusters, disturbed, imus, cells, lines, motion, changing, drifting, pushes;
    i64 links_at, joints_at, cyclic_at, thrusters_at;    /* places among all unknowns */
    const heft_tree *tree;
    const heft_columns *columns;                /* of the payload, then of the uncertain links */
    const heft_errors *errors;                  /* NULL: the joints have none */
    const i64 *estimated, *bodies;                  /* (states,) places among all unknowns; (10 links,) in the state */
    const double *chi, *drawn, *factor;         /* (10 links,); (uncertain, 10): see scaled.c */
    const double *wrenches, *frames;            /* (6, thrusters); (imus, 12) axes and place of each */
    const i64 *imu, *cell;                      /* (imus, NUMBERS), (cells, NUMBERS) */
    const i64 *own, *own_here, *own_there;      /* (imus + cells,) how many; places in the state, and of their errors */
    const i64 *runs;                            /* (motion, RUN): neighbours in the state, and of what the motion depends on */
    const double *samples;                      /* (lines,) weight of the second difference */
    const i64 *changes, *drifts, *of, *push;    /* (changing,); (drifting,) what drifts, and by what; (pushes,) */
} heft_predictor;

/* What is made over n ticks; the lines of an instant last */
typedef struct {
    double *values, *jacobian, *carried, *transition, *lines;
} shown;

static i64 sources(const heft_predictor *m) { return m->thrusters + (m->disturbed ? PUSHES : 0); }

static i64 shown_in(const heft_predictor *m, i64 n, i64 total, double *at, shown *out) {
    out->values = at, out->jacobian = at + (n - 2) * m->lines, out->carried = out->jacobian + (n - 2) * m->lines * m->states;
    out->transition = out->carried + m->states, out->lines = out->transition + m->changing * m->states;
    return (out->lines - at) + n * m->lines * total;
}

/* The state with bodies by their parameters */
static void linear_of(const heft_predictor *m, const double *state, double *linear) {
    memcpy(linear, state, (size_t)m->states * sizeof(double));
    for (i64 b = 0; b < m->columns->count - 1; b++) {
        double z[10], s[10];
        for (i64 k = 0; k < 10; k++) z[k] = state[m->bodies[10 * b + k]];
        scaled_body(m->drawn + 10 * b, m->factor + 10 * b, z, s);
        for (i64 k = 0; k < 10; k++) linear[m->bodies[10 * b + k]] = s[k];
    }
}

/* All unknowns x, (unknowns,), and this state without what pushes */
static void unknowns_of(const heft_predictor *m, const double *state, double *linear, double *x) {
    linear_of(m, state, linear);
    for (i64 k = 0; k < m->pushes; k++) linear[m->push[k]] = 0.0;
    memset(x, 0, (size_t)m->unknowns * sizeof(double));
    for (i64 k = 0; k < m->states; k++) x[m->estimated[k]] = linear[k];
}

static void parameters_of(const heft_predictor *m, const double *x, double *chi) {
    memcpy(chi, m->chi, (size_t)(10 * m->links) * sizeof(double));
    memcpy(chi + 10 * m->columns->links[0], x + PAYLOAD, 10 * sizeof(double));
    for (i64 b = 1; b < m->columns->count; b++)
        for (i64 k = 0; k < 10; k++) {
            double more = 0.0, *own = chi + 10 * m->columns->links[b];
            for (i64 j = 0; j < 10; j++) more += m->columns->bases[100 * b + 10 * k + j] * x[m->links_at + 10 * (b - 1) + j];
            own[k] += more;
        }
}

/* Wrenches of the thrusters, (n, thrusters) N, then a unit of each component, constant and growing, (n, 6, sources) */
static void push_of(const heft_predictor *m, i64 n, double period_s, const double *thrust, double *of_each) {
    i64 count = sources(m);
    memset(of_each, 0, (size_t)(6 * n * count) * sizeof(double));
    for (i64 i = 0; i < n; i++)
        for (i64 row = 0; row < 6; row++) {
            double *own = of_each + count * (6 * i + row);
            for (i64 k = 0; thrust && k < m->thrusters; k++)
                own[k] = thrust[m->thrusters * i + k] * m->wrenches[m->thrusters * row + k];
            if (m->disturbed) own[m->thrusters + row] = 1.0, own[m->thrusters + 6 + row] = period_s * (double)i;
        }
}

/* Lengths of what the motion is made of: the chain, corrected readings, the base */
typedef struct {
    i64 chain, corrected, base, width;
} lengths;

static lengths lengths_of(const heft_predictor *m, i64 n) {
    i64 nj = m->joints, nl = m->links, functions = m->errors ? m->errors->functions : 0;
    lengths of = {n * (24 * nl + 30 * nj + 12 * (nj + 1)), m->errors ? 3 * n * (nj + functions) : 0, 0, 0};
    of.width = 3 + 10 * m->columns->count + (m->errors ? 4 * nj + functions : 0) + sources(m);
    of.base = motion_size(n, nl) + n * (12 * of.width + 54 + (m->errors ? 72 * nj : 0));
    return of;
}

static void frames_at(double *at, i64 count, const double *frames[4]) {
    frames[0] = at, frames[1] = at + 9 * count, frames[2] = at + 12 * count, frames[3] = at + 18 * count;
}

/* The vehicle's motion, in the order of the lengths; see work_for */
static int moved(const heft_predictor *m, i64 n, double period_s, const double *const readings[5], const double *x,
                 double *work, double *out) {
    lengths of = lengths_of(m, n);
    i64 nj = m->joints, nl = m->links, count = sources(m);
    double *chi = work, *gain = chi + 10 * nl, *of_each = gain + count, *spare = of_each + 6 * n * count, *offsets = spare + 4 * nj;
    double *corrected = out + of.chain;
    const double *motion[3] = {readings[0], readings[1], readings[2]}, *functions = NULL;
    int code = HEFT_OK;
    if (m->errors) {
        i64 cyclic = m->errors->functions - 2 * nj;
        heft_readings r = {n, nj, cyclic, cyclic, motion[0], motion[1], motion[2], readings[3], m->errors->of + 2 * nj,
                           x + m->joints_at, x + m->cyclic_at};
        code = heft_corrected(&r, period_s, spare, corrected, of.corrected);
        for (i64 k = 0; k < 3; k++) motion[k] = corrected + n * nj * k;
        for (i64 k = 0; k < 3 * nj; k++) offsets[k] = x[m->joints_at + 6 * (k / 3) + k % 3];
        functions = corrected + 3 * n * nj;
    }
    if (!code) code = heft_chain(m->tree, n, motion[0], motion[1], motion[2], m->errors ? offsets : NULL, out, of.chain);
    if (code) return code;
    const double *links[4], *seats[4];
    frames_at(out, n * nl, links), frames_at(out + 24 * n * nl, n * nj, seats);
    const double *joints[4] = {seats[0], seats[2], seats[3], out + n * (24 * nl + 24 * nj)};
    parameters_of(m, x, chi);
    for (i64 k = 0; k < count; k++) gain[k] = (k < m->thrusters ? 1.0 : 0.0) + x[m->thrusters_at + k];
    push_of(m, n, period_s, readings[4], of_each);
    heft_frames frames = {n, nl, links[0], links[1], links[2], links[3], chi};
    heft_push push = {count, of_each, gain};
    return heft_predict_base(&frames, m->columns, m->errors, joints, functions, 0, count ? &push : NULL, period_s, x, 1,
                             corrected + of.corrected, of.base);
}

static double weight_of(i64 samples) { return (1.0 - 1.0 / ((double)samples * (double)samples)) / 24.0; }

static int within(const heft_predictor *m, i64 total) {
    for (const i64 *run = m->runs; run < m->runs + RUN * m->motion; run += RUN)
        if (run[LENGTH] < 0 || run[THERE] < 0 || run[THERE] + run[LENGTH] > total) return 0;
    return 1;
}

/* What changes with time: the rate, of the last tick but one, and what drifts; the others stay */
static void changed(const heft_predictor *m, const heft_base *b, double period_s, shown *out) {
    i64 p = m->states, last = b->n - 2;
    const double *d_rate = b->along + 9 * b->total * last;
    double last_s = period_s * (double)last;
    memset(out->transition, 0, (size_t)(m->changing * p) * sizeof(double));
    for (i64 k = 0; k < m->changing; k++) out->transition[p * k + m->changes[k]] = 1.0;
    for (i64 axis = 0; axis < 3; axis++) {
        out->carried[axis] = b->rate[3 * last + axis];
        for (const i64 *run = m->runs; run < m->runs + RUN * m->motion; run += RUN)
            memcpy(out->transition + p * axis + run[HERE], d_rate + b->total * axis + run[THERE],
                   (size_t)run[LENGTH] * sizeof(double));
    }
    for (i64 k = 0; k < m->drifting; k++) {
        out->carried[m->drifts[k]] += last_s * out->carried[m->of[k]];
        out->transition[p * (3 + k) + m->of[k]] = last_s;
    }
}

/* The lines of IMUs and cells, and what changes; see work_for */
static int lines_of(const heft_predictor *m, const heft_base *b, const heft_moving *v, const heft_cut *const *cuts,
                    const heft_errors *const *errors, double period_s, const double *const readings[5], const double *x,
                    double *work, shown *out) {
    i64 inner = b->n - 2, p = m->states, total = b->total, own = 0;
    if (!within(m, total)) return HEFT_SIZE;
    changed(m, b, period_s, out);
    memset(out->jacobian, 0, (size_t)(inner * m->lines * p) * sizeof(double));
    for (i64 k = 0; k < m->imus; own += m->own[k++]) {
        const i64 *numbers = m->imu + NUMBERS * k;
        const double *frame = m->frames + 12 * k, *off = x + numbers[PLACE_AT];
        double place[3], *d = work + 6 * inner, *d_place = d + 6 * ERRORS * inner;
        sum_of(frame + 9, off, place, 3);
        if (imu_along(b, frame, place, x + numbers[ERRORS_AT], numbers[SAMPLES], period_s, out->lines + 6 * total * k,
                      m->lines, work))
            return HEFT_MEMORY;
        for (i64 i = 0; i < 6 * inner; i++) {
            i64 line = m->lines * (i / 6) + 6 * k + i % 6;
            out->values[line] = work[i];
            for (i64 e = own; e < own + m->own[k]; e++) {
                i64 at = m->own_there[e];
                out->jacobian[p * line + m->own_here[e]] = at < ERRORS ? d[ERRORS * i + at] : d_place[3 * i + at - ERRORS];
            }
        }
    }
    for (i64 k = 0; k < m->cells; own += m->own[m->imus + k++]) {
        const i64 *numbers = m->cell + NUMBERS * k, first = 6 * m->imus + k;
        const double *of = x + numbers[ERRORS_AT], *d_values = work + b->n;
        i64 size = b->n * (1 + total);
        int code = heft_cut_wrench(v, cuts[k], v->screws ? errors[k] : NULL, work + size, work, size);
        if (code) return code;
        for (i64 i = 0; i < b->n; i++)
            for (i64 c = 0; c < total; c++)
                out->lines[total * (m->lines * i + first) + c] = (1.0 + of[2]) * d_values[total * i + c];
        for (i64 i = 0; i < inner; i++) {
            double d[CELL + FELT];
            i64 line = m->lines * i + first;
            out->values[line] = cell_shows(work, period_s, of, weight_of(numbers[SAMPLES]), readings[1], readings[2],
                                     numbers[OF_JOINT], m->joints, i + 1, d);
            for (i64 e = own; e < own + m->own[m->imus + k]; e++)
                out->jacobian[p * line + m->own_here[e]] = d[m->own_there[e]];
        }
    }
    return HEFT_OK;
}

static i64 larger(i64 a, i64 b) { return a > b ? a : b; }

static i64 work_for(const heft_predictor *m, i64 n, i64 total) {
    i64 columns = m->errors ? 4 * m->joints + m->errors->functions : 0;
    i64 lines = larger(6 * n * (ERRORS + 4), n * (1 + total) + 6 * columns);
    return m->unknowns + 9 * n + larger(lines, 10 * m->links + sources(m) * (6 * n + 1) + 7 * m->joints);
}

/* From a motion of the base, as that of flexible joints. Results: those of shown_in, for heft_linked; the lines of trackers
 * are left to be put. readings: angles, rates, accelerations of the joints */
HEFT_API int heft_shown(const heft_predictor *m, const heft_base *b, const heft_moving *v, const heft_cut *const *cuts,
                        const heft_errors *const *errors, double period_s, const double *const readings[5],
                        const double *state, double *out, i64 size) {
    shown to;
    if (b->n < 4 || size != shown_in(m, b->n, b->total, out, &to)) return HEFT_SIZE;
    double *x = malloc((size_t)work_for(m, b->n, b->total) * sizeof(double));
    if (!x) return HEFT_MEMORY;
    unknowns_of(m, state, to.carried, x);
    int code = lines_of(m, b, v, cuts, errors, period_s, readings, x, x + m->unknowns, &to);
    free(x);
    return code;
}

/* The same with the motion, which is put after it: see lengths. readings: of the joints, functions of cyclic errors,
 * forces of the thrusters or NULL */
HEFT_API int heft_predict(const heft_predictor *m, const heft_cut *const *cuts, const heft_errors *const *errors, i64 n,
                          double period_s, const double *const readings[5], const double *state, double *out, i64 size) {
    shown to;
    lengths of = lengths_of(m, n);
    i64 total = of.width, begin = n < 4 ? 0 : shown_in(m, n, total, out, &to), nl = m->links;
    if (n < 4 || size != begin + of.chain + of.corrected + of.base) return HEFT_SIZE;
    double *x = malloc((size_t)work_for(m, n, total) * sizeof(double)), *motion = out + begin;
    if (!x) return HEFT_MEMORY;
    unknowns_of(m, state, to.carried, x);
    int code = moved(m, n, period_s, readings, x, x + m->unknowns, motion);
    if (!code) {
        const double *links[4];
        double *base = motion + of.chain + of.corrected, *along = base + motion_size(n, nl);
        heft_motion was;
        motion_in(base, n, nl, &was);
        frames_at(motion, n * nl, links);
        double *by_rate = along + 9 * total * n, *by_wrench = by_rate + 18 * n, *screws = by_wrench + 36 * n + 3 * total * n;
        double *w = x + m->unknowns, *spin = w + 3 * n, *force = spin + 3 * n;
        for (i64 k = 0; k < 3 * n; k++) {
            i64 at = 6 * (k / 3) + k % 3;
            w[k] = was.twist[at + 3], spin[k] = was.thrust[at + 3], force[k] = was.thrust[at];
        }
        heft_base b = {n, total, w, spin, force, by_rate, by_wrench, along};
        heft_moving v = {n, nl, total, links[0], links[1], was.parts, was.twist, along, by_rate, by_wrench,
                         m->errors ? screws : NULL, m->errors ? motion + of.chain + 3 * n * m->joints : NULL};
        code = lines_of(m, &b, &v, cuts, errors, period_s, readings, x, force + 3 * n, &to);
    }
    free(x);
    return code;
}

/* Makes of derivatives at instants those of means over ticks, which are added to the jacobian; of derivatives by bodies
 * those by their errors; and adds what pushes, to first order. Results: those of shown_in, changed; more may follow. */
HEFT_API int heft_linked(const heft_predictor *m, i64 n, i64 total, const double *state, double *out, i64 size) {
    shown to;
    if (n < 4 || size < shown_in(m, n, total, out, &to)) return HEFT_SIZE;
    if (!within(m, total)) return HEFT_SIZE;
    i64 p = m->states, uncertain = m->columns->count - 1, values = (n - 2) * m->lines, apart = m->lines * total;
    for (i64 i = 0; i < values; i++) {
        const double *at = to.lines + apart + total * i;
        double *row = to.jacobian + p * i, c = m->samples[i % m->lines];
        for (const i64 *run = m->runs; run < m->runs + RUN * m->motion; run += RUN) {
            const double *now = at + run[THERE];
            double *to = row + run[HERE];
            for (i64 k = 0; k < run[LENGTH]; k++) to[k] += (now[apart + k] + now[k - apart]) * c + (1.0 - 2.0 * c) * now[k];
        }
    }
    double *linear = malloc((size_t)(2 * p + 10 * uncertain) * sizeof(double)), *more = linear + p, *z = more + p;
    if (!linear) return HEFT_MEMORY;
    linear_of(m, state, linear);
    for (i64 k = 0; k < 10 * uncertain; k++) z[k] = state[m->bodies[k]];
    for (i64 k = 0; k < p; k++) to.carried[k] = (to.carried[k] + state[k]) - linear[k], more[k] = 0.0;
    for (i64 k = 0; k < m->pushes; k++) more[m->push[k]] = state[m->push[k]];
    int code = scaled_derivatives(uncertain, m->drawn, m->factor, z, m->bodies, p, to.jacobian, values * p);
    if (!code) code = scaled_derivatives(uncertain, m->drawn, m->factor, z, m->bodies, p, to.transition, m->changing * p);
    if (!code) code = heft_plus(p, to.values, to.jacobian, more, to.values, values);
    for (i64 k = 0; k < m->changing; k++) linear[k] = to.carried[m->changes[k]];
    if (!code) code = heft_plus(p, linear, to.transition, more, linear, m->changing);
    for (i64 k = 0; k < p; k++) to.carried[k] += more[k];
    for (i64 k = 0; k < m->changing; k++) to.carried[m->changes[k]] = linear[k];
    free(linear);
    return code;
}
