/* What noise of the joints does to a prediction; see onboard.identification.free_flyer.prediction.joint_noise. */
#include <math.h>
#include <stdlib.h>

#include "heft_native.h"

typedef struct {
    i64 imus, cells, lines;
    const heft_tree *tree;
    const double *beyond, *frames, *free;       /* (joints, links); (imus, 12) axes and place; (6,) one where it moves */
} heft_noise;

/* The base's accelerations by those of the joints, (joints, 6), where it is at rest: momentum is conserved */
static void recoil(const heft_noise *s, const heft_motion *m, const double *screws, double *twist) {
    double M[36], inverse[36];
    for (i64 k = 0; k < 36; k++) {
        int inside = s->free[k / 6] != 0.0 && s->free[k % 6] != 0.0;
        M[k] = inside ? m->composite[k] : k % 7 == 0 ? 1.0 : 0.0;
    }
    invert6(M, inverse);
    for (i64 j = 0; j < s->tree->joints; j++) {
        double all[PARTS], momentum[6];
        weighted_sum(m->parts, s->beyond + s->tree->links * j, s->tree->links, all);
        inertia_times(all, screws + 6 * j, momentum);
        for (i64 k = 0; k < 6; k++) momentum[k] *= -s->free[k];
        multiply(inverse, momentum, 1, twist + 6 * j, 1, 6, 6, 1);
    }
}

/* Effects of an error of one in each joint's rate and acceleration, (joints, 2, lines) */
static void effects(const heft_noise *s, const heft_cut *const *cuts, const heft_errors *const *errors,
                    const heft_frames *f, const heft_motion *m, const double *screws, const double *twist, double *out) {
    heft_moving v = {.n = 1, .links = f->links, .R = f->R, .p = f->p};
    memset(out, 0, (size_t)(2 * s->tree->joints * s->lines) * sizeof(double));
    for (i64 j = 0; j < s->tree->joints; j++) {
        const double *U = twist + 6 * j;
        double *rate = out + 2 * j * s->lines, *acceleration = rate + s->lines;
        for (i64 k = 0; k < s->imus; k++) {
            const double *R = s->frames + 12 * k;
            double force[3];
            cross(U + 3, R + 9, force);
            add(force, U, 3);
            rotate_back(R, U + 3, rate + 6 * k), rotate_back(R, force, acceleration + 6 * k + 3);
        }
        for (i64 k = 0; k < s->cells; k++) {
            double u[6], all[PARTS], own[6], moved[6];
            cut_weights(&v, cuts[k], 0, u);
            weighted_sum(m->parts, errors[k]->beyond + f->links * j, f->links, all);
            inertia_times(all, screws + 6 * j, own);
            weighted_sum(m->parts, cuts[k]->group, f->links, all);
            inertia_times(all, U, moved);
            for (i64 i = 0; i < 6; i++) acceleration[6 * s->imus + k] += (own[i] + moved[i]) * u[i];
        }
    }
}

/* Results: effects at each of n angles q, (n, joints, 2, lines); errors of the joints beyond each cell's cut. */
HEFT_API int heft_joint_noise(const heft_noise *s, const heft_cut *const *cuts, const heft_errors *const *errors, i64 n,
                              const double *q, const double *chi, double *out, i64 size) {
    i64 nj = s->tree->joints, nl = s->tree->links, chain = 24 * nl + 30 * nj + 12 * (nj + 1), moving = motion_size(1, nl);
    if (n < 0 || size != 2 * n * nj * s->lines || s->lines < 6 * s->imus + s->cells) return HEFT_SIZE;
    double *still = calloc((size_t)(nj + chain + moving + 6 * nj + 1), sizeof(double));
    if (!still) return HEFT_MEMORY;
    double *at = still + nj, *twist = at + chain + moving;
    heft_frames f = {1, nl, at, at + 9 * nl, at + 12 * nl, at + 18 * nl, chi};
    heft_motion m;
    motion_in(at + chain, 1, nl, &m);
    int code = HEFT_OK;
    for (i64 i = 0; i < n && !code; i++) {
        const double *screws = at + 24 * nl + 24 * nj;
        code = heft_chain(s->tree, 1, q + nj * i, still, still, NULL, at, chain);
        bodies_at_rest(&f, &m);
        recoil(s, &m, screws, twist);
        effects(s, cuts, errors, &f, &m, screws, twist, out + 2 * nj * s->lines * i);
    }
    free(still);
    return code;
}
