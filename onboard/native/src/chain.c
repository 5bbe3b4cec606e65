/* Motion of every link and joint relative to the base, by recursion from the base outwards (Featherstone 2008). */
#include <stdlib.h>

#include "heft_native.h"

typedef struct {
    double *R, *p, *V, *A;
} frames_out;

static double *taken(double **at, i64 count) {
    double *here = *at;
    *at += count;
    return here;
}

static frames_out frames_at(double **at, i64 count) {
    frames_out out;
    out.R = taken(at, 9 * count);
    out.p = taken(at, 3 * count);
    out.V = taken(at, 6 * count);
    out.A = taken(at, 6 * count);
    return out;
}

static void one_joint(const heft_tree *t, i64 j, const double q[3], const double *offset, double *axes, double *origins,
                      double *twists, double *rates, double *seat_R, double *seat_p, double *screw) {
    i64 on = t->parent[j];
    const double *R = axes + 9 * on, *own = t->seat_axes + 9 * j, *V = twists + 6 * on;
    double arm[3], axis[3], turned[9], move[6], change[6], sine = heft_sin(q[0]), cosine = heft_cos(q[0]);
    double *origin = origins + 3 * (j + 1), *twist = twists + 6 * (j + 1), *rate = rates + 6 * (j + 1);
    memcpy(arm, t->seat_origin + 3 * j, sizeof arm);
    if (offset) {
        double moved[3];
        rotate(own, offset, moved);
        add(arm, moved, 3);
    }
    times3(R, own, seat_R);
    rotate(R, arm, seat_p);
    add(seat_p, origins + 3 * on, 3);
    rotate(seat_R, t->axis + 3 * j, axis);
    for (i64 k = 0; k < 9; k++)
        turned[k] = own[k] + sine * t->turned[9 * j + k] + (1.0 - cosine) * t->turned[9 * (t->joints + j) + k];
    times3(R, turned, axes + 9 * (j + 1));
    memcpy(origin, seat_p, 3 * sizeof(double));
    if (t->revolute[j] != 0.0) {
        cross(seat_p, axis, screw);
        memcpy(screw + 3, axis, sizeof axis);
    } else {
        memcpy(screw, axis, sizeof axis);
        memset(screw + 3, 0, sizeof axis);
        add_times(origin, q[0], axis, 3);
    }
    for (i64 k = 0; k < 6; k++) move[k] = screw[k] * q[1];
    cross_motion(V, move, change);
    sum_of(V, move, twist, 6);
    for (i64 k = 0; k < 6; k++) rate[k] = rates[6 * on + k] + (screw[k] * q[2] + change[k]);
}

/* Results: R, p, V, A of links (n, links, ..), of seats (n, joints, ..), screws (n, joints, 6), axes (n, joints + 1, 3, 3)
 * and origins (n, joints + 1, 3) of the bodies. offsets (joints, 3) or NULL; q, dq, ddq (n, joints). */
HEFT_API int heft_chain(const heft_tree *t, i64 n, const double *q, const double *dq, const double *ddq,
                        const double *offsets, double *out, i64 size) {
    i64 nj = t->joints, nl = t->links, bodies = nj + 1;
    if (size != n * (24 * nl + 30 * nj + 12 * bodies)) return HEFT_SIZE;
    double *moving = calloc((size_t)(12 * bodies), sizeof(double)), *at = out;
    if (!moving) return HEFT_MEMORY;
    double *twists = moving, *rates = moving + 6 * bodies;
    frames_out links = frames_at(&at, n * nl), seats = frames_at(&at, n * nj);
    double *screws = taken(&at, 6 * n * nj), *axes = taken(&at, 9 * n * bodies), *origins = taken(&at, 3 * n * bodies);
    for (i64 i = 0; i < n; i++) {
        double *R = axes + 9 * i * bodies, *p = origins + 3 * i * bodies;
        memset(R, 0, 9 * sizeof(double));
        memset(p, 0, 3 * sizeof(double));
        R[0] = R[4] = R[8] = 1.0;
        for (i64 j = 0; j < nj; j++) {
            i64 one = i * nj + j;
            double motion[3] = {q[one], dq[one], ddq[one]};
            one_joint(t, j, motion, offsets ? offsets + 3 * j : NULL, R, p, twists, rates, seats.R + 9 * one,
                      seats.p + 3 * one, screws + 6 * one);
            memcpy(seats.V + 6 * one, twists + 6 * t->parent[j], 6 * sizeof(double));
            memcpy(seats.A + 6 * one, rates + 6 * t->parent[j], 6 * sizeof(double));
        }
        for (i64 k = 0; k < nl; k++) {
            i64 one = i * nl + k, on = t->body[k];
            times3(R + 9 * on, t->link_axes + 9 * k, links.R + 9 * one);
            rotate(R + 9 * on, t->link_origin + 3 * k, links.p + 3 * one);
            add(links.p + 3 * one, p + 3 * on, 3);
            memcpy(links.V + 6 * one, twists + 6 * on, 6 * sizeof(double));
            memcpy(links.A + 6 * one, rates + 6 * on, 6 * sizeof(double));
        }
    }
    free(moving);
    return HEFT_OK;
}
