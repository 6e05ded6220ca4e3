// SPDX-License-Identifier: MIT
// Writes a .prt: hashes the sections in place, then writes header, table and sections.
#include "format.h"

#include <string.h>
#define XXH_INLINE_ALL
#include <xxhash.h>

struct layout {
    struct format_header header;
    struct format_section section[FORMAT_MAX_SECTION];
    const void *bytes[FORMAT_MAX_SECTION];
    uint32_t n;
    struct format_info info;
    struct format_tensor tensor[PRT_MOST_TENSORS];
    struct format_material more[PRT_MEDIA_MAX - 1]; // all media but the first
    struct {
        struct format_profile head;
        float value[4 * PRT_MATERIAL_MAX_POINT];
    } profile[PRT_MEDIA_MAX];
};

static const char zeros[FORMAT_ALIGN];

// Sections of 0 bytes are left out; opening gives NULL for them.
static void put(struct layout *l, uint32_t type, uint32_t tensor, const void *bytes, uint64_t n)
{
    if (!n) return;
    l->bytes[l->n] = bytes;
    l->section[l->n++] = (struct format_section){.type = type, .tensor = tensor, .bytes = n};
}

static void put_variants(struct layout *l, const struct prt_mesh *m)
{
    if (!m->n_variant) return;
    put(l, SECTION_VARIANT, 0, m->variant, (uint64_t)sizeof *m->variant * m->n_variant);
    put(l, SECTION_VARIANT_SURFACE, 0, m->variant_surface,
        (uint64_t)sizeof *m->variant_surface * m->n_block * (m->n_variant + 1));
    if (m->volume)
        put(l, SECTION_VOLUME, 0, m->volume, (uint64_t)sizeof *m->volume * m->n_surface);
}

static void put_mesh(struct layout *l, const struct prt_mesh *m)
{
    put(l, SECTION_POSITION, 0, m->position, 12ull * m->n_vertex);
    put(l, SECTION_NORMAL, 0, m->normal, 12ull * m->n_vertex);
    if (m->uv) put(l, SECTION_UV, 0, m->uv, 8ull * m->n_vertex);
    put(l, SECTION_TRIANGLE, 0, m->triangle, 12ull * m->n_triangle);
    put(l, SECTION_WELD, 0, m->weld, 4ull * m->n_vertex);
    put(l, SECTION_BLOCK, 0, m->block, (uint64_t)sizeof *m->block * m->n_block);
    put(l, SECTION_SURFACE, 0, m->surface, (uint64_t)sizeof *m->surface * m->n_surface);
    if (m->blocked)
        put(l, SECTION_BLOCKED, 0, m->blocked, sizeof *m->blocked * (uint64_t)m->n_vertex);
    if (m->object)
        put(l, SECTION_OBJECT, 0, m->object, (uint64_t)sizeof *m->object * m->n_object);
    put(l, SECTION_CAMERA, 0, m->camera, (uint64_t)sizeof *m->camera * m->n_camera);
    if (m->n_uv > 1 && m->uv_more)
        put(l, SECTION_UV_MORE, 0, m->uv_more, 8ull * (m->n_uv - 1) * m->n_vertex);
    if (m->corner_uv) put(l, SECTION_CORNER_UV, 0, m->corner_uv, 24ull * m->n_triangle);
    if (m->color) put(l, SECTION_COLOR, 0, m->color, 16ull * m->n_vertex);
    if (m->maps) put(l, SECTION_MAPS, 0, m->maps, (uint64_t)sizeof *m->maps * m->n_surface);
    if (m->image) put(l, SECTION_IMAGE, 0, m->image, (uint64_t)sizeof *m->image * m->n_image);
    if (m->texel) put(l, SECTION_TEXEL, 0, m->texel, m->texel_bytes);
    put_variants(l, m);
}

static void put_low_rank(struct layout *l, uint32_t i, const struct prt_rows *r)
{
    const uint64_t n = r->direction[r->n_row];
    put(l, SECTION_ROW_SHIFT, i, r->shift, r->begin[r->n_row]);
    put(l, SECTION_ROW_DIRECTION, i, r->direction, 4 * (r->n_row + 1ull));
    put(l, SECTION_ROW_VALUE_BEGIN, i, r->value_begin, 8 * (r->n_row + 1ull));
    put(l, SECTION_ROW_SCALE, i, r->scale, 4 * n);
    put(l, SECTION_ROW_MIX, i, r->mix, 2 * n * r->n_function);
    put(l, SECTION_ROW_ENTRY, i, r->entry, r->value_begin[r->n_row]);
}

