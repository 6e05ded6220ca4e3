// SPDX-License-Identifier: MIT
// The kernels behind prt/relight.h: one table of functions for each instruction set. Each call
// of the library picks its table by the context's CPU mask.
//
// Contract. Floating-point kernels compute in f32 and may sum in any order: each output value
// differs from the C kernel's by at most KERNEL_TOLERANCE times the sum of the absolute values
// of the terms that it is the sum of. Integer kernels (lights_to_integers, pairs_group, and
// expand where `integers` is set) return the same bits as their C twins in
// prt_kernels_integer_c, except where `add` adds to an earlier colour. No kernel allocates;
// none reads or writes past its arrays. Kernels are thread-safe: they keep no state.
#ifndef PRT_RELIGHT_KERNELS_H
#define PRT_RELIGHT_KERNELS_H

#include "base/isa.h"
#include "prt/relight.h"

#include <string.h>

#define KERNEL_TOLERANCE 1e-5

enum {
    LIGHT_GROUP = 8,               // lights of one pass
    LIGHT_LANES = 3 * LIGHT_GROUP, // floats per coefficient in the table of a group
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
    float *const *color;   // [n_triple] planes [n_vertex of the file][3]
    bool add;              // to the colours that are there; false: overwrite
    bool stream;           // whole cache lines bypass the caches; not together with add
};

// The integer expansion. Coefficients of one triple and channel are scaled so that their
// absolute sum is at most EXPAND_SUM_MOST and each is at most EXPAND_COEF_MOST, then rounded to
// 16 bits: no sum of products with U (at most PRT_U_MOST) leaves 32 bits. Triples go in groups
// of eight, then four, then one by one, which gives them the same bits; from the first group
// with a coefficient that is not finite on, they go in f32.
enum {
    EXPAND_RANK_MOST = 256, // larger ranks go in f32
    EXPAND_SUM_MOST = INT32_MAX / PRT_U_MOST - EXPAND_RANK_MOST / 2 - 1,
    EXPAND_COEF_MOST = INT16_MAX,
};

// Up to LIGHT_GROUP lights as 16-bit integers, for rows of pairs. Their contraction does not
// depend on how many lights are beside them. Coefficients are multiplied
// by the gains of pairs (prt_pair_gain) before they are rounded, so that all levels of a sun's
// or a lamp's wavelet transform are of similar size.
enum { LIGHT_INTEGER_MOST = INT16_MAX };
struct integer_lights {
    uint32_t n;                       // of the cube, a power of two, at most 64
    float gain[64];                   // of a coefficient at (x, y) of its face: gain[x | y]
    uint32_t lanes;                   // of a coefficient: 4, 16 or 32
    int16_t *lane;                    // r g b 0 of one light [n_coef][4]; of up to four
                                      // [n_coef][4][4]; of lights l and 4 + l [n_coef][4][2][4]
    float scale[LIGHT_GROUP][4];      // integer = float * gain * scale
    float back[LIGHT_GROUP][4];       // 1 / scale
    float scaling[6][LIGHT_GROUP][4]; // each face's scaling coefficient, not rounded
};

// Units of one column (prt/columns.h) and the coefficients of the lights under which it
// matters, times its gain; the light that takes most units is first.
struct column_part {
    const uint16_t *unit;
    const int16_t *entry;
    unsigned n_light;
    uint32_t n[LIGHT_GROUP];  // units
    uint32_t at[LIGHT_GROUP]; // of the light's sums in a chunk
    float x[LIGHT_GROUP][3];
};

struct prt_kernels {
    const char *name;
    bool integers; // expand computes in 16-bit integers
    bool quads;    // the integer kernels take up to four lights in 16 lanes

    // DIAGONAL rows [begin, end) under one light [n_coef][4]: out[row - begin][3P]. Rows of
    // pairs take a light that was multiplied by their gains; so does diagonal_group.
    void (*diagonal)(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                     const float *light, float *out);
    // The same under up to LIGHT_GROUP lights in one table (prt_light_table_fill):
    // out[light*light_pitch + (row - begin)*row_pitch ...][3P] for light < n_light.
    void (*diagonal_group)(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                           const float *table, unsigned n_light, size_t light_pitch,
                           size_t row_pitch, float *out);
    // Fills q->lane for coefficients [begin, end) of lights that prt_integer_lights_init has
    // prepared. Scaling coefficients saturate; pairs_group does not read them.
    void (*lights_to_integers)(const struct integer_lights *q, unsigned n_light,
                               const float *const coef[], uint32_t begin, uint32_t end);
    // Rows of pairs under integer lights. NULL, as lights_to_integers is: the instruction set
    // has no integer kernels.
    void (*pairs_group)(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                        const struct integer_lights *lights, unsigned n_light,
                        size_t light_pitch, size_t row_pitch, float *out);
    // Adds units to the sums of their group's chunks, `stride` floats each, [light][16].
    void (*columns)(const struct column_part *part, size_t n, size_t stride, float *sum);
    // FULL rows under one light, of halves and low-rank: out[row - begin][J][3].
    void (*full)(const struct prt_rows *rows, uint32_t begin, uint32_t end, const float *light,
                 float *out);
    void (*mixed)(const struct prt_rows *rows, uint32_t begin, uint32_t end, const float *light,
                  float *out);
    // FACTORED and RADIAL storage: contracted rows to colours.
    void (*expand)(const struct expand_job *job);
    void (*radial)(const struct expand_job *job);
    // out[i][ch] = sum_j in[i][j][ch] coef[j][ch], i < n, j < n_radial
    void (*material)(const float *in, size_t n, uint32_t n_radial, const float *coef,
                     float *out);
};

