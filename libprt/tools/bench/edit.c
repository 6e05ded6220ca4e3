// SPDX-License-Identifier: MIT
// Editing: a new material to colours with the light contracted before, and joint transport with
// light and material both new.
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "bench.h"
#include "prt/radial.h"
#include "prt/relight.h"
#include "synthetic.h"

// A transport with a free material, its light and the result of contracting the light.
struct edit {
    struct bench_env *env;
    unsigned n_tensor, n_plane;
    const struct prt_tensor *tensor[PRT_MOST_TENSORS];
    struct prt_radial *radial[PRT_MOST_TENSORS];
    float *coef[PRT_MOST_TENSORS], *lit[PRT_MOST_TENSORS], *color;
    struct prt_material material;
    struct prt_cube cube;
    unsigned turn;
    bool own_bases;
};

static struct prt_material some_material(double eta)
{
    return (struct prt_material){.name = "edited",
                                 .sigma_s_prime = {1.1f, 1.4f, 1.9f},
                                 .sigma_a = {0.01f, 0.03f, 0.09f},
                                 .g = {0.2f, 0.1f, 0},
                                 .eta = (float)eta,
                                 .roughness = 0.3f};
}

static bool full(const struct prt_tensor *t)
{
    return t->coupling == PRT_COUPLE_FULL && t->storage == PRT_STORAGE_FACTORED;
}

// Another material each time, and its coefficients in every tensor's basis.
static int solve(void *arg)
{
    struct edit *e = arg;
    int status = PRT_OK;
    e->material.sigma_a[1] = 0.03f + 0.001f * (float)(++e->turn % 16);
    for (unsigned i = 0; i < e->n_tensor && !status; i++)
        if (e->radial[i])
            status = prt_radial_fit_material(e->radial[i], &e->material, e->coef[i], NULL);
    return status;
}

// The steps of an answer: phase planes weighted by the medium's, the view-free one among
// multiple scattering.
static int colours(struct edit *e)
{
    static const float factor[16][3] = {{.5f, .6f, .7f}, {.2f, .3f, .1f}, {.2f, .3f, .1f},
                                        {.2f, .3f, .1f}, {.1f, .1f, .1f}, {.1f, .1f, .1f},
                                        {.1f, .1f, .1f}, {.1f, .1f, .1f}, {.1f, .1f, .1f}};
    struct prt_term_input part[PRT_MOST_TENSORS];
    for (unsigned i = 0; i < e->n_tensor; i++) {
        const struct prt_tensor *t = e->tensor[i];
        const bool moves = full(t) || t->storage == PRT_STORAGE_RADIAL;
        part[i] = (struct prt_term_input){.tensor = t,
                                          .lit = e->lit[i],
                                          .coef = moves ? e->coef[i] : NULL,
                                          .factor = t->term == PRT_TERM_SINGLE ? factor : NULL};
    }
    return prt_sum_parts(&e->env->ctx, e->n_tensor, part, e->n_plane, e->color);
}

static int edit_once(void *arg)
{
    int status = solve(arg);
    return status ? status : colours(arg);
}

static int light(struct edit *e)
{
    struct prt_light light = {0};
    const struct prt_light *lights[1] = {&light};
    int status = prt_light_from_cube(&e->cube, &light);
    for (unsigned i = 0; i < e->n_tensor && !status; i++)
        if (e->tensor[i]->storage == PRT_STORAGE_FACTORED)
            status = prt_contract_light(&e->env->ctx, e->tensor[i], 1, lights, e->lit[i]);
    prt_light_finish(&light);
    return status;
}

static int frame_once(void *arg)
{
    struct edit *e = arg;
    e->cube.texel[e->turn % 64] *= 1.01f;
    int status = light(e);
    return status ? status : edit_once(e);
}

static void stop(struct edit *e)
{
    for (unsigned i = 0; i < PRT_MOST_TENSORS; i++) {
        if (e->own_bases) prt_radial_destroy(e->radial[i]);
        prt_free(e->coef[i]);
        prt_free(e->lit[i]);
    }
    prt_free(e->color);
    prt_cube_finish(&e->cube);
}

