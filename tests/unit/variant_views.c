// SPDX-License-Identifier: MIT
// Views of a mesh in its variants, and media by object, of meshes without a triangle: what each
// kind of bake lets a variant change, and to which body an opaque part belongs.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "prt/variant.h"

static char said[512];

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    snprintf(said, sizeof said, "%s", line);
}

static struct prt_context context(void)
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep_line;
    said[0] = 0;
    return ctx;
}

static struct prt_material medium(const char *name)
{
    struct prt_context ctx = context();
    struct prt_material m;
    assert_int_equal(prt_material_load(&ctx, name, &m), PRT_OK);
    return m;
}

enum { WAX, STONE, RED, GREEN, BLUE, SOOT, GLASS, N_SURFACE };
enum { N_BLOCK = 2, N_VARIANT = 5 };

// A body of wax and one of stone, whose albedo each variant changes in one channel; "soot"
// makes it black, "glass" translucent.
struct still {
    struct prt_surface surface[N_SURFACE];
    struct prt_block block[N_BLOCK];
    struct prt_mesh_variant variant[N_VARIANT];
    uint32_t of[N_BLOCK][N_VARIANT + 1];
    struct prt_material wax;
    struct prt_mesh mesh;
    struct prt_media media;
};

static void still_begin(struct still *s)
{
    static const char *const name[N_VARIANT] = {"red", "green", "blue", "soot", "glass"};
    *s = (struct still){.wax = medium("marble")};
    for (int i = 0; i < N_SURFACE; i++) {
        snprintf(s->surface[i].name, sizeof s->surface[i].name, "surface %d", i);
        s->surface[i].translucent = i == WAX || i == GLASS;
        for (int c = 0; c < 3; c++) s->surface[i].base_color[c] = i == SOOT ? 0 : 0.4f;
    }
    for (int c = 0; c < 3; c++) s->surface[RED + c].base_color[c] = 0.1f;
    for (uint32_t v = 0; v < N_VARIANT; v++) {
        strcpy(s->variant[v].name, name[v]);
        s->of[WAX][v] = WAX;
        s->of[STONE][v] = RED + v;
    }
    s->of[STONE][N_VARIANT] = STONE;
    for (uint32_t b = 0; b < N_BLOCK; b++)
        s->block[b] = (struct prt_block){.object = b, .surface = b};
    s->mesh = (struct prt_mesh){.n_block = N_BLOCK,
                                .n_object = N_BLOCK,
                                .n_surface = N_SURFACE,
                                .block = s->block,
                                .surface = s->surface,
                                .n_variant = N_VARIANT,
                                .variant = s->variant,
                                .variant_surface = s->of[0],
                                .mm_per_unit = 1};
    s->media = prt_media_one(&s->wax);
}

static int view(struct still *s, enum prt_variant_of of, const char *name,
                struct prt_variant **out)
{
    struct prt_context ctx = context();
    return prt_variant_create(&ctx, "still.glb", &s->mesh, &s->media, of, name, out);
}

// Contract of prt_variant_create: an opaque surface's albedo changes freely, by a factor of
// each channel, which pictures of a bake multiply its colours with; those of a model do not.
static void an_albedo_changes_by_channel(void **state)
{
    static const char *const name[] = {"red", "green", "blue", "default"};
    struct still s;
    still_begin(&s);
    for (int i = 0; i < 4; i++)
        for (enum prt_variant_of of = PRT_VARIANT_OF_MODEL; of <= PRT_VARIANT_OF_ANY_ETA;
             of++) {
            struct prt_variant *v;
            if (view(&s, of, name[i], &v)) fail_msg("%s", said);
            const bool changes = i < 3 && of != PRT_VARIANT_OF_MODEL;
            assert_int_equal(v->mesh.block[STONE].surface, i < 3 ? RED + i : STONE);
            assert_int_equal(v->mesh.gain != NULL, changes);
            assert_int_equal(v->plain, !changes);
            for (int c = 0; c < 3; c++) {
                assert_float_equal(v->gain[WAX][c], 1, 0);
                assert_float_equal(v->gain[STONE][c], c == i ? 0.25f : 1, 1e-7);
            }
            assert_int_equal(v->media->n, 1);
            prt_variant_destroy(v);
        }
}

// A variant may blacken an albedo, by the factor 0. No factor leads from a baked black to
// another albedo, and an opaque part of a bake stays opaque.
static void a_bake_limits_variants(void **state)
{
    struct still s;
    struct prt_variant *v;
    still_begin(&s);
    assert_int_equal(view(&s, PRT_VARIANT_OF_FIXED, "soot", &v), PRT_OK);
    for (int c = 0; c < 3; c++) assert_float_equal(v->gain[STONE][c], 0, 0);
    prt_variant_destroy(v);
    assert_int_equal(view(&s, PRT_VARIANT_OF_FREE, "glass", &v), PRT_MISMATCH);
    assert_non_null(strstr(said, "makes translucent \"surface 1\""));
    s.block[STONE].surface = SOOT; // baked so
    for (enum prt_variant_of of = PRT_VARIANT_OF_FIXED; of <= PRT_VARIANT_OF_ANY_ETA; of++) {
        assert_int_equal(view(&s, of, "blue", &v), PRT_MISMATCH);
        assert_non_null(strstr(said, "black albedo"));
    }
    assert_int_equal(view(&s, PRT_VARIANT_OF_MODEL, "blue", &v), PRT_OK);
    prt_variant_destroy(v);
    assert_int_equal(view(&s, PRT_VARIANT_OF_FIXED, "yellow", &v), PRT_ARG);
}

// Contract of prt_media_create: an opaque part of a body belongs to the body, whichever medium
// it has, and wherever it stands among the body's parts.
static void opaque_parts_belong_to_their_body(void **state)
{
    struct prt_context ctx = context();
    struct prt_surface surface[2] = {{.name = "wax", .translucent = 1}, {.name = "lid"}};
    struct prt_block block[] = {{.object = 0, .surface = 0},
                                {.object = 1, .surface = 1},
                                {.object = 1, .surface = 0},
                                {.object = 1, .surface = 1},
                                {.object = 2, .surface = 1}};
    struct prt_mesh mesh = {.n_block = 5,
                            .n_object = 3,
                            .n_surface = 2,
                            .block = block,
                            .surface = surface,
                            .mm_per_unit = 1};
    const struct prt_material marble = medium("marble"), skin = medium("skin1");
    const struct prt_material *of_block[5] = {&marble, NULL, &skin, NULL, NULL};
    struct prt_media *media;
    if (prt_media_create(&ctx, &mesh, of_block, &media)) fail_msg("%s", said);
    assert_int_equal(media->n, 2);
    assert_string_equal(prt_media_of(media, 0)->name, marble.name);
    assert_string_equal(prt_media_of(media, 1)->name, skin.name);
    prt_free(media);
    block[3].surface = 0; // two media in one body
    of_block[3] = &marble;
    assert_int_equal(prt_media_create(&ctx, &mesh, of_block, &media), PRT_ARG);
    of_block[3] = NULL;
    assert_int_equal(prt_media_create(&ctx, &mesh, of_block, &media), PRT_ARG);
    assert_non_null(strstr(said, "\"wax\" has no material"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_albedo_changes_by_channel),
        cmocka_unit_test(a_bake_limits_variants),
        cmocka_unit_test(opaque_parts_belong_to_their_body),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