static void put_tensor(struct layout *l, uint32_t i, const struct prt_tensor *t)
{
    const struct prt_rows *r = &t->rows;
    uint64_t n_entry = r->n_row ? r->begin[r->n_row] : 0;
    uint64_t value = r->value == PRT_VALUE_I8 ? 1 : 2;
    l->tensor[i] = (struct format_tensor){.term = t->term,
                                          .storage = t->storage,
                                          .coupling = t->coupling,
                                          .n_vertex = t->n_vertex,
                                          .n_function = t->n_function,
                                          .n_phase = t->n_phase,
                                          .n_cluster = t->n_cluster,
                                          .n_radial = t->n_radial,
                                          .u_count = t->u_count,
                                          .n_entry = n_entry,
                                          .n_row = r->n_row,
                                          .n_coef = r->n_coef,
                                          .value = r->value,
                                          .index_bytes = r->index_bytes,
                                          .n_knot = t->n_knot,
                                          .basis_kind = t->basis_kind};
    put(l, SECTION_TENSOR, i, &l->tensor[i], sizeof l->tensor[i]);
    put(l, SECTION_ORDER, i, t->order, 4ull * t->n_vertex);
    put(l, SECTION_CLUSTER, i, t->cluster, (uint64_t)sizeof *t->cluster * t->n_cluster);
    put(l, SECTION_U, i, t->u, 2 * t->u_count);
    if (t->u_scale)
        put(l, SECTION_U_SCALE, i, t->u_scale, 12ull * t->n_cluster * t->n_function);
    if (r->n_row) {
        put(l, SECTION_ROW_BEGIN, i, r->begin, 8 * (r->n_row + 1ull));
        put(l, SECTION_ROW_INDEX, i, r->index, n_entry * r->index_bytes);
        put(l, SECTION_ROW_SCALING, i, r->scaling, 12ull * r->n_row * t->n_function);
        if (r->direction) put_low_rank(l, i, r);
        else put(l, SECTION_ROW_ENTRY, i, r->entry, n_entry * t->n_function * value);
        if (r->value != PRT_VALUE_F16 && !r->direction)
            put(l, SECTION_ROW_SCALE, i, r->scale, 4ull * r->n_row * t->n_function);
    }
    put(l, SECTION_KNOT, i, t->knot, 4ull * t->n_knot);
    if (t->n_knot)
        put(l, SECTION_BASIS, i, t->basis,
            4ull * prt_tensor_basis_width(t) * prt_tensor_basis_size(t));
    put(l, SECTION_ETA, i, t->eta, 4ull * t->n_eta);
}

static struct format_material core_of(const struct prt_material *m)
{
    struct format_material out = {.eta = m->eta, .roughness = m->roughness};
    memcpy(out.name, m->name, sizeof out.name);
    memcpy(out.sigma_s_prime, m->sigma_s_prime, sizeof out.sigma_s_prime);
    memcpy(out.sigma_a, m->sigma_a, sizeof out.sigma_a);
    memcpy(out.g, m->g, sizeof out.g);
    return out;
}

static void put_profile(struct layout *l, uint32_t i, const struct prt_material *m)
{
    const size_t n = m->n_point, row = n * sizeof(float);
    if (!m->profile) return;
    l->profile[i].head = (struct format_profile){m->profile, m->n_point};
    memcpy(l->profile[i].value, m->radius, row);
    for (size_t c = 0; c < 3; c++)
        memcpy(l->profile[i].value + (c + 1) * n, m->reflectance[c], row);
    put(l, SECTION_PROFILE, i, &l->profile[i], sizeof l->profile[i].head + 4 * row);
}

static void put_media(struct layout *l, const struct prt_media *media, uint32_t n_object)
{
    for (uint32_t i = 0; i < media->n; i++) {
        if (i) l->more[i - 1] = core_of(&media->medium[i]);
        put_profile(l, i, &media->medium[i]);
    }
    if (media->n == 1) return;
    put(l, SECTION_MEDIA, 0, l->more, (media->n - 1) * sizeof *l->more);
    put(l, SECTION_MEDIUM_OF, 0, media->of_object, n_object);
}

