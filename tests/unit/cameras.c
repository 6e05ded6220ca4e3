// SPDX-License-Identifier: MIT
// Cameras: orbits about the framed centre, the cameras of a glTF file, files whose +z is up,
// and names by their unique beginning.
#include "prt/raster.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

#include "../data.h"

static char lines[4096];

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    snprintf(lines, sizeof lines, "%s", line);
}

static struct prt_context context(void)
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep_line;
    lines[0] = 0;
    return ctx;
}

// A box of 2 x 4 x 6 units about 1,2,3, as eight vertices and two of its triangles.
static struct prt_mesh *box(void)
{
    float position[8][3];
    const uint32_t triangle[2][3] = {{0, 1, 2}, {1, 3, 2}};
    struct prt_mesh *m;
    struct prt_context ctx = context();
    for (int i = 0; i < 8; i++)
        for (int k = 0; k < 3; k++)
            position[i][k] = (float)((k + 1) + (i >> k & 1 ? k + 1 : -(k + 1)));
    assert_int_equal(prt_mesh_create(&ctx, 8, (const float(*)[3])position, NULL, 2,
                                     (const uint32_t(*)[3])triangle, &m),
                     PRT_OK);
    return m;
}

// Largest |x| and |y| of the vertices on the screen, 1 being its edge at the camera's own
// angle.
static void extent(const struct prt_mesh *m, const struct prt_camera *c, double out[2])
{
    double f[3], r[3], u[3], length = 0, tan_y = tan((double)c->fovy_deg * M_PI / 360);
    for (int k = 0; k < 3; k++) f[k] = (double)c->target[k] - c->eye[k], length += f[k] * f[k];
    for (int k = 0; k < 3; k++) f[k] /= sqrt(length);
    r[0] = f[1] * c->up[2] - f[2] * c->up[1];
    r[1] = f[2] * c->up[0] - f[0] * c->up[2];
    r[2] = f[0] * c->up[1] - f[1] * c->up[0];
    length = sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]);
    for (int k = 0; k < 3; k++) r[k] /= length;
    u[0] = r[1] * f[2] - r[2] * f[1];
    u[1] = r[2] * f[0] - r[0] * f[2];
    u[2] = r[0] * f[1] - r[1] * f[0];
    out[0] = out[1] = 0;
    for (uint32_t v = 0; v < m->n_vertex; v++) {
        double x = 0, y = 0, z = 0;
        for (int k = 0; k < 3; k++) {
            double d = (double)m->position[v][k] - c->eye[k];
            x += d * r[k], y += d * u[k], z += d * f[k];
        }
        assert_true(z > 0);
        out[0] = fmax(out[0], fabs(x / z) / tan_y);
        out[1] = fmax(out[1], fabs(y / z) / tan_y);
    }
}

static void orbits_look_at_the_centre(void **state)
{
    struct prt_mesh *m = box();
    struct prt_camera c;
    static const struct {
        struct prt_orbit orbit;
        float back[3];
    } row[] = {{{0, 0, 1}, {0, 0, 1}},
               {{90, 0, 1}, {1, 0, 0}},
               {{180, 0, 1}, {0, 0, -1}},
               {{-90, 0, 1}, {-1, 0, 0}},
               {{0, 90, 1}, {0, 1, 0}},
               {{0, -90, 1}, {0, -1, 0}},
               {{0, 30, 1}, {0, 0.5f, 0.8660254f}}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        double seen[2], length = 0, zoomed[2];
        prt_camera_frame_from(m, 1, &row[i].orbit, &c);
        for (int k = 0; k < 3; k++) {
            assert_float_equal(c.target[k], k + 1, 1e-5);
            length += ((double)c.eye[k] - c.target[k]) * row[i].back[k];
        }
        for (int k = 0; k < 3; k++)
            assert_float_equal((double)c.eye[k] - c.target[k], length * (double)row[i].back[k],
                               1e-4);
        extent(m, &c, seen);
        assert_float_equal(fmax(seen[0], seen[1]), 0.9, 1e-3); // all is seen, with a margin
        struct prt_orbit near = row[i].orbit;
        near.zoom = 3;
        prt_camera_frame_from(m, 1, &near, &c);
        extent(m, &c, zoomed);
        for (int k = 0; k < 2; k++) assert_float_equal(zoomed[k], 3 * seen[k], 1e-3);
    }
    struct prt_camera framed;
    const struct prt_orbit as_framed = {0, 15, 1};
    prt_camera_frame(m, 1.5f, &framed);
    prt_camera_frame_from(m, 1.5f, &as_framed, &c);
    assert_memory_equal(framed.eye, c.eye, sizeof c.eye);
    prt_mesh_destroy(m);
}

