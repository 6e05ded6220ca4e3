// SPDX-License-Identifier: MIT
// What the bake leaves out: rays whose answer is known, repeated values, turns of the price.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bodies.h"
#include "expect.h"
#include "bake/horizon_places.h"
#include "bake/path_integral.h"
#include "bake/single.h"
#include "bake/stages.h"
#include "prt/radial.h"

static struct prt_context context;

// n: parts of a meridian.
static struct prt_mesh *fluted(uint32_t n)
{
    struct model m;
    model_init(&m, 2 * n * (n + 1), 2 * n * n * 2);
    add_ball(&m, 2 * n, n, n, fluted_ball);
    return body_mesh(&context, &m, false);
}

static struct prt_mesh *body(void)
{
    return fluted(80);
}

// A place of triangle t and its normals, by barycentric coordinates.
static void place(const struct prt_mesh *mesh, uint32_t t, float u, float v, float at[3],
                  float normal[3], float face[3])
{
    const uint32_t *i = mesh->triangle[t];
    float e[2][3], length = 0;
    for (int k = 0; k < 3; k++) {
        const float a = mesh->position[i[0]][k];
        e[0][k] = mesh->position[i[1]][k] - a, e[1][k] = mesh->position[i[2]][k] - a;
        at[k] = a + u * e[0][k] + v * e[1][k];
        normal[k] = (1 - u - v) * mesh->normal[i[0]][k] + u * mesh->normal[i[1]][k] +
                    v * mesh->normal[i[2]][k];
    }
    for (int k = 0; k < 3; k++) {
        int a = (k + 1) % 3, b = (k + 2) % 3;
        face[k] = e[0][a] * e[1][b] - e[0][b] * e[1][a];
        length += face[k] * face[k];
    }
    for (int k = 0; k < 3; k++) face[k] /= sqrtf(length);
}

// Rows with a horizon of so many places more than vertices against those of all rays, at every
// 211th of the mesh's triangles or, of a coarse mesh, at places of each. Returns the rays'
// share.
static double horizon_rows(struct prt_mesh *mesh, uint32_t more, uint32_t every_nth)
{
    struct prt_scene *scene;
    struct horizon *horizon;
    struct directions *d;
    struct fresnel_table fresnel;
    struct prt_rng rng;
    prt_rng_init(&rng, 3, 1);
    assert_int_equal(prt_scene_create(&context, mesh, &scene), PRT_OK);
    assert_int_equal(prt_horizon_create(scene, more, &horizon), PRT_OK);
    assert_int_equal(prt_directions_create(context.cpu, 32, 4, 1, &d), PRT_OK);
    prt_fresnel_table_init(&fresnel, 1.3);
    float *every = prt_alloc(d->n_coef, sizeof *every),
          *seen = prt_alloc(d->n_coef, sizeof *seen);
    assert_true(every && seen);
    uint64_t rays = 0, all = 0;
    double error = 0, sum = 0, hidden = 0, texels = 0;
    for (uint32_t t = 7; t < mesh->n_triangle; t += every_nth) {
        float at[3], normal[3], face[3], u = 1.0f / 3, v = u;
        struct horizon_view view;
        if (more) u = 0.9f * prt_rng_f32(&rng), v = (0.9f - u) * prt_rng_f32(&rng);
        place(mesh, t, u, v, at, normal, face);
        prt_horizon_view(horizon, t, u, v, &view);
        const struct receiver here = {at, normal, face};
        all += prt_irradiance_row(scene, d, t, &fresnel, &here, NULL, EVERY_RAY, every);
        rays += prt_irradiance_row(scene, d, t, &fresnel, &here, &view, EVERY_RAY, seen);
        for (uint32_t i = 0; i < d->n_coef; i++) {
            double w = (double)d->solid_angle[i], x = (double)every[i], y = (double)seen[i];
            error += w * (x - y) * (x - y), sum += w * x * x;
            hidden += x == 0, texels++;
        }
    }
    printf("rays %.3f of all, rows differ by %.3f %%, %.0f %% of texels dark\n",
           (double)rays / (double)all, 100 * sqrt(error / sum), 100 * hidden / texels);
    expect_above("share of dark texels", hidden / texels, 0.52); // flutes hide each other
    expect_below("relative RMSE of the rows", sqrt(error / sum), 0.0002);
    prt_free(every);
    prt_free(seen);
    prt_directions_destroy(d);
    prt_horizon_destroy(horizon);
    prt_scene_destroy(scene);
    prt_mesh_destroy(mesh);
    return (double)rays / (double)all;
}

