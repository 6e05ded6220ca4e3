// SPDX-License-Identifier: MIT
// Opens a .prt: maps the file and fills a transport with pointers into the map.
#include "format.h"
#include "map_guard.h"
#include "pages.h"
#include "prt/columns.h"
#include "prt/eta_nodes.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#define XXH_INLINE_ALL
#include <xxhash.h>

struct prt_file {
    const struct prt_context *ctx; // while opening only
    const char *name;              // while opening only
    const char *bytes;
    uint64_t size;
    enum { LENT, MAP, PAGES } from; // what closing does with the bytes
    int watch;                      // of a MAP: prt_map_watch
    const struct format_section *section;
    uint32_t n_section, n_taken;
    struct prt_transport transport;
    struct prt_material *medium; // owned: the transport's media
};

static int bad_header(const struct prt_context *ctx, const char *name, const char *what)
{
    return prt_fail(ctx, PRT_FORMAT, "%s: %s", name, what);
}

static int header_hash(const struct format_header *header, const void *table, uint64_t n,
                       uint64_t *out)
{
    struct format_header copy = *header;
    XXH3_state_t *state = XXH3_createState();
    if (!state) return PRT_NOMEM;
    copy.hash = 0;
    XXH3_64bits_reset(state);
    XXH3_64bits_update(state, &copy, sizeof copy);
    XXH3_64bits_update(state, table, n);
    *out = XXH3_64bits_digest(state);
    XXH3_freeState(state);
    return PRT_OK;
}

static int check_header(struct prt_file *f)
{
    struct format_header h;
    if (f->size < sizeof h || memcmp(f->bytes, FORMAT_MAGIC, 8))
        return bad_header(f->ctx, f->name,
                          f->size < 8 || memcmp(f->bytes, FORMAT_MAGIC, 8)
                              ? "not a .prt file"
                              : "the file is truncated in its header");
    memcpy(&h, f->bytes, sizeof h);
    if (h.endian != FORMAT_ENDIAN)
        return bad_header(f->ctx, f->name, "the .prt has another byte order");
    if (h.version != FORMAT_VERSION)
        return prt_fail(f->ctx, PRT_FORMAT,
                        "%s: .prt version %u, this program reads version %d: bake it again",
                        f->name, h.version, FORMAT_VERSION);
    if (h.file_bytes != f->size)
        return prt_fail(f->ctx, PRT_FORMAT, "%s: %s: %llu bytes of %llu", f->name,
                        f->size < h.file_bytes ? "the file is truncated"
                                               : "bytes follow the end of the file",
                        (unsigned long long)f->size, (unsigned long long)h.file_bytes);
    if (!h.n_section || h.n_section > FORMAT_MAX_SECTION)
        return bad_header(f->ctx, f->name, "the header is damaged");
    uint64_t table = format_padded(sizeof *f->section * h.n_section);
    if (table > f->size - sizeof h)
        return bad_header(f->ctx, f->name, "the table of sections is truncated");
    uint64_t hash;
    if (header_hash(&h, f->bytes + sizeof h, table, &hash))
        return prt_fail(f->ctx, PRT_NOMEM, "%s: no memory for a checksum", f->name);
    if (hash != h.hash) return bad_header(f->ctx, f->name, "the header is damaged (checksum)");
    f->section = (const struct format_section *)(f->bytes + sizeof h);
    f->n_section = h.n_section;
    return PRT_OK;
}

// Sections have to follow each other without gaps and end with the file.
static int check_table(const struct prt_file *f)
{
    uint64_t at =
        format_padded(sizeof(struct format_header) + sizeof *f->section * f->n_section);
    for (uint32_t i = 0; i < f->n_section; i++) {
        const struct format_section *s = &f->section[i];
        if (s->offset != at || !s->bytes || s->bytes > f->size - at ||
            format_padded(s->bytes) > f->size - at)
            return prt_fail(f->ctx, PRT_FORMAT, "%s: section %u is out of range", f->name, i);
        at += format_padded(s->bytes);
    }
    if (at != f->size) return bad_header(f->ctx, f->name, "sections do not fill the file");
    return PRT_OK;
}

