// SPDX-License-Identifier: MIT
// The kernels behind prt/relight.h: one table an instruction set, chosen once a call.
//
// Every variant computes what the C one does, in f32, summing in another order: results agree
// to 1e-5 of the sum of absolute terms. None allocates, none reads or writes past its arrays.
#ifndef PRT_RELIGHT_KERNELS_H
#define PRT_RELIGHT_KERNELS_H

#include "prt/relight.h"

#include <string.h>

enum {
    LIGHT_GROUP = 8,               // lights of one pass
    LIGHT_LANES = 3 * LIGHT_GROUP, // floats a coefficient in a group's table
    EXPAND_ALIGN = 32,             // vertex ranges begin at multiples of it
    MOST_PHASES = 16,              // planes of a tensor
    MOST_TRIPLES = PRT_RELIGHT_MAX_LIGHTS * MOST_PHASES,
};

// Colours of vertices [begin, end) of one cluster:
// color[t][3*order[v] + ch] (+)= sum_r U[r][v] b[r*b_stride + 3*t + ch].
struct expand_job {
    const uint16_t
        *u;        // [(rank + 1) / 2][stride][2] i16; radial: [n_triple][rank][3][stride] f16
    size_t stride; // vertices, a multiple of 16
    uint32_t rank;
    const float *b;    // [rank][b_stride]; radial: coef [rank][3]
    size_t b_stride;   // floats
    uint32_t n_triple; // lights * phase planes; radial: planes
    uint32_t begin, end;
    const uint32_t *order; // file vertex of the cluster's vertex 0, 1, ...
    float *const *color;   // [n_triple]
    bool add;
    bool stream; // not with add: colours are many times the caches, whole lines go past them
};

// Up to LIGHT_GROUP lights, times the gains of pairs, as 16-bit integers (pairs_vnni.c).
struct integer_lights {
    uint32_t n;                       // of the cube
    float gain[64];                   // by x | y
    int16_t *lane;                    // [n_coef][4][2][4]: of lights l and 4 + l, r g b 0
    float scale[LIGHT_GROUP][4];      // from floats
    float back[LIGHT_GROUP][4];       // and back
    float scaling[6][LIGHT_GROUP][4]; // each face's scaling coefficient, in floating point
};

// Rows of pairs are multiplied with lights that were scaled by their gains (prt_pair_gain).
struct relight_kernels {
    const char *name;
    // DIAGONAL rows [begin, end) under one light [n_coef][4]: out[row - begin][3P]
    void (*diagonal)(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                     const float *light, float *out);
    // the same under up to LIGHT_GROUP lights in their table:
    // out[light*light_pitch + (row - begin)*row_pitch ...][3P] for light < n_light
    void (*diagonal_group)(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                           const float *table, unsigned n_light, size_t light_pitch,
                           size_t row_pitch, float *out);
    // rows of pairs under integer lights, which agree to 1e-4 of the colours; NULL: there is
    // none
    void (*pairs_group)(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                        const struct integer_lights *lights, unsigned n_light,
                        size_t light_pitch, size_t row_pitch, float *out);
    // FULL rows of f16, or mixed ones, under one light: out[row - begin][J][3]
    void (*full)(const struct prt_rows *rows, uint32_t begin, uint32_t end, const float *light,
                 float *out);
    void (*mixed)(const struct prt_rows *rows, uint32_t begin, uint32_t end, const float *light,
                  float *out);
    void (*expand)(const struct expand_job *job);
    void (*radial)(const struct expand_job *job);
    // out[i][ch] = sum_j in[i][j][ch] coef[j][ch], i < n, j < n_radial
    void (*material)(const float *in, size_t n, uint32_t n_radial, const float *coef,
                     float *out);
};

extern const struct relight_kernels relight_kernels_c;
extern const struct relight_kernels relight_kernels_avx2;
extern const struct relight_kernels relight_kernels_avx512;
extern const struct relight_kernels relight_kernels_vnni; // AVX-512 with VNNI

// The best table that the mask of enum prt_cpu allows.
const struct relight_kernels *relight_kernels_for(unsigned cpu);

// Coefficients [begin, end) of a table of up to LIGHT_GROUP lights: [n_coef][light][ch], with 0
// for the lights that are missing. In f32: halves are read no faster, since they are to be
// widened, and move colours under a sun or a lamp by 2e-4.
void relight_fill_table(unsigned n_light, const float *const coef[], uint32_t begin,
                        uint32_t end, float *table);

// Lights of n-cubes (n <= 64) as integers: the scales from what each is at most in every
// channel once it has its gains, scaling coefficients aside, false where one is not finite;
// then the lanes of coefficients [begin, end).
bool relight_integers_begin(struct integer_lights *q, unsigned n_light, uint32_t n,
                            const float *const coef[], const float most[][4]);
void relight_integers_fill(const struct integer_lights *q, unsigned n_light,
                           const float *const coef[], uint32_t begin, uint32_t end);
void relight_pairs_vnni(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                        const struct integer_lights *lights, unsigned n_light,
                        size_t light_pitch, size_t row_pitch, float *out);

// Step 1 for several lights whose rows lie beside each other: out[n_row][light][P][3].
int relight_contract(const struct prt_context *ctx, const struct prt_tensor *tensor,
                     unsigned n_light, const struct prt_light *const light[], float *out);

// A range of one cluster's vertices: at most some thousands, so that threads share the work.
struct relight_piece {
    uint32_t cluster, begin, end;
};
// All of a tensor's, in a fresh array (free); grain: how many go to a thread at a time.
int relight_pieces(const struct prt_context *ctx, const struct prt_tensor *tensor,
                   struct relight_piece **out, size_t *n_out, size_t *grain);

// 2^-shift of an entry of mixed rows.
static inline float rows_factor(const struct prt_rows *rows, uint64_t entry)
{
    uint32_t bits = (127u - rows->shift[entry]) << 23;
    float factor;
    memcpy(&factor, &bits, 4);
    return factor;
}

void relight_mixed_avx2(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                        const float *light, float *out);
void relight_mixed_avx512(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                          const float *light, float *out);

static inline uint32_t rows_index(const struct prt_rows *rows, uint64_t entry)
{
    return rows->index_bytes == 2 ? ((const uint16_t *)rows->index)[entry]
                                  : ((const uint32_t *)rows->index)[entry];
}

#endif