static int start(struct edit *e, struct bench_env *env, uint32_t cube, unsigned n,
                 const struct prt_tensor *const tensor[], double eta)
{
    *e = (struct edit){.env = env, .n_tensor = n, .material = some_material(eta)};
    int status = bench_cube(cube, env->seed, &e->cube);
    for (unsigned i = 0; i < n && !status; i++) {
        const struct prt_tensor *t = e->tensor[i] = tensor[i];
        size_t rows = (size_t)t->rows.n_row, lit = rows * t->n_function * (full(t) ? 3u : 1u);
        if (t->n_phase > e->n_plane) e->n_plane = t->n_phase;
        e->coef[i] = prt_calloc(3ull * t->n_radial + 1, sizeof(float));
        e->lit[i] = prt_alloc(lit + 1, sizeof(float));
        if (!e->coef[i] || !e->lit[i]) return PRT_NOMEM;
        for (uint32_t k = 0; k < 3 * t->n_radial; k++) e->coef[i][k] = 1.0f / (float)(k + 1);
    }
    e->color = prt_calloc(3ull * tensor[0]->n_vertex * e->n_plane, sizeof(float));
    return status ? status : e->color ? PRT_OK : PRT_NOMEM;
}

// Bases are slow to make and the same for many figures: [family][functions].
enum { MOST_FUNCTIONS = 20 };
static struct prt_radial *bases[2][MOST_FUNCTIONS + 1];

__attribute__((destructor)) static void drop_bases(void)
{
    for (int f = 0; f < 2; f++)
        for (int n = 0; n <= MOST_FUNCTIONS; n++) prt_radial_destroy(bases[f][n]);
}

// A real basis of as many functions as each made-up tensor has, or as a basis can have; few
// when it only has to run.
static int made_up_bases(struct edit *e)
{
    int status = PRT_OK;
    for (unsigned i = 0; i < e->n_tensor && !status; i++) {
        const uint32_t family = i ? PRT_FAMILY_EXTINCTION : PRT_FAMILY_DIPOLE;
        uint32_t n = e->tensor[i]->n_radial;
        n = e->env->quick ? 8 : n < MOST_FUNCTIONS ? n : MOST_FUNCTIONS;
        struct prt_radial_options o = {
            .kind = PRT_RADIAL_REDUCED, .family = family, .eta = 1.3, .n_function = n};
        if (!bases[family][n]) status = prt_radial_create(&e->env->ctx, &o, &bases[family][n]);
        e->radial[i] = bases[family][n];
    }
    e->own_bases = false;
    return status;
}

static double lit_bytes(const struct prt_tensor *t)
{
    return full(t) ? 12.0 * t->rows.n_row * t->n_function : 0;
}

static void describe(const struct edit *e)
{
    const struct prt_tensor *t = e->tensor[0];
    double u = 0, rows = 0, functions = 0;
    for (unsigned i = 0; i < e->n_tensor; i++) {
        uint64_t u_bytes, row_bytes;
        prt_tensor_bytes(e->tensor[i], &u_bytes, &row_bytes);
        u += (double)u_bytes;
        rows += (double)row_bytes;
        functions += e->tensor[i]->n_function;
    }
    bench_number("vertices", t->n_vertex);
    bench_number("planes", e->n_plane);
    bench_number("clusters", t->n_cluster);
    bench_number("rows", t->rows.n_row);
    bench_number("functions", functions);
    bench_number("MB_of_U", 1e-6 * u);
    bench_number("MB_of_bases", 1e-6 * rows);
}

