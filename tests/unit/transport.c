// SPDX-License-Identifier: MIT
// Half floats and the .prt file: what is written comes back, and nothing else is accepted.
// Above 600 lines: short cases, each read alone.
#include <fcntl.h>
#include <math.h>
#include <pthread.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmocka.h>
#define XXH_INLINE_ALL
#include <xxhash.h>

#include "format.h"
#include "map_guard.h"
#include "pages.h"
#include "prt/radial.h"
#include "synthetic.h"

static char folder[64], path[96];
static char last_line[1024];

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    snprintf(last_line, sizeof last_line, "%s", line);
}

static struct prt_context quiet(void)
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep_line;
    last_line[0] = 0;
    return ctx;
}

static void half_floats_are_exact(void **state)
{
    static uint16_t h[65536], back[65536];
    static float f[65536];
    for (unsigned i = 0; i < 65536; i++) h[i] = (uint16_t)i;
    prt_f16_to_f32_array(h, 65536, f);
    for (unsigned i = 0; i < 65536; i++) {
        float one = prt_f16_to_f32((uint16_t)i);
        if (isnan(one)) {
            assert_true(isnan(f[i]) && (i & 0x7c00) == 0x7c00 && (i & 0x3ff));
            continue;
        }
        assert_memory_equal(&one, &f[i], 4);
        if (!isinf(one)) assert_int_equal(prt_f32_to_f16(one), i);
    }
    assert_true(prt_f16_to_f32(0x3c00) == 1.0f && prt_f16_to_f32(0xc000) == -2.0f);
    assert_true(prt_f16_to_f32(1) == 0x1p-24f && prt_f16_to_f32(0x7bff) == 65504.0f);
    // round to nearest even, on ties as well; saturation; NaN stays NaN
    assert_int_equal(prt_f32_to_f16(1 + 0x1p-11f), 0x3c00);
    assert_int_equal(prt_f32_to_f16(1 + 3 * 0x1p-11f), 0x3c02);
    assert_int_equal(prt_f32_to_f16(1e9f), 0x7bff);
    assert_int_equal(prt_f32_to_f16(-INFINITY), 0xfbff);
    assert_int_equal(prt_f32_to_f16(65519.99f), 0x7bff);
    assert_true(isnan(prt_f16_to_f32(prt_f32_to_f16(NAN))));
    struct prt_rng rng;
    prt_rng_init(&rng, 7, 7);
    for (unsigned i = 0; i < 65536; i++)
        f[i] = ldexpf(prt_rng_f32(&rng) - 0.5f, (int)(prt_rng_u32(&rng) % 50) - 30);
    f[5] = INFINITY;
    prt_f32_to_f16_array(f, 65533, back);
    for (unsigned i = 0; i < 65533; i++) assert_int_equal(back[i], prt_f32_to_f16(f[i]));
    // error of a normal number is at most half a unit in the last place
    for (unsigned i = 0; i < 65533; i++)
        if (fabsf(f[i]) > 0x1p-14f && fabsf(f[i]) < 65504)
            assert_true(fabsf(prt_f16_to_f32(back[i]) - f[i]) <= fabsf(f[i]) * 0x1p-11f);
}

enum { N_KIND = PRT_MOST_TENSORS, LEVELS = 4, NODES = 5 };
static const struct synthetic_options kind[N_KIND] = {
    {.storage = PRT_STORAGE_FACTORED,
     .value = PRT_VALUE_F16,
     .n_vertex = 101,
     .n_cluster = 3,
     .rank = 5,
     .n_phase = 1,
     .cube = 16,
     .coefs = 20,
     .seed = 1},
    {.storage = PRT_STORAGE_SPARSE,
     .value = PRT_VALUE_I8,
     .n_vertex = 101,
     .n_phase = 4,
     .cube = 16,
     .coefs = 10,
     .seed = 2,
     .term = PRT_TERM_SINGLE},
    {.storage = PRT_STORAGE_FACTORED,
     .coupling = PRT_COUPLE_FULL,
     .value = PRT_VALUE_I8,
     .n_vertex = 101,
     .n_cluster = 2,
     .rank = 4,
     .n_phase = 4,
     .n_radial = 3,
     .cube = 16,
     .coefs = 9,
     .seed = 3,
     .term = PRT_TERM_SINGLE},
    {.storage = PRT_STORAGE_RADIAL,
     .n_vertex = 101,
     .n_cluster = 2,
     .n_phase = 1,
     .n_radial = 6,
     .cube = 16,
     .seed = 4},
    {.storage = PRT_STORAGE_FACTORED,
     .coupling = PRT_COUPLE_FULL,
     .value = PRT_VALUE_I8,
     .n_vertex = 101,
     .n_cluster = 2,
     .rank = 2,
     .n_phase = 1,
     .n_radial = 3,
     .cube = 16,
     .coefs = 3,
     .seed = 5},
};

static struct prt_material medium; // of the transport that make() makes

// The basis of walks: a grid of levels and nodes, and combinations of its media.
static void make_walks(struct prt_tensor *t)
{
    float *knot = prt_calloc(LEVELS + NODES, 4);
    float *basis = prt_calloc((size_t)t->n_radial * LEVELS * NODES, 4);
    for (int i = 0; i < LEVELS; i++) knot[i] = 0.1f * (float)(i + 1);
    for (int i = 0; i < NODES; i++) knot[LEVELS + i] = 0.3f * (float)i;
    for (int i = 0; i < 3 * LEVELS * NODES; i++) basis[i] = (float)i;
    t->basis_kind = PRT_RADIAL_WALK;
    t->n_knot = LEVELS + NODES;
    t->knot = knot;
    t->basis = basis;
}

// One function at three nodes of eta.
static void make_etas(struct prt_tensor *t)
{
    static const float axis[] = {1.2f, 1.6f, 1.22f, 1.38f, 1.57f};
    float *knot = prt_calloc(5, 4), *basis = prt_calloc(5, 4), *eta = prt_calloc(5, 4);
    for (int i = 0; i < 5; i++) knot[i] = (float)i, basis[i] = (float)(5 - i), eta[i] = axis[i];
    t->n_knot = t->n_eta = 5;
    t->knot = knot, t->basis = basis, t->eta = eta;
}

static void make(struct prt_transport *t)
{
    memset(t, 0, sizeof *t);
    assert_int_equal(synthetic_mesh(101, true, &t->mesh), 0);
    medium = (struct prt_material){.name = "x",
                                   .sigma_s_prime = {1, 2, 3},
                                   .sigma_a = {0, 1, 2},
                                   .eta = 1.3f,
                                   .roughness = 0.3f};
    t->media = prt_media_one(&medium);
    t->cube = 16;
    t->n_tensor = N_KIND;
    for (int i = 0; i < N_KIND; i++)
        assert_int_equal(synthetic_tensor(&kind[i], &t->tensor[i]), 0);
    float *knot = prt_calloc(5, 4), *basis = prt_calloc(30, 4);
    for (int i = 0; i < 5; i++) knot[i] = (float)i;
    for (int i = 0; i < 30; i++) basis[i] = (float)i;
    t->tensor[3].n_knot = 5;
    t->tensor[3].knot = knot;
    t->tensor[3].basis = basis;
    make_etas(&t->tensor[2]);
    make_walks(&t->tensor[4]);
    t->settings = "{\"rank\":5}";
    t->errors = "{}";
    t->mesh_hash = 0x123456789abcdef;
}

