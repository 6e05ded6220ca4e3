// SPDX-License-Identifier: MIT
// Materials of other programs: what they become, the albedo of a half-space of them, what is
// lost is said, and hostile files (METHODS §10).
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "bodies.h"
#include "expect.h"
#include "prt/light.h"
#include "prt/medium.h"
#include "prt/reference.h"

static struct prt_context context;
static char said[4096];

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    size_t n = strlen(said);
    snprintf(said + n, sizeof said - n, "%s\n", line);
}

static int set_up(void **state)
{
    prt_context_init(&context);
    context.log = keep_line;
    return 0;
}

// A document of one shader with these inputs, each "name=value".
static const char *mtlx(const char *shader, const char *const input[])
{
    static char text[4096];
    size_t n =
        (size_t)snprintf(text, sizeof text,
                         "<materialx version=\"1.39\" colorspace=\"lin_rec709\"><%s name=\"s\" "
                         "type=\"surfaceshader\">",
                         shader);
    for (; *input; input++) {
        const char *equals = strchr(*input, '=');
        n += (size_t)snprintf(text + n, sizeof text - n,
                              "<input name=\"%.*s\" type=\"color3\" value=\"%s\"/>",
                              (int)(equals - *input), *input, equals + 1);
    }
    snprintf(text + n, sizeof text - n,
             "</%s><surfacematerial name=\"m\" type=\"material\"><input name=\"surfaceshader\" "
             "type=\"surfaceshader\" nodename=\"s\"/></surfacematerial></materialx>",
             shader);
    return text;
}

// The first material of a text; asserts that it has a medium when asked to.
static struct prt_import import(const char *text, bool medium)
{
    struct prt_import *item, first;
    unsigned n;
    said[0] = 0;
    if (prt_material_import(&context, "test", text, strlen(text), 0, &item, &n))
        fail_msg("%s", said);
    first = item[0];
    prt_free(item);
    assert_int_equal(first.has_medium, medium);
    return first;
}