static int hash_sections(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct prt_file *f = arg;
    for (size_t i = begin; i < end; i++) {
        const struct format_section *s = &f->section[i];
        if (prt_hash64(f->bytes + s->offset, format_padded(s->bytes), 0) != s->hash)
            return prt_fail(f->ctx, PRT_FORMAT, "%s: section %zu is damaged (checksum)",
                            f->name, i);
    }
    return PRT_OK;
}

// *out: where the section lies; NULL when bytes is 0 and the file has no such section.
static int take(struct prt_file *f, uint32_t type, uint32_t tensor, uint64_t bytes,
                const void **out)
{
    *out = NULL;
    for (uint32_t i = 0; i < f->n_section; i++) {
        const struct format_section *s = &f->section[i];
        if (s->type != type || s->tensor != tensor) continue;
        if (*out || s->bytes != bytes)
            return prt_fail(f->ctx, PRT_FORMAT, "%s: section %u has %llu bytes, not %llu",
                            f->name, i, (unsigned long long)s->bytes,
                            (unsigned long long)bytes);
        *out = f->bytes + s->offset;
        f->n_taken++;
    }
    if (bytes && !*out)
        return prt_fail(f->ctx, PRT_FORMAT, "%s: a section of type %u is missing", f->name,
                        type);
    return PRT_OK;
}

static int take_text(struct prt_file *f, uint32_t type, const char **out)
{
    uint64_t bytes = 0;
    const void *p;
    for (uint32_t i = 0; i < f->n_section; i++)
        if (f->section[i].type == type && !f->section[i].tensor) bytes = f->section[i].bytes;
    int status = take(f, type, 0, bytes, &p);
    if (status) return status;
    if (!p || memchr(p, 0, bytes) != (const char *)p + bytes - 1)
        return bad_header(f->ctx, f->name, "a text in it is damaged");
    *out = p;
    return PRT_OK;
}

// The map is read-only. The cast is for struct prt_mesh, whose pointers are not const because
// loaders fill them.
#define TAKE(f, type, tensor, bytes, field)                      \
    do {                                                         \
        const void *taken;                                       \
        int taken_status = take(f, type, tensor, bytes, &taken); \
        if (taken_status) return taken_status;                   \
        (field) = (void *)(uintptr_t)taken;                      \
    } while (0)

static uint64_t bytes_of(const struct prt_file *f, uint32_t type)
{
    for (uint32_t i = 0; i < f->n_section; i++)
        if (f->section[i].type == type) return f->section[i].bytes;
    return 0;
}

// The same of one tensor, or of one medium.
static uint64_t tensor_bytes_of(const struct prt_file *f, uint32_t type, uint32_t tensor)
{
    for (uint32_t i = 0; i < f->n_section; i++)
        if (f->section[i].type == type && f->section[i].tensor == tensor)
            return f->section[i].bytes;
    return 0;
}

// Textures; prt_transport_check holds their numbers to each other.
static int take_textures(struct prt_file *f, struct prt_mesh *m)
{
    uint64_t more = bytes_of(f, SECTION_UV_MORE), set = 8ull * m->n_vertex;
    uint64_t image = bytes_of(f, SECTION_IMAGE);
    if (set && more / set >= PRT_TEXTURE_MAX_UV)
        return bad_header(f->ctx, f->name, "it has too many sets of texture coordinates");
    m->n_uv = m->uv ? 1 + (set ? (uint32_t)(more / set) : 0) : 0;
    m->n_image = (uint32_t)(image / sizeof *m->image);
    m->texel_bytes = bytes_of(f, SECTION_TEXEL);
    TAKE(f, SECTION_UV_MORE, 0, m->n_uv > 1 ? set * (m->n_uv - 1) : 0, m->uv_more);
    if (bytes_of(f, SECTION_CORNER_UV))
        TAKE(f, SECTION_CORNER_UV, 0, 24ull * m->n_triangle, m->corner_uv);
    if (bytes_of(f, SECTION_COLOR)) TAKE(f, SECTION_COLOR, 0, 16ull * m->n_vertex, m->color);
    if (bytes_of(f, SECTION_MAPS))
        TAKE(f, SECTION_MAPS, 0, (uint64_t)sizeof *m->maps * m->n_surface, m->maps);
    TAKE(f, SECTION_IMAGE, 0, (uint64_t)sizeof *m->image * m->n_image, m->image);
    TAKE(f, SECTION_TEXEL, 0, m->texel_bytes, m->texel);
    return PRT_OK;
}

