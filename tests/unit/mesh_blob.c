// SPDX-License-Identifier: MIT
// The parent checks every index and number of a mesh that the process of a reader returns: a
// reader that was taken over can write anything into it.
#include "mesh/internal.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

static void swallow(void *user, enum prt_log_level level, const char *line)
{
}

static struct prt_context ctx;

static int setup(void **state)
{
    prt_context_init(&ctx);
    ctx.log = swallow;
    return 0;
}

// Two objects of one triangle each, a camera, a volume, two sets of uv, colours, and an image
// that a map shows.
static void two_triangles(struct prt_draft *d)
{
    struct prt_surface surface;
    uint32_t index, first;
    *d = (struct prt_draft){.ctx = &ctx,
                            .name = "two",
                            .max_vertices = 100,
                            .max_triangles = 100,
                            .max_bytes = 1 << 20,
                            .n_uv = 2,
                            .has_color = true,
                            .n_camera = 1};
    prt_surface_default(&surface, "wax");
    assert_int_equal(prt_draft_surface(d, &surface, &index), PRT_OK);
    for (uint32_t k = 0; k < 2; k++) {
        assert_int_equal(prt_draft_object(d, NULL), PRT_OK);
        assert_int_equal(prt_draft_vertices(d, 3, &first), PRT_OK);
        for (int i = 0; i < 2; i++) d->position[first + 1 + i][i] = 1;
        assert_int_equal(prt_draft_triangle(d, first, first + 1, first + 2), PRT_OK);
        assert_int_equal(prt_draft_block(d, (struct prt_block){.object = k,
                                                               .surface = index,
                                                               .vertex_begin = first,
                                                               .n_vertex = 3,
                                                               .triangle_begin = k,
                                                               .n_triangle = 1}),
                         PRT_OK);
    }
    d->camera[0] = (struct prt_mesh_camera){
        .name = "c", .eye = {0, 0, 1}, .up = {0, 1, 0}, .fovy_deg = 40};
    struct prt_volume *volume = prt_draft_volume(d, index);
    assert_non_null(volume);
    volume->kind = PRT_VOLUME_SCATTER;
    volume->distance = 1;
    struct prt_surface_maps *maps = prt_draft_maps(d, index);
    assert_non_null(maps);
    maps->map[0].image = 0;
    d->n_image = 1;
    d->image = calloc(1, sizeof *d->image);
    d->texel = calloc(1, sizeof *d->texel);
    d->texel_bytes = prt_texture_bytes(2, 1);
    d->texel[0] = prt_calloc(d->texel_bytes, 1);
    assert_true(d->image && d->texel && d->texel[0]);
    d->image[0] = (struct prt_texture_image){
        .width = 2, .height = 1, .n_level = prt_texture_levels(2, 1), .bytes = d->texel_bytes};
}

// What opening says of the draft, which is finished.
static int opened(struct prt_draft *d)
{
    struct prt_blob blob;
    struct prt_mesh *mesh = NULL;
    assert_int_equal(prt_blob_pack(d, &blob), PRT_OK);
    int status = prt_blob_open(&ctx, "two", &blob, &mesh);
    if (status) prt_free(blob.bytes);
    else prt_mesh_destroy(mesh);
    prt_draft_finish(d);
    return status;
}

// A triangle has its corners among the vertices of its block: also the last one, whose next
// would be another block's or lie behind all vertices.
static void corners_are_of_their_block(void **state)
{
    struct prt_draft d;
    two_triangles(&d);
    assert_int_equal(opened(&d), PRT_OK);
    for (int k = 0; k < 2; k++)
        for (int c = 0; c < 3; c++)
            for (int end = 0; end < 3; end++) {
                two_triangles(&d);
                d.triangle[k][c] = end == 0   ? d.block[k].vertex_begin - 1
                                   : end == 1 ? d.block[k].vertex_begin + d.block[k].n_vertex
                                              : UINT32_MAX / 2;
                assert_int_equal(opened(&d), PRT_FORMAT);
            }
}

// Blocks follow one another without a gap, and objects ascend from 0.
static void blocks_follow_one_another(void **state)
{
    enum { OBJECT_0, OBJECT_1, SURFACE, VERTEX, TRIANGLE, FEWER, MORE, N };
    for (int change = 0; change < N; change++) {
        struct prt_draft d;
        two_triangles(&d);
        struct prt_block *b = &d.block[1];
        if (change == OBJECT_0) d.block[0].object = b->object = 1;
        if (change == OBJECT_1) b->object = 2;
        if (change == SURFACE) b->surface = d.n_surface;
        if (change == VERTEX) b->vertex_begin--;
        if (change == TRIANGLE) b->triangle_begin--;
        if (change == FEWER) b->n_triangle = 0;
        if (change == MORE) b->n_vertex++;
        assert_int_equal(opened(&d), PRT_FORMAT);
    }
}

// A number that is not finite or outside its range is refused.
static void numbers_have_bounds(void **state)
{
    enum { POSITION, NAN_NORMAL, NORMAL, IOR, ROUGHNESS, FOV, EYE, ALBEDO, G, COLOR, NAME, N };
    for (int change = 0; change < N; change++) {
        struct prt_draft d;
        two_triangles(&d);
        if (change == POSITION) d.position[5][2] = 2e15f;
        if (change == NAN_NORMAL) d.normal[5][2] = NAN;
        if (change == NORMAL) d.normal[5][2] = -1.01f;
        if (change == IOR) d.surface[0].ior = 0.99f;
        if (change == ROUGHNESS) d.surface[0].roughness = 0;
        if (change == FOV) d.camera[0].fovy_deg = 170;
        if (change == EYE) d.camera[0].eye[2] = INFINITY;
        if (change == ALBEDO) d.volume[0].albedo[2] = 1.01f;
        if (change == G) d.volume[0].g = -0.96f;
        if (change == COLOR) d.surface[0].base_color[3] = -1.01f;
        if (change == NAME) memset(d.camera[0].name, 'c', sizeof d.camera[0].name);
        assert_int_equal(opened(&d), PRT_FORMAT);
    }
}

// So are those of textures: what a picture looks up lies in the mesh.
static void textures_have_bounds(void **state)
{
    enum { UV, COLOR, WIDTH, LEVELS, KIND, IMAGE, SET, WRAP, TRANSFORM, METAL, EMISSION, N };
    for (int change = 0; change < N; change++) {
        struct prt_draft d;
        two_triangles(&d);
        struct prt_surface_maps *maps = &d.maps[0];
        if (change == UV) d.uv_more[0][5][1] = NAN;
        if (change == COLOR) d.color[5][3] = 1.01f;
        if (change == WIDTH) d.image[0].width = 4;
        if (change == LEVELS) d.image[0].n_level++;
        if (change == KIND) d.image[0].kind = PRT_TEXTURE_N_KIND;
        if (change == IMAGE) maps->map[0].image = d.n_image;
        if (change == SET) maps->map[0].uv_set = PRT_TEXTURE_MAX_UV;
        if (change == WRAP) maps->map[0].wrap_v = PRT_WRAP_MIRROR + 1;
        if (change == TRANSFORM) maps->map[0].transform[5] = INFINITY;
        if (change == METAL) maps->metallic = 1.01f;
        if (change == EMISSION) maps->emissive[2] = -0.01f;
        assert_int_equal(opened(&d), PRT_FORMAT);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(corners_are_of_their_block),
        cmocka_unit_test(blocks_follow_one_another),
        cmocka_unit_test(numbers_have_bounds),
        cmocka_unit_test(textures_have_bounds),
    };
    return cmocka_run_group_tests(tests, setup, NULL);
}