// Material to colours. The targets are those of issue 3: either will do.
static int edit_figure(struct edit *e, const char *name, bool single)
{
    struct bench_span span[BENCH_SPANS * PRT_MOST_TENSORS];
    struct bench_time all, fit;
    unsigned n_span = 0;
    double bytes = 0;
    int status = light(e);
    for (unsigned i = 0; i < e->n_tensor; i++) {
        const struct prt_tensor *t = e->tensor[i];
        uint64_t u_bytes, row_bytes;
        prt_tensor_bytes(t, &u_bytes, &row_bytes);
        span[n_span++] = (struct bench_span){t->u, 2 * t->u_count};
        bytes += (double)u_bytes + lit_bytes(t) + 4.0 * t->n_vertex;
    }
    bytes += 12.0 * e->n_plane * e->tensor[0]->n_vertex;
    double bandwidth = bench_read_bandwidth(e->env, span, n_span);
    if (!status) status = bench_measure(e->env, solve, e, &fit);
    if (!status) status = bench_measure(e->env, edit_once, e, &all);
    if (status) return status;
    bench_begin(e->env, name);
    describe(e);
    bench_number("ms", 1e3 * all.best);
    bench_number("ms_median", 1e3 * all.median);
    bench_number("Mvertices_per_s", 1e-6 * e->tensor[0]->n_vertex / all.best);
    bench_number("target_Mvertices_per_s", single ? 30 : 120);
    bench_number("GB_per_s_read_and_written", 1e-9 * bytes / all.best);
    bench_number("GB_per_s_plain_read", 1e-9 * bandwidth);
    bench_number("of_plain_read_with_writes", bytes / all.best / bandwidth);
    bench_number("or_target_of_plain_read", 0.4);
    bench_number("solve_ms", 1e3 * fit.best);
    bench_number("solve_ms_median", 1e3 * fit.median);
    bench_number("target_solve_ms", 0.2);
    bench_end();
    return PRT_OK;
}

// Light and material both new.
static int frame_figure(struct edit *e, const char *name, bool single)
{
    struct bench_time time;
    int status = bench_measure(e->env, frame_once, e, &time);
    if (status) return status;
    bench_begin(e->env, name);
    describe(e);
    bench_number("ms", 1e3 * time.best);
    bench_number("ms_median", 1e3 * time.median);
    bench_number("frames_per_s", 1 / time.best);
    bench_number("frames_per_s_median", 1 / time.median);
    bench_number("target_frames_per_s", single ? 100 : 300);
    bench_end();
    return PRT_OK;
}

typedef int (*figure_fn)(struct edit *e, const char *name, bool single);

static int made_up(struct bench_env *env, const char *name, unsigned n,
                   const struct synthetic_options o[], figure_fn figure)
{
    struct prt_tensor tensor[2] = {{0}};
    const struct prt_tensor *tensors[2] = {tensor, tensor + 1};
    struct edit e = {0};
    int status = PRT_OK;
    for (unsigned i = 0; i < n && !status; i++) status = synthetic_tensor(&o[i], &tensor[i]);
    if (!status) status = start(&e, env, o[0].cube, n, tensors, 1.3);
    if (!status) status = made_up_bases(&e);
    if (!status) status = figure(&e, name, n > 1);
    stop(&e);
    for (unsigned i = 0; i < n; i++) synthetic_tensor_finish(&tensor[i]);
    return status ? prt_fail(&env->ctx, status, "%s cannot be measured", name) : PRT_OK;
}

// Largest size of a joint bake: 40 MB for multiple scattering, 120 MB with single.
static void joint_shape(const struct bench_env *env, uint32_t n_vertex,
                        struct synthetic_options o[2])
{
    o[0] = (struct synthetic_options){.storage = PRT_STORAGE_FACTORED,
                                      .coupling = PRT_COUPLE_FULL,
                                      .value = PRT_VALUE_I8,
                                      .n_vertex = n_vertex,
                                      .n_cluster = 128,
                                      .rank = 40,
                                      .n_phase = 1,
                                      .n_radial = 16,
                                      .cube = 32,
                                      .coefs = 200,
                                      .seed = env->seed,
                                      .run = 24};
    o[1] = o[0];
    o[1].term = PRT_TERM_SINGLE;
    o[1].n_phase = 4;
    o[1].n_radial = 12;
    o[1].coefs = 150;
    o[1].seed++;
    for (int i = 0; i < 2 && env->quick; i++) o[i].n_cluster = 8;
}

static void polynomial_shape(const struct bench_env *env, uint32_t n_vertex, uint32_t n,
                             uint32_t n_single, struct synthetic_options o[2])
{
    o[0] = (struct synthetic_options){.storage = PRT_STORAGE_RADIAL,
                                      .n_vertex = n_vertex,
                                      .n_cluster = 64,
                                      .n_phase = 1,
                                      .n_radial = n,
                                      .cube = 16,
                                      .seed = env->seed,
                                      .run = 24};
    o[1] = o[0];
    o[1].term = PRT_TERM_SINGLE;
    o[1].n_phase = 4;
    o[1].n_radial = n_single;
    o[1].seed++;
}