static int take_cameras(struct prt_file *f)
{
    struct prt_mesh *m = &f->transport.mesh;
    uint64_t bytes = bytes_of(f, SECTION_CAMERA);
    if (bytes % sizeof *m->camera || bytes / sizeof *m->camera > PRT_MESH_MOST_CAMERAS)
        return bad_header(f->ctx, f->name, "its cameras are damaged");
    m->n_camera = (uint32_t)(bytes / sizeof *m->camera);
    TAKE(f, SECTION_CAMERA, 0, bytes, m->camera);
    return prt_mesh_cameras_ok(m) ? PRT_OK
                                  : bad_header(f->ctx, f->name, "its cameras are damaged");
}

// prt_transport_check holds their numbers to the mesh.
static int take_variants(struct prt_file *f)
{
    struct prt_mesh *m = &f->transport.mesh;
    const uint64_t bytes = bytes_of(f, SECTION_VARIANT), n = bytes / sizeof *m->variant;
    if (bytes % sizeof *m->variant || n > PRT_MESH_MOST_VARIANTS)
        return bad_header(f->ctx, f->name, "its variants are damaged");
    m->n_variant = (uint32_t)n;
    TAKE(f, SECTION_VARIANT, 0, bytes, m->variant);
    TAKE(f, SECTION_VARIANT_SURFACE, 0, n ? sizeof(uint32_t) * m->n_block * (n + 1) : 0,
         m->variant_surface);
    if (n && bytes_of(f, SECTION_VOLUME))
        TAKE(f, SECTION_VOLUME, 0, (uint64_t)sizeof *m->volume * m->n_surface, m->volume);
    return PRT_OK;
}

static int take_mesh(struct prt_file *f, const struct format_info *info)
{
    struct prt_mesh *m = &f->transport.mesh;
    uint32_t has_uv = 0, has_blocked = 0;
    *m = (struct prt_mesh){.n_vertex = info->n_vertex,
                           .n_triangle = info->n_triangle,
                           .n_block = info->n_block,
                           .n_object = info->n_object,
                           .n_surface = info->n_surface,
                           .n_weld = info->n_weld,
                           .mm_per_unit = info->mm_per_unit,
                           .units_known = info->units_known,
                           .n_boundary_edge = info->n_boundary_edge,
                           .n_nonmanifold_edge = info->n_nonmanifold_edge,
                           .n_degenerate_triangle = info->n_degenerate_triangle,
                           .texture_split = info->texture_split};
    for (uint32_t i = 0; i < f->n_section; i++) {
        has_uv |= f->section[i].type == SECTION_UV;
        has_blocked |= f->section[i].type == SECTION_BLOCKED;
    }
    TAKE(f, SECTION_POSITION, 0, 12ull * m->n_vertex, m->position);
    TAKE(f, SECTION_NORMAL, 0, 12ull * m->n_vertex, m->normal);
    if (has_uv) TAKE(f, SECTION_UV, 0, 8ull * m->n_vertex, m->uv);
    TAKE(f, SECTION_TRIANGLE, 0, 12ull * m->n_triangle, m->triangle);
    TAKE(f, SECTION_WELD, 0, 4ull * m->n_vertex, m->weld);
    TAKE(f, SECTION_BLOCK, 0, (uint64_t)sizeof *m->block * m->n_block, m->block);
    TAKE(f, SECTION_SURFACE, 0, (uint64_t)sizeof *m->surface * m->n_surface, m->surface);
    if (has_blocked)
        TAKE(f, SECTION_BLOCKED, 0, sizeof *m->blocked * (uint64_t)m->n_vertex, m->blocked);
    if (bytes_of(f, SECTION_OBJECT))
        TAKE(f, SECTION_OBJECT, 0, (uint64_t)sizeof *m->object * m->n_object, m->object);
    int status = take_cameras(f);
    if (!status) status = take_variants(f);
    return status ? status : take_textures(f, m);
}

