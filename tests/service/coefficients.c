// SPDX-License-Identifier: MIT
// Coefficients: contracted rows that the client multiplies with FACTORS give the colours that
// the daemon computes, without an eye and towards one, for several lights, in views, and with
// fewer rows. Transports are made up, so that no bake is waited for.
#include "frames.h"

#include <math.h>

#include "prt/relight.h"
#include "synthetic.h"

enum { N = 1357, CUBE = 16 };
static struct daemon d;
static struct relight_client *client;
static struct relight_error error;
static const struct relight_light light = {.env = "constant:1,2,0.5"};

static const struct synthetic_options shared = {.n_vertex = N,
                                                .n_cluster = 7,
                                                .rank = 19,
                                                .n_phase = 1,
                                                .cube = CUBE,
                                                .coefs = 60,
                                                .seed = 1};

// multiple: pairs; single: halves of n_phase planes; sparse: the second tensor is; exits: a
// third has planes of exit.
static void write_model(const char *name, float g, uint32_t n_phase, bool opaque, bool sparse,
                        bool exits)
{
    struct prt_context ctx;
    struct synthetic_options a = shared, b = shared, c = shared;
    struct prt_transport t = {.cube = CUBE, .n_tensor = exits ? 3 : 2};
    char path[160];
    const struct prt_material medium = {.sigma_s_prime = {1, 1.5f, 2},
                                        .sigma_a = {0.01f, 0.02f, 0.03f},
                                        .g = {g, g, g},
                                        .eta = 1.4f,
                                        .roughness = 0.25f};
    t.media = prt_media_one(&medium);
    prt_context_init(&ctx);
    a.value = PRT_VALUE_PAIR;
    b.value = PRT_VALUE_F16;
    b.term = PRT_TERM_SINGLE;
    b.seed = 2;
    b.n_phase = n_phase;
    b.n_cluster = 5;
    b.rank = 24;
    b.storage = sparse ? PRT_STORAGE_SPARSE : PRT_STORAGE_FACTORED;
    assert_int_equal(synthetic_mesh(N, opaque, &t.mesh), 0);
    assert_int_equal(synthetic_tensor(&a, &t.tensor[0]), 0);
    assert_int_equal(synthetic_tensor(&b, &t.tensor[1]), 0);
    c.value = PRT_VALUE_F16;
    c.term = PRT_TERM_VIEW;
    c.seed = 3;
    c.n_phase = RELIGHT_EXIT_PLANES;
    if (exits) assert_int_equal(synthetic_tensor(&c, &t.tensor[2]), 0);
    snprintf(path, sizeof path, "%s/%s", d.models, name);
    assert_int_equal(prt_file_write(&ctx, path, &t), 0);
    synthetic_tensor_finish(&t.tensor[0]);
    synthetic_tensor_finish(&t.tensor[1]);
    if (exits) synthetic_tensor_finish(&t.tensor[2]);
    synthetic_mesh_finish(&t.mesh);
    struct relight_load load = {.path = name};
    struct relight_loaded loaded;
    OK(relight_load(client, &load, &loaded, &error));
    relight_loaded_finish(&loaded);
}

static int group_begin(void **state)
{
    daemon_folder(&d);
    daemon_start(&d, NULL);
    client = client_open(d.address);
    write_model("even.prt", 0, 1, false, false, false);
    write_model("phases.prt", 0.3f, 4, false, false, false);
    write_model("opaque.prt", 0, 1, true, false, false);
    write_model("sparse.prt", 0, 1, false, true, false);
    write_model("exits.prt", 0, 1, false, false, true);
    write_model("both.prt", 0.3f, 4, false, false, true);
    return 0;
}

