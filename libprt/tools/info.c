// SPDX-License-Identifier: MIT
// prt info: prints the contents of a .prt, a model or an environment, as text or JSON.
#include "tool.h"
#include "walk_ratio.h"
#include "prt/eta_nodes.h"
#include "prt/radial.h"
#include "prt/walk_grid.h"

#include <cjson/cJSON.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

static void add_vector(cJSON *to, const char *name, const float *v, int n)
{
    double d[4];
    for (int i = 0; i < n; i++) d[i] = (double)v[i];
    cJSON_AddItemToObject(to, name, cJSON_CreateDoubleArray(d, n));
}

static void add_parsed(cJSON *to, const char *name, const char *json)
{
    cJSON *item = json && *json ? cJSON_Parse(json) : NULL;
    cJSON_AddItemToObject(to, name, item ? item : cJSON_CreateNull());
}

static void add_maps(cJSON *surface, const struct prt_mesh *m, uint32_t i)
{
    static const char *const name[PRT_N_MAP] = {"base", "normal", "roughness", "occlusion",
                                                "emissive"};
    cJSON *maps = NULL;
    for (int k = 0; m->maps && k < PRT_N_MAP; k++) {
        const struct prt_texture_ref *ref = &m->maps[i].map[k];
        if (ref->image == UINT32_MAX) continue;
        if (!maps) maps = cJSON_AddObjectToObject(surface, "maps");
        cJSON_AddNumberToObject(maps, name[k], ref->image);
    }
}

// The medium that the file's material becomes, lengths in units of the file's.
static void add_volume(cJSON *surface, const struct prt_mesh *m, uint32_t i)
{
    if (!m->volume || !m->volume[i].kind) return;
    const struct prt_volume *v = &m->volume[i];
    cJSON *o = cJSON_AddObjectToObject(surface, "volume");
    cJSON_AddStringToObject(o, "attenuates",
                            v->kind == PRT_VOLUME_SCATTER ? "sigma_t" : "sigma_a");
    add_vector(o, "color", v->color, 3);
    add_vector(o, "albedo", v->albedo, 3);
    cJSON_AddNumberToObject(o, "distance", (double)v->distance);
    cJSON_AddNumberToObject(o, "g", (double)v->g);
    cJSON_AddNumberToObject(o, "eta", (double)m->surface[i].ior);
}

static void add_images(cJSON *to, const struct prt_mesh *m)
{
    static const char *const kind[PRT_TEXTURE_N_KIND] = {"color", "data", "normal"};
    cJSON *list = cJSON_AddArrayToObject(to, "images");
    for (uint32_t i = 0; i < m->n_image; i++) {
        const struct prt_texture_image *image = &m->image[i];
        cJSON *o = cJSON_CreateObject();
        char hash[40];
        snprintf(hash, sizeof hash, "%016llx%016llx", (unsigned long long)image->hash[1],
                 (unsigned long long)image->hash[0]);
        cJSON_AddNumberToObject(o, "width", image->width);
        cJSON_AddNumberToObject(o, "height", image->height);
        cJSON_AddStringToObject(o, "kind", kind[image->kind]);
        cJSON_AddStringToObject(o, "hash", hash);
        cJSON_AddItemToArray(list, o);
    }
}