static void texts_of_orbits(void **state)
{
    static const char *const wrong[] = {"",       "30",       "30,",    "30,15,", "30,15,0",
                                        "0,91",   "0,0,1000", "nan,0",  "a,b",    "1,2,3,4",
                                        "1,2,3,", "1e9,0",    "30,15 ", "30;15",  "0,0,inf"};
    struct prt_context ctx = context();
    struct prt_orbit o;
    assert_int_equal(prt_orbit_parse(&ctx, "-30.5,15,2", &o), PRT_OK);
    assert_true(o.azimuth_deg == -30.5f && o.elevation_deg == 15 && o.zoom == 2);
    assert_int_equal(prt_orbit_parse(&ctx, "400,-90", &o), PRT_OK);
    assert_true(o.azimuth_deg == 400 && o.zoom == 1);
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++)
        if (prt_orbit_parse(&ctx, wrong[i], &o) != PRT_ARG) fail_msg("accepted '%s'", wrong[i]);
}

// One triangle of 2 units, and cameras in the nodes.
#define GLTF                                                                                                            \
    "{\"asset\":{\"version\":\"2.0\"},\"scenes\":[{\"nodes\":[0,1,2,3,4,5,6]}],\"nodes\":["                             \
    "{\"mesh\":0},"                                                                                                     \
    "{\"name\":\"Front\",\"camera\":0,\"translation\":[0,0,9]},"                                                        \
    "{\"name\":\"Front\",\"camera\":0,\"translation\":[9,0,0],"                                                         \
    "\"rotation\":[0,0.70710678,0,0.70710678]},"                                                                        \
    "{\"camera\":1,\"translation\":[0,7,0],\"rotation\":[-0.70710678,0,0,0.70710678]},"                                 \
    "{\"name\":\"flat\",\"camera\":2},{\"name\":\"gone\",\"camera\":77},{\"name\":\"wide\",\"camera\":3}],"             \
    "\"cameras\":[{\"name\":\"lens\",\"type\":\"perspective\",\"perspective\":{\"yfov\":0.5,\"znear\":0.1}},"           \
    "{\"name\":\"Top: of,it\",\"type\":\"perspective\",\"perspective\":{\"yfov\":1,\"znear\":1}},"                      \
    "{\"type\":\"orthographic\",\"orthographic\":{\"xmag\":1,\"ymag\":1,\"zfar\":2,\"znear\":1}},"                      \
    "{\"type\":\"perspective\",\"perspective\":{\"yfov\":3,\"znear\":1}}],"                                             \
    "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}],\"accessors\":["                                 \
    "{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"}],\"bufferViews\":["                        \
    "{\"buffer\":0,\"byteLength\":36}],\"buffers\":[{\"byteLength\":36,\"uri\":\"data:application/octet-stream;base64," \
    "AACAvwAAgL8AAAAAAACAPwAAgL8AAAAAAAAAAAAAgD8AAAAA\"}]}"

static struct prt_mesh *load(const char *text, bool up_z)
{
    struct prt_context ctx = context();
    const struct prt_mesh_options options = {.up_z = up_z};
    struct prt_mesh *m = NULL;
    if (prt_mesh_load_memory(&ctx, "inline", text, strlen(text), NULL, &options, &m))
        fail_msg("%s", lines);
    return m;
}

static void expect_vector(const float got[3], float x, float y, float z)
{
    assert_float_equal(got[0], x, 1e-4);
    assert_float_equal(got[1], y, 1e-4);
    assert_float_equal(got[2], z, 1e-4);
}