// B/E at the middle of a large square under constant light, by the reference engine.
static void furnace(const struct prt_material *m, double albedo[3])
{
    enum { N = 12 };
    const uint32_t vertex = (N / 2) * (N + 1) + N / 2;
    struct model body;
    struct prt_cube light;
    float multiple[1][3], irradiance[1][3];
    model_init(&body, (N + 1) * (N + 1), 2 * N * N);
    add_floor(&body, 40, 0, N);
    struct prt_mesh *mesh = body_mesh(&context, &body, false);
    assert_int_equal(prt_cube_init(&light, 16), PRT_OK);
    for (int i = 0; i < 6 * 16 * 16 * 3; i++) light.texel[i] = 1;
    const struct prt_media media = prt_media_one(m);
    struct prt_reference_options o = {.term = PRT_REFERENCE_MULTIPLE,
                                      .n_sample = 150000,
                                      .n_ray = 256,
                                      .vertex = &vertex,
                                      .n_vertex = 1};
    assert_int_equal(prt_reference_colors(&context, mesh, &media, &light, &o, multiple),
                     PRT_OK);
    o.term = PRT_REFERENCE_IRRADIANCE;
    assert_int_equal(prt_reference_colors(&context, mesh, &media, &light, &o, irradiance),
                     PRT_OK);
    for (int c = 0; c < 3; c++)
        albedo[c] = M_PI * (double)multiple[0][c] / (double)irradiance[0][c];
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

static void returns(const char *text, const double albedo[3], const double free_path[3])
{
    struct prt_import i = import(text, true);
    double found[3];
    furnace(&i.material, found);
    for (int c = 0; c < 3; c++) {
        double sigma_t = (double)i.material.sigma_a[c] +
                         (double)i.material.sigma_s_prime[c] / (1 - (double)i.material.g[c]);
        expect_near("albedo that a half-space returns", found[c], albedo[c], 0.01 * albedo[c]);
        expect_near("mean free path, relative", 1 / sigma_t / free_path[c], 1, 1e-4);
    }
}

// Law: under even light a half-space of an imported medium returns the albedo of its shader,
// and its mean free path is the shader's, in the format's unit of length.
static void half_spaces_return_their_albedo(void **state)
{
    static const double a[3] = {0.6, 0.4, 0.2}, path[3] = {1, 0.6, 0.4};
    returns(
        mtlx("open_pbr_surface",
             (const char *const[]){"subsurface_weight=1", "subsurface_color=.6,.4,.2",
                                   "subsurface_radius=.1", "subsurface_radius_scale=1, .6, .4",
                                   "subsurface_scatter_anisotropy=.5", NULL}),
        a, path);
    returns(mtlx("standard_surface",
                 (const char *const[]){"subsurface=1", "subsurface_color=.6,.4,.2",
                                       "subsurface_radius=.5,.3,.2", "subsurface_scale=.2",
                                       "specular_IOR=1.3", NULL}),
            a, path);
    returns("{\"Base Color\":[0.6,0.4,0.2,1],\"Subsurface Weight\":1,\"Subsurface Radius\":"
            "[0.5,0.3,0.2],\"Subsurface Scale\":0.002,\"IOR\":1.4}",
            a, path);
    returns("MakeNamedMaterial \"m\" \"string type\" \"subsurface\" \"rgb reflectance\" "
            "[.6 .4 .2] \"rgb mfp\" [1 .6 .4]",
            a, path);
    // a mixture with an opaque base: its colour, and the share of the mean free path
    returns(mtlx("open_pbr_surface",
                 (const char *const[]){"subsurface_weight=.5", "subsurface_color=.8,.4,.4",
                                       "base_color=.4,.4,0", "subsurface_radius=.2",
                                       "subsurface_radius_scale=1,.6,.4", NULL}),
            a, path);
}

// OpenPBR's interior: sigma_t = -ln(color)/depth, sigma_s = scatter/depth; where that leaves a
// negative sigma_a, all channels are lifted alike.
static void transmissive_interiors(void **state)
{
    struct prt_import honey = import(
        mtlx("open_pbr_surface",
             (const char *const[]){"specular_ior=1.504", "transmission_weight=1",
                                   "transmission_color=0.83, 0.4, 0.04", "transmission_depth=2",
                                   "transmission_scatter=0.9,0.9,0.9", NULL}),
        true);
    const double t[3] = {0.83, 0.4, 0.04};
    for (int c = 0; c < 3; c++) { // 2 is 20 mm
        expect_near("sigma_s of honey [1/mm]", (double)honey.material.sigma_s_prime[c],
                    0.9 / 20, 1e-6);
        expect_near("sigma_a of honey [1/mm]", (double)honey.material.sigma_a[c],
                    (log(t[0]) - log(t[c])) / 20, 1e-6);
    }
    expect_near("eta of honey", (double)honey.material.eta, 1.504, 1e-5);
    // a specular weight scales the reflection at normal incidence
    struct prt_import dull =
        import(mtlx("open_pbr_surface",
                    (const char *const[]){"subsurface_weight=1", "specular_weight=.25", NULL}),
               true);
    double root = ((double)dull.material.eta - 1) / ((double)dull.material.eta + 1);
    expect_near("F_0 of a quarter of eta 1.5", root * root, 0.04 / 4, 1e-6);
    import(mtlx("open_pbr_surface", (const char *const[]){"transmission_weight=1", NULL}),
           false);
    // a depth alone colours the light on its way and scatters none of it
    static const char *const clear[] = {"transmission_weight=1", "transmission=1",
                                        "transmission_color=.8,.4,.2", "transmission_depth=2",
                                        NULL};
    import(mtlx("open_pbr_surface", clear), false);
    import(mtlx("standard_surface", clear), false);
    import(mtlx("open_pbr_surface",
                (const char *const[]){"base_metalness=1", "subsurface_weight=1", NULL}),
           false);
}

// Law: in a unit that is n times the format's own, all lengths are n times as long:
// coefficients are divided by n, and nothing else changes. Lengths of MaterialX that name a
// unit keep it.
static void units_scale_lengths(void **state)
{
    static const char principled[] =
        "{\"Base Color\":[0.6,0.4,0.2,1],\"Subsurface Weight\":1,\"Subsurface Radius\":"
        "[0.5,0.3,0.2],\"Subsurface Scale\":0.002}";
    static const char medium[] =
        "MakeNamedMedium \"m\" \"string type\" \"homogeneous\" \"rgb sigma_a\" [.1 .2 .3] "
        "\"rgb sigma_s\" [1 2 3]";
    static const char surface[] = "Material \"subsurface\" \"rgb reflectance\" [.6 .4 .2] "
                                  "\"rgb mfp\" [1 .6 .4]";
    char below[4096], through[4096], standard[4096];
    snprintf(below, sizeof below, "%s",
             mtlx("open_pbr_surface",
                  (const char *const[]){"subsurface_weight=1", "subsurface_radius=.1", NULL}));
    snprintf(through, sizeof through, "%s",
             mtlx("open_pbr_surface",
                  (const char *const[]){"transmission_weight=1", "transmission_color=.8,.4,.2",
                                        "transmission_depth=2", "transmission_scatter=.9,.9,.9",
                                        NULL}));
    snprintf(standard, sizeof standard, "%s",
             mtlx("standard_surface",
                  (const char *const[]){"subsurface=1", "subsurface_scale=.2", NULL}));
    const struct {
        const char *text;
        double own; // [mm]
    } row[] = {{principled, 1000}, {medium, 1},   {surface, 1},
               {below, 10},        {through, 10}, {standard, 10}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        const struct prt_import plain = import(row[i].text, true);
        for (double times = 0.5; times < 3; times *= 4) {
            struct prt_import *item;
            unsigned n;
            assert_int_equal(prt_material_import(&context, "test", row[i].text,
                                                 strlen(row[i].text), times * row[i].own, &item,
                                                 &n),
                             PRT_OK);
            assert_true(item->has_medium && item->material.eta == plain.material.eta);
            for (int c = 0; c < 3; c++) {
                expect_near("sigma_s' in another unit, relative",
                            times * (double)item->material.sigma_s_prime[c] /
                                (double)plain.material.sigma_s_prime[c],
                            1, 1e-5);
                expect_near("sigma_a in another unit [1/mm]",
                            times * (double)item->material.sigma_a[c],
                            (double)plain.material.sigma_a[c], 1e-5);
                assert_true(item->material.g[c] == plain.material.g[c]);
            }
            prt_free(item);
        }
    }
}

// A medium of pbrt: its scale multiplies both coefficients, and sigma_s is not the reduced one.
static void scale_of_a_pbrt_medium(void **state)
{
    static const char text[] =
        "MakeNamedMedium \"m\" \"string type\" \"homogeneous\" \"float scale\" 10 "
        "\"rgb sigma_a\" [.01 .02 .03] \"rgb sigma_s\" [.1 .2 .3] \"float g\" .5";
    const struct prt_import item = import(text, true);
    for (int c = 0; c < 3; c++) {
        expect_near("sigma_s' [1/mm]", (double)item.material.sigma_s_prime[c], 0.5 * (c + 1),
                    1e-6);
        expect_near("sigma_a [1/mm]", (double)item.material.sigma_a[c], 0.1 * (c + 1), 1e-6);
        expect_near("g", (double)item.material.g[c], 0.5, 1e-6);
    }
}

// A surface of pbrt: its scale multiplies the mean free path, and leaves the albedo as it is;
// pbrt-v3's kdsubsurface calls the albedo Kd.
static void scale_of_a_pbrt_surface(void **state)
{
    static const char *const scaled[] = {
        "Material \"subsurface\" \"rgb reflectance\" [.6 .4 .2] \"rgb mfp\" [1 .6 .4] "
        "\"float scale\" 10",
        "Material \"kdsubsurface\" \"color Kd\" [.6 .4 .2] \"color mfp\" [10 6 4]"};
    static const char text[] =
        "Material \"subsurface\" \"rgb reflectance\" [.6 .4 .2] \"rgb mfp\" [1 .6 .4]";
    const struct prt_import plain = import(text, true);
    for (int i = 0; i < 2; i++) {
        const struct prt_import item = import(scaled[i], true);
        for (int c = 0; c < 3; c++) {
            expect_near("sigma_s' at ten times the mean free path, relative",
                        10 * (double)item.material.sigma_s_prime[c] /
                            (double)plain.material.sigma_s_prime[c],
                        1, 1e-5);
            expect_near("sigma_a at ten times the mean free path, relative",
                        10 * (double)item.material.sigma_a[c] /
                            (double)plain.material.sigma_a[c],
                        1, 1e-5);
        }
    }
}

// What is lost is said, by name, of the material that is chosen.
static void losses_are_said(void **state)
{
    static const char *const path = PRT_SHARED_DATA "/materials/mtlx/";
    char file[512];
    struct prt_material m;
    want_data(path);
    snprintf(file, sizeof file, "%sopen_pbr_pearl.mtlx", path);
    said[0] = 0;
    assert_int_equal(prt_material_load(&context, file, &m), PRT_OK);
    assert_non_null(strstr(said, "coat, thin film"));
    snprintf(file, sizeof file, "%sstandard_surface_marble_solid.mtlx", path);
    said[0] = 0;
    assert_int_equal(prt_material_load(&context, file, &m), PRT_OK);
    assert_non_null(strstr(said, "subsurface_color (position \"obj_pos\")"));
    assert_non_null(strstr(said, "60 % of it is opaque"));
    snprintf(file, sizeof file, "%sstandard_surface_chess_set.mtlx", path);
    assert_true(prt_material_load(&context, file, &m) < 0);
    assert_non_null(strstr(said, "choose one as FILE#NAME; its media: M_King_B"));
    strcat(file, "#m_king_w");
    said[0] = 0;
    assert_int_equal(prt_material_load(&context, file, &m), PRT_OK);
    assert_string_equal(m.name, "M_King_W");
    assert_non_null(strstr(said, "subsurface_color (image \"mtlximage7\")"));
    assert_null(strstr(said, "M_Queen"));
    snprintf(file, sizeof file, "%sopen_pbr_glass.mtlx", path);
    said[0] = 0;
    assert_true(prt_material_load(&context, file, &m) < 0);
    assert_non_null(strstr(said, "it is clear"));
}

// A medium of a kind that is not read is named in the reason; presets go by their names.
static void unknown_kinds_are_said(void **state)
{
    struct prt_material m;
    struct prt_import cloud =
        import("MakeNamedMedium \"c\" \"string type\" \"cloud\" \"float density\" [1]", false);
    assert_non_null(strstr(cloud.why_not, "cloud"));
    assert_int_equal(prt_material_load(&context, "lowfat milk", &m), PRT_OK);
    expect_near("g of a named medium", (double)m.g[0], 0.932, 1e-6);
}

// Contract of prt_material_import: of pbrt's parameters of three channels one number is taken
// for all of them and three are; another count is a spectrum, by which the reason names it.
static void counts_of_numbers(void **state)
{
    static const char *const word[] = {"sigma_a", "sigma_s", "reflectance", "Kd",       "mfp",
                                       "g",       "eta",     "scale",       "roughness"};
    static const char *const list[] = {".5", ".5 .5", ".5 .5 .5", ".5 .5 .5 .5",
                                       ".5 .5 .5 .5 .5 .5"};
    struct prt_import made[5];
    char text[200];
    for (int w = 0; w < 9; w++)
        for (int n = 0; n < 5; n++) {
            const bool taken = n == 0 || (n == 2 && w < 5);
            snprintf(text, sizeof text,
                     "MakeNamedMedium \"m\" \"string type\" \"homogeneous\" \"rgb sigma_s\" "
                     "[1 2 3] \"rgb mfp\" [1 2 3] \"spectrum %s\" [%s]",
                     word[w], list[n]);
            made[n] = import(text, taken);
            if (n == 2 && taken)
                assert_memory_equal(&made[0].material, &made[2].material,
                                    sizeof made[0].material);
            if (taken) continue;
            assert_non_null(strstr(made[n].why_not, word[w]));
            assert_non_null(strstr(made[n].why_not, "spectrum"));
        }
}

// Loads the text as a file; what was said is in `said`.
static void load_text(const char *text, const char *ending)
{
    char path[] = "/tmp/imports-test-XXXXXX.json";
    struct prt_material m;
    memcpy(path + strlen(path) - 5, ending, 5);
    int fd = mkstemps(path, 5);
    assert_true(fd >= 0);
    assert_int_equal(write(fd, text, strlen(text)), (ssize_t)strlen(text));
    close(fd);
    said[0] = 0;
    (void)prt_material_load(&context, path, &m);
    unlink(path);
}

// Each input that a medium has no place for is named where it is not 0, and no other is.
static void every_loss_is_named(void **state)
{
    static const struct {
        const char *shader, *input, *neutral, *name;
    } loss[] = {{"standard_surface", "coat", "0", "coat"},
                {"standard_surface", "sheen", "0", "sheen"},
                {"standard_surface", "thin_film_thickness", "0", "thin film"},
                {"standard_surface", "emission", "0", "emission"},
                {"standard_surface", "transmission_dispersion", "0", "dispersion"},
                {"standard_surface", "specular_anisotropy", "0", "anisotropic roughness"},
                {"standard_surface", "thin_walled", "0", "thin walls"},
                {"standard_surface", "opacity", "1,1,1", "opacity below 1"},
                {"open_pbr_surface", "coat_weight", "0", "coat"},
                {"open_pbr_surface", "fuzz_weight", "0", "fuzz"},
                {"open_pbr_surface", "thin_film_weight", "0", "thin film"},
                {"open_pbr_surface", "emission_luminance", "0", "emission"},
                {"open_pbr_surface", "geometry_opacity", "1", "opacity below 1"},
                {NULL, "coat_weight", "0", "coat"},
                {NULL, "sheen_weight", "0", "sheen"},
                {NULL, "thin_film_thickness", "0", "thin film"},
                {NULL, "emission_strength", "0", "emission"},
                {NULL, "anisotropic", "0", "anisotropic roughness"},
                {NULL, "alpha", "1", "alpha below 1"},
                {NULL, "metallic", "0", "partial metal"}};
    for (size_t i = 0; i < sizeof loss / sizeof *loss; i++)
        for (int neutral = 0; neutral < 2; neutral++) {
            char input[80], blender[200];
            const char *value = neutral ? loss[i].neutral : "0.2";
            snprintf(input, sizeof input, "%s=%s", loss[i].input, value);
            snprintf(blender, sizeof blender,
                     "{\"type\":\"BSDF_PRINCIPLED\",\"subsurface_weight\":1,\"%s\":%s}",
                     loss[i].input, value);
            if (loss[i].shader)
                load_text(mtlx(loss[i].shader,
                               (const char *const[]){strcmp(loss[i].shader, "standard_surface")
                                                         ? "subsurface_weight=1"
                                                         : "subsurface=1",
                                                     input, NULL}),
                          ".mtlx");
            else load_text(blender, ".json");
            if (!neutral != !!strstr(said, loss[i].name))
                fail_msg("%s %s: \"%s\"", loss[i].shader ? loss[i].shader : "Blender", input,
                         said);
        }
}

// A tree of nodes, each the sum of the next one twice: 2^30 steps without a budget.
static char *doubling_graph(void)
{
    char *text = malloc(1 << 14);
    size_t n = (size_t)sprintf(text, "<materialx><nodegraph name=\"g\">");
    for (int i = 0; i < 30; i++)
        n += (size_t)sprintf(text + n,
                             "<add name=\"n%d\"><input name=\"in1\" nodename=\"n%d\"/><input "
                             "name=\"in2\" nodename=\"n%d\"/></add>",
                             i, i + 1, i + 1);
    strcpy(text + n, "<constant name=\"n30\"><input name=\"value\" value=\"1\"/></constant>"
                     "<output name=\"out\" nodename=\"n0\"/></nodegraph>"
                     "<standard_surface name=\"s\" type=\"surfaceshader\"><input name=\""
                     "subsurface\" nodegraph=\"g\" output=\"out\"/></standard_surface>"
                     "</materialx>");
    return text;
}

// Faults of a file are one line that names it; none takes long.
static void hostile_files(void **state)
{
    char deep[64 * 4 + 64] = "";
    for (int i = 0; i < 65; i++) strcat(deep, "<a>");
    const struct {
        const char *text, *line;
    } row[] = {
        {"<!DOCTYPE x [<!ENTITY a \"aaaa\"><!ENTITY b \"&a;&a;\">]><materialx>&b;</materialx>",
         "document type"},
        {"<materialx>", "not valid XML in line 1"},
        {"<materialx a=\"1\" a=\"2\"/>", "not valid XML"},
        {"<svg/>", "its root is <svg>"},
        {"<materialx/>", "holds no <surfacematerial>"},
        {deep, "nested too deeply"},
        {"\x01\x02", "neither MaterialX"},
        {"{\"Base Color\":", "not valid JSON"},
        {"{\"x\":[[[[[[]]]]]]}", "without a Principled"},
        {"MakeNamedMedium \"a\" \"rgb sigma_a\" [1 2", "a list has no ]"},
        {"WorldBegin", "without MakeNamedMedium"},
        {"Material \"x", "not a pbrt scene"},
    };
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        struct prt_import *item;
        unsigned n;
        said[0] = 0;
        assert_true(prt_material_import(&context, "evil", row[i].text, strlen(row[i].text), 0,
                                        &item, &n) < 0);
        if (!strstr(said, row[i].line) || strncmp(said, "evil: ", 6) ||
            strchr(said, '\n') != said + strlen(said) - 1)
            fail_msg("%s: \"%s\" expected in \"%s\"", row[i].text, row[i].line, said);
    }
    char *text = doubling_graph();
    import(text, true); // the weight has no value, and counts as an image's
    assert_non_null(strstr(said, "subsurface (graph \"too deep or too large\")"));
    free(text);
    // numbers beyond all ranges: no medium, or one in range (prt_material_import checks)
    import(mtlx("standard_surface",
                (const char *const[]){"subsurface=1e9", "subsurface_radius=1e-30,1e11,-5",
                                      "subsurface_color=-1,1e12,0", "specular_IOR=-1",
                                      "subsurface_anisotropy=5", NULL}),
           true);
    import(mtlx("open_pbr_surface",
                (const char *const[]){"transmission_weight=1", "transmission_depth=1e-12",
                                      "transmission_scatter=1e12,0,1", NULL}),
           true);
    import(mtlx("standard_surface", (const char *const[]){"subsurface=nan", NULL}), true);
}