static int edit_joint(struct bench_env *env)
{
    static const uint32_t size[] = {40000, 1000000};
    struct synthetic_options o[2];
    char name[64];
    int status = PRT_OK;
    for (int k = 0; k < 2 && !status; k++) {
        joint_shape(env, env->quick ? 5000 : size[k], o);
        snprintf(name, sizeof name, "edit_joint_multiple_%uk", size[k] / 1000);
        status = made_up(env, name, 1, o, edit_figure);
        snprintf(name, sizeof name, "edit_joint_with_single_%uk", size[k] / 1000);
        if (!status) status = made_up(env, name, 2, o, edit_figure);
    }
    return status;
}

static int edit_polynomial(struct bench_env *env)
{
    static const struct {
        const char *name;
        uint32_t n_vertex, n, n_single;
    } shape[] = {
        {"edit_polynomial_12_35k", 34835, 12, 0},
        {"edit_polynomial_12_million", 1000000, 12, 0},
        {"edit_polynomial_18_million", 1000000, 18, 0},
        {"edit_x07_32_35k", 34835, 32, 0},
        {"edit_x07_32_million", 1000000, 32, 0},
        {"edit_x07_32_with_single_16_35k", 34835, 32, 16},
        {"edit_polynomial_12_with_single_12_35k", 34835, 12, 12},
        {"edit_polynomial_12_with_single_12_300k", 300000, 12, 12},
    };
    int status = PRT_OK;
    for (size_t i = 0; i < sizeof shape / sizeof *shape && !status; i++) {
        struct synthetic_options o[2];
        polynomial_shape(env, env->quick ? 5000 : shape[i].n_vertex, shape[i].n,
                         shape[i].n_single, o);
        status = made_up(env, shape[i].name, shape[i].n_single ? 2 : 1, o, edit_figure);
    }
    return status;
}

static int joint_frame(struct bench_env *env)
{
    struct synthetic_options o[2];
    joint_shape(env, env->quick ? 5000 : 40000, o);
    int status = made_up(env, "joint_frame_multiple", 1, o, frame_figure);
    if (!status) status = made_up(env, "joint_frame_with_single", 2, o, frame_figure);
    return status;
}

static int file_bases(struct edit *e, const struct prt_transport *transport)
{
    int status = PRT_OK;
    e->own_bases = true;
    for (unsigned i = 0; i < e->n_tensor && !status; i++) {
        const struct prt_tensor *t = e->tensor[i];
        if (t->n_knot) // else the material is fixed
            status = prt_tensor_radial(&e->env->ctx, transport, t, &e->radial[i]);
    }
    return status;
}

// A baked file: its multiple scattering, then all of it.
static int file_figures(struct bench_env *env, figure_fn figure, const char *prefix, bool lit)
{
    struct prt_file *f;
    if (!env->file) return PRT_OK;
    int status = prt_file_open(&env->ctx, env->file, PRT_FILE_CHECK_HEADERS, &f);
    if (status) return status;
    const struct prt_transport *t = prt_file_transport(f);
    for (int single = 0; single < 2 && !status; single++) {
        const struct prt_tensor *tensors[PRT_MOST_TENSORS];
        struct edit e = {0};
        unsigned n = 0, n_free = 0, n_single = 0;
        char name[64];
        for (uint32_t i = 0; i < t->n_tensor; i++) {
            const struct prt_tensor *x = &t->tensor[i];
            if (x->term == PRT_TERM_SINGLE && !single) continue;
            if (x->storage == PRT_STORAGE_SPARSE) continue;
            n_free += full(x) || x->storage == PRT_STORAGE_RADIAL;
            n_single += x->term == PRT_TERM_SINGLE;
            tensors[n++] = x;
        }
        if (!n_free || (single && !n_single) || (lit && t->engine != PRT_TRANSPORT_JOINT))
            continue;
        snprintf(name, sizeof name, "%s_%s", prefix, single ? "with_single" : "multiple");
        status =
            start(&e, env, t->cube ? t->cube : 32, n, tensors, (double)t->media.medium->eta);
        if (!status) status = file_bases(&e, t);
        if (!status) status = figure(&e, name, single);
        stop(&e);
    }
    prt_file_close(f);
    return status;
}