static void the_files_own_cameras(void **state)
{
    struct prt_mesh *m = load(GLTF, false);
    struct prt_context ctx = context();
    struct prt_camera c;
    assert_int_equal(m->n_camera, 3); // without the orthographic and the widest
    assert_string_equal(m->camera[0].name, "Front");
    assert_string_equal(m->camera[1].name, "Front 2");
    assert_string_equal(m->camera[2].name, "Top  of it"); // : and , separate coordinates
    assert_int_equal(prt_camera_named(&ctx, m, "top", &c), PRT_OK);
    expect_vector(c.eye, 0, 7, 0);
    expect_vector(c.target, 0, 0, 0);
    expect_vector(c.up, 0, 0, -1);
    assert_float_equal(c.fovy_deg, 180 / M_PI, 1e-4);
    assert_int_equal(prt_camera_named(&ctx, m, "front", &c), PRT_OK);
    expect_vector(c.eye, 0, 0, 9);
    assert_int_equal(prt_camera_named(&ctx, m, "Front 2", &c), PRT_OK);
    expect_vector(c.eye, 9, 0, 0);
    expect_vector(c.target, 0, 0, 0);
    assert_int_equal(prt_camera_named(&ctx, m, "fro", &c), PRT_ARG);
    assert_non_null(strstr(lines, "several names: Front, Front 2"));
    assert_int_equal(prt_camera_named(&ctx, m, "frunt", &c), PRT_ARG);
    assert_non_null(strstr(lines, "did you mean Front?"));
    prt_mesh_destroy(m);
}

// A file's camera has its target where its axis is nearest to the model's middle; behind the
// camera there is none, and the model's size is taken.
static void targets_are_as_deep_as_the_model(void **state)
{
    static const struct {
        const char *moved;
        float front, second; // z of the first camera's target, x of the second one's
    } row[] = {{"{\"mesh\":0,\"translation\":[0,0,-5]}", -5, 0},
               {"{\"mesh\":0,\"translation\":[4,0,2]}", 2, 4},
               {"{\"mesh\":0,\"translation\":[0,0,8.995]}", 9 - 2.8284271f, 0}, // all but at it
               {"{\"mesh\":0,\"translation\":[0,0,20]}", 9 - 2.8284271f, 0}};
    static const char gltf[] = GLTF, plain[] = "{\"mesh\":0}";
    const char *const at = strstr(gltf, plain);
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        char text[4096];
        snprintf(text, sizeof text, "%.*s%s%s", (int)(at - gltf), gltf, row[i].moved,
                 at + strlen(plain));
        struct prt_mesh *m = load(text, false);
        expect_vector(m->camera[0].target, 0, 0, row[i].front);
        expect_vector(m->camera[1].target, row[i].second, 0, 0);
        prt_mesh_destroy(m);
    }
}

// A node's scale changes no camera's direction; letters beyond ASCII stay in its name.
static void scaled_nodes_and_their_names(void **state)
{
    static const char gltf[] = GLTF, plain[] = "\"name\":\"Front\",\"camera\":0,";
    const char *const at = strstr(gltf, plain);
    char text[4096];
    snprintf(text, sizeof text, "%.*s%s%s", (int)(at - gltf), gltf,
             "\"name\":\"T\u00fcr\\u007f, \u4e2d\",\"camera\":0,\"scale\":[3,3,3],",
             at + strlen(plain));
    struct prt_mesh *m = load(text, false);
    assert_string_equal(m->camera[0].name, "T\u00fcr   \u4e2d");
    expect_vector(m->camera[0].eye, 0, 0, 9);
    expect_vector(m->camera[0].target, 0, 0, 0);
    expect_vector(m->camera[0].up, 0, 1, 0);
    prt_mesh_destroy(m);
}

static void a_file_with_z_up_is_turned(void **state)
{
    struct prt_mesh *m = load(GLTF, false), *z = load(GLTF, true);
    for (uint32_t v = 0; v < m->n_vertex; v++) {
        const float *p = m->position[v], *n = m->normal[v];
        expect_vector(z->position[v], p[0], p[2], -p[1]);
        expect_vector(z->normal[v], n[0], n[2], -n[1]);
    }
    expect_vector(z->camera[0].eye, 0, 9, 0);
    expect_vector(z->camera[0].up, 0, 0, -1);
    prt_mesh_destroy(m);
    prt_mesh_destroy(z);
}

