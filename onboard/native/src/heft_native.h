/* What the files of the library share. Arrays are the caller's, of doubles, row by row; shapes are in the comments.
 *
 * Functions that Python calls (onboard/native/__init__.py) return 0, or one of the codes below. Results of a call lie one
 * after the other in one array; its length is checked against what is put there.
 */
#ifndef HEFT_NATIVE_H
#define HEFT_NATIVE_H

#include "algebra.h"

enum { ERRORS = 35, CELL = 4, FELT = 3 };    /* errors of an IMU; of a load cell, and of a joint's torque besides */
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

/* What encoders read. */
typedef struct {
    i64 n, joints, functions, taken;            /* taken: so many functions are multiples that are taken out */
    const double *q, *dq, *ddq, *cyclic;        /* (n, joints) each, (n, 3, functions) */
    const i64 *of;                              /* (functions,) the joint of each */
    const double *errors, *multiples;           /* (joints, 6), (taken,) */
} heft_readings;

/* Motion of the base, for its sensors. */
typedef struct {
    i64 n, total;
    const double *rate, *acceleration, *specific_force;    /* (n, 6): linear, angular; (n, 3) each otherwise */
    const double *by_rate, *by_wrench, *along;             /* (n, 6, 3), (n, 6, 6), (n, 9, total) */
} heft_base;

/* The predicted motion that a wrench follows from. */
typedef struct {
    i64 n, links, total;
    const double *R, *p;                        /* (n, links, 3, 3), (n, links, 3) */
    const double *parts, *twist;                /* (n, links, PARTS), (n, 6) */
    const double *along, *by_rate, *by_wrench;  /* (n, 9, total), (n, 6, 3), (n, 6, 6) */
    const double *screws, *functions;           /* (n, joints, 6, 12), (n, 3, functions); NULL without errors */
} heft_moving;

typedef struct {
    i64 carried_by, columns;
    const double *group, *is_beyond;            /* (links,), (columns,) one or zero */
    const double *R, *p, *projection;           /* of the cut in the link that carries it; (6,) */
} heft_cut;

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

/* The parameters s of a body in the drawing by its errors z, (10,) each; see onboard...free_flyer.prediction.scaled */
void scaled_body(const double drawn[10], const double factor[10], const double z[10], double s[10]);
/* Derivatives by s, (rows, states), in place those by z, which stand at (10 bodies,) */
int scaled_derivatives(i64 bodies, const double *drawn, const double *factor, const double *z, const i64 *at, i64 states,
                       double *by, i64 size);

/* An IMU along a motion, at p with axes R. Out: values (n - 2, 6), their derivatives by its errors (n - 2, 6, ERRORS), by
 * its place (n - 2, 6, 3); by_motion (n, apart, total), its six lines, gets those of an instant by what the motion
 * depends on. */
int imu_along(const heft_base *b, const double *R, const double *p, const double *errors, i64 samples, double period_s,
              double *by_motion, i64 apart, double *out);

/* Of a wrench about the base's origin in base axes, (6,), those that make a cut's component of it */
void cut_weights(const heft_moving *b, const heft_cut *cut, i64 i, double u[6]);

/* What a load cell, or the torque of a joint (-1: it is none), shows of its true component, (n,), over a tick: the value,
 * and derivatives by its errors; c is the weight of the second difference, dq and ddq are of all joints */
double cell_shows(const double *true, double period_s, const double *errors, double c, const double *dq, const double *ddq,
                  i64 joint, i64 joints, i64 tick, double d[CELL + FELT]);

/* Mean over a tick of what is known at its middle and those beside it: middle plus c times the second difference */
static inline double tick_mean(double c, const double *at, i64 apart) {
    return at[0] + c * (at[apart] - 2.0 * at[0] + at[-apart]);
}

/* Functions of Python that others of the library call, too */
int heft_plus(i64 columns, const double *values, const double *by, const double *more, double *out, i64 size);
int heft_corrected(const heft_readings *r, double period_s, double *work, double *out, i64 size);
int heft_chain(const heft_tree *t, i64 n, const double *q, const double *dq, const double *ddq, const double *offsets,
               double *out, i64 size);
int heft_predict_base(const heft_frames *f, const heft_columns *unknown, const heft_errors *errors,
                      const double *const *seats, const double *functions, i64 local, const heft_push *push,
                      double period_s, const double *start, int by_rate, double *out, i64 size);
int heft_cut_wrench(const heft_moving *b, const heft_cut *cut, const heft_errors *errors, double *work, double *out,
                    i64 size);

#endif