// A query as in the daemon: planes for a picture, with a contracted light.
struct asking {
    struct bench_env *env;
    const struct prt_transport *transport;
    struct prt_query query;
    struct prt_material material, media[3]; // media: of a model of three
    float *planes;
    unsigned turn;
};

static int ask(void *arg)
{
    struct asking *a = arg;
    unsigned n_plane;
    // another medium each time: fits of the last 64 are kept
    a->material.sigma_a[1] = 0.03f + 1e-5f * (float)(++a->turn % 4096);
    a->media[0] = a->material;
    return prt_answer_planes(&a->env->ctx, a->transport, &a->query, &n_plane, a->planes);
}

// Whether the objects can have three media: one eta, and three objects or more.
static bool has_room_for_media(const struct prt_transport *t)
{
    double eta[PRT_MEDIA_MAX];
    return t->mesh.n_object >= 3 && t->mesh.n_object <= 255 &&
           prt_media_etas(&t->media, eta) == 1;
}

// An edit of the medium of all objects; of_three: of one of three media, by objects in turn.
static int answer_figure(struct bench_env *env, const struct prt_transport *t, bool of_three)
{
    uint8_t of_object[255];
    struct asking a = {.env = env, .transport = t, .material = some_material(1)};
    struct prt_cube cube = {0};
    struct prt_contracted_light *lit = NULL;
    struct bench_time time = {0};
    unsigned n_plane = 0;
    a.material.eta = t->media.medium->eta;
    a.query = (struct prt_query){.term = PRT_ANSWER_TOTAL, .media = prt_media_one(&a.material)};
    for (uint32_t k = 0; k < 255; k++) of_object[k] = (uint8_t)(k % 3);
    for (int k = 0; k < 3; k++) {
        a.media[k] = a.material;
        a.media[k].sigma_a[0] += 0.01f * (float)k;
    }
    if (of_three) a.query.media = (struct prt_media){3, a.media, of_object};
    int status = bench_cube(t->cube ? t->cube : 32, env->seed, &cube);
    if (!status) status = prt_contracted_light_create(&env->ctx, t, &cube, &lit);
    a.query.lit = lit;
    if (!status) status = prt_answer_planes(&env->ctx, t, &a.query, &n_plane, NULL);
    if (!status) {
        a.planes = prt_calloc(3ull * n_plane * t->mesh.n_vertex, sizeof *a.planes);
        status = a.planes ? bench_measure(env, ask, &a, &time) : PRT_NOMEM;
    }
    if (!status) {
        bench_begin(env, of_three ? "edit_file_answer_of_three_media" : "edit_file_answer");
        bench_number("vertices", t->mesh.n_vertex);
        bench_number("planes", n_plane);
        bench_number("MB_of_contracted_light", 1e-6 * (double)prt_contracted_light_bytes(lit));
        bench_number("ms", 1e3 * time.best);
        bench_number("ms_median", 1e3 * time.median);
        bench_number("Mvertices_per_s", 1e-6 * t->mesh.n_vertex / time.best);
        bench_number("target_Mvertices_per_s", n_plane > 1 ? 30 : 120);
        bench_end();
    }
    prt_free(a.planes);
    prt_contracted_light_destroy(lit);
    prt_cube_finish(&cube);
    return status;
}

// Another light each time, under one material: contracted once, or for each answer.
static int ask_turned(void *arg)
{
    struct asking *a = arg;
    unsigned n_plane;
    ((struct prt_cube *)(uintptr_t)a->query.light)->texel[a->turn++ % 64] *= 1.01f;
    return prt_answer_planes(&a->env->ctx, a->transport, &a->query, &n_plane, a->planes);
}