// A file of 20 materials: all have a medium, and the time is printed.
static void twenty_materials(void **state)
{
    char *text = malloc(1 << 15), path[] = "/tmp/prt-imports-XXXXXX";
    size_t n = (size_t)sprintf(text, "<materialx>");
    for (int i = 0; i < 20; i++)
        n += (size_t)sprintf(
            text + n,
            "<open_pbr_surface name=\"s%d\" type=\"surfaceshader\"><input name=\""
            "subsurface_weight\" value=\"1\"/></open_pbr_surface><surfacematerial name=\"m%d\" "
            "type=\"material\"><input name=\"surfaceshader\" nodename=\"s%d\"/>"
            "</surfacematerial>",
            i, i, i);
    n += (size_t)sprintf(text + n, "</materialx>");
    int fd = mkstemp(path);
    assert_int_equal(write(fd, text, n), n);
    close(fd);
    struct prt_import *item;
    unsigned found;
    double best = 1e9;
    for (int k = 0; k < 5; k++) {
        double began = prt_time_s();
        assert_int_equal(prt_material_import_file(&context, path, 0, &item, &found), PRT_OK);
        best = fmin(best, prt_time_s() - began);
        assert_int_equal(found, 20);
        for (unsigned i = 0; i < found; i++) assert_true(item[i].has_medium);
        prt_free(item);
    }
    printf("20 materials of a file: %.2f ms\n", 1e3 * best);
    unlink(path);
    free(text);
}