static int take_low_rank(struct prt_file *f, uint32_t i, const struct format_tensor *ft,
                         struct prt_rows *r)
{
    const uint64_t n_row = ft->n_row;
    TAKE(f, SECTION_ROW_SHIFT, i, ft->n_entry, r->shift);
    TAKE(f, SECTION_ROW_DIRECTION, i, 4 * (n_row + 1), r->direction);
    TAKE(f, SECTION_ROW_VALUE_BEGIN, i, 8 * (n_row + 1), r->value_begin);
    const uint64_t n = r->direction[n_row], n_value = r->value_begin[n_row];
    if (n > PRT_ROWS_MOST_DIRECTIONS * n_row || n_value > f->size)
        return bad_header(f->ctx, f->name, "too many directions of functions");
    TAKE(f, SECTION_ROW_SCALE, i, 4 * n, r->scale);
    TAKE(f, SECTION_ROW_MIX, i, 2 * n * ft->n_function, r->mix);
    TAKE(f, SECTION_ROW_ENTRY, i, n_value, r->entry);
    return PRT_OK;
}

static int take_rows(struct prt_file *f, uint32_t i, const struct format_tensor *ft,
                     struct prt_rows *r)
{
    uint64_t j = ft->n_function, n_entry = ft->n_entry;
    *r = (struct prt_rows){.n_row = ft->n_row,
                           .n_function = ft->n_function,
                           .n_coef = ft->n_coef,
                           .value = ft->value,
                           .index_bytes = ft->index_bytes};
    if (!ft->n_row) return PRT_OK;
    if (ft->index_bytes != 2 && ft->index_bytes != 4)
        return bad_header(f->ctx, f->name, "indices of an unknown size");
    TAKE(f, SECTION_ROW_BEGIN, i, 8 * (ft->n_row + 1ull), r->begin);
    if (r->begin[ft->n_row] != n_entry)
        return bad_header(f->ctx, f->name, "rows do not end with the entries");
    TAKE(f, SECTION_ROW_INDEX, i, n_entry * ft->index_bytes, r->index);
    TAKE(f, SECTION_ROW_SCALING, i, 12 * j * ft->n_row, r->scaling);
    if (ft->value == PRT_VALUE_I8 && ft->coupling == PRT_COUPLE_FULL)
        return take_low_rank(f, i, ft, r);
    TAKE(f, SECTION_ROW_ENTRY, i, n_entry * j * (ft->value == PRT_VALUE_I8 ? 1 : 2), r->entry);
    if (ft->value != PRT_VALUE_F16) TAKE(f, SECTION_ROW_SCALE, i, 4 * j * ft->n_row, r->scale);
    return PRT_OK;
}

// The nodes of a tensor for any index; prt_transport_check holds them to their range.
static int take_eta(struct prt_file *f, uint32_t i, struct prt_tensor *t)
{
    const uint64_t bytes = tensor_bytes_of(f, SECTION_ETA, i);
    if (bytes % sizeof *t->eta || bytes / sizeof *t->eta > 2 + PRT_ETA_MOST_NODES)
        return prt_fail(f->ctx, PRT_FORMAT, "%s: tensor %u: its nodes of eta are damaged",
                        f->name, i);
    t->n_eta = (uint32_t)(bytes / sizeof *t->eta);
    TAKE(f, SECTION_ETA, i, bytes, t->eta);
    return PRT_OK;
}

