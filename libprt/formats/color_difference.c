// SPDX-License-Identifier: MIT
#include "color_difference.h"

#include <math.h>
#include <stdbool.h>

static const double degree = M_PI / 180;

// ---- sRGB (IEC 61966-2-1) to CIELAB

static double linear(uint8_t byte)
{
    double x = byte / 255.;
    return x <= .04045 ? x / 12.92 : pow((x + .055) / 1.055, 2.4);
}

static double lightness(double t)
{
    return t > 216. / 24389 ? cbrt(t) : (24389. / 27 * t + 16) / 116;
}

void prt_lab_from_srgb8(const uint8_t rgb[3], double lab[3])
{
    static const double to_xyz[3][3] = {
        {.4123907992659595, .3575843393838780, .1804807884018343},
        {.2126390058715104, .7151686787677559, .0721923153607337},
        {.0193308187155918, .1191947797946259, .9505321522496608}};
    double light[3], f[3];
    for (int i = 0; i < 3; i++) light[i] = linear(rgb[i]);
    for (int i = 0; i < 3; i++) {
        double x = 0, white = 0;
        for (int k = 0; k < 3; k++) {
            x += to_xyz[i][k] * light[k];
            white += to_xyz[i][k];
        }
        f[i] = lightness(x / white);
    }
    lab[0] = 116 * f[1] - 16;
    lab[1] = 500 * (f[0] - f[1]);
    lab[2] = 200 * (f[1] - f[2]);
}

// ---- CIEDE2000

// Degrees in [0,360); 0 for grey.
static double hue(double a, double b)
{
    if (a == 0 && b == 0) return 0;
    double h = atan2(b, a) / degree;
    return h < 0 ? h + 360 : h;
}

// Hue difference and mean of two colours. With a grey among them the difference is 0, and the
// mean is the other's hue.
static void compare_hues(double h1, double h2, bool grey, double *difference, double *mean)
{
    double d = h2 - h1, sum = h1 + h2;
    *difference = grey ? 0 : d > 180 ? d - 360 : d < -180 ? d + 360 : d;
    if (grey) *mean = sum;
    else if (fabs(d) <= 180) *mean = sum / 2;
    else *mean = sum < 360 ? (sum + 360) / 2 : (sum - 360) / 2;
}

static double power7(double x)
{
    return x * x * x * x * x * x * x;
}

double prt_ciede2000(const double a[3], const double b[3])
{
    const double far = power7(25);
    double chroma = (hypot(a[1], a[2]) + hypot(b[1], b[2])) / 2;
    double g = (1 - sqrt(power7(chroma) / (power7(chroma) + far))) / 2;
    double a1 = (1 + g) * a[1], a2 = (1 + g) * b[1];
    double c1 = hypot(a1, a[2]), c2 = hypot(a2, b[2]), dh, h;
    compare_hues(hue(a1, a[2]), hue(a2, b[2]), c1 * c2 == 0, &dh, &h);
    double light = (a[0] + b[0]) / 2 - 50, c = (c1 + c2) / 2;
    double dl = b[0] - a[0], dc = c2 - c1, dhue = 2 * sqrt(c1 * c2) * sin(dh / 2 * degree);
    double t = 1 - .17 * cos((h - 30) * degree) + .24 * cos(2 * h * degree) +
               .32 * cos((3 * h + 6) * degree) - .20 * cos((4 * h - 63) * degree);
    double turn = 30 * exp(-(h - 275) / 25 * ((h - 275) / 25));
    double rotation = -2 * sqrt(power7(c) / (power7(c) + far)) * sin(2 * turn * degree);
    double x = dl / (1 + .015 * light * light / sqrt(20 + light * light));
    double y = dc / (1 + .045 * c), z = dhue / (1 + .015 * c * t);
    return sqrt(fmax(0, x * x + y * y + z * z + rotation * y * z));
}