static void unmake(struct prt_transport *t)
{
    for (int i = 0; i < N_KIND; i++) synthetic_tensor_finish(&t->tensor[i]);
    synthetic_mesh_finish(&t->mesh);
}

static void same(const void *a, const void *b, size_t n)
{
    if (!n) return;
    assert_non_null(b);
    assert_int_equal((uintptr_t)b % 64, 0);
    assert_memory_equal(a, b, n);
}

static void what_is_written_comes_back(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_file *file;
    make(&t);
    assert_int_equal(prt_file_write(&ctx, path, &t), 0);
    assert_true(prt_file_probe(path));
    assert_int_equal(prt_file_open(&ctx, path, PRT_FILE_CHECK_ALL, &file), 0);
    const struct prt_transport *b = prt_file_transport(file);
    assert_int_equal(b->cube, 16);
    assert_true(b->mesh_hash == t.mesh_hash && b->n_tensor == N_KIND);
    assert_string_equal(b->settings, t.settings);
    assert_string_equal(b->errors, t.errors);
    assert_int_equal(b->media.n, 1);
    assert_memory_equal(b->media.medium, t.media.medium, sizeof *t.media.medium);
    same(t.mesh.position, b->mesh.position, 101 * 12);
    same(t.mesh.normal, b->mesh.normal, 101 * 12);
    same(t.mesh.triangle, b->mesh.triangle, t.mesh.n_triangle * 12);
    same(t.mesh.weld, b->mesh.weld, 101 * 4);
    same(t.mesh.block, b->mesh.block, sizeof *t.mesh.block * 2);
    same(t.mesh.surface, b->mesh.surface, sizeof *t.mesh.surface * 2);
    assert_null(b->mesh.uv);
    for (int i = 0; i < N_KIND; i++) {
        const struct prt_tensor *x = &t.tensor[i], *y = &b->tensor[i];
        const struct prt_rows *r = &x->rows, *s = &y->rows;
        size_t n = r->n_row ? r->begin[r->n_row] : 0, j = x->n_function;
        size_t value = r->value == PRT_VALUE_I8 ? 1 : 2;
        same(x->order, y->order, 101 * 4);
        same(x->cluster, y->cluster, sizeof *x->cluster * x->n_cluster);
        same(x->u, y->u, x->u_count * 2);
        same(x->u_scale, y->u_scale, x->u_scale ? 12ull * x->n_cluster * x->n_function : 0);
        same(r->begin, s->begin, r->n_row ? 8 * (r->n_row + 1) : 0);
        same(r->index, s->index, n * r->index_bytes);
        size_t d = r->direction ? r->direction[r->n_row] : 0;
        same(r->entry, s->entry, d ? r->value_begin[r->n_row] : n * j * value);
        same(r->scale, s->scale, d ? 4 * d : r->scale ? 4 * j * r->n_row : 0);
        same(r->shift, s->shift, d ? n : 0);
        same(r->mix, s->mix, 2 * d * j);
        same(r->direction, s->direction, d ? 4 * (r->n_row + 1) : 0);
        same(r->value_begin, s->value_begin, d ? 8 * (r->n_row + 1) : 0);
        same(r->scaling, s->scaling, 12 * j * r->n_row);
        assert_int_equal(x->basis_kind, y->basis_kind);
        same(x->knot, y->knot, 4ull * x->n_knot);
        if (x->n_knot)
            same(x->basis, y->basis,
                 4ull * prt_tensor_basis_width(x) * prt_tensor_basis_size(x));
        assert_int_equal(x->n_eta, y->n_eta);
        same(x->eta, y->eta, 4ull * x->n_eta);
        assert_true(x->n_phase == y->n_phase && x->storage == y->storage &&
                    x->coupling == y->coupling && x->term == y->term && r->n_coef == s->n_coef);
    }
    prt_file_close(file);
    unmake(&t);
}

// Files from before columns had factors have none, and are read as before.
static void columns_without_factors_come_back(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_file *file;
    make(&t);
    const struct prt_transport whole = t;
    for (int i = 0; i < N_KIND; i++) t.tensor[i].u_scale = NULL;
    assert_int_equal(prt_file_write(&ctx, path, &t), PRT_OK);
    assert_int_equal(prt_file_open(&ctx, path, PRT_FILE_CHECK_ALL, &file), PRT_OK);
    for (int i = 0; i < N_KIND; i++) assert_null(prt_file_transport(file)->tensor[i].u_scale);
    prt_file_close(file);
    unlink(path);
    t = whole;
    unmake(&t);
}

static struct prt_blob written(void)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_blob blob;
    make(&t);
    assert_int_equal(prt_file_write(&ctx, path, &t), 0);
    assert_int_equal(prt_read_file(&ctx, path, 1 << 20, &blob), 0);
    unmake(&t);
    return blob;
}

static int open_copy(const void *bytes, size_t n, enum prt_file_check check)
{
    struct prt_context ctx = quiet();
    struct prt_file *file = NULL;
    // exactly n bytes, so that a reader past the end meets the sanitizer
    void *copy = malloc(n ? n : 1);
    memcpy(copy, bytes, n);
    int status = prt_file_open_memory(&ctx, "x.prt", copy, n, check, &file);
    if (status) assert_true(strncmp(last_line, "x.prt: ", 7) == 0 && !strchr(last_line, '\n'));
    prt_file_close(file);
    free(copy);
    return status;
}

// A file of another length than its header says is refused, and the message says which is
// longer.
static void every_truncation_is_refused(void **state)
{
    struct prt_blob blob = written();
    for (size_t n = 0; n < blob.size; n += n < 2048 ? 1 : 61) {
        assert_int_equal(open_copy(blob.bytes, n, PRT_FILE_CHECK_HEADERS), PRT_FORMAT);
        assert_non_null(strstr(last_line, n < 8 ? "not a .prt file" : "the file is truncated"));
    }
    assert_int_equal(open_copy(blob.bytes, blob.size, PRT_FILE_CHECK_ALL), 0);
    char *longer = calloc(blob.size + 1, 1);
    assert_non_null(longer);
    memcpy(longer, blob.bytes, blob.size);
    assert_int_equal(open_copy(longer, blob.size + 1, PRT_FILE_CHECK_HEADERS), PRT_FORMAT);
    assert_non_null(strstr(last_line, "bytes follow the end of the file"));
    free(longer);
    prt_free(blob.bytes);
}