static int take_tensor(struct prt_file *f, uint32_t i)
{
    struct prt_tensor *t = &f->transport.tensor[i];
    const struct format_tensor *ft;
    TAKE(f, SECTION_TENSOR, i, sizeof *ft, ft);
    // with these limits no product below overflows
    if (ft->n_function > 65536 || ft->n_radial > 65536 || ft->n_entry > f->size ||
        ft->u_count > f->size || ft->n_knot > 1u << 24)
        return prt_fail(f->ctx, PRT_FORMAT, "%s: tensor %u is damaged", f->name, i);
    *t = (struct prt_tensor){.term = ft->term,
                             .storage = ft->storage,
                             .coupling = ft->coupling,
                             .n_vertex = ft->n_vertex,
                             .n_function = ft->n_function,
                             .n_phase = ft->n_phase,
                             .n_cluster = ft->n_cluster,
                             .n_radial = ft->n_radial,
                             .u_count = ft->u_count,
                             .n_knot = ft->n_knot,
                             .basis_kind = ft->basis_kind};
    TAKE(f, SECTION_ORDER, i, 4ull * ft->n_vertex, t->order);
    TAKE(f, SECTION_CLUSTER, i, (uint64_t)sizeof *t->cluster * ft->n_cluster, t->cluster);
    TAKE(f, SECTION_U, i, 2 * ft->u_count, t->u);
    if (tensor_bytes_of(f, SECTION_U_SCALE, i))
        TAKE(f, SECTION_U_SCALE, i, 12ull * ft->n_cluster * ft->n_function, t->u_scale);
    TAKE(f, SECTION_KNOT, i, 4ull * ft->n_knot, t->knot);
    const int status = take_eta(f, i, t);
    if (status) return status;
    const uint64_t width = ft->n_knot ? prt_tensor_basis_width(t) : 0;
    TAKE(f, SECTION_BASIS, i, 4 * width * prt_tensor_basis_size(t), t->basis);
    return take_rows(f, i, ft, &t->rows);
}

static int take_profile(struct prt_file *f, uint32_t index, struct prt_material *m)
{
    const struct format_profile *p = NULL;
    const uint64_t bytes = tensor_bytes_of(f, SECTION_PROFILE, index);
    if (!bytes) return PRT_OK;
    TAKE(f, SECTION_PROFILE, index, bytes, p);
    if (bytes < sizeof *p || p->n_point > PRT_MATERIAL_MAX_POINT || !p->kind ||
        bytes != sizeof *p + 16ull * p->n_point)
        return bad_header(f->ctx, f->name, "the material's profile is damaged");
    const float *value = (const float *)(p + 1);
    m->profile = p->kind;
    m->n_point = p->n_point;
    memcpy(m->radius, value, m->n_point * sizeof *value);
    for (uint32_t c = 0; c < 3; c++)
        memcpy(m->reflectance[c], value + (c + 1) * m->n_point, m->n_point * sizeof *value);
    return PRT_OK;
}

static int take_material(struct prt_file *f, uint32_t index, const struct format_material *core)
{
    struct prt_material *m = &f->medium[index];
    *m = (struct prt_material){.eta = core->eta, .roughness = core->roughness};
    memcpy(m->name, core->name, sizeof m->name);
    memcpy(m->sigma_s_prime, core->sigma_s_prime, sizeof m->sigma_s_prime);
    memcpy(m->sigma_a, core->sigma_a, sizeof m->sigma_a);
    memcpy(m->g, core->g, sizeof m->g);
    return take_profile(f, index, m);
}

// prt_transport_check holds the numbers to their ranges.
static int take_media(struct prt_file *f, const struct format_info *info)
{
    const struct format_material *more = NULL;
    const uint8_t *of_object = NULL;
    uint64_t bytes = bytes_of(f, SECTION_MEDIA), n = 1 + bytes / sizeof *more;
    if (bytes % sizeof *more || n > PRT_MEDIA_MAX)
        return bad_header(f->ctx, f->name, "its media are damaged");
    TAKE(f, SECTION_MEDIA, 0, bytes, more);
    TAKE(f, SECTION_MEDIUM_OF, 0, n > 1 ? info->n_object : 0, of_object);
    f->medium = prt_alloc(n, sizeof *f->medium);
    if (!f->medium) return prt_fail(f->ctx, PRT_NOMEM, "%s: no memory to open it", f->name);
    int status = take_material(f, 0, &info->material);
    for (uint32_t i = 1; i < n && !status; i++) status = take_material(f, i, &more[i - 1]);
    f->transport.media = (struct prt_media){(uint32_t)n, f->medium, of_object};
    return status;
}

