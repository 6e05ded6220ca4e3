// SPDX-License-Identifier: MIT
// The mip chain of a model's image as PNG files, one of each level. Viewers of a model share
// them.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"
#include "render/shared/geometry.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct file_job {
    struct cache_job job;
    struct cache_entry *shape;
    uint32_t image;
};

static void destroy(void *value)
{
    struct texture_files *f = value;
    prt_free(f->bytes);
    free(f);
}

static int append(struct texture_files *f, const struct prt_blob *file)
{
    uint8_t *more = prt_alloc(f->size + file->size, 1);
    if (!more) return PRT_NOMEM;
    if (f->size) memcpy(more, f->bytes, f->size);
    memcpy(more + f->size, file->bytes, file->size);
    prt_free(f->bytes);
    f->bytes = more;
    f->size += file->size;
    f->level[f->n_level++] = (uint32_t)file->size;
    return PRT_OK;
}

static int run(struct cache_job *job, const struct prt_context *ctx)
{
    const struct file_job *own = (struct file_job *)job;
    const struct prt_mesh *mesh = &((const struct shape *)own->shape->value)->mesh;
    const struct prt_texture_image *image = &mesh->image[own->image];
    const uint8_t *texel = mesh->texel + image->begin;
    struct texture_files *f = job->value = calloc(1, sizeof *f);
    int status = f ? PRT_OK : PRT_NOMEM;
    for (uint32_t w = image->width, h = image->height; !status;
         w = w > 1 ? w / 2 : 1, h = h > 1 ? h / 2 : 1) {
        struct prt_blob file;
        status = prt_encode_png(ctx, texel, w, h, 4, &file);
        if (!status) status = append(f, &file);
        prt_free(file.bytes);
        texel += 4 * (size_t)w * h;
        if ((w == 1 && h == 1) || f->n_level == TEXTURE_LEVELS) break;
    }
    if (!status) job->bytes = sizeof *f + f->size;
    return status;
}

static const struct cache_job_kind kind = {
    .size = sizeof(struct file_job), .run = run, .destroy = destroy};

struct cache_entry *texture_files_get(struct model *model, struct cache_entry *shape,
                                      uint32_t image)
{
    const struct prt_texture_image *of =
        &((const struct shape *)shape->value)->mesh.image[image];
    char key[sizeof model->key + 60];
    struct cache_job *job;
    snprintf(key, sizeof key, "%s/texture/%016llx%016llx", model->key,
             (unsigned long long)of->hash[1], (unsigned long long)of->hash[0]);
    struct cache_entry *entry = cache_compute(model->server, key, &kind, &job);
    if (!job) return entry;
    ((struct file_job *)job)->shape = shape;
    ((struct file_job *)job)->image = image;
    cache_job_hold(job, shape);
    cache_job_submit(job);
    return entry;
}