// Law: directions that the horizon knows give the rows of all rays (METHODS §3.2, W05 eq 8).
// Triangles of a coarse mesh are wider than 2 % of its box: their horizon is that of places
// between their corners.
static void known_directions_take_no_rays(void **state)
{
    expect_below("rays over all rays", horizon_rows(body(), 0, 211), 0.25);
    expect_below("rays over all rays, coarse", horizon_rows(fluted(20), 20000, 13), 0.25);
}

// Sums over squares of 2 x 2 texels of (mean - every)^2 and every^2, of rows of one place over
// so many patterns, by the given rays and by every ray. cast: of both.
static void mean_rows(const struct prt_scene *scene, const struct directions *d,
                      const struct receiver *at, const struct horizon_view *view,
                      enum texel_rays rays, unsigned n, double sums[2], uint64_t cast[2])
{
    double *mean = calloc((size_t)2 * d->n_coef, sizeof *mean);
    float *row = prt_alloc(d->n_coef, sizeof *row);
    assert_true(mean && row);
    for (unsigned i = 0; i < 2 * n; i++) {
        const unsigned pattern = i / 2 * 0x9e3779b1u; // the high bits choose rays
        const bool all = i & 1;
        cast[all] += prt_irradiance_row(scene, d, pattern, NULL, at, all ? NULL : view,
                                        all ? EVERY_RAY : rays, row);
        for (uint32_t k = 0; k < d->n_coef; k++)
            mean[all * d->n_coef + k] += (double)row[k] / n;
    }
    for (uint32_t k = 0; k < d->n_coef; k += 4) {
        double few = 0, want = 0;
        for (uint32_t i = k; i < k + 4; i++) {
            const double w = (double)d->solid_angle[d->texel[i]];
            few += w * mean[d->texel[i]], want += w * mean[d->n_coef + d->texel[i]];
        }
        sums[0] += (few - want) * (few - want), sums[1] += want * want;
    }
    free(mean);
    prt_free(row);
}

// Law: rays that stand for texels give the mean of every ray over receivers near one another,
// which choose different ones (METHODS §3.2, W05 eq 8). Where the others are cast if four
// disagree, one row is close to that of every ray.
static void few_rays_give_the_mean(void **state)
{
    struct prt_mesh *mesh = body();
    struct prt_scene *scene;
    struct horizon *horizon;
    struct directions *d;
    assert_int_equal(prt_scene_create(&context, mesh, &scene), PRT_OK);
    assert_int_equal(prt_horizon_create(scene, 0, &horizon), PRT_OK);
    assert_int_equal(prt_directions_create(context.cpu, 32, 4, 1, &d), PRT_OK);
    double one[2] = {0, 0}, agree[2] = {0, 0};
    uint64_t one_cast[2] = {0, 0}, agree_cast[2] = {0, 0};
    for (uint32_t t = 7; t < mesh->n_triangle; t += 2311) {
        float at[3], normal[3], face[3];
        struct horizon_view view;
        place(mesh, t, 0.3f, 0.3f, at, normal, face);
        prt_horizon_view(horizon, t, 0.3f, 0.3f, &view);
        const struct receiver here = {at, normal, face};
        mean_rows(scene, d, &here, &view, RAY_A_TEXEL, 256, one, one_cast);
        mean_rows(scene, d, &here, NULL, AGREEING_RAYS, 1, agree, agree_cast);
    }
    expect_below("rays over all, a ray a texel", (double)one_cast[0] / (double)one_cast[1],
                 0.06);
    expect_below("error of the mean, a ray a texel", sqrt(one[0] / one[1]), 0.004);
    expect_below("rays over all, agreeing", (double)agree_cast[0] / (double)agree_cast[1], 0.5);
    expect_below("error of one row, agreeing", sqrt(agree[0] / agree[1]), 0.009);
    prt_directions_destroy(d);
    prt_horizon_destroy(horizon);
    prt_scene_destroy(scene);
    prt_mesh_destroy(mesh);
}