static int group_end(void **state)
{
    relight_close(client);
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

static float cube[2][CUBE * CUBE * 18];

// Two lights with directions, so that colours differ from vertex to vertex.
static void some_lights(struct relight_light out[2])
{
    for (int l = 0; l < 2; l++) {
        for (int i = 0; i < CUBE * CUBE * 18; i++)
            cube[l][i] = (float)((i * 7 + l * 3) % 13) * (i < 2000 ? 3 : 0.5f);
        out[l] = (struct relight_light){.cube_n = CUBE, .cube = cube[l]};
    }
}

static double rmse(const float *got, const float *want, size_t n)
{
    double difference = 0, sum = 0;
    for (size_t i = 0; i < n; i++) {
        difference += ((double)got[i] - (double)want[i]) * ((double)got[i] - (double)want[i]);
        sum += (double)want[i] * (double)want[i];
    }
    assert_true(sum > 0);
    return sqrt(difference / sum);
}

static void ask(struct relight_colors_request *request, enum relight_color_format format,
                struct relight_colors *out)
{
    request->format = format;
    OK(relight_colors(client, request, out, &error));
    assert_int_equal(out->n_vertex, N);
}

static double worst_rounding; // of packed coefficients against halves

// The planes of both formats differ by at most `most`, those of rounded coefficients by the
// 0.2 % that streams of light may differ by.
static void compare(struct relight_colors_request request,
                    const struct relight_factors *factors, double most)
{
    const struct relight_block all = {.translucent = true, .n_vertex = N};
    static float got[3 * N], want[3 * N], rounded[3 * N];
    struct relight_colors rows, packed, colors;
    ask(&request, RELIGHT_COLOR_COEFFICIENTS, &rows);
    ask(&request, RELIGHT_COLOR_COEFFICIENTS_PACKED, &packed);
    ask(&request, RELIGHT_COLOR_F32, &colors);
    assert_int_equal(rows.n_plane, colors.n_plane);
    assert_int_equal(packed.n_plane, colors.n_plane);
    assert_true(rows.plane_bytes < colors.plane_bytes / 2);
    assert_true(packed.plane_bytes <= rows.plane_bytes * 2 / 3 + 128); // layers' alignment
    for (uint32_t i = 0; i < rows.n_plane; i++) {
        OK(relight_coefficients_colors(factors, &rows, i, 1, &all, got, &error));
        OK(relight_colors_decode(&colors, i, want));
        double difference = rmse(got, want, 3 * N);
        if (!(difference <= most))
            fail_msg("%s term %d plane %u: relative RMSE %.3g", request.model,
                     request.shade.term, i, difference);
        OK(relight_coefficients_colors(factors, &packed, i, 1, &all, rounded, &error));
        difference = rmse(rounded, got, 3 * N);
        worst_rounding = fmax(worst_rounding, difference);
        if (!(difference > 0 && difference <= 2e-3))
            fail_msg("%s term %d plane %u: packed is %.3g off", request.model,
                     request.shade.term, i, difference);
    }
    relight_colors_finish(&packed);
    relight_colors_finish(&rows);
    relight_colors_finish(&colors);
}

// Colours of every term, of one light, of two, of their sum.
static void equal_colors(void **state)
{
    static const enum relight_term terms[] = {RELIGHT_TERM_TOTAL, RELIGHT_TERM_MULTIPLE,
                                              RELIGHT_TERM_SINGLE};
    static const char *const models[] = {"even.prt", "phases.prt"};
    struct relight_light two[2];
    some_lights(two);
    for (int m = 0; m < 2; m++) {
        struct relight_factors factors;
        OK(relight_factors(client, models[m], 0, &factors, &error));
        assert_int_equal(factors.n_tensor, 2);
        for (int t = 0; t < 3; t++) {
            struct relight_colors_request request = {
                .model = models[m], .n_light = 1, .lights = two, .shade.term = terms[t]};
            compare(request, &factors, 1e-3);
            request.n_light = 2;
            compare(request, &factors, 1e-3);
            request.sum = true;
            compare(request, &factors, 1e-3);
        }
        relight_factors_finish(&factors);
    }
    print_message("packed coefficients: at most %.3g from halves\n", worst_rounding);
}

// The harmonics of PROTOCOL.md, the first as 1: plane 0 is times it already.
static void harmonics(const float w[3], float y[RELIGHT_EXIT_PLANES])
{
    const float x = w[0], v = w[1], z = w[2];
    const float all[RELIGHT_EXIT_PLANES] = {1,
                                            0.488603f * v,
                                            0.488603f * z,
                                            0.488603f * x,
                                            1.092548f * x * v,
                                            1.092548f * v * z,
                                            0.315392f * (3 * z * z - 1),
                                            1.092548f * x * z,
                                            0.546274f * (x * x - v * v)};
    memcpy(y, all, sizeof all);
}

// PROTOCOL.md's formula at one vertex, with what the client received. exits NULL: none.
static void toward_eye(const struct relight_outgoing *o, const float n[3], const float w[3],
                       const float *multiple, const float *single, unsigned n_phase,
                       const float *exits, float out[3])
{
    const float mu = n[0] * w[0] + n[1] * w[1] + n[2] * w[2], eta = o->eta;
    const float inside = sqrtf(1 - (1 - mu * mu) / (eta * eta));
    const float rs = (mu - eta * inside) / (mu + eta * inside);
    const float rp = (eta * mu - inside) / (eta * mu + inside);
    const float transmittance = (1 - 0.5f * (rs * rs + rp * rp)) / o->divisor;
    float in[3], y[RELIGHT_EXIT_PLANES];
    for (int i = 0; i < 3; i++) in[i] = w[i] / eta + (inside - mu / eta) * n[i];
    harmonics(in, y);
    for (int c = 0; c < 3; c++) {
        float sum = 0;
        for (unsigned k = 0; k < n_phase; k++) sum += y[k] * single[k * 3 * N + (unsigned)c];
        sum = multiple[c] + (1 + o->view_slope * (1 - inside)) * sum;
        for (unsigned k = 0; exits && k < RELIGHT_EXIT_PLANES; k++)
            sum += y[k] * exits[k * 3 * N + (unsigned)c];
        out[c] = mu > 0 ? fmaxf(0, transmittance * sum) : 0;
    }
}

// Colours towards an eye from one answer without an eye: exact for a medium that scatters
// evenly, and to the 2 % of the daemon's own fit (METHODS 3.6) for others. Models from 2 on
// have planes of exit.
static void equal_colors_toward_an_eye(void **state)
{
    static const char *const models[] = {"even.prt", "phases.prt", "exits.prt", "both.prt"};
    static float multiple[3 * N], single[4 * 3 * N], got[3 * N], want[3 * N];
    static float exits[RELIGHT_EXIT_PLANES * 3 * N];
    struct relight_light two[2];
    some_lights(two);
    for (int i = 0; i < 8; i++) {
        const int m = i % 4;
        const unsigned n_phase = m % 2 ? 4 : 1;
        struct relight_factors factors;
        struct relight_geometry g;
        struct relight_colors rows, colors;
        struct relight_outgoing outgoing;
        struct relight_colors_request request = {
            .model = models[m], .n_light = 1, .lights = two, .phases = true, .exits = true};
        OK(relight_factors_with_exits(client, models[m], 0, &factors, &error));
        assert_int_equal(factors.n_tensor, m < 2 ? 2 : 3);
        OK(relight_geometry(client, models[m], true, &g, &error));
        ask(&request, i < 4 ? RELIGHT_COLOR_COEFFICIENTS : RELIGHT_COLOR_COEFFICIENTS_PACKED,
            &rows);
        assert_int_equal(rows.layer[1].n_phase, n_phase);
        assert_int_equal(rows.n_layer, factors.n_tensor);
        OK(relight_coefficients_expand(&factors, &rows, 0, 4, multiple, single, &error));
        OK(relight_coefficients_exits(&factors, &rows, 0, exits, &error));
        assert_int_equal(relight_colors_outgoing(&rows, 0, &outgoing), 0);
        request.shade = (struct relight_shade){.has_eye = true, .eye = {3, 9, 4}};
        ask(&request, RELIGHT_COLOR_F32, &colors);
        OK(relight_colors_decode(&colors, 0, want));
        for (int v = 0; v < N; v++) {
            float w[3], length = 0;
            for (int k = 0; k < 3; k++) {
                w[k] = request.shade.eye[k] - g.position[v][k];
                length += w[k] * w[k];
            }
            for (int k = 0; k < 3; k++) w[k] /= sqrtf(length);
            toward_eye(&outgoing, g.normal[v], w, multiple + 3 * v, single + 3 * v, n_phase,
                       m < 2 ? NULL : exits + 3 * v, got + 3 * v);
        }
        double difference = rmse(got, want, 3 * N);
        if (!(difference <= (m % 2 ? 0.02 : i < 4 ? 1e-3 : 3e-3)))
            fail_msg("%s, format %d: relative RMSE %.3g", models[m], rows.format, difference);
        relight_colors_finish(&rows);
        relight_colors_finish(&colors);
        relight_factors_finish(&factors);
        relight_geometry_finish(&g);
    }
}

// The parts of a plane are the sums that coefficients expand to (a term's own: M of SINGLE is
// 0), and without an eye they make the colours. RGB9E5 has 0 for negative numbers, which the
// made-up transport has and a bake has not.
static void compare_parts(const struct relight_colors *parts, float *want, uint32_t plane,
                          const float *plain)
{
    const bool positive = parts->format == RELIGHT_COLOR_RGB9E5;
    const double most = positive ? 3e-3 : 1e-3;
    static float part[3 * N], sum[3 * N];
    struct relight_outgoing outgoing;
    OK(relight_colors_outgoing(parts, 0, &outgoing));
    memset(sum, 0, sizeof sum);
    for (uint32_t k = 0; k < parts->n_part; k++) {
        OK(relight_colors_decode(parts, plane * parts->n_part + k, part));
        for (int v = 0; v < 3 * N && k < 2; v++) sum[v] += part[v];
        float largest = 0;
        for (int v = 0; v < 3 * N; v++) {
            float *x = &want[k * 3 * N + v];
            if (positive) *x = fmaxf(0, *x);
            largest = fmaxf(largest, fabsf(*x));
        }
        if (largest > 0) {
            double difference = rmse(part, want + k * 3 * N, 3 * N);
            if (!(difference <= most)) fail_msg("part %u: relative RMSE %.3g", k, difference);
        }
    }
    for (int v = 0; v < 3 * N; v++) sum[v] = fmaxf(0, outgoing.mean * sum[v]);
    assert_true(positive || rmse(sum, plain, 3 * N) <= 2e-3);
}

// n_exit: planes of exit of the bake.
static void check_parts(const char *model, uint32_t n_phase, uint32_t n_exit,
                        enum relight_term term, enum relight_color_format format)
{
    static float want[(5 + RELIGHT_EXIT_PLANES) * 3 * N], plain[3 * N];
    struct relight_light two[2];
    struct relight_factors factors;
    struct relight_colors rows, parts, colors;
    struct relight_colors_request request = {
        .model = model, .n_light = 2, .lights = two, .shade.term = term, .phases = true};
    const uint32_t all = term == RELIGHT_TERM_MULTIPLE ? 1 : 1 + n_phase;
    const bool positive = format == RELIGHT_COLOR_RGB9E5;
    request.exits = n_exit > 0;
    if (term == RELIGHT_TERM_MULTIPLE || positive) n_exit = 0;
    some_lights(two);
    OK(relight_factors_with_exits(client, model, 0, &factors, &error));
    ask(&request, RELIGHT_COLOR_COEFFICIENTS, &rows);
    ask(&request, format, &parts);
    assert_int_equal(parts.n_plane, 2);
    assert_int_equal(parts.n_part, positive && all > 2 ? 2 : all + n_exit);
    assert_int_equal(parts.n_exit, n_exit);
    request.phases = false;
    ask(&request, RELIGHT_COLOR_F32, &colors);
    assert_int_equal(colors.n_part, 0);
    for (uint32_t l = 0; l < 2; l++) {
        OK(relight_coefficients_expand(&factors, &rows, l, n_phase, want, want + 3 * N,
                                       &error));
        OK(relight_coefficients_exits(&factors, &rows, l, want + 3 * N * (1 + n_phase),
                                      &error));
        OK(relight_colors_decode(&colors, l, plain));
        compare_parts(&parts, want, l, plain);
    }
    assert_int_equal(relight_colors_decode(&parts, 2 * parts.n_part, plain),
                     -RELIGHT_E_ARGUMENT);
    relight_colors_finish(&rows);
    relight_colors_finish(&parts);
    relight_colors_finish(&colors);
    relight_factors_finish(&factors);
}

static void colours_in_parts(void **state)
{
    static const enum relight_term terms[] = {RELIGHT_TERM_TOTAL, RELIGHT_TERM_MULTIPLE,
                                              RELIGHT_TERM_SINGLE};
    static const enum relight_color_format formats[] = {RELIGHT_COLOR_F32, RELIGHT_COLOR_F16,
                                                        RELIGHT_COLOR_RGB9E5};
    for (int t = 0; t < 3; t++)
        for (int f = 0; f < 3; f++) {
            check_parts("even.prt", 1, 0, terms[t], formats[f]);
            check_parts("phases.prt", 4, 0, terms[t], formats[f]);
            check_parts("exits.prt", 1, RELIGHT_EXIT_PLANES, terms[t], formats[f]);
            check_parts("both.prt", 4, RELIGHT_EXIT_PLANES, terms[t], formats[f]);
        }
}

// A client that does not ask for planes of exit gets what one of a bake without them gets.
static void planes_of_exit_on_request(void **state)
{
    static const enum relight_color_format formats[] = {RELIGHT_COLOR_COEFFICIENTS,
                                                        RELIGHT_COLOR_F16};
    struct relight_factors factors;
    struct relight_model info;
    struct relight_light two[2];
    some_lights(two);
    OK(relight_factors(client, "exits.prt", 0, &factors, &error));
    assert_int_equal(factors.n_tensor, 2);
    for (int f = 0; f < 2; f++) {
        struct relight_colors plain;
        struct relight_colors_request request = {
            .model = "exits.prt", .n_light = 1, .lights = two, .phases = true};
        ask(&request, formats[f], &plain);
        assert_int_equal(plain.n_layer, f ? 0 : 2);
        assert_int_equal(plain.n_part, f ? 2 : 0);
        assert_int_equal(plain.n_exit, 0);
        relight_colors_finish(&plain);
    }
    OK(relight_info(client, "exits.prt", &info, &error));
    assert_int_equal(info.exit_planes, RELIGHT_EXIT_PLANES);
    relight_model_finish(&info);
    OK(relight_info(client, "even.prt", &info, &error));
    assert_int_equal(info.exit_planes, 0);
    relight_model_finish(&info);
    relight_factors_finish(&factors);
}

// Fewer rows of coefficients, fewer columns of U, or both: the same sums.
static void fewer_rows(void **state)
{
    const struct relight_block all = {.translucent = true, .n_vertex = N};
    static float both[3 * N], rows_alone[3 * N], columns_alone[3 * N];
    struct relight_factors whole, few;
    struct relight_colors all_rows, few_rows;
    struct relight_light two[2];
    some_lights(two);
    struct relight_colors_request request = {
        .model = "even.prt", .n_light = 1, .lights = two, .format = RELIGHT_COLOR_COEFFICIENTS};
    OK(relight_factors(client, "even.prt", 0, &whole, &error));
    OK(relight_factors(client, "even.prt", 8, &few, &error));
    assert_int_equal(few.hash, whole.hash);
    assert_true(few.tensor[0].n_u < whole.tensor[0].n_u / 2);
    OK(relight_colors(client, &request, &all_rows, &error));
    request.most_rank = 8;
    OK(relight_colors(client, &request, &few_rows, &error));
    assert_true(few_rows.plane_bytes < all_rows.plane_bytes / 2);
    OK(relight_coefficients_colors(&few, &few_rows, 0, 1, &all, both, &error));
    OK(relight_coefficients_colors(&whole, &few_rows, 0, 1, &all, rows_alone, &error));
    OK(relight_coefficients_colors(&few, &all_rows, 0, 1, &all, columns_alone, &error));
    assert_memory_equal(both, rows_alone, sizeof both);
    assert_true(rmse(columns_alone, both, 3 * N) < 1e-3);
    relight_colors_finish(&all_rows);
    relight_colors_finish(&few_rows);
    relight_factors_finish(&whole);
    relight_factors_finish(&few);
}

// After 64 lights the rows are stored by column, too: the log says so, and the colours change
// by less than a contraction by columns may leave out.
static void many_lights_make_columns(void **state)
{
    static float before[3 * N], after[3 * N];
    static float sun[CUBE * CUBE * 18];
    struct relight_light own = {.cube_n = CUBE, .cube = sun}, constant = light;
    for (int i = 0; i < CUBE * CUBE * 18; i++) sun[i] = 1 + (float)i * 1e-4f;
    sun[2000] = 300;
    struct relight_colors_request request = {
        .model = "opaque.prt", .n_light = 1, .lights = &own};
    struct relight_colors_request other = {
        .model = "opaque.prt", .n_light = 1, .lights = &constant};
    struct relight_colors colors;
    assert_false(log_says(&d, " columns ms=", 1));
    ask(&request, RELIGHT_COLOR_F32, &colors);
    OK(relight_colors_decode(&colors, 0, before));
    relight_colors_finish(&colors);
    for (int i = 0; i < 80; i++) {
        constant.rotate_deg = i + 1;
        ask(&other, RELIGHT_COLOR_F32, &colors);
        relight_colors_finish(&colors);
    }
    assert_true(log_says(&d, " columns ms=", 20000));
    sun[2000] = 300.003f; // not the answer that is kept
    ask(&request, RELIGHT_COLOR_F32, &colors);
    OK(relight_colors_decode(&colors, 0, after));
    relight_colors_finish(&colors);
    const double off = rmse(after, before, 3 * N);
    print_message("by columns: %.2g off\n", off);
    assert_true(off > 0 && off <= 0.004);
}

// U that is fetched in two or three parts has the numbers of the whole.
static void factors_in_parts(void **state)
{
    struct frames *f = frames_open(&d);
    static const uint32_t part[][2] = {{0, 0}, {0, 8}, {8, 0}, {8, 8}, {16, 0}}; // first, most
    enum { N_PART = sizeof part / sizeof *part };
    uint64_t bytes[N_PART];
    for (unsigned i = 0; i < N_PART; i++) {
        Relight__FactorsRequest m = RELIGHT__FACTORS_REQUEST__INIT;
        struct frames_answer a;
        ProtobufCMessage *message = NULL;
        m.model = "even.prt";
        m.first = part[i][0];
        m.most_rank = part[i][1];
        frames_add(f, RELIGHT_TYPE_FACTORS, 50 + i, &m.base, NULL, 0);
        frames_send(f);
        assert_true(frames_next(f, &a, 20000, &message));
        assert_int_equal(a.type, RELIGHT_TYPE_FACTORS | RELIGHT_TYPE_ANSWER);
        const Relight__FactorsAnswer *answer = (Relight__FactorsAnswer *)message;
        bytes[i] = answer->tensors[0]->u_bytes;
        assert_int_equal(answer->tensors[0]->order_offset > 0, !m.first);
        protobuf_c_message_free_unpacked(message, NULL);
    }
    assert_true(bytes[1] && bytes[3] && bytes[4]);
    assert_int_equal(bytes[0], bytes[1] + bytes[2]);
    assert_int_equal(bytes[2], bytes[3] + bytes[4]);
    frames_close(f);
}

static void expect_refused(struct relight_colors_request request, int code, const char *word)
{
    struct relight_colors colors;
    request.n_light = 1;
    request.lights = &light;
    request.format = RELIGHT_COLOR_COEFFICIENTS;
    int status = relight_colors(client, &request, &colors, &error);
    if (status != -code || !strstr(error.text, word))
        fail_msg("%d %s, expected %d with %s", -status, error.text, code, word);
}

static void refusals(void **state)
{
    struct relight_factors factors;
    struct relight_shade toward = {.has_eye = true}, traced = {.term = RELIGHT_TERM_IRRADIANCE};
    expect_refused((struct relight_colors_request){.model = "sparse.prt"},
                   RELIGHT_E_UNSUPPORTED, "take colours");
    expect_refused((struct relight_colors_request){.model = "opaque.prt"}, RELIGHT_E_MISMATCH,
                   "take colours");
    expect_refused((struct relight_colors_request){.model = "even.prt", .shade = toward},
                   RELIGHT_E_BAD_REQUEST, "shade.eye");
    expect_refused((struct relight_colors_request){.model = "even.prt", .shade = traced},
                   RELIGHT_E_UNSUPPORTED, "irradiance");
    assert_int_equal(relight_factors(client, "sparse.prt", 0, &factors, &error),
                     -RELIGHT_E_UNSUPPORTED);
    assert_int_equal(relight_factors(client, "even.prt", 7, &factors, &error),
                     -RELIGHT_E_OUT_OF_RANGE);
    assert_int_equal(relight_factors(client, "nobody", 0, &factors, &error),
                     -RELIGHT_E_NOT_FOUND);
}

// Coefficients of one bake and factors of another are not multiplied.
static void factors_of_another_bake(void **state)
{
    const struct relight_block all = {.translucent = true, .n_vertex = N};
    static float out[3 * N];
    struct relight_factors factors;
    struct relight_colors rows;
    struct relight_colors_request request = {
        .model = "even.prt", .n_light = 1, .lights = &light};
    OK(relight_factors(client, "phases.prt", 0, &factors, &error));
    ask(&request, RELIGHT_COLOR_COEFFICIENTS, &rows);
    assert_int_equal(relight_coefficients_colors(&factors, &rows, 0, 1, &all, out, &error),
                     -RELIGHT_E_MISMATCH);
    assert_int_equal(relight_colors_decode(&rows, 0, out), -RELIGHT_E_ARGUMENT);
    relight_colors_finish(&rows);
    relight_factors_finish(&factors);
}

// Frames of a view are those of COLORS; views of equal states share them, and a view changes
// its number of rows and its format while it is open.
static void views(void **state)
{
    const struct relight_block all = {.translucent = true, .n_vertex = N};
    static float got[3 * N], want[3 * N];
    struct relight_view *view[2];
    struct relight_view_request request = {.model = "even.prt",
                                           .n_light = 1,
                                           .lights = &light,
                                           .colors = true,
                                           .color_format = RELIGHT_COLOR_COEFFICIENTS};
    struct relight_colors_request still = {.model = "even.prt", .n_light = 1, .lights = &light};
    struct relight_factors factors;
    struct relight_frame_out frame;
    struct relight_colors colors;
    uint64_t hash[2], whole = 0;
    OK(relight_factors(client, "even.prt", 0, &factors, &error));
    ask(&still, RELIGHT_COLOR_F32, &colors);
    OK(relight_colors_decode(&colors, 0, want));
    relight_colors_finish(&colors);
    double before = metric(client, "relightd_relights_total");
    for (int i = 0; i < 2; i++) {
        OK(relight_view_open(client, &request, &view[i], &error));
        OK(relight_view_next(view[i], 20, &frame, &error));
        OK(relight_coefficients_colors(&factors, &frame.colors, 0, 1, &all, got, &error));
        assert_true(rmse(got, want, 3 * N) < 1e-3);
        hash[i] = frame.hash;
        whole = frame.colors.plane_bytes;
        relight_frame_out_finish(&frame);
    }
    assert_int_equal(hash[0], hash[1]);
    assert_true(metric(client, "relightd_relights_total") <= before + 1);
    const char *rank = "options.most_rank", *format = "options.color_format";
    request.most_rank = 4;
    OK(relight_view_change(view[0], &request, 1, &rank, NULL, &error));
    OK(relight_view_next(view[0], 20, &frame, &error));
    assert_int_equal(frame.colors.most_rank, 4);
    assert_true(frame.colors.plane_bytes < whole / 3);
    relight_frame_out_finish(&frame);
    request.color_format = RELIGHT_COLOR_RGB9E5;
    OK(relight_view_change(view[0], &request, 1, &format, NULL, &error));
    OK(relight_view_next(view[0], 20, &frame, &error));
    assert_int_equal(frame.colors.format, RELIGHT_COLOR_RGB9E5);
    relight_frame_out_finish(&frame);
    for (int i = 0; i < 2; i++) OK(relight_view_close(view[i], NULL, NULL, &error));
    relight_factors_finish(&factors);
}

static void run(const char *fmt, const char *file)
{
    char command[700], arguments[400];
    snprintf(arguments, sizeof arguments, fmt, d.folder, file);
    snprintf(command, sizeof command, "RELIGHT_TERMINAL=kitty %s/relight -s %s %s",
             PRT_BINARY_DIR, d.address, arguments);
    assert_int_equal(system(command), 0);
}

static void read_rows(const char *name, float out[3 * N])
{
    char path[160];
    snprintf(path, sizeof path, "%s/%s", d.folder, name);
    char *text = read_text(path), *line = strchr(text, '\n');
    for (int v = 0; v < N; v++, line = strchr(line + 1, '\n'))
        assert_int_equal(
            sscanf(line + 1, "%*d,%f,%f,%f", out + 3 * v, out + 3 * v + 1, out + 3 * v + 2), 3);
    free(text);
}

// relight writes the same CSV from coefficients, and draws a picture in the terminal.
static void command_line(void **state)
{
    static float got[3 * N], want[3 * N];
    char path[160];
    run("colors even.prt --env constant -o %s/%s >/dev/null", "colors.csv");
    run("colors even.prt --env constant --format coefficients -o %s/%s >/dev/null", "rows.csv");
    read_rows("colors.csv", want);
    read_rows("rows.csv", got);
    assert_true(rmse(got, want, 3 * N) < 2e-3);
    run("image even.prt --env constant --size 16x12 -o - >%s/%s", "terminal");
    snprintf(path, sizeof path, "%s/terminal", d.folder);
    char *text = read_text(path);
    assert_true(!strncmp(text, "\x1b_Ga=T,f=24,s=16,v=12,m=0;", 26));
    assert_int_equal(strlen(text), 26 + 16 * 12 * 4 + 3);
    free(text);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(equal_colors),
        cmocka_unit_test(equal_colors_toward_an_eye),
        cmocka_unit_test(colours_in_parts),
        cmocka_unit_test(planes_of_exit_on_request),
        cmocka_unit_test(fewer_rows),
        cmocka_unit_test(many_lights_make_columns),
        cmocka_unit_test(factors_in_parts),
        cmocka_unit_test(refusals),
        cmocka_unit_test(factors_of_another_bake),
        cmocka_unit_test(views),
        cmocka_unit_test(command_line),
    };
    return cmocka_run_group_tests(tests, group_begin, group_end);
}