static void every_flipped_byte_is_refused(void **state)
{
    struct prt_blob blob = written();
    unsigned char *b = blob.bytes;
    for (size_t i = 0; i < blob.size; i++) {
        unsigned char bit = (unsigned char)(1u << (i * 5 % 8));
        b[i] ^= bit;
        assert_int_equal(open_copy(b, blob.size, PRT_FILE_CHECK_ALL), PRT_FORMAT);
        int status = open_copy(b, blob.size, PRT_FILE_CHECK_HEADERS);
        assert_true(status == PRT_OK || status == PRT_FORMAT);
        b[i] ^= bit;
    }
    prt_free(blob.bytes);
}

// A forger recomputes the header's checksum: the structure must hold on its own.
static void reseal(struct prt_blob *blob)
{
    struct format_header *h = blob->bytes;
    h->hash = 0;
    h->hash = XXH3_64bits(h, sizeof *h + format_padded(h->n_section * 32ull));
}

static void forged_headers_are_refused(void **state)
{
    struct prt_blob blob = written();
    struct format_header *h = blob.bytes, saved = *h;
    reseal(&blob);
    assert_int_equal(open_copy(blob.bytes, blob.size, PRT_FILE_CHECK_ALL), 0);
    h->version = 1; // the one before: U in halves
    reseal(&blob);
    assert_int_equal(open_copy(blob.bytes, blob.size, PRT_FILE_CHECK_ALL), PRT_FORMAT);
    assert_non_null(strstr(last_line, "version 1"));
    assert_non_null(strstr(last_line, "bake it again"));
    *h = saved;
    h->endian = 0x04030201;
    reseal(&blob);
    assert_int_equal(open_copy(blob.bytes, blob.size, PRT_FILE_CHECK_ALL), PRT_FORMAT);
    assert_non_null(strstr(last_line, "byte order"));
    *h = saved;
    struct format_section *s = (struct format_section *)(h + 1);
    for (uint32_t i = 0; i < saved.n_section * 4; i++) {
        uint64_t *field = i % 4 == 0 ? &s[i / 4].offset : i % 4 == 1 ? &s[i / 4].bytes : NULL;
        uint32_t *word = i % 4 == 2 ? &s[i / 4].type : &s[i / 4].tensor;
        static const uint64_t evil[] = {0, 1, 64, 4096, 1u << 31, UINT64_MAX, UINT64_MAX - 63};
        for (int e = 0; e < 7; e++) {
            uint64_t keep = field ? *field : *word;
            if (keep == evil[e]) continue;
            if (field) *field = evil[e];
            else *word = (uint32_t)evil[e];
            reseal(&blob);
            if (keep != (field ? *field : *word))
                assert_int_equal(open_copy(blob.bytes, blob.size, PRT_FILE_CHECK_HEADERS),
                                 PRT_FORMAT);
            if (field) *field = keep;
            else *word = (uint32_t)keep;
        }
    }
    prt_free(blob.bytes);
}

// The file with one more section behind the others, of 64 zeros.
static struct prt_blob with_section(const struct prt_blob *blob, uint32_t type, uint32_t tensor)
{
    const struct format_header *h = blob->bytes;
    const size_t n_section = h->n_section, table = format_padded(32 * n_section);
    const size_t longer = format_padded(32 * (n_section + 1)), head = sizeof *h;
    struct prt_blob out = {.size = blob->size + longer - table + FORMAT_ALIGN};
    out.bytes = calloc(1, out.size);
    assert_non_null(out.bytes);
    char *to = out.bytes;
    memcpy(to, blob->bytes, head + 32 * n_section);
    memcpy(to + head + longer, (const char *)blob->bytes + head + table,
           blob->size - head - table);
    struct format_section *s = (struct format_section *)(to + head);
    for (size_t i = 0; i < n_section; i++) s[i].offset += longer - table;
    s[n_section] = (struct format_section){
        .type = type,
        .tensor = tensor,
        .offset = out.size - FORMAT_ALIGN,
        .bytes = FORMAT_ALIGN,
        .hash = XXH3_64bits(to + out.size - FORMAT_ALIGN, FORMAT_ALIGN)};
    ((struct format_header *)to)->n_section++;
    ((struct format_header *)to)->file_bytes = out.size;
    reseal(&out);
    return out;
}

// A section that nothing reads: of an unknown type, or of a tensor that is not there.
static void sections_too_many_are_refused(void **state)
{
    struct prt_blob blob = written();
    const uint32_t more[][2] = {
        {SECTION_U_SCALE + 1, 0}, {4096, 0}, {SECTION_U, PRT_MOST_TENSORS}};
    for (size_t i = 0; i < sizeof more / sizeof *more; i++) {
        struct prt_blob longer = with_section(&blob, more[i][0], more[i][1]);
        assert_int_equal(open_copy(longer.bytes, longer.size, PRT_FILE_CHECK_ALL), PRT_FORMAT);
        assert_non_null(strstr(last_line, "unknown type, or one too many"));
        free(longer.bytes);
    }
    prt_free(blob.bytes);
}

// Damages, each with a part of the message that refuses it: a damage that another check refuses
// first would prove nothing about its own. M: the mesh; A factored halves, S sparse bytes, F
// low-rank rows, P polynomial, K walks; C, Q clusters of A and P. Bounds are broken by one.
#define W(type, p) ((type *)(uintptr_t)(p))
#define M (&t->mesh)
#define A (&t->tensor[0])
#define S (&t->tensor[1])
#define F (&t->tensor[2])
#define P (&t->tensor[3])
#define K (&t->tensor[4])
#define C W(struct prt_cluster, A->cluster)
#define Q W(struct prt_cluster, P->cluster)
#define ROWS_DAMAGES(X)                                                               \
    X(order_twice, "no permutation", W(uint32_t, A->order)[3] = A->order[4])          \
    X(order_past, "no permutation", W(uint32_t, A->order)[3] = 101)                   \
    X(rows_fall, "row 1 is out of range",                                             \
      W(uint64_t, A->rows.begin)[2] = A->rows.begin[1] - 1)                           \
    X(rows_begin, "do not start at entry 0", W(uint64_t, A->rows.begin)[0] = 1)       \
    X(rows_end, "row 3 is out of range",                                              \
      W(uint64_t, A->rows.begin)[4] = A->rows.begin[A->rows.n_row] + 1)               \
    X(index_falls, "out of order",                                                    \
      W(uint16_t, A->rows.index)[1] = W(uint16_t, A->rows.index)[0] - 1)              \
    X(index_past, "out of order",                                                     \
      W(uint16_t, A->rows.index)[A->rows.begin[1] - 1] = 6 * 256 + 1)                 \
    X(index_scaling, "out of order", W(uint16_t, S->rows.index)[0] = 0)               \
    X(entry_infinite, "rows have values", W(uint16_t, A->rows.entry)[5] = 0x7c00)     \
    X(scaling_infinite, "rows have values", W(uint16_t, A->rows.scaling)[5] = 0xfc00) \
    X(scale_nan, "rows have values", W(float, S->rows.scale)[5] = NAN)                \
    X(sparse_rows, "100 rows for 101", S->rows.n_row = 100)                           \
    X(value_kind, "unknown kind of rows", A->rows.value = PRT_VALUE_PAIR + 1)         \
    X(index_bytes, "unknown kind of rows", A->rows.index_bytes = 4)                   \
    X(no_begin, "rows are missing", A->rows.begin = NULL)                             \
    X(no_index, "entries are missing", A->rows.index = NULL)                          \
    X(no_scale, "entries are missing", S->rows.scale = NULL)                          \
    X(shift_past, "shifted by 64", W(uint8_t, F->rows.shift)[7] = 64)                 \
    X(direction_count, "out of range", W(uint32_t, F->rows.direction)[1]++)           \
    X(direction_begin, "do not start at 0", W(uint32_t, F->rows.direction)[0] = 1)    \
    X(direction_missing, "missing or too many", F->rows.direction = NULL)             \
    X(direction_many, "missing or too many", A->rows.direction = F->rows.direction)   \
    X(value_begin, "out of range", W(uint64_t, F->rows.value_begin)[1]++)             \
    X(mix_infinite, "not finite", W(uint16_t, F->rows.mix)[2] = 0x7c00)               \
    X(component_nan, "not finite", W(float, F->rows.scale)[2] = NAN)                  \
    X(radial_rows, "has no rows", P->rows.n_row = 1)