static int turn_figures(struct bench_env *env, const struct prt_transport *t)
{
    struct asking a = {.env = env, .transport = t, .material = some_material(1)};
    struct prt_cube cube = {0};
    struct prt_contracted_transport *fixed = NULL;
    struct bench_time plain = {0}, time = {0};
    unsigned n_plane = 0;
    a.material.eta = t->media.medium->eta;
    a.query = (struct prt_query){
        .term = PRT_ANSWER_TOTAL, .light = &cube, .media = prt_media_one(&a.material)};
    int status = bench_cube(t->cube, env->seed, &cube);
    if (!status) status = prt_answer_planes(&env->ctx, t, &a.query, &n_plane, NULL);
    a.planes = prt_calloc(3ull * n_plane * t->mesh.n_vertex, sizeof *a.planes);
    if (!status) status = a.planes ? bench_measure(env, ask_turned, &a, &plain) : PRT_NOMEM;
    const size_t n = 3ull * n_plane * t->mesh.n_vertex;
    float *free_planes = prt_alloc(n, sizeof *free_planes);
    if (!status && free_planes) memcpy(free_planes, a.planes, n * sizeof *free_planes);
    double started = prt_time_s(), off = 0, all = 0;
    if (!status) status = prt_contracted_transport_create(&env->ctx, t, &a.query.media, &fixed);
    double seconds = prt_time_s() - started;
    a.query.media.n = 0;
    if (!status) a.transport = prt_contracted_transport_get(fixed);
    if (!status)
        status = prt_answer_planes(&env->ctx, a.transport, &a.query, &n_plane, a.planes);
    for (size_t i = 0; i < n && !status && free_planes; i++) {
        off += pow((double)(a.planes[i] - free_planes[i]), 2);
        all += pow((double)free_planes[i], 2);
    }
    prt_free(free_planes);
    if (!status) status = bench_measure(env, ask_turned, &a, &time);
    if (!status) {
        bench_begin(env, "joint_file_turned");
        bench_number("relative_difference", sqrt(off / all));
        bench_number("vertices", t->mesh.n_vertex);
        bench_number("planes", n_plane);
        bench_number("ms", 1e3 * time.best);
        bench_number("ms_median", 1e3 * time.median);
        bench_number("ms_material_free", 1e3 * plain.best);
        bench_number("ms_material_free_median", 1e3 * plain.median);
        bench_number("s_to_put_in", seconds);
        bench_number("MB_of_material", 1e-6 * (double)prt_contracted_transport_bytes(fixed));
        bench_end();
    }
    prt_contracted_transport_destroy(fixed);
    prt_free(a.planes);
    prt_cube_finish(&cube);
    return status;
}

static int edit_file(struct bench_env *env)
{
    struct prt_file *f;
    int status = file_figures(env, edit_figure, "edit_file", false);
    if (status || !env->file) return status;
    status = prt_file_open(&env->ctx, env->file, PRT_FILE_CHECK_HEADERS, &f);
    if (status) return status;
    const struct prt_transport *t = prt_file_transport(f);
    if (t->engine != PRT_TRANSPORT_WAVELET) status = answer_figure(env, t, false);
    if (!status && t->engine != PRT_TRANSPORT_WAVELET && has_room_for_media(t))
        status = answer_figure(env, t, true);
    prt_file_close(f);
    return status;
}

static int joint_file(struct bench_env *env)
{
    struct prt_file *f;
    int status = file_figures(env, frame_figure, "joint_file", true);
    if (status || !env->file) return status;
    status = prt_file_open(&env->ctx, env->file, PRT_FILE_CHECK_HEADERS, &f);
    if (status) return status;
    const struct prt_transport *t = prt_file_transport(f);
    if (t->engine == PRT_TRANSPORT_JOINT) status = turn_figures(env, t);
    prt_file_close(f);
    return status;
}

BENCH(edit_joint, "Joint transport, light contracted: new material to colours", edit_joint)
BENCH(edit_polynomial, "Polynomial transport: new material to colours", edit_polynomial)
BENCH(joint_frame, "Joint transport: light and material both new", joint_frame)
BENCH(edit_file, "New material to colours with --file X.prt", edit_file)
BENCH(joint_file, "Light and material both new with --file X.prt", joint_file)