static void add_mesh(cJSON *root, const struct prt_mesh *mesh)
{
    cJSON *m = cJSON_AddObjectToObject(root, "mesh");
    float box[2][3];
    uint32_t translucent = 0;
    for (uint32_t i = 0; i < mesh->n_block; i++)
        translucent += mesh->surface[mesh->block[i].surface].translucent != 0;
    prt_mesh_bounds(mesh, box);
    cJSON_AddNumberToObject(m, "vertices", mesh->n_vertex);
    cJSON_AddNumberToObject(m, "welded", mesh->n_weld);
    cJSON_AddNumberToObject(m, "triangles", mesh->n_triangle);
    cJSON_AddNumberToObject(m, "blocks", mesh->n_block);
    cJSON_AddNumberToObject(m, "translucent_blocks", translucent);
    cJSON_AddNumberToObject(m, "objects", mesh->n_object);
    cJSON_AddNumberToObject(m, "boundary_edges", mesh->n_boundary_edge);
    cJSON_AddNumberToObject(m, "nonmanifold_edges", mesh->n_nonmanifold_edge);
    cJSON_AddNumberToObject(m, "degenerate_triangles", mesh->n_degenerate_triangle);
    cJSON_AddBoolToObject(m, "texture_coordinates", mesh->uv != NULL);
    add_vector(m, "box_min", box[0], 3);
    add_vector(m, "box_max", box[1], 3);
    cJSON_AddNumberToObject(m, "diagonal", prt_mesh_diagonal(mesh));
    cJSON_AddStringToObject(m, "units",
                            mesh->mm_per_unit > 0 ? "mm"
                            : mesh->units_known   ? "m"
                                                  : "unknown");
    if (mesh->mm_per_unit > 0)
        cJSON_AddNumberToObject(m, "mm_per_unit", (double)mesh->mm_per_unit);
    cJSON *surfaces = cJSON_AddArrayToObject(m, "surfaces");
    for (uint32_t i = 0; i < mesh->n_surface; i++) {
        cJSON *s = cJSON_CreateObject();
        cJSON_AddStringToObject(s, "name", mesh->surface[i].name);
        cJSON_AddBoolToObject(s, "translucent", mesh->surface[i].translucent);
        add_maps(s, mesh, i);
        add_volume(s, mesh, i);
        cJSON_AddItemToArray(surfaces, s);
    }
    if (mesh->n_uv > 1) cJSON_AddNumberToObject(m, "uv_sets", mesh->n_uv);
    if (mesh->color) cJSON_AddBoolToObject(m, "vertex_colors", true);
    if (mesh->n_image) add_images(m, mesh);
    if (mesh->texture_split > 0)
        cJSON_AddNumberToObject(m, "texture_split", (double)mesh->texture_split);
}

// The default camera of a picture of 800x600 and the file's own, each as --camera takes it.
static void add_cameras(cJSON *root, const struct prt_mesh *mesh)
{
    cJSON *list = cJSON_AddObjectToObject(root, "cameras");
    struct prt_camera c;
    char text[256];
    prt_camera_frame(mesh, 4.f / 3, &c);
    prt_camera_print(&c, text, sizeof text);
    cJSON_AddStringToObject(list, "framed (default, --orbit 0,15)", text);
    for (uint32_t i = 0; i < mesh->n_camera; i++) {
        (void)prt_camera_named(NULL, mesh, mesh->camera[i].name, &c);
        prt_camera_print(&c, text, sizeof text);
        cJSON_AddStringToObject(list, mesh->camera[i].name, text);
    }
}

// Names for --variant.
static void add_variants(cJSON *root, const struct prt_mesh *mesh)
{
    cJSON *variants = mesh->n_variant ? cJSON_AddArrayToObject(root, "variants") : NULL;
    for (uint32_t i = 0; i < mesh->n_variant; i++)
        cJSON_AddItemToArray(variants, cJSON_CreateString(mesh->variant[i].name));
}

enum { MAX_LINE = 512 };

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    snprintf(user, MAX_LINE, "%s", line);
}

// Why the .prt does not answer for some of its variants, by name.
static void add_own_bakes(cJSON *root, const char *path, const struct prt_transport *t)
{
    cJSON *list = NULL;
    for (uint32_t i = 0; i < t->mesh.n_variant; i++) {
        char line[MAX_LINE] = "";
        const struct prt_context ctx = {.log = keep_line, .log_user = line};
        struct prt_variant *view = NULL;
        (void)prt_variant_create(&ctx, path, &t->mesh, &t->media, prt_transport_variants(t),
                                 t->mesh.variant[i].name, &view);
        if (view) {
            prt_variant_destroy(view);
            continue;
        }
        if (!list) list = cJSON_AddObjectToObject(root, "variants_not_baked");
        cJSON_AddStringToObject(list, t->mesh.variant[i].name, line);
    }
}

// Durations in seconds by name, for --animation and --time.
static void add_animations(cJSON *root, const struct prt_mesh *mesh)
{
    cJSON *list = mesh->n_animation ? cJSON_AddObjectToObject(root, "animations_s") : NULL;
    for (uint32_t i = 0; i < mesh->n_animation; i++)
        cJSON_AddNumberToObject(list, mesh->animation[i].name,
                                round((double)mesh->animation[i].duration_s * 1e6) * 1e-6);
}