// Law: a colour is in the space that its own element names, else the nearest element around it:
// one of srgb_texture is decoded, one of lin_rec709 is taken as it is, one of acescg is turned
// into Rec. 709, where white is white.
static void colours_have_the_space_around_them(void **state)
{
    static const char grey[] = ".5,.5,.5";
    static const struct {
        const char *document, *shader, *input, *value;
        double linear[3];
    } all[] = {
        {"srgb_texture", "", "", grey, {0.214041, 0.214041, 0.214041}},
        {"srgb_texture", "lin_rec709", "", grey, {0.5, 0.5, 0.5}},
        {"acescg", "srgb_texture", "", grey, {0.214041, 0.214041, 0.214041}},
        {"srgb_texture", "acescg", "lin_rec709", grey, {0.5, 0.5, 0.5}},
        {"acescg", "", "", grey, {0.5, 0.5, 0.5}},
        {"lin_ap1", "", "", ".5,.4,.3", {0.57883, 0.38803, 0.28231}},
    };
    for (size_t k = 0; k < sizeof all / sizeof *all; k++) {
        const char *space[3] = {all[k].document, all[k].shader, all[k].input};
        char named[3][40] = {"", "", ""}, text[1024];
        for (int i = 0; i < 3; i++)
            if (*space[i]) snprintf(named[i], sizeof named[i], " colorspace=\"%s\"", space[i]);
        snprintf(text, sizeof text,
                 "<materialx version=\"1.39\"%s><open_pbr_surface name=\"s\" "
                 "type=\"surfaceshader\"%s><input name=\"transmission_weight\" type=\"float\" "
                 "value=\"1\"/><input name=\"transmission_depth\" type=\"float\" value=\"2\"/>"
                 "<input name=\"transmission_color\" type=\"color3\" value=\".1,.1,.1\" "
                 "colorspace=\"lin_rec709\"/><input name=\"transmission_scatter\" "
                 "type=\"color3\" value=\"%s\"%s/></open_pbr_surface><surfacematerial "
                 "name=\"m\" type=\"material\"><input name=\"surfaceshader\" "
                 "type=\"surfaceshader\" nodename=\"s\"/></surfacematerial></materialx>",
                 named[0], named[1], all[k].value, named[2]);
        struct prt_import i = import(text, true);
        for (int c = 0; c < 3; c++) // 2 is 20 mm
            expect_near("sigma_s of a colour in its space, times the depth",
                        20 * (double)i.material.sigma_s_prime[c], all[k].linear[c], 2e-5);
    }
}