// What the columns of phase k of a RADIAL cluster are multiplied with, [n_radial][3]: coef, an
// optional factor of the plane, and the columns' own factors.
static inline void radial_coef(const struct prt_tensor *t, size_t cluster, uint32_t k,
                               const float *coef, const float factor[3], float *out)
{
    const size_t n = 3 * (size_t)t->n_radial;
    const float *scale =
        t->u_scale ? t->u_scale + (cluster * t->n_function + (size_t)k * t->n_radial) * 3
                   : NULL;
    for (size_t i = 0; i < n; i++)
        out[i] = coef[i] * (factor ? factor[i % 3] : 1) * (scale ? scale[i] : 1);
}

extern const struct prt_kernels prt_kernels_c;
extern const struct prt_kernels prt_kernels_integer_c; // C twins of the integer kernels
#if PRT_ISA_X86
extern const struct prt_kernels prt_kernels_avx2;
extern const struct prt_kernels prt_kernels_avx512;
extern const struct prt_kernels prt_kernels_vnni; // AVX-512 with integer kernels
#endif
#if PRT_ISA_ARM64
extern const struct prt_kernels prt_kernels_neon;
#endif

void prt_columns_c(const struct column_part *part, size_t n, size_t stride, float *sum);

// Calls visit for every table whose instruction set the mask of enum prt_cpu allows, best
// first; the last one is prt_kernels_c. Stops when visit returns false.
void prt_kernels_visit(unsigned cpu, bool (*visit)(void *user, const struct prt_kernels *k),
                       void *user);
// The best of these tables. Never NULL.
const struct prt_kernels *prt_kernels_for(unsigned cpu);

// Coefficients [begin, end) of a table of up to LIGHT_GROUP lights, [n_coef][light][ch] with 0
// for missing lights. The table is f32: halves are not read faster, since they have to be
// widened, and they change colours under a sun or a lamp by 2e-4.
void prt_light_table_fill(unsigned n_light, const float *const coef[], uint32_t begin,
                          uint32_t end, float *table);

// Where r g b of a light begin in a coefficient's lanes.
static inline uint32_t integer_lane_of(const struct integer_lights *q, unsigned light)
{
    return q->lanes == 32 ? 8 * (light % 4) + 4 * (light / 4) : 4 * light;
}

// Prepares integer lights of n-cubes (n <= 64) but for their lanes. quads: two to four lights
// get 16 lanes, not 32. most[light][ch]: the largest absolute coefficient after the gains,
// scaling coefficients left out. False where a coefficient is not finite: the caller has to use
// f32.
bool prt_integer_lights_init(struct integer_lights *q, unsigned n_light, bool quads, uint32_t n,
                             const float *const coef[], const float most[][4]);

// prt_contract_light for several lights with the results of a row's lights adjacent:
// out[n_row][light][P][3]. most_rank: only the first rows of each cluster, at most so many, are
// computed; 0: all.
int prt_contract_lights(const struct prt_context *ctx, const struct prt_tensor *tensor,
                        unsigned n_light, const struct prt_light *const light[],
                        uint32_t most_rank, float *out);

// A range of one cluster's vertices, at most some thousands, so that threads share the work.
struct expand_piece {
    uint32_t cluster, begin, end;
};
// All pieces of a tensor in a fresh array, which the caller free()s. grain: how many pieces a
// thread takes at a time.
int prt_expand_pieces(const struct prt_context *ctx, const struct prt_tensor *tensor,
                      struct expand_piece **out, size_t *n_out, size_t *grain);

// 2^-shift of an entry of low-rank rows.
static inline float rows_factor(const struct prt_rows *rows, uint64_t entry)
{
    uint32_t bits = (127u - rows->shift[entry]) << 23;
    float factor;
    memcpy(&factor, &bits, 4);
    return factor;
}

static inline uint32_t rows_index(const struct prt_rows *rows, uint64_t entry)
{
    return rows->index_bytes == 2 ? ((const uint16_t *)rows->index)[entry]
                                  : ((const uint32_t *)rows->index)[entry];
}

#endif