// Light that comes from nearer to the tangent plane may pass below the rays of the lowest bins,
// whose centres are up to 4 degrees above it.
static const float lowest = 0.07f; // sin 4 degrees

// Casts 4 x 4 rays through a bin from place (u, v) of a triangle. Returns how many of those
// that leave above 4 degrees are blocked; *above gets their number.
static unsigned blocked_rays(const struct prt_scene *scene, uint32_t triangle, float u, float v,
                             unsigned bin, unsigned *above)
{
    float at[3], normal[3], face[3];
    float eps = prt_scene_epsilon(scene);
    unsigned x = bin % HORIZON_WIDE, y = bin / HORIZON_WIDE % HORIZON_WIDE;
    struct prt_packet packet = {0};
    uint32_t mask = 0;
    place(prt_scene_mesh(scene), triangle, u, v, at, normal, face);
    for (unsigned i = 0; i < 16; i++) {
        float d[3], cosine = 0, rise = 0;
        prt_cube_direction(bin / (HORIZON_WIDE * HORIZON_WIDE),
                           2 * (x + (i % 4 + 0.5) / 4) / HORIZON_WIDE - 1,
                           2 * (y + (i / 4 + 0.5) / 4) / HORIZON_WIDE - 1, d);
        for (int k = 0; k < 3; k++) cosine += normal[k] * d[k], rise += face[k] * d[k];
        mask |= (uint32_t)(cosine > lowest && rise > lowest) << i;
        packet.ox[i] = at[0] + eps * face[0], packet.oy[i] = at[1] + eps * face[1];
        packet.oz[i] = at[2] + eps * face[2];
        packet.dx[i] = d[0], packet.dy[i] = d[1], packet.dz[i] = d[2];
        packet.tfar[i] = INFINITY;
    }
    *above = (unsigned)__builtin_popcount(mask);
    return mask ? (unsigned)__builtin_popcount(prt_scene_occluded16(scene, &packet, mask)) : 0;
}

// A floor of 20 mm under a plate of 14 mm that floats 0.8 mm above it: from most places of the
// floor the sky shows only below the rim of the plate, a few degrees above the horizon.
// n: parts of an edge.
static struct prt_mesh *floor_under_plate(uint32_t n)
{
    struct model m;
    model_init(&m, 2 * (n + 1) * (n + 1), 4 * n * n);
    add_floor(&m, 10, 0, n);
    add_floor(&m, 7, 0.8f, n);
    return body_mesh(&context, &m, false);
}

// Whether some of a bin's neighbours are on another face of the cube.
static bool at_edge(unsigned bin)
{
    const unsigned x = bin % HORIZON_WIDE, y = bin / HORIZON_WIDE % HORIZON_WIDE;
    return x % (HORIZON_WIDE - 1) == 0 || y % (HORIZON_WIDE - 1) == 0;
}