#define CLUSTER_DAMAGES(X)                                                                    \
    X(cluster_begin, "cluster 1 is out of range", C[1].vertex_begin++)                        \
    X(cluster_vertices, "cluster 2 is out of range", C[2].n_vertex++)                         \
    X(cluster_short, "do not cover", C[2].n_vertex--)                                         \
    X(cluster_rows, "cluster 2 is out of range", C[2].rank++) /* U has an even last row */    \
    X(cluster_row_begin, "cluster 2 is out of range",                                         \
      C[2] = (struct prt_cluster){C[2].vertex_begin, C[2].n_vertex, A->rows.n_row + 1, 0, 0}) \
    X(u_one_short, "cluster 2 is out of range", A->u_count--)                                 \
    X(u_begin_past, "cluster 2 is out of range",                                              \
      C[2] = (struct prt_cluster){C[2].vertex_begin, C[2].n_vertex, 0, 0, A->u_count + 16})   \
    X(u_begin_wraps, "cluster 2 is out of range", C[2].u_begin = UINT64_MAX - 15)             \
    X(u_begin_uneven, "cluster 1 is out of range", C[1].u_begin += 8)                         \
    X(u_missing, "U is missing", A->u = NULL)                                                 \
    X(u_past, "U is out of range", W(int16_t, A->u)[33] = PRT_U_MOST + 1)                     \
    X(u_below, "U is out of range", W(int16_t, A->u)[34] = -PRT_U_MOST - 1)                   \
    X(u_least, "U is out of range", W(int16_t, A->u)[A->u_count - 1] = INT16_MIN)             \
    X(beside_odd_row, "more rows of U than its rank",                                         \
      W(int16_t, A->u)[(C[0].rank - 1) * ((C[0].n_vertex + 15) / 16 * 16) + 1] = 1)           \
    X(radial_rank, "cluster 1 is out of range", Q[1].rank++)                                  \
    X(radial_u, "cluster 1 is out of range", P->u_count--)                                    \
    X(radial_u_infinite, "U is not finite", W(uint16_t, P->u)[5] = 0x7c00)                    \
    X(radial_scale_nan, "factors of U", W(float, P->u_scale)[5] = NAN)                        \
    X(factored_scale, "factors of U", A->u_scale = P->u_scale)

#define MESH_DAMAGES(X)                                                                      \
    X(triangle, "names a vertex", M->triangle[4][1] = 101)                                   \
    X(weld, "weld map", M->weld[4] = 101)                                                    \
    X(weld_count, "weld map", M->n_weld = 102)                                               \
    X(position, "coordinates", M->position[4][1] = INFINITY)                                 \
    X(scale_unit, "mm a unit", M->mm_per_unit = 1e12f)                                       \
    X(scale_sign, "mm a unit", M->mm_per_unit = -1e-9f)                                      \
    X(no_triangles, "missing", M->triangle = NULL)                                           \
    X(no_objects, "empty", M->n_object = 0)                                                  \
    X(block_surface, "block 1 is out of range", M->block[1].surface = 2)                     \
    X(block_object, "block 0 is out of range", M->block[0].object = 1)                       \
    X(block_vertex, "block 1 is out of range", M->block[1].vertex_begin--)                   \
    X(block_vertices, "block 1 is out of range", M->block[1].n_vertex++)                     \
    X(block_triangle, "block 1 is out of range", M->block[1].triangle_begin--)               \
    X(block_triangles, "block 1 is out of range", M->block[1].n_triangle++)                  \
    X(block_short, "do not cover", M->block[1].n_vertex--)                                   \
    X(surface_name, "surface 0", memset(M->surface[0].name, 'x', sizeof M->surface[0].name)) \
    X(surface_translucent, "surface 1", M->surface[1].translucent = 2)                       \
    X(surface_rough, "surface 1", M->surface[1].roughness = nextafterf(1, 2))                \
    X(surface_smooth, "surface 1", M->surface[1].roughness = -1e-9f)                         \
    X(surface_ior, "surface 1", M->surface[1].ior = 1e3f)                                    \
    X(surface_color, "surface 1", M->surface[1].base_color[3] = nextafterf(1, 2))            \
    X(vertices, "", M->n_vertex = 100)

#define SHAPE_DAMAGES(X)                                                             \
    X(eta_below, "material", medium.eta = nextafterf(1, 0))                          \
    X(eta_above, "material", medium.eta = nextafterf(3, 4))                          \
    X(asymmetry, "material", medium.g[2] = 1)                                        \
    X(absorption, "material", medium.sigma_a[0] = -1e-9f)                            \
    X(points, "material", medium.n_point = 1)                                        \
    X(media_none, "0 media", t->media.n = 0)                                         \
    X(media_past, "65 media", t->media.n = PRT_MEDIA_MAX + 1)                        \
    X(media_unmapped, "2 media", t->media.n = 2)                                     \
    X(tensors_none, "0 tensors", t->n_tensor = 0)                                    \
    X(tensors_past, "6 tensors", t->n_tensor = PRT_MOST_TENSORS + 1)                 \
    X(engine, "unknown engine 3", t->engine = PRT_TRANSPORT_JOINT + 1)               \
    X(term, "unknown kind of transport", A->term = PRT_TERM_VIEW + 1)                \
    X(storage, "unknown kind of transport", A->storage = PRT_STORAGE_RADIAL + 1)     \
    X(coupling, "unknown kind of transport", A->coupling = PRT_COUPLE_FULL + 1)      \
    X(phases, "unknown kind of transport", A->n_phase = 3)                           \
    X(functions, "unknown kind of transport", A->n_function = 4)                     \
    X(radials, "unknown kind of transport", F->n_radial = 5)                         \
    X(radials_past, "unknown kind of transport", P->n_radial = P->n_function = 1025) \
    X(sparse_clusters, "unknown kind of transport", S->n_cluster = 1)                \
    X(tensor_vertices, "the mesh has 101", A->n_vertex = 100)                        \
    X(cube_power, "for a cube of 17", t->cube = 17)                                  \
    X(cube_most, "for a cube of 2048", t->cube = 2048)                               \
    X(coefs, "1537 coefficients", A->rows.n_coef++)                                  \
    X(knot_order, "does not ascend", W(float, P->knot)[2] = P->knot[1])              \
    X(knot_nan, "basis is not finite", W(float, P->knot)[2] = NAN)                   \
    X(basis_nan, "basis is not finite", W(float, P->basis)[29] = INFINITY)           \
    X(knots_few, "basis is damaged", P->n_knot = 1)                                  \
    X(knots_many, "basis is damaged", P->n_knot = (1u << 24) + 1)                    \
    X(knots_missing, "basis is damaged", P->knot = NULL)

