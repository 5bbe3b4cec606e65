/* What the files of the library share. Arrays are the caller's, of doubles, row by row; shapes are in the comments.
 *
 * Functions that Python calls (onboard/native/__init__.py) return 0, or one of the codes below. Results of a call lie one
 * after the other in one array; its length is checked against what is put there.
 */
#ifndef HEFT_NATIVE_H
#define HEFT_NATIVE_H

#include "algebra.h"

enum { HEFT_OK = 0, HEFT_SIZE = 1, HEFT_MEMORY = 2 };

#define HEFT_API __attribute__((visibility("default")))

/* Joints and links of a vehicle: onboard.dynamics.model.tree.Tree. */
typedef struct {
    i64 joints, links;
    const i64 *parent, *body;                   /* (joints,), (links,) */
    const double *seat_axes, *seat_origin;      /* (joints, 3, 3), (joints, 3) */
    const double *axis, *turned, *revolute;     /* (joints, 3), (2, joints, 3, 3), (joints,) */
    const double *link_axes, *link_origin;      /* (links, 3, 3), (links, 3) */
} heft_tree;

/* Motion of links relative to the base, and their standard parameters. */
typedef struct {
    i64 n, links;
    const double *R, *p, *V, *A;                /* (n, links, 3, 3), (.., 3), (.., 6), (.., 6) */
    const double *chi;                          /* (links, 10) */
} heft_frames;

/* Known wrenches on the base. */
typedef struct {
    i64 count;
    const double *of_each, *gain;               /* (n, 6, count), (count,) */
} heft_push;

/* Links whose parameters are unknown, and ten directions of each. */
typedef struct {
    i64 count;
    const i64 *links;                           /* (count,) */
    const double *bases;                        /* (count, 10, 10) */
} heft_columns;

/* Errors of the joints: onboard.dynamics.joint_errors.JointErrors. */
typedef struct {
    i64 joints, functions;                      /* functions: 2 x joints + cyclic ones */
    const double *beyond, *stays;               /* (joints, links), (joints,) */
    const i64 *of;                              /* (functions,) the joint of each */
} heft_errors;

/* A body, or a sum of some: inertia about the base's origin, its rate of change, momentum and wrench. */
enum { MASS = 0, MOMENT = 1, TENSOR = 4, D_MOMENT = 10, D_TENSOR = 13, MOMENTUM = 19, WRENCH = 25, PARTS = 31 };

/* The links as they move: onboard.dynamics.kinematics.Bodies. */
typedef struct {
    double *parts;                              /* (n, links, PARTS) */
    double *composite, *relative_momentum;      /* (n, 6, 6), (n, 6) */
    double *twist, *rate;                       /* (n, 6) of the base */
    double *V, *A;                              /* (n, links, 6) */
    double *inverse, *momentum;                 /* (n, 6, 6), (n, 3) */
    double *slope, *thrust;                     /* (n, 6, 3), (n, 6) */
} heft_motion;

double heft_sin(double x);
double heft_cos(double x);

/* I U, dI U with I of a body */
void inertia_times(const double *part, const double U[6], double out[6]);
void change_times(const double *part, const double U[6], double out[6]);
void inertia_matrix(const double *part, double out[36]);
/* Derivative of the wrench by the base's rate, (6, 3) */
void slope_of(const double *part, const double twist[6], double out[18]);
/* Sum of the links with weights (links,) */
void weighted_sum(const double *parts, const double *weights, i64 links, double out[PARTS]);

i64 motion_size(i64 n, i64 links);
void motion_in(double *at, i64 n, i64 links, heft_motion *out);
void bodies_at_rest(const heft_frames *f, heft_motion *m);
/* The base moves with its twist, without specific force and angular acceleration: bias (6,) is the wrench on all links */
void move_links(const heft_frames *f, i64 tick, heft_motion *m, double bias[6]);
void push_links(i64 links, i64 tick, heft_motion *m, const double thrust[6]);
int move_base(const heft_frames *f, const heft_push *push, double period_s, const double start[3], int by_rate,
              heft_motion *m);
void centre_of(const double composite[36], double *mass_kg, double centre_m[3]);
void torque_about_centre(const double *of_each, i64 count, const double centre_m[3], double *out);

/* eta, (n, 3); inverse (n, 6, 6), still (n, 3), torque (n, 3) or NULL */
int integrate_momentum(i64 n, const double *inverse, const double *still, const double start[3], double h,
                       const double *torque, double *eta);
/* S, (n, 3, width), S[0] is the start; forcing (n, 3, width - 3) */
int integrate_sensitivity(i64 n, i64 width, const heft_motion *m, const double *forcing, double h, double *S);

int invert6(const double a[36], double out[36]);
int solve3(const double a[9], double *b, i64 columns);

/* Screws (12, 6) of a joint, and of what lies beyond it derivatives of the wrench (6 vectors: places, zero, rate,
 * acceleration of a function) and of the momentum (5) */
void displaced_by(const double *seat_R, const double *seat_V, const double *seat_A, const double screw[6],
                  const double twist[6], const double rate[6], double U[72]);
void errors_into(const heft_errors *e, i64 links, const double *parts, const double *U, const double *functions,
                 double *H, i64 H_apart, double *Y, i64 Y_apart);
/* Columns of momentum, and of the wrench, of one link, (6, 10) each; either may be NULL */
void link_columns(const double R[9], const double p[3], const double V[6], const double A[6], const double *basis,
                  double *H, i64 H_apart, double *Y, i64 Y_apart);

#endif
