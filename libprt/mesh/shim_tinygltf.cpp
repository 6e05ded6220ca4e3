// SPDX-License-Identifier: MIT
// tinygltf behind C: parsing with replaced file and image access, and conversion of the
// document to plain structs. Compiles against 2.7 (SetFsCallbacks returns void) and 2.9
// (returns bool).
#include "tinygltf.h"

#include <cstdio>
#include <cstring>
#include <new>
#include <stdexcept>
#include <string>
#include <tiny_gltf.h>
#include <type_traits>
#include <vector>

namespace
{

using tinygltf::Value;

struct Holder {
    tinygltf::Model model;
    std::vector<const char *> required;
    std::vector<prt_gltf_buffer> buffer;
    std::vector<prt_gltf_view> view;
    std::vector<prt_gltf_accessor> accessor;
    std::vector<std::vector<prt_gltf_primitive>> primitive;
    std::vector<prt_gltf_mesh> mesh;
    std::vector<prt_gltf_node> node;
    std::vector<prt_gltf_scene> scene;
    std::vector<std::vector<const char *>> extension;
    std::vector<std::vector<double>> diffuse;
    std::vector<prt_gltf_material> material;
};

// ---- files and images

struct Loader {
    const prt_gltf_files *files;
    std::string name; // file that `bytes` holds: 2.9 asks for the size before it reads
    std::vector<unsigned char> bytes;
    bool full = false;