#define WALK_DAMAGES(X)                                                               \
    X(levels_order, "without a grid", W(float, K->knot)[1] = K->knot[0])              \
    X(levels_negative, "without a grid", W(float, K->knot)[0] = -1)                   \
    X(levels_few, "without a grid", W(float, K->knot)[3] = 0)                         \
    X(nodes_order, "without a grid", W(float, K->knot)[7] = K->knot[8])               \
    X(nodes_past, "without a grid", W(float, K->knot)[8] = 1e6f)                      \
    X(nodes_nan, "without a grid", W(float, K->knot)[8] = NAN)                        \
    X(nodes_few, "without a grid", K->n_knot = LEVELS + 3)                            \
    X(node_zero, "without a grid", W(float, K->knot)[LEVELS] = 1e-3f)                 \
    X(walks_nan, "basis is not finite", W(float, K->basis)[59] = NAN)                 \
    X(walks_missing, "basis is damaged", K->basis = NULL)                             \
    X(walks_term, "walks are of multiple scattering", K->term = PRT_TERM_UNSCATTERED) \
    X(walks_kind, "an unknown kind", K->basis_kind = PRT_RADIAL_WALK + 1)             \
    X(walks_as_radii, "does not ascend", K->basis_kind = PRT_RADIAL_REDUCED)

#define ETA_DAMAGES(X)                                                              \
    X(eta_order, "nodes of eta are damaged", W(float, F->eta)[3] = F->eta[4])       \
    X(eta_close, "nodes of eta are damaged", W(float, F->eta)[3] = 1.225f)          \
    X(eta_nan, "nodes of eta are damaged", W(float, F->eta)[2] = NAN)               \
    X(eta_low, "nodes of eta are damaged", W(float, F->eta)[0] = nextafterf(1, 0))  \
    X(eta_high, "nodes of eta are damaged", W(float, F->eta)[4] = nextafterf(3, 4)) \
    X(eta_range, "nodes of eta are damaged", W(float, F->eta)[1] = 1.19f)           \
    X(eta_few, "nodes of eta are damaged", F->n_eta = 2)                            \
    X(eta_many, "nodes of eta are damaged", F->n_eta = 7)                           \
    X(eta_missing, "nodes of eta are damaged", F->eta = NULL)                       \
    X(eta_shares, "3 functions for 2 nodes", F->n_eta = 4)                          \
    X(eta_basis, "nodes of eta are damaged", F->n_knot = 0)                         \
    X(eta_walks, "nodes of eta are damaged", K->n_eta = 5, K->eta = F->eta)         \
    X(eta_columns, "nodes of eta are damaged", P->n_eta = 5, P->eta = F->eta)

#define DAMAGES(X)  \
    ROWS_DAMAGES(X) \
    CLUSTER_DAMAGES(X) MESH_DAMAGES(X) SHAPE_DAMAGES(X) WALK_DAMAGES(X) ETA_DAMAGES(X)

#define X(name, message, ...)                          \
    static void damage_##name(struct prt_transport *t) \
    {                                                  \
        __VA_ARGS__;                                   \
    }
DAMAGES(X)
#undef X

static const struct {
    const char *name, *message;
    void (*apply)(struct prt_transport *t);
} damages[] = {
#define X(name, message, ...) {#name, message, damage_##name},
    DAMAGES(X)
#undef X
};
#undef M
#undef A
#undef S
#undef F
#undef P
#undef K
#undef C
#undef Q

static void refuse(const struct prt_transport *t, const char *name, const char *message)
{
    struct prt_context ctx = quiet();
    int status = prt_file_write(&ctx, path, t);
    if (status != PRT_FORMAT || !strstr(last_line, message))
        fail_msg("%s: status %d, \"%s\"; expected one with \"%s\"", name, status, last_line,
                 message);
    assert_int_equal(access(path, F_OK), -1);
}

static void broken_structure_is_refused(void **state)
{
    unlink(path);
    for (size_t i = 0; i < sizeof damages / sizeof *damages; i++) {
        struct prt_transport t;
        make(&t);
        const struct prt_transport whole = t; // counts and pointers that a damage replaces
        damages[i].apply(&t);
        refuse(&t, damages[i].name, damages[i].message);
        t = whole;
        unmake(&t);
    }
}

// Bounds that need more than a small transport: a rank of 4097, a row of 2 n_coef + 1 entries,
// a row of 65 components.
static void large_counts_are_refused(void **state)
{
    struct synthetic_options o = kind[0];
    struct prt_transport t;
    o.n_cluster = 1;
    for (o.rank = 4096; o.rank <= 4097; o.rank++) {
        struct prt_context ctx = quiet();
        o.coefs = 1;
        make(&t);
        synthetic_tensor_finish(&t.tensor[0]);
        assert_int_equal(synthetic_tensor(&o, &t.tensor[0]), 0);
        if (o.rank == 4096) assert_int_equal(prt_file_write(&ctx, path, &t), 0);
        unlink(path);
        if (o.rank > 4096) refuse(&t, "rank", "cluster 0 is out of range");
        unmake(&t);
    }
    o.rank = 100;
    o.coefs = 60;
    for (uint64_t n = 2 * 1536; n <= 2 * 1536 + 1; n++) {
        struct prt_context ctx = quiet();
        make(&t);
        synthetic_tensor_finish(&t.tensor[0]);
        assert_int_equal(synthetic_tensor(&o, &t.tensor[0]), 0);
        struct prt_rows *r = &t.tensor[0].rows;
        assert_true(r->begin[r->n_row] > n);
        for (uint64_t e = 0; e < n; e++) W(uint16_t, r->index)[e] = 1;
        for (uint32_t row = 1; row <= r->n_row; row++) W(uint64_t, r->begin)[row] = n;
        if (n == 2 * 1536) assert_int_equal(prt_file_write(&ctx, path, &t), 0);
        unlink(path);
        if (n > 2 * 1536) refuse(&t, "entries of a row", "row 0 is out of range");
        unmake(&t);
    }
    make(&t); // the last row loses its entries, so that only the number of components is wrong
    struct prt_rows *r = &t.tensor[2].rows;
    const uint32_t last = r->n_row - 1;
    W(uint64_t, r->begin)[last + 1] = r->begin[last];
    W(uint64_t, r->value_begin)[last + 1] = r->value_begin[last];
    W(uint32_t, r->direction)[last + 1] = r->direction[last] + PRT_ROWS_MOST_DIRECTIONS + 1;
    refuse(&t, "components of a row", "directions are out of range");
    unmake(&t);
}

