// SPDX-License-Identifier: MIT
// The running mean of pictures of one view.
#include "internal.h"

#include <math.h>

double prt_screen_mean_add(uint32_t n, size_t n_point, const float (*picture)[3],
                           float (*mean)[3])
{
    double moved = 0, all = 0;
    const float share = 2 / (float)(n + 2);
    for (size_t i = 0; i < n_point; i++) {
        for (int c = 0; c < 3; c++) {
            float *m = &mean[i][c], step = n ? share * (picture[i][c] - *m) : 0;
            *m = n ? *m + step : picture[i][c];
            moved += (double)step * (double)step;
            all += (double)*m * (double)*m;
        }
    }
    return all > 0 ? sqrt(moved / all) : -1;
}