    bool load(const std::string &wanted)
    {
        if (full && wanted == name) return true;
        void *at = nullptr;
        size_t n = 0;
        full = false;
        if (files->read(files->user, wanted.c_str(), &at, &n)) return false;
        try {
            const auto *p = static_cast<const unsigned char *>(at);
            bytes.assign(p, p + n);
        } catch (...) {
            files->release(at);
            throw;
        }
        files->release(at);
        name = wanted;
        return full = true;
    }
};

bool file_exists(const std::string &, void *)
{
    return true;
} // reading reports a missing file

std::string same_path(const std::string &path, void *)
{
    return path;
}

bool read_file(std::vector<unsigned char> *out, std::string *, const std::string &path,
               void *user)
{
    auto *loader = static_cast<Loader *>(user);
    if (!loader->load(path)) return false;
    out->swap(loader->bytes);
    loader->full = false;
    return true;
}

bool write_file(std::string *, const std::string &, const std::vector<unsigned char> &, void *)
{
    return false;
}

[[maybe_unused]] bool file_size(size_t *out, std::string *, const std::string &path, void *user)
{
    auto *loader = static_cast<Loader *>(user);
    if (!loader->load(path)) return false;
    *out = loader->bytes.size();
    return true;
}

bool no_image(tinygltf::Image *, const int, std::string *, std::string *, int, int,
              const unsigned char *, int, void *)
{
    return true;
}

template <class F> auto set_size(F &fs, int) -> decltype(fs.GetFileSizeInBytes, void())
{
    fs.GetFileSizeInBytes = file_size;
}
template <class F> void set_size(F &, long)
{
}

template <class T>
auto set_files(T &t, const tinygltf::FsCallbacks &fs, int) ->
    typename std::enable_if<std::is_same<decltype(t.SetFsCallbacks(fs)), bool>::value,
                            bool>::type
{
    return t.SetFsCallbacks(fs);
}
template <class T> bool set_files(T &t, const tinygltf::FsCallbacks &fs, long)
{
    t.SetFsCallbacks(fs);
    return true;
}

// ---- conversion

int64_t whole(const Value &object, const char *key)
{
    if (!object.IsObject() || !object.Has(key)) return -1;
    const Value &v = object.Get(std::string(key));
    return v.IsInt() ? v.GetNumberAsInt() : -1;
}

const char *text(const Value &object, const char *key)
{
    if (!object.IsObject() || !object.Has(key)) return "";
    const Value &v = object.Get(std::string(key));
    return v.IsString() ? v.Get<std::string>().c_str() : "?";
}

prt_gltf_numbers numbers(const std::vector<double> &v)
{
    return {v.data(), v.size()};
}

prt_gltf_view view_of(const tinygltf::BufferView &v)
{
    prt_gltf_view o = {};
    o.slice = {v.buffer, static_cast<int64_t>(v.byteOffset),
               static_cast<int64_t>(v.byteLength)};
    o.stride = v.byteStride;
    auto ext = v.extensions.find("EXT_meshopt_compression");
    if (ext == v.extensions.end()) return o;
    const Value &e = ext->second;
    o.meshopt = true;
    o.packed = {whole(e, "buffer"), whole(e, "byteOffset"), whole(e, "byteLength")};
    if (e.IsObject() && !e.Has("byteOffset")) o.packed.offset = 0;
    o.packed_count = whole(e, "count");
    o.packed_stride = whole(e, "byteStride");
    o.mode = text(e, "mode");
    o.filter = text(e, "filter");
    return o;
}

prt_gltf_accessor accessor_of(const tinygltf::Accessor &a)
{
    prt_gltf_accessor o = {};
    o.view = a.bufferView;
    o.offset = a.byteOffset;
    o.count = a.count;
    o.component = a.componentType;
    o.n_component = a.type == TINYGLTF_TYPE_SCALAR ? 1
                    : a.type == TINYGLTF_TYPE_VEC2 ? 2
                    : a.type == TINYGLTF_TYPE_VEC3 ? 3
                    : a.type == TINYGLTF_TYPE_VEC4 ? 4
                    : a.type == TINYGLTF_TYPE_MAT4 ? 16
                                                   : 0;
    o.normalized = a.normalized;
    o.sparse = a.sparse.isSparse;
    if (!o.sparse) return o; // tinygltf leaves the rest uninitialised
    o.sparse_count = a.sparse.count;
    o.index_view = a.sparse.indices.bufferView;
    o.index_offset = a.sparse.indices.byteOffset;
    o.index_component = a.sparse.indices.componentType;
    o.value_view = a.sparse.values.bufferView;
    o.value_offset = a.sparse.values.byteOffset;
    return o;
}

int64_t attribute(const tinygltf::Primitive &p, const char *name)
{
    auto it = p.attributes.find(name);
    return it == p.attributes.end() ? -1 : it->second;
}

prt_gltf_primitive primitive_of(const tinygltf::Primitive &p)
{
    static const char *const name[PRT_GLTF_DRACO_IDS] = {
        "POSITION",   "NORMAL",     "COLOR_0",    "TEXCOORD_0", "TEXCOORD_1", "TEXCOORD_2",
        "TEXCOORD_3", "TEXCOORD_4", "TEXCOORD_5", "TEXCOORD_6", "TEXCOORD_7"};
    prt_gltf_primitive o = {};
    o.position = attribute(p, name[0]);
    o.normal = attribute(p, name[1]);
    o.color = attribute(p, name[2]);
    for (int k = 0; k < PRT_GLTF_UV_SETS; k++) o.uv[k] = attribute(p, name[3 + k]);
    o.indices = p.indices;
    o.material = p.material;
    o.mode = p.mode;
    o.targets = !p.targets.empty();
    auto ext = p.extensions.find("KHR_draco_mesh_compression");
    o.draco = ext != p.extensions.end();
    if (!o.draco) return o;
    static const Value none;
    const Value &e = ext->second;
    const bool has = e.IsObject() && e.Has("attributes");
    o.draco_view = whole(e, "bufferView");
    for (int i = 0; i < PRT_GLTF_DRACO_IDS; i++)
        o.draco_id[i] = whole(has ? e.Get(std::string("attributes")) : none, name[i]);
    return o;
}

prt_gltf_node node_of(const tinygltf::Node &n)
{
    prt_gltf_node o = {};
    o.name = n.name.c_str();
    o.mesh = n.mesh;
    o.skin = n.skin;
    o.camera = n.camera;
    o.matrix = numbers(n.matrix);
    o.translation = numbers(n.translation);
    o.rotation = numbers(n.rotation);
    o.scale = numbers(n.scale);
    o.child = n.children.data();
    o.n_child = n.children.size();
    return o;
}

double ior_of(const tinygltf::Material &m)
{
    auto ext = m.extensions.find("KHR_materials_ior");
    if (ext == m.extensions.end() || !ext->second.Has("ior")) return 1.5;
    const Value &v = ext->second.Get(std::string("ior"));
    return v.IsNumber() ? v.GetNumberAsDouble() : 1.5;
}

// Colour of the older material model, for materials whose newer model has none.
std::vector<double> diffuse_of(const tinygltf::Material &m, bool *textured)
{
    std::vector<double> out;
    auto ext = m.extensions.find("KHR_materials_pbrSpecularGlossiness");
    if (ext == m.extensions.end()) return out;
    *textured |= ext->second.Has("diffuseTexture");
    for (double x : m.pbrMetallicRoughness.baseColorFactor)
        if (x != 1) return out;
    if (!ext->second.Has("diffuseFactor")) return out;
    const Value &list = ext->second.Get(std::string("diffuseFactor"));
    for (size_t i = 0; i < list.ArrayLen() && i < 4; i++) {
        const Value &v = list.Get(static_cast<int>(i));
        out.push_back(v.IsNumber() ? v.GetNumberAsDouble() : 1);
    }
    return out;
}

void convert_material(Holder &h, const tinygltf::Material &m)
{
    prt_gltf_material o = {};
    o.textured = m.pbrMetallicRoughness.baseColorTexture.index >= 0;
    h.diffuse.push_back(diffuse_of(m, &o.textured));
    h.extension.emplace_back();
    for (const auto &e : m.extensions) h.extension.back().push_back(e.first.c_str());
    o.name = m.name.c_str();
    o.base_color = numbers(h.diffuse.back().empty() ? m.pbrMetallicRoughness.baseColorFactor
                                                    : h.diffuse.back());
    o.roughness = m.pbrMetallicRoughness.roughnessFactor;
    o.ior = ior_of(m);
    o.double_sided = m.doubleSided;
    o.extension = h.extension.back().data();
    o.n_extension = h.extension.back().size();
    h.material.push_back(o);
}

void convert_head(Holder &h, prt_gltf_document *d)
{
    d->version = h.model.asset.version.c_str();
    d->min_version = h.model.asset.minVersion.c_str();
    for (const auto &name : h.model.extensionsRequired) h.required.push_back(name.c_str());
    d->required = h.required.data();
    d->n_required = h.required.size();
}

void convert(Holder &h, prt_gltf_document *d)
{
    const tinygltf::Model &m = h.model;
    for (const auto &b : m.buffers)
        h.buffer.push_back({b.data.data(), b.data.size(), !b.uri.empty()});
    for (const auto &v : m.bufferViews) h.view.push_back(view_of(v));
    for (const auto &a : m.accessors) h.accessor.push_back(accessor_of(a));
    for (const auto &mesh : m.meshes) {
        h.primitive.emplace_back();
        for (const auto &p : mesh.primitives) h.primitive.back().push_back(primitive_of(p));
        h.mesh.push_back({h.primitive.back().data(), h.primitive.back().size()});
    }
    for (const auto &n : m.nodes) h.node.push_back(node_of(n));
    for (const auto &s : m.scenes) h.scene.push_back({s.nodes.data(), s.nodes.size()});
    for (const auto &o : m.materials) convert_material(h, o);
    d->buffer = h.buffer.data();
    d->view = h.view.data();
    d->accessor = h.accessor.data();
    d->mesh = h.mesh.data();
    d->node = h.node.data();
    d->scene = h.scene.data();
    d->material = h.material.data();
    d->n_buffer = h.buffer.size();
    d->n_view = h.view.size();
    d->n_accessor = h.accessor.size();
    d->n_mesh = h.mesh.size();
    d->n_node = h.node.size();
    d->n_scene = h.scene.size();
    d->n_material = h.material.size();
    d->default_scene = m.defaultScene;
}

// Copies the first line; characters outside ASCII become ?.
void copy_line(const char *from, char *to, size_t size)
{
    size_t n = 0;
    for (; *from && *from != '\n' && n + 1 < size; from++)
        to[n++] = *from < 32 || *from > 126 ? '?' : *from;
    to[n] = 0;
}

int parse(const void *bytes, uint32_t n, bool binary, const prt_gltf_files *files,
          prt_gltf_document *out, char *say, size_t say_size)
{
    auto *h = new Holder;
    out->holder = h;
    Loader loader = {};
    loader.files = files;
    tinygltf::TinyGLTF reader;
    tinygltf::FsCallbacks fs = {};
    fs.FileExists = file_exists;
    fs.ExpandFilePath = same_path;
    fs.ReadWholeFile = read_file;
    fs.WriteWholeFile = write_file;
    fs.user_data = &loader;
    set_size(fs, 0);
    if (!set_files(reader, fs, 0)) { // without these callbacks tinygltf would open any path
        copy_line("tinygltf refuses our file access", say, say_size);
        return PRT_GLTF_REFUSED;
    }
    reader.SetImageLoader(no_image, nullptr);
    std::string error, warning;
    const bool ok =
        binary ? reader.LoadBinaryFromMemory(&h->model, &error, &warning,
                                             static_cast<const unsigned char *>(bytes), n, "")
               : reader.LoadASCIIFromString(&h->model, &error, &warning,
                                            static_cast<const char *>(bytes), n, "");
    convert_head(*h, out);
    copy_line((error.empty() ? warning : error).c_str(), say, say_size);
    if (!ok) return PRT_GLTF_REFUSED;
    convert(*h, out);
    return 0;
}

} // namespace

int prt_gltf_parse(const void *bytes, uint32_t n, bool binary, const prt_gltf_files *files,
                   prt_gltf_document *out, char *say, size_t say_size)
{
    *out = prt_gltf_document();
    *say = 0;
    try {
        return parse(bytes, n, binary, files, out, say, say_size);
    } catch (const std::bad_alloc &) {
        return PRT_GLTF_NO_MEMORY;
    } catch (const std::length_error &) {
        return PRT_GLTF_NO_MEMORY;
    } catch (const std::exception &e) {
        copy_line(e.what(), say, say_size);
    } catch (...) {
        copy_line("an unknown exception", say, say_size);
    }
    return PRT_GLTF_REFUSED;
}

void prt_gltf_free(prt_gltf_document *d)
{
    delete static_cast<Holder *>(d->holder);
    *d = prt_gltf_document();
}
