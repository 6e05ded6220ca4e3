// SPDX-License-Identifier: MIT
// Fetches the model: geometry as a mesh for the raster room, environments, and colours under a
// light.
#include "preview.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int fail(const char *text)
{
    fprintf(stderr, "relight-preview: %s\n", text);
    return EXIT_FAILED;
}

// Blocks of the answer, checked: the raster room trusts its mesh.
static bool put_blocks(const struct relight_geometry *g, struct prt_mesh *m)
{
    for (uint32_t i = 0; i < m->n_block; i++) {
        const struct relight_block *b = g->block + i;
        if (b->vertex_begin > g->n_vertex || b->n_vertex > g->n_vertex - b->vertex_begin ||
            b->triangle_begin > g->n_triangle ||
            b->n_triangle > g->n_triangle - b->triangle_begin)
            return false;
        m->block[i] = (struct prt_block){
            b->object, i, b->vertex_begin, b->n_vertex, b->triangle_begin, b->n_triangle};
        struct prt_surface *s = m->surface + i;
        *s = (struct prt_surface){.translucent = b->translucent, .roughness = 1, .ior = 1.5f};
        snprintf(s->name, sizeof s->name, "%s", b->surface);
        memcpy(s->base_color, b->base_color, sizeof b->base_color);
        s->base_color[3] = 1;
        if (b->object >= g->n_block) return false;
        snprintf(m->object[b->object].name, sizeof m->object[0].name, "%s", b->node);
    }
    return true;
}

static int count_objects(struct prt_mesh *m)
{
    for (uint32_t i = 0; i < m->n_block; i++)
        if (m->block[i].object >= m->n_object) m->n_object = m->block[i].object + 1;
    return EXIT_DONE;
}

static int make_mesh(struct scene *scene)
{
    const struct relight_geometry *g = &scene->geometry;
    struct prt_mesh *m = &scene->mesh;
    if (!g->n_block || !g->n_triangle || !g->normal) return fail("the model has no triangles");
    *m = (struct prt_mesh){.n_vertex = g->n_vertex,
                           .n_triangle = g->n_triangle,
                           .n_block = (uint32_t)g->n_block,
                           .n_surface = (uint32_t)g->n_block,
                           .n_weld = g->n_vertex,
                           .mm_per_unit = (float)g->mm_per_unit};
    m->position = prt_alloc(g->n_vertex, 12);
    m->normal = prt_alloc(g->n_vertex, 12);
    m->triangle = prt_alloc(g->n_triangle, 12);
    m->weld = prt_alloc(g->n_vertex, 4);
    m->block = prt_calloc(g->n_block, sizeof *m->block);
    m->surface = prt_calloc(g->n_block, sizeof *m->surface);
    m->object = prt_calloc(g->n_block, sizeof *m->object); // there are no more than blocks
    if (!m->position || !m->normal || !m->triangle || !m->weld || !m->block || !m->surface ||
        !m->object)
        return fail("not enough memory for the model");
    memcpy(m->position, g->position, 12 * (size_t)g->n_vertex);
    memcpy(m->normal, g->normal, 12 * (size_t)g->n_vertex);
    memcpy(m->triangle, g->triangle, 12 * (size_t)g->n_triangle);
    for (uint32_t i = 0; i < g->n_vertex; i++) m->weld[i] = i;
    if (!put_blocks(g, m)) return fail("the model's blocks do not fit its vertices");
    if (scene->options->no_textures) return count_objects(m);
    int status = scene_textures(scene);
    if (status) return status;
    return count_objects(m);
}

// The camera of options->camera_name.
static int find_camera(struct scene *scene)
{
    const struct options *o = scene->options;
    struct prt_mesh_camera list[PRT_MESH_MOST_CAMERAS];
    struct prt_mesh mesh = {.camera = list};
    struct relight_error error;
    struct relight_model info;
    if (!o->camera_name) return EXIT_DONE;
    if (relight_info(scene->client, o->model, &info, &error)) return report(&error);
    for (size_t i = 0; i < info.n_camera && i < PRT_MESH_MOST_CAMERAS; i++) {
        const struct relight_named_camera *c = &info.camera[i];
        struct prt_mesh_camera *to = &list[mesh.n_camera++];
        *to = (struct prt_mesh_camera){.fovy_deg = c->fovy_deg};
        snprintf(to->name, sizeof to->name, "%s", c->name);
        memcpy(to->eye, c->eye, sizeof to->eye);
        memcpy(to->target, c->target, sizeof to->target);
        memcpy(to->up, c->up, sizeof to->up);
    }
    relight_model_finish(&info);
    return prt_camera_named(&scene->ctx, &mesh, o->camera_name, &scene->named) ? EXIT_USAGE
                                                                               : EXIT_DONE;
}

static int find_sky(struct scene *scene, const char *word, struct sky *sky)
{
    struct relight_error error;
    if (relight_env_resolve(scene->client, word, NULL, NULL, sky->word, &error))
        return report(&error);
    if (!strncmp(word, "env:", 4)) return EXIT_DONE; // the daemon does not send images back
    return prt_env_load(&scene->ctx, word, &sky->env) ? EXIT_FAILED : EXIT_DONE;
}

int scene_fetch(struct scene *scene)
{
    struct relight_error error;
    const struct options *o = scene->options;
    if (relight_geometry_textured(scene->client, o->model, false, &scene->geometry, &error))
        return report(&error);
    int status = make_mesh(scene);
    if (!status) status = scene_media(scene, o->n_try ? o->attempt[0] : NULL);
    if (!status) status = find_camera(scene);
    for (size_t i = 0; !status && i < o->n_env; i++)
        status = find_sky(scene, o->env[i], scene->sky + i);
    return status;
}