// more: the horizon's places beside vertices, of a coarse mesh.
static void check_bins(struct prt_mesh *mesh, uint32_t more)
{
    const uint32_t every_nth = more ? 7 : 97;
    struct prt_scene *scene;
    struct horizon *horizon;
    struct prt_rng rng;
    double open_rays = 0, open_wrong = 0, blocked = 0, blocked_wrong = 0;
    double at_edges = 0;
    assert_int_equal(prt_scene_create(&context, mesh, &scene), PRT_OK);
    assert_int_equal(prt_horizon_create(scene, more, &horizon), PRT_OK);
    prt_rng_init(&rng, 11, 0);
    for (uint32_t t = 5; t < mesh->n_triangle; t += every_nth) {
        struct horizon_view view;
        const float own = prt_rng_f32(&rng), beside = prt_rng_f32(&rng) * (1 - own);
        prt_horizon_view(horizon, t, own, beside, &view);
        for (unsigned bin = 0; bin < 6 * HORIZON_WIDE * HORIZON_WIDE; bin++) {
            bool open = view.visible[bin / 64] >> bin % 64 & 1;
            bool hidden = view.blocked[bin / 64] >> bin % 64 & 1;
            assert_false(open && hidden);
            if (!more)
                assert_int_equal(prt_horizon_bin(horizon, t, bin), (int)open - (int)hidden);
            if (!open && !hidden) continue;
            float u = own, v = beside;
            if (!more) u = prt_rng_f32(&rng), v = prt_rng_f32(&rng) * (1 - u);
            unsigned above, hit = blocked_rays(scene, t, u, v, bin, &above);
            *(open ? &open_rays : &blocked) += above;
            *(open ? &open_wrong : &blocked_wrong) += open ? hit : above - hit;
            at_edges += at_edge(bin) ? above : 0;
        }
    }
    printf("visible bins: %.0f rays, %.4f %% blocked; blocked bins: %.0f rays, %.4f %% open\n",
           open_rays, 100 * open_wrong / open_rays, blocked, 100 * blocked_wrong / blocked);
    expect_above("rays into visible bins", open_rays, 1e5);
    expect_above("rays into blocked bins", blocked, 5e4);
    // a detail thinner than a bin may be missed
    expect_below("share of blocked rays in visible bins", open_wrong / open_rays, 1e-4);
    expect_below("share of open rays in blocked bins", blocked_wrong / blocked, 1e-4);
    // 124 of a face's 1024 bins: 12.1 %
    expect_above("share of bins at edges of faces", at_edges / (open_rays + blocked), 0.115);
    prt_horizon_destroy(horizon);
    prt_scene_destroy(scene);
    prt_mesh_destroy(mesh);
}

// Law: a ray into a bin that the horizon calls visible is not blocked, and one into a bin that
// it calls blocked is (METHODS §3.2, conservative visibility). Bins at the edge of a face,
// whose neighbours are on other faces, are certain as often as others.
static void certain_bins_are_certain(void **state)
{
    check_bins(body(), 0);
    check_bins(floor_under_plate(56), 0);
    check_bins(fluted(20), 20000);
    check_bins(floor_under_plate(7), 20000);
}

// The share of the rays through a square of wide x wide bins that are not blocked; negative
// where some are near or below the horizon.
static double open_share(const struct prt_scene *scene, uint32_t triangle, float u, float v,
                         unsigned bin, unsigned wide)
{
    double hit = 0;
    for (unsigned i = 0; i < wide * wide; i++) {
        unsigned above;
        hit += blocked_rays(scene, triangle, u, v, bin + i / wide * HORIZON_WIDE + i % wide,
                            &above);
        if (above < 16) return -1;
    }
    return 1 - hit / (16 * wide * wide);
}