// Ranks of the clusters that have any: dense numbers a vertex.
static void add_ranks(cJSON *o, const struct prt_tensor *t)
{
    enum { BIN = 8, BINS = 16 };
    int bins[BINS] = {0}, last = 0;
    uint32_t low = UINT32_MAX, high = 0;
    double weighted = 0, vertices = 0;
    for (uint32_t i = 0; i < t->n_cluster; i++) {
        uint32_t rank = t->cluster[i].rank, bin = rank / BIN < BINS ? rank / BIN : BINS - 1;
        if (!rank) continue;
        low = rank < low ? rank : low;
        high = rank > high ? rank : high;
        weighted += (double)rank * t->cluster[i].n_vertex;
        vertices += t->cluster[i].n_vertex;
        bins[bin]++;
        last = (int)bin > last ? (int)bin : last;
    }
    if (!high || t->storage != PRT_STORAGE_FACTORED) return;
    cJSON *r = cJSON_AddObjectToObject(o, "cluster_rank");
    cJSON_AddNumberToObject(r, "min", low);
    cJSON_AddNumberToObject(r, "mean", round(1000 * weighted / vertices) / 1000);
    cJSON_AddNumberToObject(r, "max", high);
    cJSON_AddItemToObject(r, "histogram_by_8", cJSON_CreateIntArray(bins, last + 1));
}

static double rounded_eta(float eta)
{
    return round((double)eta * 1e4) / 1e4;
}

// The indices that a tensor for any index serves, its nodes and the worst error of their
// weights, over eleven indices.
static void add_eta(cJSON *o, const struct prt_tensor *t, enum prt_radial_family family)
{
    struct prt_eta_nodes nodes;
    double weight[PRT_ETA_MOST_NODES], worst = 0, error;
    if (prt_eta_nodes_from_axis(t->n_eta, t->eta, &nodes)) return;
    cJSON *range = cJSON_AddArrayToObject(o, "eta_range"), *all;
    for (uint32_t i = 0; i < 2; i++)
        cJSON_AddItemToArray(range, cJSON_CreateNumber(rounded_eta(t->eta[i])));
    all = cJSON_AddArrayToObject(o, "eta_nodes");
    for (uint32_t i = 0; i < nodes.n; i++)
        cJSON_AddItemToArray(all, cJSON_CreateNumber(rounded_eta(nodes.node[i])));
    for (int i = 0; i <= 10; i++) {
        const double eta = (double)nodes.low + i / 10.0 * (double)(nodes.high - nodes.low);
        if (!prt_eta_weights(family, &nodes, eta, weight, &error)) worst = fmax(worst, error);
    }
    cJSON_AddNumberToObject(o, "eta_worst_error", worst);
}

// Error of the tensor's radial basis (METHODS §4's weighted L1) for the twelve measured media
// at the bake's eta, or at their own where it serves any, and for its whole range.
static int add_basis(struct tool *tool, cJSON *o, const struct prt_transport *transport,
                     const struct prt_tensor *t)
{
    static const char *const kinds[] = {"reduced", "polynomial", "hat", "x07"};
    struct prt_radial *radial;
    const struct prt_material *preset;
    float coef[3 * 64];
    double worst = 0, mean = 0;
    int status = prt_tensor_radial(&tool->ctx, transport, t, &radial), n = 0;
    if (status) return status;
    cJSON *b = cJSON_AddObjectToObject(o, "basis");
    cJSON_AddStringToObject(b, "kind", kinds[radial->kind & 3]);
    cJSON_AddStringToObject(b, "of",
                            radial->family == PRT_FAMILY_EXTINCTION ? "e^(-sigma_t r)" : "R_d");
    cJSON_AddNumberToObject(b, "functions", radial->n_function);
    cJSON_AddNumberToObject(b, "radius_mm", (double)radial->r[radial->n_grid - 1]);
    bool dipole = radial->family == PRT_FAMILY_DIPOLE;
    cJSON_AddItemToObject(b, dipole ? "sigma_s_prime_range" : "sigma_t_range",
                          cJSON_CreateDoubleArray(radial->range[0], 2));
    if (dipole)
        cJSON_AddItemToObject(b, "sigma_a_range", cJSON_CreateDoubleArray(radial->range[1], 2));
    if (t->n_eta) add_eta(b, t, dipole ? PRT_FAMILY_DIPOLE : PRT_FAMILY_EXTINCTION);
    cJSON_AddNumberToObject(b, "range_mean_error", radial->mean_error);
    cJSON_AddNumberToObject(b, "range_worst_error", radial->worst_error);
    cJSON *all = cJSON_AddObjectToObject(b, "preset_error");
    for (unsigned i = 0; !status && (preset = prt_material_preset(i)); i++) {
        struct prt_material m = *preset;
        double error = 0;
        if (!t->n_eta) m.eta = transport->media.medium[0].eta;
        if (!(status = prt_radial_fit_material(radial, &m, coef, &error)))
            cJSON_AddNumberToObject(all, m.name, error);
        worst = fmax(worst, error);
        mean += error;
        n++;
    }
    cJSON_AddNumberToObject(b, "preset_mean_error", mean / (n ? n : 1));
    cJSON_AddNumberToObject(b, "preset_worst_error", worst);
    prt_radial_destroy(radial);
    return status;
}

