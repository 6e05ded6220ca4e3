// SPDX-License-Identifier: MIT
// Parts of an answer that no model is needed for: colours as bytes, and which of a bake's
// measured errors is told.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "relight.pb-c.h"
#include "render/walk.h"

enum { N = 50, PLANES = 2, SOME = 20 };

// Colours of the first vertices of a coarse order have the bytes that all vertices have, in
// each format and with the exposure.
static void coarse_colours_are_those_of_all(void **state)
{
    struct prt_context ctx;
    struct render_spec spec = {.exposure_ev = 1.5f};
    struct vertex_values *values = calloc(1, sizeof *values + PLANES * N * 3 * sizeof(float));
    uint32_t vertex[SOME];
    uint8_t all[PLANES * N * 12], some[PLANES * SOME * 12];
    assert_non_null(values);
    prt_context_init(&ctx);
    values->n_plane = PLANES;
    values->n_vertex = N;
    for (int i = 0; i < PLANES * N * 3; i++) values->values[i] = (float)(i * 37 % 101) / 150;
    for (uint32_t i = 0; i < SOME; i++) vertex[i] = (7 * i + 3) % N;
    static const int formats[] = {
        RELIGHT__COLOR_FORMAT__COLOR_F32, RELIGHT__COLOR_FORMAT__COLOR_F16,
        RELIGHT__COLOR_FORMAT__COLOR_RGB9E5, RELIGHT__COLOR_FORMAT__COLOR_SRGB8};
    for (int k = 0; k < 4; k++) {
        spec.format = formats[k];
        const size_t n = color_bytes(spec.format);
        encode_colors(&ctx, &spec, values, all);
        assert_int_equal(encode_coarse(&ctx, &spec, values, vertex, SOME, some), 0);
        for (size_t plane = 0; plane < PLANES; plane++)
            for (size_t i = 0; i < SOME; i++)
                assert_memory_equal(some + (plane * SOME + i) * n,
                                    all + (plane * N + vertex[i]) * n, n);
    }
    free(values);
}

// Single scattering was measured along the normal and towards eyes: an answer for an eye, as a
// picture is, has the larger error.
static void the_error_is_that_of_the_view(void **state)
{
    struct render *r = calloc(1, sizeof *r);
    struct model *m = calloc(1, sizeof *m);
    assert_true(r && m);
    r->model = m;
    m->facts.error_multiple = .01f;
    m->facts.error_single = .02f;
    m->facts.error_view = .05f;
    r->spec.term = RELIGHT__TERM__TERM_SINGLE;
    assert_true(bake_error(r) == .02f);
    r->spec.has_eye = true;
    assert_true(bake_error(r) == .05f);
    m->facts.error_view = .001f;
    assert_true(bake_error(r) == .02f);
    m->facts.error_view = .05f;
    r->spec.has_eye = false;
    r->spec.picture = true;
    assert_true(bake_error(r) == .05f);
    r->spec.term = RELIGHT__TERM__TERM_MULTIPLE;
    assert_true(bake_error(r) == .01f);
    r->spec.term = RELIGHT__TERM__TERM_IRRADIANCE; // it is traced
    assert_true(bake_error(r) == 0);
    free(m);
    free(r);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(coarse_colours_are_those_of_all),
        cmocka_unit_test(the_error_is_that_of_the_view),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
