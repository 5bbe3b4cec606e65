/* Links of a floating vehicle as bodies that move with it (Featherstone 2008, chapter 2; onboard.dynamics.kinematics).
 *
 * A rigid body's spatial inertia about the base's origin has ten numbers: mass m, first moment h, tensor J. With V its
 * twist (v, w), L = I V is (m v + w x h, J w + h x v). As the body moves, h changes by m v + w x h and J, of which
 * J = sum of (r r 1 - r r'), by W J - J W + 2 h v 1 - (v h' + h v'), W = hat(w).
 */
#include "heft_native.h"

/* (h v' + v h') less twice h v 1, times sign, added to a tensor */
static void add_shift(double J[6], double sign, const double h[3], const double v[3]) {
    double twice = 2.0 * dot(h, v);
    J[0] += sign * (h[0] * v[0] + v[0] * h[0] - twice);
    J[1] += sign * (h[0] * v[1] + v[0] * h[1]);
    J[2] += sign * (h[1] * v[1] + v[1] * h[1] - twice);
    J[3] += sign * (h[0] * v[2] + v[0] * h[2]);
    J[4] += sign * (h[1] * v[2] + v[1] * h[2]);
    J[5] += sign * (h[2] * v[2] + v[2] * h[2] - twice);
}

static void symmetric_of(const double a[9], double out[6]) {    /* of one that is so but for rounding */
    out[0] = a[0], out[1] = a[3], out[2] = a[4], out[3] = a[6], out[4] = a[7], out[5] = a[8];
}

static void inertia_of(const double R[9], const double p[3], const double chi[10], double *part) {
    double h[3], J[9], turned[9], back[9], half[3];
    part[MASS] = chi[0];
    rotate(R, chi + 1, h);
    tensor_matrix(chi + 4, J);
    times3(R, J, turned);
    for (i64 i = 0; i < 3; i++)
        for (i64 j = 0; j < 3; j++) back[3 * i + j] = R[3 * j + i];
    times3(turned, back, J);
    symmetric_of(J, part + TENSOR);
    for (i64 k = 0; k < 3; k++) {
        part[MOMENT + k] = h[k] + chi[0] * p[k];
        half[k] = h[k] + 0.5 * chi[0] * p[k];
    }
    add_shift(part + TENSOR, -1.0, half, p);    /* of h and p, and half m p and p */
}

void inertia_times(const double *part, const double U[6], double out[6]) {
    double a[3], b[3];
    cross(U + 3, part + MOMENT, a);
    for (i64 k = 0; k < 3; k++) out[k] = part[MASS] * U[k] + a[k];
    tensor_times(part + TENSOR, U + 3, out + 3);
    cross(part + MOMENT, U, b);
    add(out + 3, b, 3);
}

void change_times(const double *part, const double U[6], double out[6]) {
    double b[3];
    cross(U + 3, part + D_MOMENT, out);
    tensor_times(part + D_TENSOR, U + 3, out + 3);
    cross(part + D_MOMENT, U, b);
    add(out + 3, b, 3);
}

/* [[m 1, -hat(h)], [hat(h), J]] */
static void spatial_matrix(double mass, const double h[3], const double J[6], double out[36]) {
    double H[9], T[9];
    hat(h, H);
    tensor_matrix(J, T);
    for (i64 i = 0; i < 3; i++)
        for (i64 j = 0; j < 3; j++) {
            out[6 * i + j] = i == j ? mass : 0.0;
            out[6 * i + j + 3] = -H[3 * i + j];
            out[6 * (i + 3) + j] = H[3 * i + j];
            out[6 * (i + 3) + j + 3] = T[3 * i + j];
        }
}

void inertia_matrix(const double *part, double out[36]) {
    spatial_matrix(part[MASS], part + MOMENT, part + TENSOR, out);
}