static int take_all(struct prt_file *f)
{
    struct prt_transport *t = &f->transport;
    const struct format_info *info;
    int status;
    TAKE(f, SECTION_INFO, 0, sizeof *info, info);
    if (info->n_tensor < 1 || info->n_tensor > PRT_MOST_TENSORS)
        return prt_fail(f->ctx, PRT_FORMAT, "%s: %u tensors, 1 to %d are known", f->name,
                        info->n_tensor, PRT_MOST_TENSORS);
    if ((status = take_media(f, info))) return status;
    t->cube = info->cube;
    t->engine = info->engine;
    t->n_tensor = info->n_tensor;
    t->mesh_hash = info->mesh_hash;
    if ((status = take_text(f, SECTION_SETTINGS, &t->settings)) ||
        (status = take_text(f, SECTION_ERRORS, &t->errors)) || (status = take_mesh(f, info)))
        return status;
    for (uint32_t i = 0; i < t->n_tensor; i++)
        if ((status = take_tensor(f, i))) return status;
    if (f->n_taken != f->n_section)
        return bad_header(f->ctx, f->name,
                          "it has a section of an unknown type, or one too many");
    return PRT_OK;
}

static int open_bytes(struct prt_file *f, enum prt_file_check check)
{
    int status;
    if ((status = check_header(f)) || (status = check_table(f))) return status;
    if (check == PRT_FILE_CHECK_ALL &&
        (status = prt_parallel_for(f->ctx, NULL, f->n_section, 1, hash_sections, f)))
        return status;
    if ((status = take_all(f))) return status;
    return prt_transport_check(f->ctx, f->name, &f->transport);
}

int prt_file_open_memory(const struct prt_context *ctx, const char *name, const void *bytes,
                         size_t n, enum prt_file_check check, struct prt_file **out)
{
    if ((uintptr_t)bytes % 8)
        return prt_fail(ctx, PRT_ARG, "%s: a .prt in memory must be 8-byte aligned", name);
    struct prt_file *f = prt_calloc(1, sizeof *f);
    if (!f) return prt_fail(ctx, PRT_NOMEM, "%s: no memory to open it", name);
    f->ctx = ctx;
    f->name = name;
    f->bytes = bytes;
    f->size = n;
    int status = open_bytes(f, check);
    if (status) {
        prt_free(f->medium);
        prt_free(f);
        return status;
    }
    f->ctx = NULL;
    f->name = NULL;
    *out = f;
    return PRT_OK;
}

// *out: a descriptor of a regular file that is not empty.
static int open_regular(const struct prt_context *ctx, const char *path, int *out, size_t *size)
{
    struct stat st;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return prt_fail(ctx, PRT_IO, "%s: %s", path, strerror(errno));
    if (fstat(fd, &st) || !S_ISREG(st.st_mode)) {
        close(fd);
        return prt_fail(ctx, PRT_IO, "%s: not a regular file", path);
    }
    if (!st.st_size) {
        close(fd);
        return prt_fail(ctx, PRT_FORMAT, "%s: the file is empty", path);
    }
    *out = fd;
    *size = (size_t)st.st_size;
    return PRT_OK;
}

int prt_file_open(const struct prt_context *ctx, const char *path, enum prt_file_check check,
                  struct prt_file **out)
{
    int fd = -1;
    size_t size = 0;
    int status = open_regular(ctx, path, &fd, &size);
    if (status) return status;
    void *map = mmap(NULL, size, PROT_READ, MAP_SHARED, fd, 0);
    int error = errno;
    close(fd);
    if (map == MAP_FAILED) return prt_fail(ctx, PRT_IO, "%s: %s", path, strerror(error));
    (void)madvise(map, size, MADV_WILLNEED);
    const int watch = prt_map_watch(map, size);
    status = prt_file_open_memory(ctx, path, map, size, check, out);
    const bool lost = prt_map_lost(watch);
    if (!status && lost) prt_file_close(*out); // lent: the map stays
    if (!status && !lost) {
        (*out)->from = MAP;
        (*out)->watch = watch;
        return PRT_OK;
    }
    prt_map_unwatch(watch);
    munmap(map, size);
    return lost ? prt_fail(ctx, PRT_IO,
                           "%s: it became shorter while it was read, or its disk fails", path)
                : status;
}