static void names(void **state)
{
    static const char *const list[] = {"bunny.glb", "bunny_low.glb", "Dragon.obj", "teapot"};
    char say[200];
    assert_int_equal(prt_name_choose("bunny.glb", list, 4, say, sizeof say), 0);
    assert_int_equal(prt_name_choose("bunny_", list, 4, say, sizeof say), 1);
    assert_int_equal(prt_name_choose("dra", list, 4, say, sizeof say), 2);
    assert_int_equal(prt_name_choose("TEAPOT", list, 4, say, sizeof say), 3);
    assert_int_equal(prt_name_choose("bun", list, 4, say, sizeof say), -1);
    assert_string_equal(say, "it begins several names: bunny.glb, bunny_low.glb");
    assert_int_equal(prt_name_choose("draogn", list, 4, say, sizeof say), -1);
    assert_string_equal(say, "did you mean Dragon.obj?");
    assert_int_equal(prt_name_choose("xyzzy", list, 4, say, sizeof say), -1);
    assert_string_equal(say, "");
    assert_int_equal(prt_name_choose("", list, 4, say, sizeof say), -1);
    char tiny[4]; // a short buffer holds a beginning
    assert_int_equal(prt_name_choose("b", list, 4, tiny, sizeof tiny), -1);
    assert_int_equal(strlen(tiny), 3);
}

// Of equal names the one whose case is right; every longer list ends after eight names.
static void names_of_either_case_and_many(void **state)
{
    static const char *const twice[] = {"Front", "front", "frontal"};
    static const char *const many[] = {"a0", "a1", "a2", "a3", "a4",
                                       "a5", "a6", "a7", "a8", "a9"};
    char say[200];
    assert_int_equal(prt_name_choose("front", twice, 3, say, sizeof say), 1);
    assert_int_equal(prt_name_choose("FRONT", twice, 3, say, sizeof say), 0);
    assert_int_equal(prt_name_choose("A", many, 10, say, sizeof say), -1);
    assert_string_equal(say, "it begins several names: a0, a1, a2, a3, a4, a5, a6, a7");
    assert_int_equal(prt_name_choose("", twice, 3, say, sizeof say), -1);
    assert_string_equal(say, ""); // a beginning of all, and of none that could be meant
}

// Levenshtein's distance of a's first n and b's first m characters, by its definition.
static unsigned distance(const char *a, size_t n, const char *b, size_t m)
{
    if (!n || !m) return (unsigned)(n + m);
    const unsigned change = distance(a, n - 1, b, m - 1) + (a[n - 1] != b[m - 1]);
    const unsigned less = distance(a, n - 1, b, m) + 1, more = distance(a, n, b, m - 1) + 1;
    const unsigned best = change < less ? change : less;
    return best < more ? best : more;
}

// Contract of prt_name_nearest: the first of the nearest names, with or without its ending; a
// third of the text's letters and one more may be wrong.
static void the_nearest_name(void **state)
{
    unsigned seed = 1, none = 0;
    for (int turn = 0; turn < 4000; turn++) {
        char word[4][7] = {{0}};
        for (int i = 0; i < 4; i++) {
            const unsigned n = (seed = seed * 1103515245 + 12345) >> 16 & 3;
            for (unsigned k = 0; k < n + 3; k++)
                word[i][k] = "abc.d"[((seed = seed * 1103515245 + 12345) >> 16) % (i ? 5 : 3)];
        }
        const char *name[3] = {word[1], word[2], word[3]};
        const size_t n = strlen(word[0]);
        unsigned most = (unsigned)n / 3 + 1;
        int want = -1;
        for (int i = 0; i < 3; i++) {
            const char *dot = strrchr(name[i], '.');
            unsigned d = distance(word[0], n, name[i], strlen(name[i]));
            const unsigned stem =
                dot ? distance(word[0], n, name[i], (size_t)(dot - name[i])) : d;
            if (stem < d) d = stem;
            if (d < most + (want < 0)) want = i, most = d;
        }
        none += want < 0;
        assert_int_equal(prt_name_nearest(word[0], name, 3), want);
    }
    assert_in_range(none, 40, 3900);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(orbits_look_at_the_centre),
        cmocka_unit_test(texts_of_orbits),
        cmocka_unit_test(the_files_own_cameras),
        cmocka_unit_test(targets_are_as_deep_as_the_model),
        cmocka_unit_test(scaled_nodes_and_their_names),
        cmocka_unit_test(a_file_with_z_up_is_turned),
        cmocka_unit_test(names),
        cmocka_unit_test(names_of_either_case_and_many),
        cmocka_unit_test(the_nearest_name),
    };
    return run_test_group(tests, NULL, NULL);
}