// Law: where a coefficient is above its limit, scattering and absorption are scaled by one
// factor, so that the albedo stays (METHODS §10).
static void limits_keep_the_albedo(void **state)
{
    static const char text[] =
        "MakeNamedMedium \"m\" \"string type\" \"homogeneous\" \"rgb sigma_a\" [30 200 900] "
        "\"rgb sigma_s\" [4000 9000 2000] \"float g\" [.2]";
    const struct prt_import i = import(text, true);
    static const double absorbed[3] = {30, 200, 900}, scattered[3] = {4000, 9000, 2000};
    assert_non_null(strstr(said, "were moved there"));
    for (int c = 0; c < 3; c++) {
        const double s = (double)i.material.sigma_s_prime[c], a = (double)i.material.sigma_a[c];
        expect_above("sigma_s' at its limit [1/mm]", s, 500);
        expect_close("sigma_a over sigma_s' of a dense medium", a / s,
                     absorbed[c] / (0.8 * scattered[c]), 1e-5);
    }
}

// FILE#NAME names a material of the file, and a file's own name may have a # as well.
static void names_of_files_with_a_hash(void **state)
{
    char folder[] = "/tmp/imports-test-XXXXXX", path[64], named[80];
    const char *text =
        mtlx("open_pbr_surface", (const char *const[]){"subsurface_weight=1", NULL});
    assert_non_null(mkdtemp(folder));
    for (int hash = 0; hash < 2; hash++) {
        struct prt_import *item;
        unsigned n;
        snprintf(path, sizeof path, "%s/%s", folder, hash ? "a#b.mtlx" : "ab.mtlx");
        FILE *f = fopen(path, "w");
        assert_non_null(f);
        fputs(text, f);
        assert_int_equal(fclose(f), 0);
        for (int name = 0; name < 2; name++) {
            snprintf(named, sizeof named, "%s%s", path, name ? "#m" : "");
            said[0] = 0;
            if (prt_material_import_file(&context, named, 0, &item, &n)) fail_msg("%s", said);
            assert_int_equal(n, 1);
            assert_true(item->has_medium);
            prt_free(item);
        }
        snprintf(named, sizeof named, "%s#other", path);
        assert_int_not_equal(prt_material_import_file(&context, named, 0, &item, &n), PRT_OK);
        unlink(path);
    }
    assert_int_equal(rmdir(folder), 0);
}

