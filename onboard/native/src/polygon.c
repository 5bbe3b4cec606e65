/* Convex polygons of points (x, y) in counter-clockwise order; see onboard.timebase.polygon. */
#include <math.h>
#include <stdlib.h>

#include "heft_native.h"

typedef struct {
    double x, y;
} point;

/* Corners that two hands of memory hold in turns; there is room for all that a call can make */
typedef struct {
    i64 count, most;    /* most: corners that are kept of a wider one */
    point *at, *other;
    double *beside;
} shape;

static void swap(shape *s, i64 count) {
    point *at = s->at;
    s->at = s->other, s->other = at, s->count = count;
}

/* The part with a x + b y <= c, possibly empty (Sutherland and Hodgman, 1974) */
static void clip(shape *s, double a, double b, double c) {
    i64 n = s->count, kept = 0, outside = 0;
    for (i64 i = 0; i < n; i++) {
        s->beside[i] = a * s->at[i].x + b * s->at[i].y - c;
        outside |= !(s->beside[i] <= 0.0);
    }
    for (i64 i = 0; outside && i < n; i++) {
        point p = s->at[i], q = s->at[(i + 1) % n];
        double here = s->beside[i], there = s->beside[(i + 1) % n];
        if (here <= 0.0) s->other[kept++] = p;
        if ((here < 0.0 && 0.0 < there) || (there < 0.0 && 0.0 < here)) {
            double share = here / (here - there);
            s->other[kept++] = (point){p.x + share * (q.x - p.x), p.y + share * (q.y - p.y)};
        }
    }
    if (outside) swap(s, kept);
    if (s->count < 3) s->count = 0;
}

static int before(point a, point b) { return a.x < b.x || (a.x == b.x && a.y < b.y); }

static void sort(point *at, i64 count) {
    for (i64 i = 1; i < count; i++) {
        point moved = at[i];
        i64 k = i;
        for (; k > 0 && before(moved, at[k - 1]); k--) at[k] = at[k - 1];
        at[k] = moved;
    }
}

/* The lower side of points in order, from the first to the last by step; its length */
static i64 chain(const point *ordered, i64 count, i64 first, i64 step, point *out) {
    i64 kept = 0;
    for (i64 i = 0; i < count; i++) {
        point p = ordered[first + i * step];
        for (; kept > 1; kept--) {
            point a = out[kept - 2], b = out[kept - 1];
            if ((b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x) > 0.0) break;    /* it turns to the left there */
        }
        out[kept++] = p;
    }
    return kept;
}

/* Convex hull (Andrew, 1979) */
static void hull(shape *s) {
    i64 distinct = 0;
    sort(s->at, s->count);
    for (i64 i = 0; i < s->count; i++)
        if (i == 0 || before(s->at[distinct - 1], s->at[i])) s->at[distinct++] = s->at[i];
    s->count = distinct;
    if (distinct < 3) return;
    i64 lower = chain(s->at, distinct, 0, 1, s->other) - 1;
    i64 upper = chain(s->at, distinct, distinct - 1, -1, s->other + lower) - 1;
    swap(s, lower + upper);
}

/* Where line a b beyond b meets line d c beyond c; 0 if nowhere */
static int meeting(point a, point b, point c, point d, point *out) {
    double ux = b.x - a.x, uy = b.y - a.y, vx = c.x - d.x, vy = c.y - d.y, turn = ux * vy - uy * vx;
    if (!(turn < 0.0)) return 0;
    double along = ((c.x - b.x) * vy - (c.y - b.y) * vx) / turn;
    *out = (point){b.x + along * ux, b.y + along * uy};
    return along >= 0.0;
}

/* Without its shortest side that can be, whose neighbours are extended; 0 if none can */
static int shortened(shape *s, double width, double height) {
    i64 n = s->count;
    point apex;
    for (i64 i = 0; i < n; i++) {
        point p = s->at[i], q = s->at[(i + n - 1) % n];
        double x = (p.x - q.x) / width, y = (p.y - q.y) / height;
        s->beside[i] = x * x + y * y;
    }
    for (i64 tried = 0; tried < n; tried++) {
        i64 i = -1;
        for (i64 k = 0; k < n; k++)
            if (s->beside[k] >= 0.0 && (i < 0 || s->beside[k] < s->beside[i])) i = k;
        if (i < 0) return 0;
        s->beside[i] = -1.0;
        if (!meeting(s->at[(i + n - 2) % n], s->at[(i + n - 1) % n], s->at[i], s->at[(i + 1) % n], &apex)) continue;
        i64 gone = (i + n - 1) % n, kept = 0;
        for (i64 k = 0; k < n; k++)
            if (k != gone) s->at[kept++] = s->at[k];
        s->at[i > 0 ? i - 1 : 0] = apex;
        s->count = kept;
        return 1;
    }
    return 0;
}

/* Enclosing polygon with fewer corners */
static void simplify(shape *s) {
    point low = s->at[0], high = s->at[0];
    for (i64 i = 1; i < s->count; i++) {
        low = (point){fmin(low.x, s->at[i].x), fmin(low.y, s->at[i].y)};
        high = (point){fmax(high.x, s->at[i].x), fmax(high.y, s->at[i].y)};
    }
    while (s->count > s->most / 2 && shortened(s, high.x - low.x, high.y - low.y)) continue;
}