void scene_finish(struct scene *scene)
{
    struct prt_mesh *m = &scene->mesh;
    prt_free(m->position);
    prt_free(m->normal);
    prt_free(m->triangle);
    prt_free(m->weld);
    prt_free(m->block);
    prt_free(m->surface);
    prt_free(m->object);
    scene_media_finish(scene);
    scene_textures_finish(scene);
    for (int i = 0; i < MAX_ENV; i++)
        if (scene->sky[i].env) prt_env_destroy(scene->sky[i].env);
    relight_geometry_finish(&scene->geometry);
}

int scene_colors_begin(struct scene *scene, const struct sky *sky, double rotate_deg,
                       const float eye[3], struct colors_pending *pending)
{
    static const enum relight_term terms[2] = {RELIGHT_TERM_MULTIPLE, RELIGHT_TERM_SINGLE};
    struct relight_error error;
    struct relight_light light = {.env = sky->word, .rotate_deg = (float)rotate_deg};
    struct relight_colors_request request = {.model = scene->options->model,
                                             .n_light = 1,
                                             .lights = &light,
                                             .shade = scene->shade,
                                             .format = scene->options->format};
    for (int i = 0; i < 2; i++) {
        request.shade.term = terms[i];
        if (i == 1 && scene->anisotropic) {
            request.shade.term = RELIGHT_TERM_TOTAL;
            request.shade.has_eye = true;
            memcpy(request.shade.eye, eye, sizeof request.shade.eye);
        }
        if (relight_colors_begin(scene->client, &request, 0, pending->id + i, &error))
            return report(&error);
    }
    memcpy(pending->eye, eye, sizeof pending->eye);
    pending->begun = true;
    return EXIT_DONE;
}

// The total towards the eye divided by the vertex's exit factor F_t / T, which drawing
// multiplies by again at each pixel. A vertex that faces away keeps the other terms alone.
static void divide_total(const struct scene *scene, const struct prt_block *b,
                         const float eye[3], const float *total, float *plane)
{
    const struct prt_mesh *m = &scene->mesh;
    const double eta = (double)prt_media_of(scene->media, b->object)->eta;
    for (size_t v = b->vertex_begin; v < b->vertex_begin + (size_t)b->n_vertex; v++) {
        double length = 0, cosine = 0, transmittance = 1;
        for (int c = 0; c < 3; c++) {
            double d = (double)eye[c] * (double)m->mm_per_unit - (double)m->position[v][c];
            length += d * d;
            cosine += d * (double)m->normal[v][c];
        }
        cosine /= sqrt(length);
        if (m->surface[b->surface].translucent)
            transmittance = cosine > 0 ? prt_fresnel_transmittance(eta, cosine) /
                                             prt_exit_divisor(eta, PRT_EXIT_NORMALISED)
                                       : 0;
        for (size_t i = 3 * v; i < 3 * v + 3; i++)
            if (transmittance > 0.01) plane[i] = total[i] / (float)transmittance;
    }
}

// Adds single scattering, times the exit's divisor as planes of prt_shade have it, to the other
// terms in plane 0. An isotropic medium's is corrected here
// for every view, which takes four planes.
static int add_single(struct scene *scene, const struct colors_pending *pending, float *single,
                      float *plane)
{
    const struct prt_mesh *m = &scene->mesh;
    const size_t n = 3 * (size_t)m->n_vertex;
    if (scene->anisotropic) {
        for (uint32_t i = 0; i < m->n_block; i++)
            divide_total(scene, m->block + i, pending->eye, single, plane);
        memset(plane + n, 0, 3 * n * sizeof *plane);
        return EXIT_DONE;
    }
    for (uint32_t k = 0; k < m->n_block; k++) {
        const struct prt_block *b = &m->block[k];
        const double eta = (double)prt_media_of(scene->media, b->object)->eta;
        const float gain = (float)prt_exit_divisor(eta, PRT_EXIT_NORMALISED);
        const size_t end = 3 * ((size_t)b->vertex_begin + b->n_vertex);
        for (size_t i = 3 * (size_t)b->vertex_begin; i < end; i++) {
            float other = plane[i];
            plane[i] = gain * single[i];
            single[i] = other;
        }
        if (prt_view_correct(&scene->ctx, m->n_vertex, b->vertex_begin,
                             b->vertex_begin + b->n_vertex, (const float(*)[3])m->normal, eta,
                             1, 4, plane))
            return EXIT_FAILED;
    }
    for (size_t i = 0; i < n; i++) plane[i] += single[i];
    return EXIT_DONE;
}

int scene_colors_end(struct scene *scene, struct colors_pending *pending, float *plane)
{
    int status = EXIT_DONE;
    size_t n = 3 * (size_t)scene->mesh.n_vertex;
    float *single = prt_alloc(n, sizeof *single);
    pending->begun = false;
    for (int i = 0; i < 2; i++) {
        struct relight_error error;
        struct relight_colors colors;
        if (relight_colors_end(scene->client, pending->id[i], &colors, &error)) {
            if (!status) status = report(&error);
            continue;
        }
        if (!single || colors.n_vertex != scene->mesh.n_vertex)
            status = fail("the colours do not fit the model");
        else relight_colors_decode(&colors, 0, i ? single : plane);
        relight_colors_finish(&colors);
    }
    if (!status) status = add_single(scene, pending, single, plane);
    prt_free(single);
    return status;
}
