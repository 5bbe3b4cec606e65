/* Small linear systems by elimination with the largest pivot of each column (Golub and Van Loan, 3.4). */
#include <math.h>

#include "heft_native.h"

/* Gauss-Jordan on (size, size + columns), row by row; not 0 where a pivot is zero */
static int eliminate(double *a, i64 size, i64 width) {
    for (i64 k = 0; k < size; k++) {
        i64 best = k;
        for (i64 i = k + 1; i < size; i++)
            if (fabs(a[i * width + k]) > fabs(a[best * width + k])) best = i;
        double pivot = a[best * width + k];
        if (pivot == 0.0) return 1;
        for (i64 j = 0; j < width; j++) {
            double moved = a[best * width + j];
            a[best * width + j] = a[k * width + j];
            a[k * width + j] = moved / pivot;
        }
        for (i64 i = 0; i < size; i++) {
            double by = a[i * width + k];
            if (i != k && by != 0.0) add_times(a + i * width, -by, a + k * width, width);
        }
    }
    return 0;
}

int invert6(const double a[36], double out[36]) {
    double both[72] = {0.0};
    for (i64 i = 0; i < 6; i++) {
        memcpy(both + 12 * i, a + 6 * i, 6 * sizeof(double));
        both[12 * i + 6 + i] = 1.0;
    }
    int singular = eliminate(both, 6, 12);
    for (i64 i = 0; i < 6; i++)
        for (i64 j = 0; j < 6; j++) out[6 * i + j] = singular ? NAN : both[12 * i + 6 + j];
    return singular;
}

/* b (3, columns) becomes a^-1 b, NaN of a singular a: by the inverse, which all columns share */
int solve3(const double a[9], double *b, i64 columns) {
    double both[18] = {0.0}, inverse[9];
    for (i64 i = 0; i < 3; i++) {
        memcpy(both + 6 * i, a + 3 * i, 3 * sizeof(double));
        both[6 * i + 3 + i] = 1.0;
    }
    int singular = eliminate(both, 3, 6);
    for (i64 i = 0; i < 3; i++)
        for (i64 j = 0; j < 3; j++) inverse[3 * i + j] = singular ? NAN : both[6 * i + 3 + j];
    for (i64 j = 0; j < columns; j++) {
        double column[3] = {b[j], b[columns + j], b[2 * columns + j]};
        for (i64 i = 0; i < 3; i++) b[i * columns + j] = dot(inverse + 3 * i, column);
    }
    return singular;
}
