// SPDX-License-Identifier: MIT
// The JSON that a .prt records of its bake; bounds of settings; the size of clusters.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <cjson/cJSON.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bake/run.h"

static struct prt_context context;

static struct bake small_bake(struct clusters *none)
{
    static const struct prt_mesh empty;
    struct bake b = {.ctx = &context, .mesh = &empty, .clusters = none};
    static struct prt_material skin;
    assert_int_equal(prt_material_load(&context, "skin1", &skin), PRT_OK);
    b.o.media = prt_media_one(&skin);
    b.o.cube = 32, b.o.n_phase = 4, b.o.max_error = 0.01;
    return b;
}

// A source longer than any fixed buffer is recorded whole.
static void a_long_source_is_whole(void **state)
{
    enum { LONG = 20000 };
    struct clusters none = {0};
    struct bake b = small_bake(&none);
    char *source = malloc(LONG + 16);
    assert_non_null(source);
    memcpy(source, "{\"file\":\"", 9);
    memset(source + 9, 'x', LONG);
    memcpy(source + 9 + LONG, "\"}", 3);
    b.o.settings_json = source;
    char *text = prt_bake_describe(&b);
    assert_non_null(text);
    cJSON *json = cJSON_Parse(text);
    assert_non_null(json);
    const cJSON *file = cJSON_GetObjectItem(cJSON_GetObjectItem(json, "source"), "file");
    assert_non_null(file);
    assert_int_equal(strlen(file->valuestring), LONG);
    cJSON_Delete(json);
    free(text);
    free(source);
}

// Seeds have 64 bits, more than a double holds.
static void a_seed_keeps_its_digits(void **state)
{
    struct clusters none = {0};
    struct bake b = small_bake(&none);
    b.o.seed = UINT64_MAX - 1;
    char *text = prt_bake_describe(&b);
    assert_non_null(text);
    assert_non_null(strstr(text, "\"seed\":18446744073709551614,"));
    assert_non_null(strstr(text, "\"max_error\":0.01,"));
    assert_non_null(strstr(text, "\"engine\":\"wavelet\",\"storage\":\"factored\","
                                 "\"scattering\":\"dipole\",\"cube\":32,"));
    free(text);
}

// Several media are recorded in their order, and the number of each object's.
static void media_are_recorded_by_object(void **state)
{
    static const struct prt_mesh three = {.n_object = 3};
    static const uint8_t of_object[] = {1, 0, 1};
    struct clusters none = {0};
    struct bake b = small_bake(&none);
    struct prt_material medium[2];
    assert_int_equal(prt_material_load(&context, "skin1", &medium[0]), PRT_OK);
    assert_int_equal(prt_material_load(&context, "marble", &medium[1]), PRT_OK);
    b.mesh = &three;
    b.o.media = (struct prt_media){2, medium, of_object};
    char *text = prt_bake_describe(&b);
    cJSON *json = cJSON_Parse(text);
    const cJSON *media = cJSON_GetObjectItem(json, "media");
    const cJSON *of = cJSON_GetObjectItem(json, "medium_of_object");
    assert_int_equal(cJSON_GetArraySize(media), 2);
    assert_int_equal(cJSON_GetArraySize(of), 3);
    for (int i = 0; i < 2; i++) {
        const cJSON *name = cJSON_GetObjectItem(cJSON_GetArrayItem(media, i), "name");
        assert_string_equal(name->valuestring, medium[i].name);
    }
    for (int i = 0; i < 3; i++)
        assert_int_equal(cJSON_GetArrayItem(of, i)->valueint, of_object[i]);
    cJSON_Delete(json);
    free(text);
}

static char said[512];

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    snprintf(said, sizeof said, "%s", line);
}

// A setting out of its bounds is refused by its own name.
static void each_setting_has_its_bound(void **state)
{
    static const struct {
        struct prt_bake_options o;
        const char *name;
    } wrong[] = {{{.n_sample = 1}, "--samples"},
                 {{.cube = 17}, "--cube"},
                 {{.n_coef = 5}, "--coeffs"},
                 {{.rank = 1000000}, "--rank"},
                 {{.n_basis_coef = 1000000}, "--basis-coeffs"},
                 {{.n_phase = 5}, "--phase-terms"},
                 {{.n_single = 1000000}, "--single-points"},
                 {{.n_walk = 1}, "--walks"},
                 {{.max_error = 7}, "--max-error"}};
    struct prt_context c = context;
    c.log = keep_line;
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        said[0] = 0;
        assert_int_equal(prt_bake_check_settings(&c, &wrong[i].o), PRT_ARG);
        assert_non_null(strstr(said, wrong[i].name));
    }
    const struct prt_bake_options open = {0};
    assert_int_equal(prt_bake_check_settings(&c, &open), PRT_OK);
}

// Contract of struct prt_bake_options: settings that are left open get the values that its
// comments and --help name, given ones stay, and a draft has its own.
static void open_settings_have_their_defaults(void **state)
{
    struct prt_bake_options o = {0}, draft = {.draft = true, .max_error = 0.3};
    struct prt_bake_options given = {.n_coef = 200, .cube = 64, .n_single = 9};
    prt_bake_set_defaults(&o);
    assert_true(o.n_coef == 128 && o.cube == 32 && o.n_single == 16 && o.max_error == 0.01);
    assert_true(o.n_sample == 0); // by the mean free path
    prt_bake_set_defaults(&draft);
    assert_true(draft.n_coef == 128 && draft.cube == 16 && draft.n_sample == 20000);
    assert_true(draft.max_error == 0.3);
    prt_bake_set_defaults(&given);
    assert_true(given.n_coef == 200 && given.cube == 64 && given.n_single == 9);
}

static uint32_t cluster_size(uint32_t n_vertex, enum prt_transport_kind engine,
                             enum prt_scattering scattering)
{
    const struct prt_mesh mesh = {.n_vertex = n_vertex};
    const struct bake b = {.mesh = &mesh, .o = {.engine = engine, .scattering = scattering}};
    return prt_bake_cluster_size(&b);
}

// Few vertices are divided into about as many clusters as 35,000, many into a bounded number,
// of a joint bake twice as many. Walks have half as many. More vertices never make a cluster
// smaller.
static void a_small_model_has_many_clusters(void **state)
{
    const enum prt_scattering dipole = PRT_SCATTERING_DIPOLE;
    for (int joint = 0; joint < 2; joint++) {
        const enum prt_transport_kind engine =
            joint ? PRT_TRANSPORT_JOINT : PRT_TRANSPORT_WAVELET;
        uint32_t last = 0;
        for (uint32_t n = 100; n < 4000000; n += n / 10) {
            const uint32_t size = cluster_size(n, engine, dipole), clusters = n / size;
            assert_true(size >= last && size >= 64);
            if (n > 7000) assert_in_range(clusters, 100, joint ? 256 : 128);
            last = size;
        }
        assert_int_equal(cluster_size(35000, engine, dipole), 320);
        assert_int_equal(cluster_size(35000, engine, PRT_SCATTERING_WALK), joint ? 320 : 640);
        assert_int_equal(cluster_size(3225, engine, dipole), 64);
        assert_int_equal(cluster_size(3225, engine, PRT_SCATTERING_WALK), joint ? 320 : 160);
    }
}

int main(void)
{
    prt_context_init(&context);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_long_source_is_whole),
        cmocka_unit_test(a_seed_keeps_its_digits),
        cmocka_unit_test(media_are_recorded_by_object),
        cmocka_unit_test(each_setting_has_its_bound),
        cmocka_unit_test(open_settings_have_their_defaults),
        cmocka_unit_test(a_small_model_has_many_clusters),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