void slope_of(const double *part, const double twist[6], double out[18]) {
    double dh[9], l[9], k[9], h[9], v[9], w[9], J[9], dJ[9], hw[9], hv[9], Jw[9];
    hat(part + D_MOMENT, dh), hat(part + MOMENTUM, l), hat(part + MOMENTUM + 3, k), hat(part + MOMENT, h);
    hat(twist, v), hat(twist + 3, w), tensor_matrix(part + TENSOR, J), tensor_matrix(part + D_TENSOR, dJ);
    times3(h, w, hw), times3(h, v, hv), times3(J, w, Jw);
    for (i64 i = 0; i < 9; i++) {
        out[i] = 2.0 * part[MASS] * v[i] - hw[i] - dh[i] - l[i];
        out[9 + i] = dJ[i] - k[i] + 2.0 * hv[i] + Jw[i];
    }
}

void weighted_sum(const double *parts, const double *weights, i64 links, double out[PARTS]) {
    memset(out, 0, PARTS * sizeof(double));
    for (i64 k = 0; k < links; k++)
        if (weights[k] != 0.0) add_times(out, weights[k], parts + PARTS * k, PARTS);
}

static double *taken(double **at, i64 count) {
    double *here = *at;
    *at += count;
    return here;
}

i64 motion_size(i64 n, i64 links) { return n * (links * (PARTS + 12) + 36 + 6 + 6 + 6 + 36 + 3 + 18 + 6); }

void motion_in(double *at, i64 n, i64 links, heft_motion *out) {
    out->parts = taken(&at, n * links * PARTS);
    out->composite = taken(&at, 36 * n), out->relative_momentum = taken(&at, 6 * n);
    out->twist = taken(&at, 6 * n), out->rate = taken(&at, 6 * n);
    out->V = taken(&at, 6 * n * links), out->A = taken(&at, 6 * n * links);
    out->inverse = taken(&at, 36 * n), out->momentum = taken(&at, 3 * n);
    out->slope = taken(&at, 18 * n), out->thrust = taken(&at, 6 * n);
}

/* The base at rest: parts, composite inertia, momentum of the links */
void bodies_at_rest(const heft_frames *f, heft_motion *m) {
    i64 nl = f->links;
    memset(m->parts, 0, (size_t)(f->n * nl * PARTS) * sizeof(double));
    memset(m->twist, 0, (size_t)(6 * f->n) * sizeof(double));
    memset(m->rate, 0, (size_t)(6 * f->n) * sizeof(double));
    memcpy(m->V, f->V, (size_t)(6 * f->n * nl) * sizeof(double));
    memcpy(m->A, f->A, (size_t)(6 * f->n * nl) * sizeof(double));
    for (i64 i = 0; i < f->n; i++) {
        double all[PARTS] = {0.0};
        for (i64 k = 0; k < nl; k++) {
            double *part = m->parts + PARTS * (i * nl + k);
            inertia_of(f->R + 9 * (i * nl + k), f->p + 3 * (i * nl + k), f->chi + 10 * k, part);
            inertia_times(part, f->V + 6 * (i * nl + k), part + MOMENTUM);
            add(all, part, PARTS);
        }
        inertia_matrix(all, m->composite + 36 * i);
        memcpy(m->relative_momentum + 6 * i, all + MOMENTUM, 6 * sizeof(double));
    }
}

/* A link with the base's twist and rate: momentum, rate of change of the inertia, wrench */
static void moved(double *part, const double twist[6], const double rate[6], const double V_rel[6], const double A_rel[6],
                  double V[6], double A[6]) {
    double carried[6], moving[6], W[9], J[9], WJ[9];
    sum_of(V_rel, twist, V, 6);
    cross_motion(twist, V_rel, carried);
    for (i64 k = 0; k < 6; k++) A[k] = A_rel[k] + rate[k] + carried[k];
    inertia_times(part, V, part + MOMENTUM);
    memcpy(part + D_MOMENT, part + MOMENTUM, 3 * sizeof(double));
    hat(V + 3, W);
    tensor_matrix(part + TENSOR, J);
    times3(W, J, WJ);
    double *dJ = part + D_TENSOR;
    dJ[0] = WJ[0] + WJ[0], dJ[1] = WJ[1] + WJ[3], dJ[2] = WJ[4] + WJ[4];
    dJ[3] = WJ[2] + WJ[6], dJ[4] = WJ[5] + WJ[7], dJ[5] = WJ[8] + WJ[8];
    add_shift(dJ, -1.0, part + MOMENT, V);
    inertia_times(part, A, part + WRENCH);
    cross_force(V, part + MOMENTUM, moving);
    add(part + WRENCH, moving, 6);
}