// The grid of media whose walks a tensor holds, and the error of the measured media in it.
static void add_walk_basis(cJSON *o, const struct prt_transport *transport,
                           const struct prt_tensor *t)
{
    double weight[PRT_WALK_MOST_LEVELS * PRT_WALK_MOST_NODES], worst = 0, mean = 0;
    const struct prt_material *preset;
    struct prt_walk_grid grid;
    int n = 0;
    if (prt_walk_grid_from_axes(t->n_knot, t->knot, &grid)) return;
    cJSON *b = cJSON_AddObjectToObject(o, "basis");
    cJSON_AddStringToObject(b, "kind", "walk");
    cJSON_AddStringToObject(b, "of", "walks of a grid of media");
    cJSON_AddNumberToObject(b, "functions", t->n_radial);
    cJSON_AddItemToObject(b, "sigma_s_prime",
                          cJSON_CreateFloatArray(grid.level, (int)grid.n_level));
    cJSON_AddItemToObject(b, "sigma_a", cJSON_CreateFloatArray(grid.node, (int)grid.n_node));
    cJSON *all = cJSON_AddObjectToObject(b, "preset_error");
    for (unsigned i = 0; (preset = prt_material_preset(i)); i++, n++) {
        double most = 0, error;
        for (int c = 0; c < 3; c++) {
            prt_walk_grid_weights(&grid, (double)transport->media.medium[0].eta,
                                  (double)preset->sigma_s_prime[c], (double)preset->sigma_a[c],
                                  weight, &error);
            most = fmax(most, error);
        }
        cJSON_AddNumberToObject(all, preset->name, most);
        worst = fmax(worst, most);
        mean += most;
    }
    cJSON_AddNumberToObject(b, "preset_mean_error", mean / (n ? n : 1));
    cJSON_AddNumberToObject(b, "preset_worst_error", worst);
}