// Law: the share of a square that a triangle's corners see is that of rays from between them,
// and it is linear between them (METHODS §3.5). Triangles that are divided have none.
static void shares_are_those_of_rays(void **state)
{
    struct prt_mesh *mesh = body(), *coarse = fluted(20);
    struct prt_scene *scene;
    struct horizon *horizon;
    struct prt_rng rng;
    double partly = 0, square = 0, sum = 0;
    const unsigned n_bin = 6 * HORIZON_WIDE * HORIZON_WIDE;
    assert_int_equal(prt_scene_create(&context, mesh, &scene), PRT_OK);
    assert_int_equal(prt_horizon_create(scene, 0, &horizon), PRT_OK);
    prt_rng_init(&rng, 12, 0);
    for (uint32_t t = 5; t < mesh->n_triangle; t += 13)
        for (unsigned draw = 0; draw < 12; draw++) {
            const unsigned wide = 1u << draw % 3;
            unsigned bin = prt_rng_u32(&rng) % n_bin;
            bin -= bin % wide + bin / HORIZON_WIDE % wide * HORIZON_WIDE;
            const float u = prt_rng_f32(&rng), v = prt_rng_f32(&rng) * (1 - u);
            const double got = (double)prt_horizon_share(horizon, t, u, v, bin, wide);
            const double corner[] = {(double)prt_horizon_share(horizon, t, 0, 0, bin, wide),
                                     (double)prt_horizon_share(horizon, t, 1, 0, bin, wide),
                                     (double)prt_horizon_share(horizon, t, 0, 1, bin, wide)};
            const double linear = (1 - (double)u - (double)v) * corner[0] +
                                  (double)u * corner[1] + (double)v * corner[2];
            expect_below("share less that between corners", fabs(got - linear), 1e-5);
            // any bin of the square names it
            const unsigned other = bin + wide - 1 + (wide - 1) * HORIZON_WIDE;
            assert_true(got == (double)prt_horizon_share(horizon, t, u, v, other, wide));
            const double want = open_share(scene, t, u, v, bin, wide);
            if (!(want > 0 && want < 1)) continue;
            partly++, square += (got - want) * (got - want), sum += got - want;
        }
    print_message("%.0f squares partly open: RMSE %.3f, mean %+.3f\n", partly,
                  sqrt(square / partly), sum / partly);
    expect_above("squares that are partly open", partly, 250);
    expect_below("RMSE of their shares", sqrt(square / partly), 0.13);
    expect_below("mean error of their shares", fabs(sum / partly), 0.03);
    prt_horizon_destroy(horizon);
    prt_scene_destroy(scene);
    assert_int_equal(prt_scene_create(&context, coarse, &scene), PRT_OK);
    assert_int_equal(prt_horizon_create(scene, 20000, &horizon), PRT_OK);
    assert_true(prt_horizon_share(horizon, coarse->n_triangle / 2, 0.2f, 0.2f, 0, 1) < 0);
    prt_horizon_destroy(horizon);
    prt_scene_destroy(scene);
    prt_mesh_destroy(mesh);
    prt_mesh_destroy(coarse);
}

// A face of 16 x 16 texels whose tiles are, in turn, one cell, four blocks, and blocks of which
// one is split; a cell has a linear function's value at its middle.
static void linear_face(uint32_t cell[256], float value[256])
{
    uint32_t n_cell = 0;
    for (uint32_t t = 0; t < 16; t++) {
        const uint32_t first = t / 4 * 64 + t % 4 * 4, kind = (t / 4 + t) % 3;
        for (uint32_t i = 0; i < 16; i++) {
            const uint32_t x = i % 4, y = i / 4, block = y / 2 * 2 + x / 2;
            const bool split = kind == 2 && block == 3;
            const uint32_t wide = kind == 0 ? 4 : split ? 1 : 2;
            const uint32_t own = kind == 0 ? 0 : split ? 3 + y % 2 * 2 + x % 2 : block;
            cell[first + y * 16 + x] = n_cell + own;
            const float middle_x = (float)(t % 4 * 4 + x / wide * wide) + 0.5f * (float)wide;
            const float middle_y = (float)(t / 4 * 4 + y / wide * wide) + 0.5f * (float)wide;
            value[first + y * 16 + x] = 1 + 0.25f * middle_x + 0.75f * middle_y;
        }
        n_cell += kind == 0 ? 1 : kind == 1 ? 4 : 7;
    }
}

