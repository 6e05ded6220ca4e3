// SPDX-License-Identifier: MIT
// KHR_draco_mesh_compression through libdraco. Runs in the isolated child only: damaged streams
// have crashed it.
#include "draco.h"

#include <cstdlib>
#include <draco/compression/decode.h>
#include <exception>

namespace
{

template <int N> float *values(const draco::Mesh &mesh, int64_t id)
{
    const draco::PointAttribute *a = mesh.GetAttributeByUniqueId(static_cast<uint32_t>(id));
    if (!a || a->num_components() != N) return nullptr;
    auto *out = static_cast<float *>(std::malloc(sizeof(float) * N * mesh.num_points()));
    if (!out) return nullptr;
    for (draco::PointIndex p(0); p < mesh.num_points(); ++p) {
        const draco::AttributeValueIndex v = a->mapped_index(p);
        if (v.value() >= a->size() ||
            !a->ConvertValue<float, N>(v, out + size_t{N} * p.value())) {
            std::free(out);
            return nullptr;
        }
    }
    return out;
}

// RGB or RGBA as RGBA.
float *colors(const draco::Mesh &mesh, int64_t id)
{
    const draco::PointAttribute *a = mesh.GetAttributeByUniqueId(static_cast<uint32_t>(id));
    if (!a) return nullptr;
    if (a->num_components() == 4) return values<4>(mesh, id);
    float *rgb = values<3>(mesh, id);
    auto *out = static_cast<float *>(std::malloc(sizeof(float) * 4 * mesh.num_points()));
    for (uint32_t i = 0; rgb && out && i < mesh.num_points(); i++) {
        for (int c = 0; c < 3; c++) out[size_t{4} * i + c] = rgb[size_t{3} * i + c];
        out[size_t{4} * i + 3] = 1;
    }
    if (!rgb) {
        std::free(out);
        out = nullptr;
    }
    std::free(rgb);
    return out;
}

const char *decode(const void *bytes, size_t n, const int64_t id[11], uint32_t max_vertices,
                   uint32_t max_triangles, prt_draco *out)
{
    draco::DecoderBuffer buffer;
    buffer.Init(static_cast<const char *>(bytes), n);
    auto type = draco::Decoder::GetEncodedGeometryType(&buffer);
    if (!type.ok() || type.value() != draco::TRIANGULAR_MESH) return "is no Draco mesh";
    draco::Decoder decoder;
    auto result = decoder.DecodeMeshFromBuffer(&buffer);
    if (!result.ok()) return "damaged Draco data";
    const draco::Mesh &mesh = *result.value();
    if (mesh.num_points() > max_vertices || mesh.num_faces() > max_triangles)
        return "the Draco mesh is too large";
    if (!mesh.num_points() || !mesh.num_faces()) return "the Draco mesh is empty";
    out->n_vertex = mesh.num_points();
    out->n_triangle = mesh.num_faces();
    out->triangle =
        static_cast<uint32_t *>(std::malloc(sizeof(uint32_t) * 3 * mesh.num_faces()));
    if (!out->triangle) return "no memory";
    for (draco::FaceIndex f(0); f < mesh.num_faces(); ++f)
        for (int k = 0; k < 3; k++) {
            const uint32_t v = mesh.face(f)[k].value();
            if (v >= out->n_vertex) return "damaged Draco data";
            out->triangle[size_t{3} * f.value() + k] = v;
        }
    if (!(out->position = values<3>(mesh, id[0]))) return "the Draco mesh has no positions";
    if (id[1] >= 0 && !(out->normal = values<3>(mesh, id[1]))) return "damaged Draco normals";
    if (id[2] >= 0 && !(out->color = colors(mesh, id[2]))) return "damaged Draco COLOR_0";
    for (int k = 0; k < 8; k++)
        if (id[3 + k] >= 0 && !(out->uv[k] = values<2>(mesh, id[3 + k])))
            return "damaged Draco texture coordinates";
    return nullptr;
}

} // namespace

int prt_draco_decode(const void *bytes, size_t n, const int64_t id[11], uint32_t max_vertices,
                     uint32_t max_triangles, prt_draco *out, const char **why)
{
    *out = prt_draco();
    try {
        *why = decode(bytes, n, id, max_vertices, max_triangles, out);
    } catch (const std::exception &) {
        *why = "damaged Draco data (it asks for too much memory)";
    }
    return *why ? -1 : 0;
}

void prt_draco_free(prt_draco *d)
{
    std::free(d->position);
    std::free(d->normal);
    std::free(d->color);
    for (float *uv : d->uv) std::free(uv);
    std::free(d->triangle);
    *d = prt_draco();
}