enum { READ_PIECE = 2 << 20 };

struct reading {
    const struct prt_context *ctx;
    const char *path;
    int fd;
    char *to;
};

static int read_piece(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct reading *r = arg;
    while (begin < end) {
        const ssize_t n = pread(r->fd, r->to + begin, end - begin, (off_t)begin);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) return prt_fail(r->ctx, PRT_IO, "%s: %s", r->path, strerror(errno));
        if (!n)
            return prt_fail(r->ctx, PRT_IO, "%s: it became shorter while it was read", r->path);
        begin += (size_t)n;
    }
    return PRT_OK;
}

int prt_file_read(const struct prt_context *ctx, const char *path, enum prt_file_check check,
                  struct prt_file **out)
{
    struct reading r = {.ctx = ctx, .path = path, .fd = -1};
    size_t size = 0;
    int status = open_regular(ctx, path, &r.fd, &size);
    if (status) return status;
    r.to = prt_pages_take(size);
    status = r.to ? prt_parallel_for(ctx, NULL, size, READ_PIECE, read_piece, &r)
                  : prt_fail(ctx, PRT_NOMEM, "%s: no memory to read it", path);
    close(r.fd);
    if (!status) status = prt_file_open_memory(ctx, path, r.to, size, check, out);
    if (status) prt_pages_give(r.to, size);
    else (*out)->from = PAGES;
    return status;
}

const struct prt_transport *prt_file_transport(const struct prt_file *file)
{
    return &file->transport;
}

uint64_t prt_file_bytes(const struct prt_file *file)
{
    return file->size;
}

uint64_t prt_file_hash(const struct prt_file *file)
{
    return ((const struct format_header *)file->bytes)->hash;
}

int prt_file_columns(const struct prt_context *ctx, struct prt_file *file)
{
    int status = PRT_OK;
    for (uint32_t i = 0; i < file->transport.n_tensor && !status; i++) {
        struct prt_tensor *t = &file->transport.tensor[i];
        struct prt_columns *columns = NULL;
        if (!t->columns && prt_columns_possible(t)) status = prt_columns_make(ctx, t, &columns);
        if (columns) __atomic_store_n(&t->columns, columns, __ATOMIC_RELEASE);
    }
    return status;
}

uint64_t prt_file_memory(const struct prt_file *file)
{
    uint64_t bytes = file->size;
    for (uint32_t i = 0; i < file->transport.n_tensor; i++)
        if (file->transport.tensor[i].columns)
            bytes += file->transport.tensor[i].columns->bytes;
    return bytes;
}

void prt_file_close(struct prt_file *file)
{
    if (!file) return;
    for (uint32_t i = 0; i < file->transport.n_tensor; i++)
        prt_columns_destroy((void *)(uintptr_t)file->transport.tensor[i].columns);
    char *bytes = (char *)(uintptr_t)file->bytes;
    if (file->from == MAP) {
        prt_map_unwatch(file->watch);
        munmap(bytes, file->size);
    }
    if (file->from == PAGES) prt_pages_give(bytes, file->size);
    prt_free(file->medium);
    prt_free(file);
}

bool prt_file_probe(const char *path)
{
    char magic[8];
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0) return false;
    bool is = read(fd, magic, 8) == 8 && !memcmp(magic, FORMAT_MAGIC, 8);
    close(fd);
    return is;
}

uint32_t prt_file_version(const char *path)
{
    struct format_header h;
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0) return 0;
    bool is = read(fd, &h, sizeof h) == (ssize_t)sizeof h && !memcmp(h.magic, FORMAT_MAGIC, 8);
    close(fd);
    return is ? h.version : 0;
}
