/* Evidence of what may not be as stated; equations in onboard.identification.evidence.bank. */
#include <math.h>
#include <stdlib.h>

#include "heft_native.h"

/* Suspects, one after the other */
typedef struct {
    i64 states, suspects, columns, places;      /* the last two are sums */
    const i64 *count, *width, *at;              /* (suspects,) places of each and columns, (places,) */
    const double *slopes, *inner;               /* U of each, (count, width); 1 + D' U of all, (columns, columns) */
} heft_bank;

/* One of them, and how far its parts are from those of the first */
typedef struct {
    i64 count, width, column;
    const i64 *at;
    const double *slopes;
} suspect;

/* Logarithm of a number from one on; fdlibm 5.3 (e_log.c), whose error is below one unit in the last place */
static double logarithm(double x) {
    uint64_t bits;
    if (!(x < INFINITY)) return x;
    memcpy(&bits, &x, sizeof bits);
    double k = (double)(bits >> 52) - 1023.0, m;
    bits = (bits & 0xfffffffffffffULL) | 0x3ff0000000000000ULL;
    memcpy(&m, &bits, sizeof m);
    if (m > 1.41421356237309514547) m *= 0.5, k += 1.0;
    double f = m - 1.0, s = f / (2.0 + f), z = s * s, w = z * z, half = 0.5 * f * f;
    double even = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01));
    double odd = z * (6.666666666666735130e-01 +
                      w * (2.857142874366239149e-01 + w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01)));
    return k * 6.93147180369123816490e-01 - ((half - (s * (half + (even + odd)) + k * 1.90821492927058770002e-10)) - f);
}

/* M (r, r) becomes its Cholesky factor; log |M|. Nothing of M - 1 is negative but by rounding: no row of the factor gets
 * longer than the root of its diagonal. */
static double factor(double *M, i64 r) {
    double log_of = 0.0;
    for (i64 i = 0; i < r; i++) {
        double *row = M + r * i, left = row[i] < 1.0 ? 0.0 : row[i] - 1.0;    /* of the pivot, over one */
        for (i64 j = 0; j < i; j++) {
            for (i64 k = 0; k < j; k++) row[j] -= row[k] * M[r * j + k];
            row[j] /= M[r * j + j];
            if (row[j] * row[j] > left) row[j] = row[j] < 0.0 ? -sqrt(left) : sqrt(left);
            left -= row[j] * row[j];
            if (left < 0.0) left = 0.0;
        }
        log_of += logarithm(1.0 + left), row[i] = sqrt(1.0 + left);
    }
    return log_of;
}

/* W = L^-T (r, r), of which the product with its transpose is M^-1 */
static void root_of_inverse(const double *L, i64 r, double *W) {
    for (i64 i = 0; i < r; i++)
        for (i64 j = 0; j < r; j++) {
            double sum = i == j ? 1.0 : 0.0;
            for (i64 k = i; k < j; k++) sum -= L[r * j + k] * W[r * i + k];
            W[r * i + j] = j < i ? 0.0 : sum / L[r * j + j];
        }
}

/* g = W' slope and W g, the sizes; the square of g */
static double sizes_of(const double *W, const double *slope, i64 r, double *g, double *sizes) {
    double square = 0.0;
    for (i64 j = 0; j < r; j++) {
        g[j] = 0.0;
        for (i64 i = 0; i <= j; i++) g[j] += W[r * i + j] * slope[i];
        square += g[j] * g[j];
    }
    for (i64 i = 0; i < r; i++) {
        sizes[i] = 0.0;
        for (i64 j = i; j < r; j++) sizes[i] += W[r * i + j] * g[j];
    }
    return square;
}

/* inner - U' P V, (r, s), of two of them */
static void between(const heft_bank *b, const double *P, const suspect *one, const suspect *other, double *PV, double *out) {
    i64 r = one->width, s = other->width;
    for (i64 i = 0; i < r; i++)
        for (i64 j = 0; j < s; j++) out[s * i + j] = b->inner[b->columns * (one->column + i) + other->column + j];
    for (i64 k = 0; k < one->count; k++) {
        const double *row = P + b->states * one->at[k];
        memset(PV, 0, (size_t)s * sizeof(double));
        for (i64 c = 0; c < other->count; c++) add_times(PV, row[other->at[c]], other->slopes + s * c, s);
        for (i64 i = 0; i < r; i++) add_times(out + s * i, -one->slopes[r * k + i], PV, s);
    }
}

static int fits(const heft_bank *b, i64 *widest) {
    i64 columns = 0, places = 0;
    for (i64 k = 0; k < b->suspects; k++) {
        if (b->count[k] < 0 || b->width[k] < 0) return 0;
        columns += b->width[k], places += b->count[k];
        *widest = b->width[k] > *widest ? b->width[k] : *widest;
    }
    for (i64 k = 0; k < b->places; k++)
        if (b->at[k] < 0 || b->at[k] >= b->states) return 0;
    return columns == b->columns && places == b->places;
}

static suspect next(const heft_bank *b, i64 k, const suspect *before) {
    suspect one = {b->count[k], b->width[k], 0, b->at, b->slopes};
    if (before) {
        one.column = before->column + before->width, one.at = before->at + before->count;
        one.slopes = before->slopes + before->count * before->width;
    }
    return one;
}