/* Minkowski sum with the segment from (-x, -y) to (x, y) */
static void widen(shape *s, double x, double y) {
    i64 n = s->count, kept = 0;
    double *facing = s->beside;    /* outward normals along the segment */
    int out = 1;
    for (i64 i = 0; i < n; i++) {
        point a = s->at[(i + n - 1) % n], b = s->at[i];
        facing[i] = (b.y - a.y) * x - (b.x - a.x) * y;
        if (facing[i] != 0.0) out = facing[i] > 0.0;
    }
    for (i64 i = 0; i < n; i++) {
        double next = facing[(i + 1) % n];
        point p = s->at[i], ahead = {p.x + x, p.y + y}, behind = {p.x - x, p.y - y};
        if (facing[i] != 0.0) out = facing[i] > 0.0;
        s->other[kept++] = out ? ahead : behind;
        if (next != 0.0 && (next > 0.0) != out) s->other[kept++] = out ? behind : ahead;
    }
    swap(s, kept);
    if (kept <= s->most) return;
    hull(s);
    if (s->count > s->most) simplify(s);
}

/* A polygon (count, 2), sheared, x += y shear + shift, then widened by segments (2, 2), then cut by lines (2, 3). how: shear,
 * shift, segments, lines. Results: the number of corners, and they; room for 10 x (count + 2) of them */
HEFT_API int heft_polygon(i64 count, i64 most, const double *corners, i64 segments, i64 lines, const double *how,
                          double *out, i64 size) {
    i64 room = 10 * (count + 2);    /* a wider one has twice as many corners at most, one that is cut half as many again */
    if (count < 1 || segments < 0 || segments > 2 || lines < 0 || lines > 2 || size != 1 + 2 * room) return HEFT_SIZE;
    double *work = malloc((size_t)(5 * room) * sizeof(double));
    if (!work) return HEFT_MEMORY;
    shape s = {count, most, (point *)work, (point *)(work + 2 * room), work + 4 * room};
    for (i64 i = 0; i < count; i++)
        s.at[i] = (point){corners[2 * i] + corners[2 * i + 1] * how[0] + how[1], corners[2 * i + 1]};
    for (i64 k = 0; k < segments; k++) widen(&s, how[2 + 2 * k], how[3 + 2 * k]);
    for (i64 k = 0; k < lines && s.count; k++) clip(&s, how[6 + 3 * k], how[7 + 3 * k], how[8 + 3 * k]);
    out[0] = (double)s.count;
    memcpy(out + 1, s.at, (size_t)s.count * sizeof(point));
    free(work);
    return HEFT_OK;
}

/* Mean and variances of the corners, where the area is lost to rounding */
static void of_corners(const point *at, i64 n, double out[5]) {
    double mx = 0.0, my = 0.0, xx = 0.0, xy = 0.0, yy = 0.0;
    for (i64 i = 0; i < n; i++) mx += at[i].x - at[0].x, my += at[i].y - at[0].y;
    mx /= (double)n, my /= (double)n;
    for (i64 i = 0; i < n; i++) {
        double x = at[i].x - at[0].x - mx, y = at[i].y - at[0].y - my;
        xx += x * x, xy += x * y, yy += y * y;
    }
    out[0] = at[0].x + mx, out[1] = at[0].y + my;
    out[2] = xx / (double)n, out[3] = xy / (double)n, out[4] = yy / (double)n;
}

/* Centroid and covariance (x, y, xx, xy, yy), by Green's theorem about the first corner of (count, 2) */
HEFT_API int heft_moments(i64 count, const double *corners, double *out, i64 size) {
    if (count < 1 || size != 5) return HEFT_SIZE;
    const point *at = (const point *)corners;
    double area = 0.0, sx = 0.0, sy = 0.0, sxx = 0.0, sxy = 0.0, syy = 0.0;
    for (i64 i = 0; i < count; i++) {
        point p = at[i], q = at[(i + 1) % count];
        double ax = p.x - at[0].x, ay = p.y - at[0].y, bx = q.x - at[0].x, by = q.y - at[0].y, turn = ax * by - bx * ay;
        area += turn;
        sx += (ax + bx) * turn, sy += (ay + by) * turn;
        sxx += (ax * ax + ax * bx + bx * bx) * turn, syy += (ay * ay + ay * by + by * by) * turn;
        sxy += (ax * by + 2.0 * ax * ay + 2.0 * bx * by + bx * ay) * turn;
    }
    if (area <= 0.0) {
        of_corners(at, count, out);
        return HEFT_OK;
    }
    double mx = sx / (3.0 * area), my = sy / (3.0 * area);
    double xx = sxx / (6.0 * area) - mx * mx, yy = syy / (6.0 * area) - my * my;
    out[0] = at[0].x + mx, out[1] = at[0].y + my;
    out[2] = xx > 0.0 ? xx : 0.0, out[3] = sxy / (12.0 * area) - mx * my, out[4] = yy > 0.0 ? yy : 0.0;
    return HEFT_OK;
}
