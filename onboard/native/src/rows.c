/* Rows of the wrench through a cut by the ten standard parameters of each link beyond it (Limparis 2.115, 2.132). */
#include <stdlib.h>

#include "heft_native.h"

/* y' T(x) of the six elements of a tensor: what they make of x, (3, 6), along y */
static void of_tensor(const double x[3], const double y[3], double out[6]) {
    out[0] = x[0] * y[0], out[1] = x[1] * y[0] + x[0] * y[1], out[2] = x[1] * y[1];
    out[3] = x[2] * y[0] + x[0] * y[2], out[4] = x[2] * y[1] + x[1] * y[2], out[5] = x[2] * y[2];
}

/* Force and moment at a link's origin along f and m, all in its axes, by its parameters: it accelerates by a and turns */
static void row_of(const double a[3], const double w[3], const double dw[3], const double f[3], const double m[3],
                   double out[10]) {
    double turning[3], round[3], more[6];
    out[0] = dot(f, a);
    cross(f, dw, out + 1);
    cross(a, m, turning);
    for (i64 k = 0; k < 3; k++) out[k + 1] += dot(f, w) * w[k] - dot(w, w) * f[k] + turning[k];
    cross(m, w, round);
    of_tensor(dw, m, out + 4);
    of_tensor(w, round, more);
    add(out + 4, more, 6);
}

/* q, dq, ddq (n, joints); rate and acceleration of the base (n, 3), its specific force (n, 3) or NULL; projection (rows, 6)
 * on the wrench at the cut, in its axes, which has axes (3, 3) and origin (3,) in a body (0: the base); links (count,).
 * Results: (n, rows, 10 count) */
HEFT_API int heft_rows(const heft_tree *t, i64 n, const double *q, const double *dq, const double *ddq, const double *rate,
                       const double *acceleration, const double *force, i64 rows, const double *projection, i64 body,
                       const double *axes, const double *origin, i64 count, const i64 *links, double *out, i64 size) {
    i64 nj = t->joints, nl = t->links, length = n * (24 * nl + 30 * nj + 12 * (nj + 1));
    if (size != n * rows * 10 * count) return HEFT_SIZE;
    double *chain = malloc((size_t)(length + 1) * sizeof(double));
    if (!chain) return HEFT_MEMORY;
    int code = heft_chain(t, n, q, dq, ddq, NULL, chain, length);
    double *R = chain, *p = R + 9 * n * nl, *V = p + 3 * n * nl, *A = V + 6 * n * nl, *seats = A + 6 * n * nl;
    double *turned = seats + 30 * n * nj, *placed = turned + 9 * n * (nj + 1);
    for (i64 i = 0; i < n && code == HEFT_OK; i++) {
        const double *on = turned + 9 * (i * (nj + 1) + body), *at = placed + 3 * (i * (nj + 1) + body);
        double cut[9], place[3], twist[6] = {0.0}, pushed[6] = {0.0};
        times3(on, axes, cut), rotate(on, origin, place), add(place, at, 3);
        memcpy(twist + 3, rate + 3 * i, 3 * sizeof(double));
        memcpy(pushed + 3, acceleration + 3 * i, 3 * sizeof(double));
        if (force) memcpy(pushed, force + 3 * i, 3 * sizeof(double));
        for (i64 k = 0; k < count; k++) {
            i64 one = i * nl + links[k];
            const double *axes_of = R + 9 * one, *at_link = p + 3 * one;
            double v[6], a[6], arm[3], w[3], dw[3], swept[3], moved[3], own[3];
            sum_of(V + 6 * one, twist, v, 6);
            cross_motion(twist, V + 6 * one, a);
            add(a, A + 6 * one, 6), add(a, pushed, 6);
            cross(v + 3, at_link, moved), add(moved, v, 3);    /* velocity of the link's origin */
            cross(v + 3, moved, swept), cross(a + 3, at_link, own), add(swept, own, 3), add(swept, a, 3);
            rotate_back(axes_of, swept, own), rotate_back(axes_of, v + 3, w), rotate_back(axes_of, a + 3, dw);
            for (i64 j = 0; j < 3; j++) arm[j] = at_link[j] - place[j];
            for (i64 r = 0; r < rows; r++) {
                double f[3], m[3], along[3], about[3];
                rotate(cut, projection + 6 * r, f), rotate(cut, projection + 6 * r + 3, m);
                cross(m, arm, along), add(along, f, 3);
                rotate_back(axes_of, along, f), rotate_back(axes_of, m, about);
                row_of(own, w, dw, f, about, out + 10 * ((i * rows + r) * count + k));
            }
        }
    }
    free(chain);
    return code;
}
