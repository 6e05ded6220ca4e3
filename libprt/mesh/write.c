// SPDX-License-Identifier: MIT
// Writes a mesh with a colour a vertex, as binary PLY or GLB, in the model's own units.
#include "internal.h"
#include "vertex_file.h"

#include <stdio.h>
#include <stdlib.h>

static struct prt_vertex_block *copy_blocks(const struct prt_mesh *mesh)
{
    struct prt_vertex_block *block = prt_alloc((size_t)mesh->n_block + 1, sizeof *block);
    for (uint32_t i = 0; i < mesh->n_block && block; i++)
        block[i] = (struct prt_vertex_block){
            .object = mesh->block[i].object,
            .vertex_begin = mesh->block[i].vertex_begin,
            .n_vertex = mesh->block[i].n_vertex,
            .triangle_begin = mesh->block[i].triangle_begin,
            .n_triangle = mesh->block[i].n_triangle,
        };
    return block;
}

// The file's bytes, which the caller free()s.
static int encode(const struct prt_context *ctx, const char *path,
                  const struct prt_vertex_data *data, char **bytes, size_t *n)
{
    *bytes = NULL;
    FILE *f = open_memstream(bytes, n);
    int result =
        f ? prt_vertex_file_write(f, prt_vertex_format_of(path), data) : PRT_VERTEX_NO_MEMORY;
    bool bad = f && ferror(f);
    if (f) bad |= fclose(f) != 0;
    if (result == PRT_VERTEX_TOO_LARGE)
        return prt_fail(ctx, PRT_LIMIT, "%s: a GLB holds less than 4 GiB; write .ply", path);
    return result || bad ? prt_fail(ctx, PRT_NOMEM, "%s: no memory for the file", path)
                         : PRT_OK;
}

int prt_mesh_write_colors(const struct prt_context *ctx, const char *path,
                          const struct prt_mesh *mesh, const float (*color)[3])
{
    if (!prt_vertex_format_has_mesh(prt_vertex_format_of(path)))
        return prt_fail(ctx, PRT_ARG, "%s: a mesh is written as .ply or .glb", path);
    struct prt_vertex_block *block = copy_blocks(mesh);
    if (!block) return prt_fail(ctx, PRT_NOMEM, "%s: no memory for the file", path);
    struct prt_vertex_data data = {
        .n_vertex = mesh->n_vertex,
        .n_triangle = mesh->n_triangle,
        .position = (const float(*)[3])mesh->position,
        .unit = mesh->mm_per_unit,
        .normal = (const float(*)[3])mesh->normal,
        .color = color,
        .triangle = (const uint32_t(*)[3])mesh->triangle,
        .block = block,
        .n_block = mesh->n_block,
        .generator = "prt",
    };
    char *bytes;
    size_t n;
    int status = encode(ctx, path, &data, &bytes, &n);
    if (!status) status = prt_write_file(ctx, path, bytes, n);
    free(bytes);
    prt_free(block);
    return status;
}
