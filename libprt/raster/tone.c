// SPDX-License-Identifier: MIT
// Tone curves and sRGB encoding: one table look-up for each value, indexed by the float's bits.
#include "internal.h"

#include "base/isa.h"

#include <math.h>
#include <pthread.h>
#include <string.h>

// Values in [2^-14, 2^12) in 1024 steps an octave: a step is at most a quarter of an 8-bit one.
enum { OCTAVE_LO = -14, OCTAVE_HI = 12, STEP_BITS = 10, SHIFT = 23 - STEP_BITS };
enum { N_ENTRY = (OCTAVE_HI - OCTAVE_LO) << STEP_BITS };

enum { FINE_LEVELS = 5 * 255 }; // an odd multiple: rounded again to 8 bits they are the table's

static uint8_t table[3][N_ENTRY];
static uint16_t fine[3][N_ENTRY];
static pthread_once_t once = PTHREAD_ONCE_INIT;

// Filmic: x (x + a) / (x (x + b) + c) has a toe, maps middle grey (0.18) to itself and
// approaches 1: one stop over white is 0.75.
static double filmic(double x)
{
    return x * (x + 0.06) / (x * (x + 0.62) + 0.09);
}

static double curve(enum prt_tone tone, double x)
{
    if (tone == PRT_TONE_FILMIC) return filmic(x);
    if (tone == PRT_TONE_REINHARD) return x / (1 + x); // METHODS §7: not (1+R)/R
    return x;
}

static double srgb(double x)
{
    if (x <= 0) return 0;
    if (x >= 1) return 1;
    return x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1 / 2.4) - 0.055;
}

static void make_tables(void)
{
    for (int t = 0; t < 3; t++) {
        for (int i = 0; i < N_ENTRY; i++) {
            uint32_t bits = ((uint32_t)(127 + OCTAVE_LO) << 23) + ((uint32_t)i << SHIFT) +
                            (1u << (SHIFT - 1));
            float x;
            memcpy(&x, &bits, 4);
            const double shown = srgb(curve((enum prt_tone)t, x));
            table[t][i] = (uint8_t)(255 * shown + 0.5);
            fine[t][i] =
                (uint16_t)(65535.0 / FINE_LEVELS * floor(FINE_LEVELS * shown + 0.5) + 0.5);
        }
        table[t][0] = 0; // values below 2^-14, and NaN, take this entry: black
        fine[t][0] = 0;
    }
}

enum { TOGETHER = 256 }; // values whose indices are computed before one is looked up

#define PRT_KERNEL_FILE "raster/tone_kernel.h"
#include "base/isa_each.h"

int prt_tone_curve(const struct prt_context *ctx, enum prt_tone tone, float exposure_ev,
                   struct tone_curve *out)
{
    if (tone < PRT_TONE_FILMIC || tone > PRT_TONE_NONE)
        return prt_fail(ctx, PRT_ARG, "tone map %d is not one of filmic, reinhard, none",
                        (int)tone);
    if (!(exposure_ev >= -64 && exposure_ev <= 64))
        return prt_fail(ctx, PRT_ARG, "exposure %g EV is outside [-64,64]",
                        (double)exposure_ev);
    pthread_once(&once, make_tables);
    *out = (struct tone_curve){table[tone], fine[tone], exp2f(exposure_ev), tone_values_c};
#if PRT_ISA_X86
    const unsigned cpu = ctx ? ctx->cpu : prt_cpu_detect();
    if (cpu & PRT_CPU_AVX2) out->values = tone_values_avx2;
    if (cpu & PRT_CPU_AVX512) out->values = tone_values_avx512;
#endif
    return PRT_OK;
}

static void fine_values(const struct tone_curve *tone, const float *in, size_t n, uint16_t *out)
{
    for (size_t i = 0; i < n; i += TOGETHER) {
        int32_t index[TOGETHER];
        const int m = n - i < TOGETHER ? (int)(n - i) : TOGETHER;
        find_entries_c(tone->scale, in + i, m, index);
        for (int k = 0; k < m; k++) out[i + (size_t)k] = tone->fine[index[k]];
    }
}

struct job {
    const float *in;
    uint8_t *out;
    uint16_t *fine; // in place of out
    struct tone_curve curve;
};

static int encode(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct job *job = arg;
    if (job->fine) fine_values(&job->curve, job->in + begin, end - begin, job->fine + begin);
    else job->curve.values(&job->curve, job->in + begin, end - begin, job->out + begin);
    return PRT_OK;
}

static int map_image(const struct prt_context *ctx, const struct prt_image *image,
                     enum prt_tone tone, float exposure_ev, struct job *job)
{
    int status = prt_tone_curve(ctx, tone, exposure_ev, &job->curve);
    if (status) return status;
    job->in = image->rgb;
    return prt_parallel_for(ctx, NULL, (size_t)image->width * image->height * 3, 65536, encode,
                            job);
}

int prt_tone_map(const struct prt_context *ctx, const struct prt_image *image,
                 enum prt_tone tone, float exposure_ev, uint8_t *rgb8)
{
    return map_image(ctx, image, tone, exposure_ev, &(struct job){.out = rgb8});
}

int prt_tone_map_fine(const struct prt_context *ctx, const struct prt_image *image,
                      enum prt_tone tone, float exposure_ev, uint16_t *rgb16)
{
    return map_image(ctx, image, tone, exposure_ev, &(struct job){.fine = rgb16});
}