static int add_tensor(struct tool *tool, cJSON *to, const struct prt_transport *transport,
                      const struct prt_tensor *t, uint64_t *total)
{
    static const char *const storages[] = {"factored", "sparse", "radial"};
    cJSON *o = cJSON_CreateObject();
    uint64_t u_bytes, row_bytes;
    prt_tensor_bytes(t, &u_bytes, &row_bytes);
    *total += u_bytes + row_bytes;
    uint64_t entries = t->rows.n_row ? t->rows.begin[t->rows.n_row] : 0;
    double rank = 0;
    for (uint32_t i = 0; i < t->n_cluster; i++)
        rank += (double)t->cluster[i].rank * t->cluster[i].n_vertex;
    static const char *const terms[] = {"multiple", "single", "unscattered", "view"};
    cJSON_AddStringToObject(o, "term", t->term < 4 ? terms[t->term] : "unknown");
    cJSON_AddStringToObject(o, "storage", t->storage < 3 ? storages[t->storage] : "unknown");
    cJSON_AddStringToObject(o, "coupling",
                            t->coupling == PRT_COUPLE_FULL ? "full" : "diagonal");
    cJSON_AddNumberToObject(o, "functions", t->n_function);
    cJSON_AddNumberToObject(o, "radial_functions", t->n_radial);
    if (t->n_eta) cJSON_AddNumberToObject(o, "eta_nodes", prt_tensor_eta_nodes(t));
    cJSON_AddNumberToObject(o, "phase_terms", t->n_phase);
    cJSON_AddNumberToObject(o, "clusters", t->n_cluster);
    if (t->n_cluster) cJSON_AddNumberToObject(o, "mean_rank", rank / t->n_vertex);
    cJSON_AddNumberToObject(o, "rows", t->rows.n_row);
    cJSON_AddNumberToObject(o, "entries", (double)entries);
    cJSON_AddStringToObject(o, "values",
                            t->rows.value == PRT_VALUE_I8     ? "i8"
                            : t->rows.value == PRT_VALUE_PAIR ? "i16"
                                                              : "f16");
    if (t->rows.direction && entries) // bytes an entry beside its index and shift
        cJSON_AddNumberToObject(o, "mean_directions",
                                (double)t->rows.value_begin[t->rows.n_row] / (double)entries);
    cJSON_AddNumberToObject(o, "u_bytes", (double)u_bytes);
    cJSON_AddNumberToObject(o, "row_bytes", (double)row_bytes);
    cJSON_AddNumberToObject(o, "bytes_per_vertex", (double)(u_bytes + row_bytes) / t->n_vertex);
    cJSON_AddItemToArray(to, o);
    add_ranks(o, t);
    if (t->basis_kind == PRT_RADIAL_WALK) {
        add_walk_basis(o, transport, t);
        return PRT_OK;
    }
    return t->n_knot ? add_basis(tool, o, transport, t) : PRT_OK;
}

// "media": each with the objects that have it; "material": the first of them.
static void add_baked_media(cJSON *root, const struct prt_mesh *mesh,
                            const struct prt_media *media)
{
    char text[PRT_MATERIAL_SUMMARY];
    prt_material_summary(&media->medium[0], text, sizeof text);
    add_parsed(root, "material", text);
    cJSON *list = cJSON_AddArrayToObject(root, "media");
    for (uint32_t i = 0; i < media->n; i++) {
        cJSON *o = cJSON_CreateObject();
        prt_material_summary(&media->medium[i], text, sizeof text);
        add_parsed(o, "material", text);
        cJSON *objects = cJSON_AddArrayToObject(o, "objects");
        for (uint32_t b = 0; b < mesh->n_block; b++) {
            const struct prt_block *block = &mesh->block[b];
            const struct prt_surface *s = &mesh->surface[block->surface];
            if (!s->translucent || prt_media_index(media, block->object) != i) continue;
            cJSON *object = cJSON_CreateObject();
            cJSON_AddNumberToObject(object, "object", block->object);
            cJSON_AddStringToObject(object, "node",
                                    mesh->object ? mesh->object[block->object].name : "");
            cJSON_AddStringToObject(object, "material", s->name);
            cJSON_AddItemToArray(objects, object);
        }
        cJSON_AddItemToArray(list, o);
    }
}

static int describe_prt(struct tool *tool, const char *path, cJSON *root)
{
    struct prt_file *file;
    int status = prt_file_open(&tool->ctx, path, PRT_FILE_CHECK_ALL, &file);
    if (status) return tool_exit(tool, status == PRT_ARG ? PRT_FORMAT : status);
    const struct prt_transport *t = prt_file_transport(file);
    char hash[24];
    uint64_t total = 0;
    cJSON_AddStringToObject(root, "kind", "prt");
    cJSON_AddStringToObject(root, "engine", source_engine_name(t));
    cJSON_AddNumberToObject(root, "cube", t->cube);
    cJSON_AddNumberToObject(root, "bytes", (double)prt_file_bytes(file));
    add_baked_media(root, &t->mesh, &t->media);
    snprintf(hash, sizeof hash, "%016llx", (unsigned long long)t->mesh_hash);
    cJSON_AddStringToObject(root, "mesh_hash", hash);
    add_mesh(root, &t->mesh);
    add_cameras(root, &t->mesh);
    add_variants(root, &t->mesh);
    add_own_bakes(root, path, t);
    cJSON *tensors = cJSON_AddArrayToObject(root, "tensors");
    for (uint32_t i = 0; i < t->n_tensor && !status; i++)
        status = add_tensor(tool, tensors, t, &t->tensor[i], &total);
    if (status) {
        prt_file_close(file);
        return tool_exit(tool, status);
    }
    cJSON_AddNumberToObject(root, "transport_bytes", (double)total);
    cJSON_AddNumberToObject(root, "bytes_per_vertex", (double)total / t->mesh.n_vertex);
    add_parsed(root, "errors", t->errors);
    add_parsed(root, "settings", t->settings);
    prt_file_close(file);
    return EXIT_DONE;
}