// Law: texels of a block are bilinear between the means of blocks (METHODS §3.5); those of
// tiles and of split blocks stay as they were traced. Beyond a face's edge lies the block
// itself.
static void blocks_are_bilinear(void **state)
{
    uint32_t cell[256];
    float traced[256], value[256], mean[64], block[8][8];
    linear_face(cell, traced);
    memcpy(value, traced, sizeof value);
    prt_smooth_blocks(cell, 16, value, mean);
    for (uint32_t b = 0; b < 64; b++) {
        const float *at = traced + b / 8 * 32 + b % 8 * 2;
        block[b / 8][b % 8] = (at[0] + at[1] + at[16] + at[17]) / 4;
    }
    unsigned smooth = 0;
    for (uint32_t i = 0; i < 256; i++) {
        const uint32_t x = i % 16, y = i / 16, corner = (y & ~1u) * 16 + (x & ~1u);
        const uint32_t tile = (y & ~3u) * 16 + (x & ~3u);
        if (cell[tile] == cell[tile + 51] || cell[corner] != cell[corner + 17]) {
            assert_true(value[i] == traced[i]);
            continue;
        }
        // The middle of texel x lies between the middles of two blocks.
        const double u = fmin(fmax(((double)x + 0.5) / 2 - 0.5, 0), 7);
        const double v = fmin(fmax(((double)y + 0.5) / 2 - 0.5, 0), 7);
        const unsigned left = (unsigned)fmin(u, 6), top = (unsigned)fmin(v, 6);
        const double s = u - left, r = v - top;
        const double want =
            (1 - r) * ((1 - s) * (double)block[top][left] + s * (double)block[top][left + 1]) +
            r * ((1 - s) * (double)block[top + 1][left] + s * (double)block[top + 1][left + 1]);
        expect_close("value of a texel", (double)value[i], want, 1e-6);
        smooth++;
    }
    assert_true(smooth > 100);
}

// Clusters of made-up rows whose coefficients fall off at very different rates.
static struct factored *rows_of(uint32_t n_cluster, uint32_t n_vertex, uint32_t n, uint32_t J)
{
    uint32_t n_coef = 6 * n * n, rank = 4;
    struct factored *f = calloc(n_cluster, sizeof *f);
    struct prt_rng rng;
    assert_non_null(f);
    prt_rng_init(&rng, 3, 3);
    for (uint32_t c = 0; c < n_cluster; c++) {
        struct factored *own = &f[c];
        double loud = exp(4 * (double)prt_rng_f32(&rng));
        own->n_vertex = n_vertex, own->rank = rank;
        own->u = prt_calloc(rank * n_vertex, sizeof *own->u);
        own->b = prt_alloc(rank * J * n_coef, sizeof *own->b);
        own->scale = prt_alloc(rank * J, sizeof *own->scale);
        own->energy = prt_calloc(rank * n_coef, sizeof *own->energy);
        own->tail = calloc(rank + 1, sizeof *own->tail);
        assert_true(own->u && own->b && own->scale && own->energy && own->tail);
        for (uint32_t i = 0; i < rank * J; i++) own->scale[i] = 1;
        for (uint32_t r = rank; r-- > 0;) {
            own->tail[r] = own->tail[r + 1];
            own->u[r * n_vertex + r] = 1;
            for (uint32_t k = 0; k < n_coef; k++) {
                double x = loud * exp(-8 * (double)prt_rng_f32(&rng) - r);
                own->energy[r * n_coef + k] = (float)(x * x);
                own->tail[r] += x * x;
                for (uint32_t j = 0; j < J; j++)
                    own->b[((size_t)r * J + j) * n_coef + k] = prt_f32_to_f16((float)x);
            }
        }
    }
    return f;
}