static void foreign_files_are_refused(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_file *file;
    static const char text[] = "solid teapot\n";
    assert_int_equal(prt_write_file(&ctx, path, text, sizeof text), 0);
    assert_false(prt_file_probe(path));
    assert_int_equal(prt_file_open(&ctx, path, PRT_FILE_CHECK_HEADERS, &file), PRT_FORMAT);
    assert_non_null(strstr(last_line, "not a .prt file"));
    assert_int_equal(prt_write_file(&ctx, path, "", 0), 0);
    assert_int_equal(prt_file_open(&ctx, path, PRT_FILE_CHECK_HEADERS, &file), PRT_FORMAT);
    assert_int_equal(prt_file_open(&ctx, folder, PRT_FILE_CHECK_HEADERS, &file), PRT_IO);
    unlink(path);
    assert_int_equal(prt_file_open(&ctx, path, PRT_FILE_CHECK_HEADERS, &file), PRT_IO);
    assert_false(prt_file_probe(path));
}

// Unlike a map, whose pages beyond a file's new end raise SIGBUS.
static void what_was_read_outlives_its_file(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_blob blob = written();
    struct prt_file *map, *read;
    assert_int_equal(prt_file_open(&ctx, path, PRT_FILE_CHECK_ALL, &map), 0);
    assert_int_equal(prt_file_read(&ctx, path, PRT_FILE_CHECK_ALL, &read), 0);
    assert_int_equal(prt_file_bytes(read), blob.size);
    assert_true(prt_file_hash(read) == prt_file_hash(map));
    prt_file_close(map);
    assert_int_equal(truncate(path, 0), 0);
    assert_int_equal(prt_write_file(&ctx, path, "x", 1), 0);
    struct prt_transport t;
    make(&t);
    same(t.mesh.position, prt_file_transport(read)->mesh.position, 101 * 12);
    same(t.tensor[N_KIND - 1].order, prt_file_transport(read)->tensor[N_KIND - 1].order,
         101 * 4);
    unmake(&t);
    prt_file_close(read);
    assert_int_equal(prt_file_read(&ctx, path, PRT_FILE_CHECK_HEADERS, &read), PRT_FORMAT);
    assert_int_equal(prt_file_read(&ctx, folder, PRT_FILE_CHECK_HEADERS, &read), PRT_IO);
    unlink(path);
    assert_int_equal(prt_file_read(&ctx, path, PRT_FILE_CHECK_HEADERS, &read), PRT_IO);
    prt_free(blob.bytes);
}

// A file of three pages of 'x', mapped.
static const char *map_pages(size_t page)
{
    struct prt_context ctx = quiet();
    char *text = malloc(3 * page);
    assert_non_null(text);
    memset(text, 'x', 3 * page);
    assert_int_equal(prt_write_file(&ctx, path, text, 3 * page), 0);
    free(text);
    const int fd = open(path, O_RDONLY | O_CLOEXEC);
    const char *map = mmap(NULL, 3 * page, PROT_READ, MAP_SHARED, fd, 0);
    assert_ptr_not_equal(map, MAP_FAILED);
    close(fd);
    return map;
}

// A page that the file has no longer reads as zeros where the map is watched, and ends the
// process where it is not.
static void a_lost_page_is_noticed(void **state)
{
    const size_t page = (size_t)sysconf(_SC_PAGESIZE);
    prt_file_guard_maps();
    const char *map = map_pages(page);
    const int whole = prt_map_watch(map, page), lost = prt_map_watch(map + page, 2 * page);
    assert_true(whole >= 0 && lost >= 0 && whole != lost);
    assert_int_equal(truncate(path, (off_t)page), 0);
    assert_int_equal(*(volatile const char *)(map + 5), 'x');
    assert_false(prt_map_lost(lost));
    assert_int_equal(*(volatile const char *)(map + 3 * page - 1), 0);
    assert_true(prt_map_lost(lost));
    assert_false(prt_map_lost(whole));
    prt_map_unwatch(lost);
    const pid_t child = fork();
    if (!child) {
        const struct rlimit none = {0, 0};
        setrlimit(RLIMIT_CORE, &none);
        signal(SIGBUS, SIG_DFL);
        prt_file_guard_maps();
        _exit(*(volatile const char *)(map + page));
    }
    int how = 0;
    assert_int_equal(waitpid(child, &how, 0), child);
    assert_true(WIFSIGNALED(how) && WTERMSIG(how) == SIGBUS);
    prt_map_unwatch(whole);
    munmap((void *)(uintptr_t)map, 3 * page);
    int number[PRT_MOST_WATCHED];
    for (int i = 0; i < PRT_MOST_WATCHED; i++)
        assert_true((number[i] = prt_map_watch(map, page)) >= 0);
    assert_int_equal(prt_map_watch(map, page), -1);
    for (int i = 0; i < PRT_MOST_WATCHED; i++) prt_map_unwatch(number[i]);
    unlink(path);
}

static void *shorten(void *arg)
{
    const unsigned *us = arg;
    usleep(*us);
    assert_int_equal(truncate(path, 4096), 0);
    return NULL;
}

// At whatever moment a file becomes shorter, opening it returns.
static void a_file_that_shrinks_is_no_end(void **state)
{
    struct prt_context ctx = quiet();
    prt_file_guard_maps();
    for (unsigned i = 0; i < 200; i++) {
        struct prt_file *file = NULL;
        struct prt_blob blob = written();
        unsigned us = i % 50;
        pthread_t thread;
        assert_int_equal(pthread_create(&thread, NULL, shorten, &us), 0);
        const int status = prt_file_open(&ctx, path, PRT_FILE_CHECK_ALL, &file);
        assert_true(status == PRT_OK || status == PRT_IO || status == PRT_FORMAT);
        if (!status) assert_int_equal(prt_file_bytes(file), blob.size);
        if (!status) prt_file_close(file);
        pthread_join(thread, NULL);
        prt_free(blob.bytes);
    }
    unlink(path);
}

// Pages of `size` bytes, all 1, that were given back.
static char *given(size_t size)
{
    char *pages = prt_pages_take(size);
    assert_non_null(pages);
    memset(pages, 1, size);
    prt_pages_give(pages, size);
    return pages;
}

