// SPDX-License-Identifier: MIT
// The JSON that a .prt records of its bake; the size of its clusters.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <cjson/cJSON.h>
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
        cmocka_unit_test(a_small_model_has_many_clusters),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