// The medium that each translucent surface's own material became, in the file's unit.
// Millimetres in a unit, as a bake with these options has them; 0: not known.
static double unit_mm(const struct options *o, const struct prt_mesh *mesh)
{
    if (o->mm_per_unit > 0) return o->mm_per_unit;
    if (o->size_mm > 0) return o->size_mm / prt_mesh_diagonal(mesh);
    return mesh->units_known ? 1000 : 0;
}

static void add_media(const struct tool *tool, cJSON *root, const struct prt_mesh *mesh)
{
    const double unit = unit_mm(&tool->opt, mesh);
    cJSON *list = cJSON_GetObjectItem(cJSON_GetObjectItem(root, "mesh"), "surfaces");
    for (uint32_t i = 0; mesh->volume && unit > 0 && i < mesh->n_surface; i++) {
        struct prt_material m;
        char text[PRT_MATERIAL_SUMMARY];
        if (!mesh->surface[i].translucent || !mesh->volume[i].kind ||
            !prt_media_of_surface(&tool->ctx, mesh, i, unit, &m))
            continue;
        prt_material_summary(&m, text, sizeof text);
        add_parsed(cJSON_GetArrayItem(list, (int)i), "medium", text);
    }
}

static int describe_materials(struct tool *tool, const char *path, cJSON *root)
{
    struct prt_import *item;
    unsigned n;
    int status = prt_material_import_file(&tool->ctx, path, 0, &item, &n);
    if (status) return tool_exit(tool, status);
    cJSON_AddStringToObject(root, "kind", "materials");
    cJSON *list = cJSON_AddArrayToObject(root, "materials");
    for (unsigned i = 0; i < n; i++) cJSON_AddItemToArray(list, describe_import(&item[i]));
    prt_free(item);
    return EXIT_DONE;
}

static int describe_model(struct tool *tool, const char *path, cJSON *root)
{
    struct prt_mesh *mesh;
    struct prt_mesh_options options = source_mesh_options(&tool->opt);
    int status = prt_mesh_load(&tool->ctx, path, &options, &mesh);
    if (status == PRT_ARG && (options.opaque || options.variant)) return EXIT_USAGE;
    if (status) return tool_exit(tool, status == PRT_ARG ? PRT_FORMAT : status);
    cJSON_AddStringToObject(root, "kind", "model");
    add_mesh(root, mesh);
    add_media(tool, root, mesh);
    add_cameras(root, mesh);
    add_variants(root, mesh);
    add_animations(root, mesh);
    prt_mesh_destroy(mesh);
    return EXIT_DONE;
}

// Where the dipole errs in these media: seconds of walks.
static int describe_dipole(struct tool *tool, const char *path, cJSON *root)
{
    struct source source;
    struct prt_walk_ratio *ratio = NULL;
    struct prt_walk_ratio_report report;
    int exit_status = source_open(tool, path, NULL, &source);
    if (exit_status) return exit_status;
    int status = ratio_create(tool, source.mesh, &source.media, &ratio, &report);
    if (!status) status = ratio_error_json(root, ratio, &report, source.mesh, &source.media);
    if (!status) ratio_json(root, &report);
    prt_walk_ratio_destroy(ratio);
    source_close(&source);
    return tool_exit(tool, status);
}