// Law: the multiplier of energy + lambda * bytes fills the byte budget and no more (METHODS
// §3.4).
static void the_bytes_allowed_are_used(void **state)
{
    enum { CLUSTERS = 67, VERTICES = 40, N = 16, J = 3 };
    struct prt_cluster cluster[CLUSTERS];
    uint32_t order[CLUSTERS * VERTICES];
    for (uint32_t i = 0; i < CLUSTERS * VERTICES; i++) order[i] = i;
    for (uint32_t c = 0; c < CLUSTERS; c++)
        cluster[c] = (struct prt_cluster){c * VERTICES, VERTICES, 0, 0, 0};
    uint32_t object[CLUSTERS] = {0};
    struct clusters clusters = {
        .n_cluster = CLUSTERS, .cluster = cluster, .object = object, .order = order};
    struct factored *f = rows_of(CLUSTERS, VERTICES, N, J);
    static const double budget[] = {2e5, 6e5, 1e12};
    for (int i = 0; i < 3; i++) {
        struct pack_options o = {.energy_error = i < 2 ? 1e-4 : 0.05, .max_bytes = budget[i]};
        struct prt_tensor t;
        uint64_t u_bytes, row_bytes;
        assert_int_equal(prt_pack_factored(&context, &clusters, f, J, N, &o, &t), PRT_OK);
        prt_tensor_bytes(&t, &u_bytes, &row_bytes);
        // Energies lost: all less what is kept.
        double total = 0, kept = 0;
        for (uint32_t c = 0; c < CLUSTERS; c++) total += f[c].tail[0];
        for (uint32_t c = 0; c < CLUSTERS; c++)
            for (uint32_t r = 0; r < t.cluster[c].rank; r++) {
                uint32_t row = t.cluster[c].row_begin + r;
                const float *e = f[c].energy + (size_t)r * 6 * N * N;
                for (uint32_t k = 0; k < 6; k++) kept += (double)e[k * N * N];
                const uint16_t *index = t.rows.index;
                for (uint64_t at = t.rows.begin[row]; at < t.rows.begin[row + 1]; at++)
                    if (at == t.rows.begin[row] || index[at] != index[at - 1]) // no half pair
                        kept += (double)e[index[at]];
            }
        double bytes =
            (double)t.rows.begin[t.rows.n_row] * (2 + 2 * J) + t.rows.n_row * (16.0 * J + 8);
        for (uint32_t c = 0; c < CLUSTERS; c++) // rows of U lie in pairs
            bytes += (t.cluster[c].rank + 1) / 2 * 4.0 * VERTICES;
        double error = sqrt((total - kept) / total);
        printf("budget %.0f: %.0f bytes, %.4f lost\n", budget[i], bytes, error);
        assert_true(bytes <= budget[i]);
        if (i < 2) expect_near("bytes over the budget", bytes / budget[i], 1, 0.005);
        else expect_near("energy lost without a budget", error, 0.05, 1e-4);
        prt_tensor_finish(&t);
    }
    for (uint32_t c = 0; c < CLUSTERS; c++) prt_factored_finish(&f[c]);
    free(f);
}

// Law: S_j is the integral of B_j(s + s') F_t V along the path (METHODS §4, X07 eq 15), also
// where the path's steps are below the resolution of s + s': in a body that intersects itself
// the last nodes lie outside, have no exit, and the length of a missed ray.
static void short_steps_of_long_paths(void **state)
{
    enum { NODES = 6, DARK = 3 };
    const float depth[NODES] = {2.07e-4f, 3.52e-4f, 5.97e-4f, 1.015e-3f, 1.725e-3f, 2.931e-3f};
    const float length = 3.99f, end = 3.45e-3f, light[3] = {1, 1, 1};
    const struct prt_radial_options o = {.kind = PRT_RADIAL_REDUCED,
                                         .family = PRT_FAMILY_EXTINCTION,
                                         .eta = 1.3,
                                         .radius_mm = 100,
                                         .max_error = 0.002};
    struct prt_radial *radial;
    struct extinction_table *table;
    struct fresnel_table fresnel;
    assert_int_equal(prt_radial_create(&context, &o, &radial), PRT_OK);
    assert_int_equal(prt_extinction_table_create(radial, &table), PRT_OK);
    prt_fresnel_table_init(&fresnel, 1.3);
    float path_mm[NODES], open[NODES], up[3] = {0, 0, 1}, cosine = 1, lit = 0.96f;
    struct scratch s = {.cosine = &cosine};
    s.node = s.of_eta[0];
    for (int a = 0; a < NODES; a++) {
        path_mm[a] = a < DARK ? length - depth[a] : 1e4f;
        open[a] = a < DARK ? lit : 0;
        s.node[a] = (struct exits){&path_mm[a], &open[a], {&up[0], &up[1], &up[2]}};
    }
    cosine = -1; // a ray that begins behind the tangent plane: s + s' goes on to depth 0
    struct single_plan plan = {
        .cpu = context.cpu, .n_node = NODES, .n_phase = 1, .extinction = table};
    float out[EXTINCTION_WIDE][3] = {{0}}, value[EXTINCTION_WIDE];
    const struct path_job job = {&plan, &fresnel, &s, depth, end, 1, light, out[0]};
    prt_path_integrate(&job);
    prt_radial_eval(radial, 1, &length, value);
    // lit to the last node with light, and half of the way to the next
    double way =
        (double)depth[DARK - 1] + 0.5 * ((double)depth[DARK] - (double)depth[DARK - 1]);
    double most = 0, off = 0;
    for (uint32_t j = 0; j < radial->n_function; j++) {
        double want = (double)value[j] * (double)lit * way * sqrt(0.25 / M_PI);
        assert_true(isfinite(out[j][0]));
        most = fmax(most, fabs(want));
        off = fmax(off, fabs((double)out[j][0] - want));
    }
    // the table of integrals has a point each 2 % of s + s', between which B_j is constant
    expect_below("error of S_j, of the largest", off / most, 0.05);
    prt_extinction_table_destroy(table);
    prt_radial_destroy(radial);
}