// Fresh pages are 0, those that were used are not.
static void pages_of_closed_files_are_used_again(void **state)
{
    enum { MIB = 1 << 20, N = 12 };
    char *small[N], *all[N];
    prt_file_keep_pages(8 * MIB);
    char *first = given(3 * MIB), *pages = prt_pages_take(2 * MIB + 1);
    assert_ptr_equal(pages, first);
    for (size_t i = 0; i <= 2 * MIB; i++) assert_int_equal(pages[i], 1);
    prt_pages_give(pages, 2 * MIB + 1);
    pages = prt_pages_take(3 * MIB); // what was kept is too small by now
    assert_int_equal(pages[0], 0);
    prt_pages_give(pages, 3 * MIB);
    given(9 * MIB); // above the limit
    pages = prt_pages_take(9 * MIB);
    assert_int_equal(pages[0], 0);
    prt_pages_give(pages, 9 * MIB);
    for (int i = 0; i < N; i++) memset(all[i] = prt_pages_take(4096), 2 + i, 4096);
    for (int i = 0; i < N; i++) prt_pages_give(all[i], 4096);
    for (int i = 0; i < N; i++) { // the latest eight, each once
        small[i] = prt_pages_take(4096);
        assert_non_null(small[i]);
        assert_true(i >= 8 || small[i][4095] >= 2 + N - 8);
        for (int k = 0; k < i; k++) assert_ptr_not_equal(small[i], small[k]);
    }
    for (int i = 0; i < N; i++) prt_pages_give(small[i], 4096);
    prt_file_keep_pages(0);
    given(MIB);
    pages = prt_pages_take(MIB);
    assert_int_equal(pages[0], 0);
    prt_pages_give(pages, MIB);
}

// Whether the page at an address is mapped.
static bool is_mapped(char *page)
{
    unsigned char resident;
    return mincore(page, 1, &resident) == 0;
}

// Contract of prt_file_keep_pages: up to so many bytes, in whole pages; of those kept the
// smallest that suffice are taken, and what is left of them is returned to the system.
static void the_smallest_pages_that_suffice(void **state)
{
    enum { KIB = 1 << 10, PAGE = 4 * KIB };
    prt_file_keep_pages(64 * PAGE);
    char *most = given(64 * PAGE - 5), *pages = prt_pages_take(64 * PAGE - 5);
    assert_ptr_equal(pages, most); // the limit itself, of an odd size
    assert_int_equal(pages[0], 1);
    prt_pages_give(pages, 64 * PAGE - 5);
    pages = prt_pages_take(3 * PAGE);
    assert_ptr_equal(pages, most);
    assert_true(is_mapped(pages + 2 * PAGE));
    assert_false(is_mapped(pages + 3 * PAGE));
    assert_false(is_mapped(pages + 63 * PAGE));
    char *other[3];
    static const size_t size[3] = {30 * PAGE, 10 * PAGE, 20 * PAGE};
    for (int i = 0; i < 3; i++) memset(other[i] = prt_pages_take(size[i]), 1, size[i]);
    for (int i = 0; i < 3; i++) prt_pages_give(other[i], size[i]);
    prt_pages_give(pages, 3 * PAGE);
    pages = prt_pages_take(9 * PAGE);
    assert_ptr_equal(pages, other[1]);
    assert_int_equal(pages[0], 1);
    prt_pages_give(pages, 9 * PAGE);
    prt_file_keep_pages(0);
    for (int i = 0; i < 3; i++) assert_false(is_mapped(other[i]));
}

// A file that takes the pages of another is read as from fresh ones.
static void nothing_of_the_last_file_is_left(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_blob blob = written();
    struct prt_file *file;
    prt_file_keep_pages(8 << 20);
    for (int turn = 0; turn < 2; turn++) {
        given(blob.size + 5000);
        assert_int_equal(prt_file_read(&ctx, path, PRT_FILE_CHECK_ALL, &file), 0);
        struct prt_transport t;
        make(&t);
        same(t.mesh.position, prt_file_transport(file)->mesh.position, 101 * 12);
        unmake(&t);
        prt_file_close(file);
    }
    prt_file_keep_pages(0);
    unlink(path);
    prt_free(blob.bytes);
}

static void failed_writes_leave_nothing(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    char deep[128];
    make(&t);
    snprintf(deep, sizeof deep, "%s/none/x.prt", folder);
    assert_int_equal(prt_file_write(&ctx, deep, &t), PRT_IO);
    assert_int_equal(prt_file_write(&ctx, "/dev/full", &t), PRT_IO);
    // a folder cannot be opened for writing
    assert_int_equal(prt_file_write(&ctx, folder, &t), PRT_IO);
    unmake(&t);
    assert_int_equal(rmdir(folder), 0); // nothing is left in it
    assert_non_null(mkdtemp(strcpy(folder, "/tmp/prt-transport-XXXXXX")));
    snprintf(path, sizeof path, "%s/x.prt", folder);
}

// Rows of halves with an odd number of entries, none and a value only.
static void make_halves(struct prt_tensor *t)
{
    const struct synthetic_options o = {.storage = PRT_STORAGE_FACTORED,
                                        .value = PRT_VALUE_F16,
                                        .n_vertex = 101,
                                        .n_cluster = 3,
                                        .rank = 5,
                                        .n_phase = 1,
                                        .cube = 16,
                                        .coefs = 33,
                                        .seed = 11};
    assert_int_equal(synthetic_tensor(&o, t), 0);
    uint64_t *begin = (uint64_t *)(uintptr_t)t->rows.begin;
    uint16_t *entry = (uint16_t *)(uintptr_t)t->rows.entry;
    begin[1] = 0;            // of none
    begin[2] = begin[1] + 1; // of one
    begin[3] = begin[2] + 7; // odd
    uint16_t *index = (uint16_t *)(uintptr_t)t->rows.index;
    for (uint32_t row = 0; row < 4; row++)
        for (uint64_t e = begin[row]; e < begin[row + 1]; e++)
            index[e] = (uint16_t)(1 + (e - begin[row]));
    for (int i = 0; i < 3; i++) entry[3 * begin[2] + i] = 0x7bff; // as large as a half can be
    for (uint64_t e = begin[3]; e < begin[4]; e++) entry[3 * e + 1] = 0; // a channel of zeros
}