static int describe_env(struct tool *tool, const char *path, cJSON *root)
{
    struct prt_env *env;
    int status = tool_env_load(tool, path, &env);
    if (status) return tool_exit(tool, status == PRT_ARG ? PRT_FORMAT : status);
    bool latlong = env->kind == PRT_ENV_LATLONG;
    uint32_t w = latlong ? env->latlong.width : env->cube.n;
    uint32_t h = latlong ? env->latlong.height : env->cube.n;
    const float *value = latlong ? env->latlong.rgb : env->cube.texel;
    size_t n = (size_t)w * h * 3 * (latlong ? 1 : 6);
    double power[3], mean[3], top = 0;
    for (size_t i = 0; i < n; i++) top = fmax(top, (double)value[i]);
    env_power(env, power);
    for (int c = 0; c < 3; c++) mean[c] = power[c] / (4 * M_PI);
    cJSON_AddStringToObject(root, "kind", "environment");
    cJSON_AddStringToObject(root, "layout", latlong ? "latlong" : "cube");
    cJSON_AddNumberToObject(root, "width", w);
    cJSON_AddNumberToObject(root, "height", h);
    cJSON_AddNumberToObject(root, "full_cube", prt_env_full_cube(env));
    cJSON_AddItemToObject(root, "power", cJSON_CreateDoubleArray(power, 3));
    cJSON_AddItemToObject(root, "mean_radiance", cJSON_CreateDoubleArray(mean, 3));
    cJSON_AddNumberToObject(root, "max_radiance", top);
    cJSON_AddNumberToObject(root, "negative_pixels", env->n_negative);
    cJSON_AddNumberToObject(root, "nonfinite_pixels", env->n_nonfinite);
    prt_env_destroy(env);
    return EXIT_DONE;
}

// Plain text: `name: value`, nested objects indented, arrays of numbers on one line, of more
// than 32 their count.
static void print_text(const cJSON *item, int depth)
{
    for (const cJSON *c = item->child; c; c = c->next) {
        if (c->string) printf("%*s%s:", 2 * depth, "", c->string);
        if (cJSON_IsObject(c)) {
            if (c->string) putchar('\n');
            print_text(c, depth + 1);
            continue;
        }
        if (cJSON_IsArray(c) && c->child && cJSON_IsObject(c->child)) {
            putchar('\n');
            for (const cJSON *e = c->child; e; e = e->next) {
                printf("%*s-\n", 2 * depth + 2, "");
                print_text(e, depth + 2);
            }
            continue;
        }
        if (cJSON_IsArray(c) && cJSON_GetArraySize(c) > 32) {
            printf(" %d values (--json prints them)\n", cJSON_GetArraySize(c));
            continue;
        }
        char *text = cJSON_IsString(c) ? NULL : cJSON_PrintUnformatted(c);
        printf(" %s\n", text ? text : cJSON_IsString(c) ? c->valuestring : "");
        free(text);
    }
}

static bool ends_with_any(const char *path, const char *const *endings)
{
    size_t n = strlen(path);
    for (; *endings; endings++) {
        size_t m = strlen(*endings);
        if (n > m && !strcasecmp(path + n - m, *endings)) return true;
    }
    return false;
}

static bool walks_asked(const struct options *o)
{
    return o->scattering && !strcmp(o->scattering, "walk");
}

int run_info(struct tool *tool)
{
    static const char *const models[] = {".glb", ".gltf", ".obj", ".ply", ".stl", NULL};
    static const char *const files[] = {".prt", NULL};
    const char *path = tool->opt.input[0];
    // "constant" and patterns of six faces are environments that are no file.
    bool exists = access(path, R_OK) == 0;
    if (!exists && strncmp(path, "constant", 8) && !strchr(path, '*') && !strchr(path, '%'))
        return tool_exit(tool, prt_fail(&tool->ctx, PRT_IO, "%s: %s", path, strerror(errno)));
    cJSON *root = cJSON_CreateObject();
    cJSON_AddStringToObject(root, "file", path);
    int status;
    if (ends_with_any(path, files) || (exists && prt_file_probe(path)))
        status = describe_prt(tool, path, root);
    else if (ends_with_any(path, models)) status = describe_model(tool, path, root);
    else if (prt_material_is_foreign(path)) status = describe_materials(tool, path, root);
    else status = describe_env(tool, path, root);
    if (!status && (tool->opt.n_material || walks_asked(&tool->opt)))
        status = describe_dipole(tool, path, root);
    if (!status && tool->opt.json) {
        char *text = cJSON_PrintUnformatted(root);
        puts(text ? text : "{}");
        free(text);
    } else if (!status) {
        print_text(root, 0);
    }
    cJSON_Delete(root);
    return status;
}