static int build(const struct prt_context *ctx, const char *path, const struct prt_transport *t,
                 struct layout *l)
{
    const struct prt_mesh *m = &t->mesh;
    if (t->n_tensor > PRT_MOST_TENSORS)
        return prt_fail(ctx, PRT_ARG, "%s: more than %d tensors", path, PRT_MOST_TENSORS);
    l->info = (struct format_info){.n_vertex = m->n_vertex,
                                   .n_triangle = m->n_triangle,
                                   .n_block = m->n_block,
                                   .n_object = m->n_object,
                                   .n_surface = m->n_surface,
                                   .n_weld = m->n_weld,
                                   .mm_per_unit = m->mm_per_unit,
                                   .units_known = m->units_known,
                                   .n_boundary_edge = m->n_boundary_edge,
                                   .n_nonmanifold_edge = m->n_nonmanifold_edge,
                                   .n_degenerate_triangle = m->n_degenerate_triangle,
                                   .cube = t->cube,
                                   .engine = t->engine,
                                   .n_tensor = t->n_tensor,
                                   .material = core_of(&t->media.medium[0]),
                                   .texture_split = m->texture_split,
                                   .mesh_hash = t->mesh_hash};
    put(l, SECTION_INFO, 0, &l->info, sizeof l->info);
    put_media(l, &t->media, m->n_object);
    const char *settings = t->settings ? t->settings : "{}";
    const char *errors = t->errors ? t->errors : "{}";
    put(l, SECTION_SETTINGS, 0, settings, strlen(settings) + 1);
    put(l, SECTION_ERRORS, 0, errors, strlen(errors) + 1);
    put_mesh(l, m);
    for (uint32_t i = 0; i < t->n_tensor; i++) put_tensor(l, i, &t->tensor[i]);
    return PRT_OK;
}

static uint64_t hash_padded(XXH3_state_t *state, const void *bytes, uint64_t n)
{
    XXH3_64bits_reset(state);
    XXH3_64bits_update(state, bytes, n);
    XXH3_64bits_update(state, zeros, format_padded(n) - n);
    return XXH3_64bits_digest(state);
}

static int seal(const struct prt_context *ctx, struct layout *l)
{
    XXH3_state_t *state = XXH3_createState();
    if (!state) return prt_fail(ctx, PRT_NOMEM, "no memory to hash a transport");
    uint64_t table = (uint64_t)sizeof l->section[0] * l->n;
    uint64_t at = format_padded(sizeof l->header + table);
    for (uint32_t i = 0; i < l->n; i++) {
        l->section[i].offset = at;
        l->section[i].hash = hash_padded(state, l->bytes[i], l->section[i].bytes);
        at += format_padded(l->section[i].bytes);
    }
    memcpy(l->header.magic, FORMAT_MAGIC, 8);
    l->header.version = FORMAT_VERSION;
    l->header.endian = FORMAT_ENDIAN;
    l->header.file_bytes = at;
    l->header.n_section = l->n;
    l->header.hash = 0;
    XXH3_64bits_reset(state);
    XXH3_64bits_update(state, &l->header, sizeof l->header);
    XXH3_64bits_update(state, l->section, table);
    XXH3_64bits_update(state, zeros, format_padded(table) - table);
    l->header.hash = XXH3_64bits_digest(state);
    XXH3_freeState(state);
    return PRT_OK;
}

static int write_padded(struct prt_writer *w, const void *bytes, uint64_t n)
{
    int status = prt_writer_write(w, bytes, n);
    return status ? status : prt_writer_write(w, zeros, format_padded(n) - n);
}

int prt_file_write(const struct prt_context *ctx, const char *path,
                   const struct prt_transport *transport)
{
    struct prt_writer *w = NULL;
    // a transport that could not be opened again is not written
    int status = prt_transport_check(ctx, path, transport);
    if (status) return status;
    struct layout *l = prt_calloc(1, sizeof *l);
    if (!l) return prt_fail(ctx, PRT_NOMEM, "%s: no memory to write it", path);
    if ((status = build(ctx, path, transport, l)) || (status = seal(ctx, l)) ||
        (status = prt_writer_open(ctx, path, &w)))
        goto out;
    status = prt_writer_write(w, &l->header, sizeof l->header);
    if (!status) status = write_padded(w, l->section, (uint64_t)sizeof l->section[0] * l->n);
    for (uint32_t i = 0; i < l->n && !status; i++)
        status = write_padded(w, l->bytes[i], l->section[i].bytes);
    if (status) prt_writer_abandon(w);
    else status = prt_writer_finish(w);
out:
    prt_free(l);
    return status;
}
