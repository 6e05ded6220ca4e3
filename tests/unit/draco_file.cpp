// SPDX-License-Identifier: MIT
#include "draco_file.h"

#include <cstring>
#include <draco/compression/encode.h>

size_t draco_write(uint32_t n_vertex, uint32_t n_triangle, const uint32_t (*triangle)[3],
                   int n_attribute, const struct draco_attribute *attribute, void *out,
                   size_t room)
{
    static const draco::GeometryAttribute::Type type[] = {
        draco::GeometryAttribute::POSITION, draco::GeometryAttribute::NORMAL,
        draco::GeometryAttribute::COLOR, draco::GeometryAttribute::TEX_COORD};
    draco::Mesh mesh;
    mesh.set_num_points(n_vertex);
    mesh.SetNumFaces(n_triangle);
    for (uint32_t t = 0; t < n_triangle; t++) {
        const draco::Mesh::Face face = {draco::PointIndex(triangle[t][0]),
                                        draco::PointIndex(triangle[t][1]),
                                        draco::PointIndex(triangle[t][2])};
        mesh.SetFace(draco::FaceIndex(t), face);
    }
    for (int i = 0; i < n_attribute; i++) {
        const draco_attribute &a = attribute[i];
        const int64_t stride = a.n_value * int64_t{sizeof(float)};
        draco::GeometryAttribute g;
        g.Init(type[a.kind], nullptr, static_cast<int8_t>(a.n_value), draco::DT_FLOAT32, false,
               stride, 0);
        const int id = mesh.AddAttribute(g, true, n_vertex);
        for (uint32_t v = 0; v < n_vertex; v++)
            mesh.attribute(id)->SetAttributeValue(draco::AttributeValueIndex(v),
                                                  a.value + size_t(a.n_value) * v);
    }
    draco::Encoder encoder; // floats are not quantised unless that is asked for
    encoder.SetEncodingMethod(draco::MESH_SEQUENTIAL_ENCODING);
    draco::EncoderBuffer buffer;
    if (!encoder.EncodeMeshToBuffer(mesh, &buffer).ok() || buffer.size() > room) return 0;
    std::memcpy(out, buffer.data(), buffer.size());
    return buffer.size();
}