/* The base moves with its twists, without specific force and angular acceleration: the wrench on all is bias, (6,) */
void move_links(const heft_frames *f, i64 i, heft_motion *m, double bias[6]) {
    i64 nl = f->links;
    double all[PARTS] = {0.0}, *rate = m->rate + 6 * i, *twist = m->twist + 6 * i;
    memset(rate, 0, 6 * sizeof(double));
    cross(twist, twist + 3, rate);    /* less w x v */
    for (i64 k = 0; k < nl; k++) {
        i64 one = i * nl + k;
        moved(m->parts + PARTS * one, twist, rate, f->V + 6 * one, f->A + 6 * one, m->V + 6 * one, m->A + 6 * one);
        add(all, m->parts + PARTS * one, PARTS);
    }
    slope_of(all, twist, m->slope + 18 * i);
    memcpy(bias, all + WRENCH, 6 * sizeof(double));
}

/* Specific force and angular acceleration of the base as well */
void push_links(i64 links, i64 i, heft_motion *m, const double thrust[6]) {
    add(m->rate + 6 * i, thrust, 6);
    for (i64 k = 0; k < links; k++) {
        double more[6], *part = m->parts + PARTS * (i * links + k);
        add(m->A + 6 * (i * links + k), thrust, 6);
        inertia_times(part, thrust, more);
        add(part + WRENCH, more, 6);
    }
}

void centre_of(const double composite[36], double *mass_kg, double centre_m[3]) {
    *mass_kg = composite[0];
    centre_m[0] = -composite[16] / *mass_kg, centre_m[1] = -composite[5] / *mass_kg, centre_m[2] = -composite[9] / *mass_kg;
}

/* M - r x F of each wrench, (6, count) to (3, count) */
void torque_about_centre(const double *of_each, i64 count, const double centre_m[3], double *out) {
    for (i64 j = 0; j < count; j++) {
        double F[3] = {of_each[j], of_each[count + j], of_each[2 * count + j]}, turned[3];
        cross(centre_m, F, turned);
        for (i64 k = 0; k < 3; k++) out[k * count + j] = of_each[(k + 3) * count + j] - turned[k];
    }
}

/* bodies_at_rest, moved: as a function of Python. Results: those of motion_in */
HEFT_API int heft_bodies(const heft_frames *f, const double *twist, const double *thrust, double *out, i64 size) {
    if (size != motion_size(f->n, f->links)) return HEFT_SIZE;
    heft_motion m;
    memset(out, 0, (size_t)size * sizeof(double));
    motion_in(out, f->n, f->links, &m);
    bodies_at_rest(f, &m);
    if (!twist) return HEFT_OK;
    memcpy(m.twist, twist, (size_t)(6 * f->n) * sizeof(double));
    for (i64 i = 0; i < f->n; i++) {
        double bias[6];
        move_links(f, i, &m, bias);
        memcpy(m.thrust + 6 * i, thrust, 6 * sizeof(double));
        push_links(f->links, i, &m, thrust + 6 * i);
    }
    return HEFT_OK;
}

/* Sums over groups with weights (groups, links): inertia and its change (n, groups, 6, 6), momentum and wrench (.., 6) */
HEFT_API int heft_sums(i64 n, i64 links, i64 groups, const double *parts, const double *weights, double *out, i64 size) {
    if (size != n * groups * 84) return HEFT_SIZE;
    i64 count = n * groups;
    double *inertia = out, *change = out + 36 * count, *momentum = change + 36 * count, *wrench = momentum + 6 * count;
    for (i64 i = 0; i < n; i++)
        for (i64 g = 0; g < groups; g++) {
            double all[PARTS];
            i64 one = i * groups + g;
            weighted_sum(parts + PARTS * links * i, weights + links * g, links, all);
            inertia_matrix(all, inertia + 36 * one);
            spatial_matrix(0.0, all + D_MOMENT, all + D_TENSOR, change + 36 * one);
            memcpy(momentum + 6 * one, all + MOMENTUM, 6 * sizeof(double));
            memcpy(wrench + 6 * one, all + WRENCH, 6 * sizeof(double));
        }
    return HEFT_OK;
}
