/* A load cell, or the torque of a joint, whose errors are those of an IMU for one axis; see
 * onboard.identification.free_flyer.prediction.further. */
#include "heft_native.h"

static double sign(double a) { return a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : a; }

double cell_shows(const double *true, double period_s, const double *errors, double c, const double *dq, const double *ddq,
                  i64 joint, i64 joints, i64 tick, double d[CELL + FELT]) {
    double parts[3][1 + FELT], late[1 + FELT], change[1 + FELT], gain = 1.0 + errors[2], time_s = period_s * (double)tick;
    i64 count = joint < 0 ? 1 : 1 + FELT;
    for (i64 k = 0; k < 3; k++) {
        i64 i = tick + k - 1;
        parts[k][0] = true[i];
        if (joint < 0) continue;
        parts[k][1] = sign(dq[joints * i + joint]), parts[k][2] = dq[joints * i + joint];
        parts[k][3] = ddq[joints * i + joint];
        for (i64 f = 0; f < FELT; f++) parts[k][0] += parts[k][1 + f] * errors[CELL + f];
    }
    for (i64 k = 0; k < count; k++) {
        change[k] = (parts[2][k] - parts[0][k]) / (2.0 * period_s);
        late[k] = tick_mean(c, parts[1] + k, 1 + FELT) - errors[3] * change[k];
        if (k) d[CELL + k - 1] = gain * late[k];
    }
    d[0] = 1.0, d[1] = time_s, d[2] = late[0], d[3] = -gain * change[0];
    return gain * late[0] + errors[0] + errors[1] * time_s;
}