static double area_of(const float *a, const float *b, const float *c)
{
    double n[3];
    for (int k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        n[k] = (double)(b[i] - a[i]) * (double)(c[j] - a[j]) -
               (double)(b[j] - a[j]) * (double)(c[i] - a[i]);
    }
    return sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / 2;
}

// Law: of a triangle in 4^L parts the three places around a point are the corners of one part,
// which holds the point, and a place has a unit normal (METHODS §3.2).
static void places_are_corners_of_the_part(void **state)
{
    struct prt_mesh *mesh = fluted(8);
    struct horizon_places p;
    struct prt_rng rng;
    unsigned divided = 0;
    prt_rng_init(&rng, 3, 0);
    assert_int_equal(
        prt_horizon_places_create(mesh, 0.02 * prt_mesh_diagonal(mesh), 1 << 20, &p), PRT_OK);
    for (uint32_t t = 0; t < mesh->n_triangle; t++) {
        const uint32_t *v = mesh->triangle[t];
        const double all =
            area_of(mesh->position[v[0]], mesh->position[v[1]], mesh->position[v[2]]);
        if (p.level[t] == UINT8_MAX || !(all > 1e-6)) continue;
        divided += p.level[t] > 1;
        for (int i = 0; i < 40; i++) {
            const float a = prt_rng_f32(&rng), b = prt_rng_f32(&rng);
            const float u = a + b > 1 ? 1 - a : a, w = a + b > 1 ? 1 - b : b;
            float at[3], unused[2][3];
            const float *corner[3], *normal;
            uint32_t around[3];
            assert_true(prt_horizon_places_around(&p, t, u, w, around));
            for (int k = 0; k < 3; k++) {
                prt_horizon_place(&p, around[k], &corner[k], &normal);
                expect_near(
                    "length of a place's normal",
                    hypot(hypot((double)normal[0], (double)normal[1]), (double)normal[2]), 1,
                    1e-5);
            }
            place(mesh, t, u, w, at, unused[0], unused[1]);
            const double part = area_of(corner[0], corner[1], corner[2]);
            expect_close("area of a part times 4^L", part * (1 << 2 * p.level[t]), all, 1e-3);
            expect_close("areas about a point of the part",
                         area_of(at, corner[1], corner[2]) + area_of(corner[0], at, corner[2]) +
                             area_of(corner[0], corner[1], at),
                         part, 5e-3);
        }
    }
    assert_true(divided > mesh->n_triangle / 4);
    prt_horizon_places_finish(&p);
    prt_mesh_destroy(mesh);
}

int main(void)
{
    prt_context_init(&context);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(known_directions_take_no_rays),
        cmocka_unit_test(few_rays_give_the_mean),
        cmocka_unit_test(certain_bins_are_certain),
        cmocka_unit_test(shares_are_those_of_rays),
        cmocka_unit_test(blocks_are_bilinear),
        cmocka_unit_test(the_bytes_allowed_are_used),
        cmocka_unit_test(short_steps_of_long_paths),
        cmocka_unit_test(places_are_corners_of_the_part),
    };
    return run_physics_tests(tests, NULL, NULL);
}