static i64 results(const heft_bank *b, i64 given) {
    i64 size = 2 * b->suspects + b->columns * given;
    for (i64 k = 0; k < b->suspects; k++) size += b->width[k] * (b->width[k] + 1);
    return size;
}

/* Each by itself or, with first from 0 on, beside that one, whose root W (r, r) and gradient g (r,) are given.
 * Results: nats (suspects,), sizes (suspects,), then of each W and g; beside the first, U' P V W of all, (columns, r) */
HEFT_API int heft_alone(const heft_bank *b, const double *x, const double *P, i64 first, const double *W, const double *g,
                        double *out, i64 size) {
    i64 n = b->suspects, widest = 0;
    if (n < 0 || first >= n || !fits(b, &widest)) return HEFT_SIZE;
    i64 given = first < 0 ? 0 : b->width[first], apart = widest * widest + widest;
    if (size != results(b, given)) return HEFT_SIZE;
    double *work = malloc((size_t)(2 * apart + 1) * sizeof(double)), *M = work, *slope = M + widest * widest;
    if (!work) return HEFT_MEMORY;
    double *across = work + apart, *row = across + widest * widest, *at = out + 2 * n;
    suspect one = {0}, other = {0};
    for (i64 k = 0; k <= first; k++) other = next(b, k, k ? &other : NULL);
    for (i64 k = 0; k < n; k++) {
        one = next(b, k, k ? &one : NULL);
        i64 r = one.width;
        between(b, P, &one, &one, row, M);
        memset(slope, 0, (size_t)r * sizeof(double));
        for (i64 c = 0; c < one.count; c++) add_times(slope, x[one.at[c]], one.slopes + r * c, r);
        if (given) {
            double *onto = out + size - given * (b->columns - one.column);
            between(b, P, &one, &other, row, across);
            for (i64 i = 0; i < r; i++)
                for (i64 j = 0; j < given; j++) {
                    onto[given * i + j] = 0.0;
                    for (i64 c = 0; c < given; c++) onto[given * i + j] += across[given * i + c] * W[given * c + j];
                    slope[i] -= onto[given * i + j] * g[j];
                }
            for (i64 i = 0; i < r; i++)
                for (i64 j = 0; j < r; j++)
                    for (i64 c = 0; c < given; c++) M[r * i + j] -= onto[given * i + c] * onto[given * j + c];
        }
        double log_of = factor(M, r), squares = 0.0;
        root_of_inverse(M, r, at);
        out[k] = 0.5 * (sizes_of(at, slope, r, at + r * r, row) - log_of);
        for (i64 i = 0; i < r; i++) squares += row[i] * row[i];
        out[n + k] = r ? sqrt(squares / (double)r) : 0.0;
        at += r * r + r;
    }
    free(work);
    return HEFT_OK;
}

/* Nats of one with several columns, from its part of J; none where it is farther off than that */
static double of_several(const double *d, const double *J, i64 m, i64 first, i64 r, double farthest, double *work) {
    double *M = work, *W = M + r * r, *g = W + r * r, *sizes = g + r;
    for (i64 i = 0; i < r; i++)
        for (i64 j = 0; j < r; j++) M[r * i + j] = J[m * (first + i) + first + j] + (i == j ? 1.0 : 0.0);
    double log_of = factor(M, r);
    root_of_inverse(M, r, W);
    double nats = 0.5 * (sizes_of(W, d + first, r, g, sizes) - log_of);
    for (i64 i = 0; i < r; i++)
        if (!(fabs(sizes[i]) < farthest)) nats = -INFINITY;
    return nats;
}

/* Steps, of width (n,) columns of m each, with the gradient d (m,), the information J (m, m) and logarithms of the odds
 * (n,). Results: nats of each two (n, n) and logarithms of their weights (n, n), of each alone on the diagonals; two of
 * which one has several columns have none. work (2 w w + 2 w,) with w the largest width. */
HEFT_API int heft_pairs(i64 n, i64 m, const i64 *width, const double *d, const double *J, const double *odds,
                        double farthest, double *work, double *out, i64 size) {
    if (n < 0 || size != 2 * n * n) return HEFT_SIZE;
    double *logs = out + n * n;
    i64 at = 0, other;
    for (i64 k = 0; k < n; k++) at += width[k] > 0 ? width[k] : m + 1;
    if (at != m) return HEFT_SIZE;
    for (i64 a = at = 0; a < n; at += width[a++]) {
        double M = 1.0 + (J[(m + 1) * at] < 0.0 ? 0.0 : J[(m + 1) * at]);
        double alone = 0.5 * (d[at] * d[at] / M - logarithm(M));
        if (width[a] > 1) alone = of_several(d, J, m, at, width[a], farthest, work);
        out[(n + 1) * a] = alone, logs[(n + 1) * a] = alone + odds[a];
        other = at + width[a];
        for (i64 b = a + 1; b < n; other += width[b++]) {
            double nats = -INFINITY;
            if (width[a] == 1 && width[b] == 1) {
                double both = J[m * at + other], own = J[(m + 1) * other] < 0.0 ? 0.0 : J[(m + 1) * other];
                double left = 1.0 + own - both * both / M, slope = d[other] - d[at] * both / M;
                left = left < 1.0 ? 1.0 : left;
                nats = alone + 0.5 * (slope * slope / left - logarithm(left));
            }
            out[n * a + b] = out[n * b + a] = nats;
            logs[n * a + b] = logs[n * b + a] = nats + odds[a] + odds[b];
        }
    }
    return HEFT_OK;
}