// Law: pbrt's named media are those that NSJ06 measured. Sums of each column of the table, a
// row weighing its number, show a slip of any digit.
static void measured_media(void **state)
{
    static const double want[9] = {-3882.138721502621, -3848.723562995132, -3969.174451429120,
                                   -1908.426320149223, -1497.795642205957, -1227.619068741808,
                                   564.4700019955635,  525.9889984726906,  495.8489972949028};
    double sum[9] = {0};
    const struct prt_material *m;
    unsigned n = 0;
    for (; (m = prt_material_named_medium(n)); n++)
        for (int c = 0; c < 3; c++) {
            sum[c] += (n + 1) * log((double)m->sigma_s_prime[c]);
            sum[3 + c] += (n + 1) * log((double)m->sigma_a[c]);
            sum[6 + c] += (n + 1) * (double)m->g[c];
        }
    assert_int_equal(n, 35);
    for (int c = 0; c < 9; c++) expect_near("sum of a column", sum[c], want[c], 1e-11);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(half_spaces_return_their_albedo),
        cmocka_unit_test(transmissive_interiors),
        cmocka_unit_test(units_scale_lengths),
        cmocka_unit_test(colours_have_the_space_around_them),
        cmocka_unit_test(scale_of_a_pbrt_medium),
        cmocka_unit_test(scale_of_a_pbrt_surface),
        cmocka_unit_test(counts_of_numbers),
        cmocka_unit_test(losses_are_said),
        cmocka_unit_test(unknown_kinds_are_said),
        cmocka_unit_test(every_loss_is_named),
        cmocka_unit_test(hostile_files),
        cmocka_unit_test(twenty_materials),
        cmocka_unit_test(limits_keep_the_albedo),
        cmocka_unit_test(names_of_files_with_a_hash),
        cmocka_unit_test(measured_media),
    };
    return run_physics_tests(tests, set_up, NULL);
}
