// SPDX-License-Identifier: MIT
// Rewrites the JSON that tinygltf refuses: fallback buffers of EXT_meshopt_compression, which
// have no bytes, and Draco primitives, whose index accessors have no bufferView. gltf_buffer.c
// and gltf_primitive.c decode the compressed bytes later, from the extensions themselves.
#include "gltf.h"

#include <cjson/cJSON.h>
#include <stdlib.h>
#include <string.h>

static const cJSON *member(const cJSON *object, const char *key)
{
    return cJSON_IsObject(object) ? cJSON_GetObjectItemCaseSensitive(object, key) : NULL;
}

static bool set(cJSON *object, const char *key, cJSON *value)
{
    cJSON_DeleteItemFromObjectCaseSensitive(object, key);
    return value && cJSON_AddItemToObject(object, key, value);
}

// Gives each buffer without bytes a single byte. A bufferView of it that is not decoded then
// fails its bounds check.
static bool fill_buffers(const struct gltf *g, cJSON *json)
{
    cJSON *buffer;
    size_t i = 0;
    cJSON_ArrayForEach(buffer, member(json, "buffers"))
    {
        bool from_bin = i++ == 0 && g->bin.n;
        if (!cJSON_IsObject(buffer) || from_bin || member(buffer, "uri")) continue;
        if (!set(buffer, "byteLength", cJSON_CreateNumber(1)) ||
            !set(buffer, "uri",
                 cJSON_CreateString("data:application/octet-stream;base64,AA==")))
            return false;
    }
    return true;
}

static void drop_draco_indices(cJSON *json)
{
    cJSON *mesh, *primitive;
    cJSON_ArrayForEach(mesh, member(json, "meshes"))
        cJSON_ArrayForEach(primitive, member(mesh, "primitives"))
    {
        const cJSON *ext = member(primitive, "extensions");
        if (cJSON_IsObject(member(ext, "KHR_draco_mesh_compression")))
            cJSON_DeleteItemFromObjectCaseSensitive(primitive, "indices");
    }
}

bool prt_gltf_needs_rewrite(const char *json, size_t n)
{
    return memmem(json, n, "EXT_meshopt_compression", 23) ||
           memmem(json, n, "KHR_draco_mesh_compression", 26);
}

int prt_gltf_rewrite(struct gltf *g, const char *json, size_t n, char **out)
{
    const char *end = NULL;
    cJSON *tree = cJSON_ParseWithLengthOpts(json, n, &end, 0);
    if (!tree || end != json + n) {
        cJSON_Delete(tree);
        return prt_gltf_bad(g, "its JSON is damaged near byte %zu",
                            end ? (size_t)(end - json) : 0);
    }
    drop_draco_indices(tree);
    *out = fill_buffers(g, tree) ? cJSON_PrintUnformatted(tree) : NULL;
    cJSON_Delete(tree);
    return *out ? PRT_OK : prt_gltf_no_memory(g);
}