static void pairs_keep_their_rows(void **state)
{
    struct prt_tensor t;
    struct prt_rows pairs;
    make_halves(&t);
    const struct prt_rows *halves = &t.rows;
    assert_int_equal(prt_rows_pair(halves, &pairs), 0);
    for (uint32_t row = 0; row < halves->n_row; row++) {
        const uint64_t from = halves->begin[row], to = pairs.begin[row];
        const uint64_t n = halves->begin[row + 1] - from, m = pairs.begin[row + 1] - to;
        assert_int_equal(m, (n + 1) / 2 * 2);
        for (uint32_t ch = 0; ch < 3; ch++) {
            const float scale = pairs.scale[3 * row + ch];
            long sum = 0;
            assert_true(isfinite(scale));
            for (uint64_t e = 0; e < m; e++) {
                const uint32_t i = ((const uint16_t *)pairs.index)[to + e];
                const int16_t x =
                    ((const int16_t *)pairs.entry)[(to + e) / 2 * 6 + 2 * ch + e % 2];
                const float back = (float)x * scale * prt_pair_gain(16, i);
                if (e % PRT_PAIR_BLOCK == 0) sum = 0;
                sum += labs(x);
                assert_true(sum <= PRT_PAIR_MOST && x > -32768);
                if (e >= n) {
                    assert_int_equal(x, 0);
                    continue;
                }
                assert_int_equal(i, ((const uint16_t *)halves->index)[from + e]);
                const float want =
                    prt_f16_to_f32(((const uint16_t *)halves->entry)[3 * (from + e) + ch]);
                assert_true(fabsf(back - want) <= 0.5001f * scale * prt_pair_gain(16, i));
            }
        }
    }
    // a coefficient's gain: 2 for every level above the finest
    assert_float_equal(prt_pair_gain(16, 0), 1, 0);
    assert_float_equal(prt_pair_gain(16, 256 + 1), 8, 0);
    assert_float_equal(prt_pair_gain(16, 16 + 1), 8, 0);
    assert_float_equal(prt_pair_gain(16, 3 * 16), 4, 0);
    assert_float_equal(prt_pair_gain(16, 7 * 16 + 8), 1, 0);
    prt_rows_finish(&pairs);
    synthetic_tensor_finish(&t);
}

static void broken_pairs_are_refused(void **state)
{
    struct prt_context ctx = quiet();
    medium = (struct prt_material){.eta = 1.3f};
    struct prt_transport t = {.cube = 16, .n_tensor = 1, .media = prt_media_one(&medium)};
    struct prt_rows pairs;
    struct prt_file *file;
    make_halves(&t.tensor[0]);
    assert_int_equal(synthetic_mesh(101, true, &t.mesh), 0);
    assert_int_equal(prt_rows_pair(&t.tensor[0].rows, &pairs), 0);
    prt_rows_finish(&t.tensor[0].rows);
    t.tensor[0].rows = pairs;
    if (prt_file_write(&ctx, path, &t)) fail_msg("%s", last_line);
    assert_int_equal(prt_file_open(&ctx, path, PRT_FILE_CHECK_ALL, &file), 0);
    const struct prt_rows *back = &prt_file_transport(file)->tensor[0].rows;
    const uint64_t n = pairs.begin[pairs.n_row];
    assert_int_equal(back->value, PRT_VALUE_PAIR);
    assert_memory_equal(back->entry, pairs.entry, 6 * n);
    assert_memory_equal(back->scale, pairs.scale, 12ull * pairs.n_row);
    prt_file_close(file);
    ((uint64_t *)(uintptr_t)pairs.begin)[2]++; // half a pair
    assert_int_equal(prt_file_write(&ctx, path, &t), PRT_FORMAT);
    ((uint64_t *)(uintptr_t)pairs.begin)[2]--;
    ((float *)(uintptr_t)pairs.scale)[4] = NAN;
    assert_int_equal(prt_file_write(&ctx, path, &t), PRT_FORMAT);
    synthetic_tensor_finish(&t.tensor[0]);
    const struct synthetic_options sparse = {.storage = PRT_STORAGE_SPARSE,
                                             .value = PRT_VALUE_PAIR,
                                             .n_vertex = 101,
                                             .n_phase = 1,
                                             .cube = 16,
                                             .coefs = 8,
                                             .seed = 12};
    assert_int_equal(synthetic_tensor(&sparse, &t.tensor[0]), 0);
    assert_int_equal(prt_file_write(&ctx, path, &t), PRT_FORMAT);
    synthetic_tensor_finish(&t.tensor[0]);
    synthetic_mesh_finish(&t.mesh);
}

// Not a limit, a number to look at: a bunny's file should open in well under 50 ms.
static void opening_is_timed(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_transport t = {.cube = 32, .n_tensor = 1};
    struct synthetic_options o = {.storage = PRT_STORAGE_FACTORED,
                                  .value = PRT_VALUE_F16,
                                  .n_vertex = 34835,
                                  .n_cluster = 64,
                                  .rank = 40,
                                  .n_phase = 1,
                                  .cube = 32,
                                  .coefs = 512,
                                  .seed = 9};
    struct prt_file *file;
    medium = (struct prt_material){.eta = 1.3f};
    t.media = prt_media_one(&medium);
    assert_int_equal(synthetic_mesh(o.n_vertex, false, &t.mesh), 0);
    assert_int_equal(synthetic_tensor(&o, &t.tensor[0]), 0);
    assert_int_equal(prt_file_write(&ctx, path, &t), 0);
    for (int check = 0; check < 2; check++) {
        double start = prt_time_s();
        assert_int_equal(prt_file_open(&ctx, path, (enum prt_file_check)check, &file), 0);
        print_message("opened %.1f MB in %.2f ms (%s)\n", (double)prt_file_bytes(file) / 1e6,
                      1e3 * (prt_time_s() - start), check ? "all checksums" : "structure");
        prt_file_close(file);
    }
    synthetic_tensor_finish(&t.tensor[0]);
    synthetic_mesh_finish(&t.mesh);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(half_floats_are_exact),
        cmocka_unit_test(what_is_written_comes_back),
        cmocka_unit_test(columns_without_factors_come_back),
        cmocka_unit_test(every_truncation_is_refused),
        cmocka_unit_test(every_flipped_byte_is_refused),
        cmocka_unit_test(forged_headers_are_refused),
        cmocka_unit_test(sections_too_many_are_refused),
        cmocka_unit_test(broken_structure_is_refused),
        cmocka_unit_test(large_counts_are_refused),
        cmocka_unit_test(foreign_files_are_refused),
        cmocka_unit_test(what_was_read_outlives_its_file),
        cmocka_unit_test(a_lost_page_is_noticed),
        cmocka_unit_test(a_file_that_shrinks_is_no_end),
        cmocka_unit_test(pages_of_closed_files_are_used_again),
        cmocka_unit_test(the_smallest_pages_that_suffice),
        cmocka_unit_test(nothing_of_the_last_file_is_left),
        cmocka_unit_test(failed_writes_leave_nothing),
        cmocka_unit_test(pairs_keep_their_rows),
        cmocka_unit_test(broken_pairs_are_refused),
        cmocka_unit_test(opening_is_timed),
    };
    if (!mkdtemp(strcpy(folder, "/tmp/prt-transport-XXXXXX"))) return 1;
    snprintf(path, sizeof path, "%s/x.prt", folder);
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    unlink(path);
    rmdir(folder);
    return failed;
}
