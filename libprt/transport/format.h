// SPDX-License-Identifier: MIT
// The layout of a .prt file: a header, a table of sections, the sections.
//
// Everything is little-endian. The header has 64 bytes; the table follows it. Sections lie in
// the order of the table, each at a multiple of 64 bytes and padded with zeros to the next one.
// A section's checksum covers its padding, so that checksums cover every byte of the file.
#ifndef PRT_TRANSPORT_FORMAT_H
#define PRT_TRANSPORT_FORMAT_H

#include "prt/transport.h"

enum {
    FORMAT_VERSION = PRT_FILE_VERSION,
    FORMAT_ENDIAN = 0x01020304,
    FORMAT_ALIGN = 64,
    FORMAT_MAX_SECTION = 256,
};
#define FORMAT_MAGIC "\x89PRT\r\n\x1a\n"

struct format_header {
    char magic[8];
    uint32_t version, endian;
    uint64_t file_bytes;
    uint32_t n_section, reserved;
    uint64_t reserved2[3];
    uint64_t hash; // XXH3 of header and table, this field 0
};

enum format_section_type {
    SECTION_INFO = 1,
    SECTION_SETTINGS,
    SECTION_ERRORS,
    SECTION_POSITION,
    SECTION_NORMAL,
    SECTION_UV,
    SECTION_TRIANGLE,
    SECTION_WELD,
    SECTION_BLOCK,
    SECTION_SURFACE,
    SECTION_TENSOR,
    SECTION_ORDER,
    SECTION_CLUSTER,
    SECTION_U,
    SECTION_ROW_BEGIN,
    SECTION_ROW_INDEX,
    SECTION_ROW_ENTRY,
    SECTION_ROW_SCALE,
    SECTION_ROW_SCALING,
    SECTION_KNOT,
    SECTION_BASIS,
    SECTION_PROFILE, // of a material with its own R_d; its number in place of the tensor's
    // of low-rank rows
    SECTION_ROW_SHIFT,
    SECTION_ROW_DIRECTION,
    SECTION_ROW_VALUE_BEGIN,
    SECTION_ROW_MIX,
    // textures; files without them have none of these
    SECTION_UV_MORE,
    SECTION_CORNER_UV,
    SECTION_COLOR,
    SECTION_MAPS,
    SECTION_IMAGE,
    SECTION_TEXEL,
    SECTION_CAMERA, // the model's own cameras; missing where it has none
    SECTION_OBJECT, // names; missing where no object has one
    // of several media; files with one have neither
    SECTION_MEDIA,     // the second medium and so on
    SECTION_MEDIUM_OF, // a byte an object
    SECTION_BLOCKED,   // sky that the model hides from its vertices
    // of KHR_materials_variants; files without them have none of these
    SECTION_VARIANT,         // names
    SECTION_VARIANT_SURFACE, // surface of each block in each variant
    SECTION_VOLUME,          // insides of the surfaces, from which variants have their media
    SECTION_ETA,             // of a tensor for any index: range and nodes; else missing
    SECTION_U_SCALE,         // of RADIAL storage; missing: columns have no factors
};

struct format_section {
    uint32_t type;          // enum format_section_type
    uint32_t tensor;        // the tensor it belongs to; 0 for sections of none
    uint64_t offset, bytes; // bytes without the padding
    uint64_t hash;          // XXH3 with the padding
};

struct format_material {
    char name[32];
    float sigma_s_prime[3], sigma_a[3], g[3], eta, roughness;
};

struct format_profile {
    uint32_t kind, n_point;
    // floats: radius[n_point], reflectance[3][n_point]
};

struct format_info {
    uint32_t n_vertex, n_triangle, n_block, n_object, n_surface, n_weld;
    float mm_per_unit;
    uint32_t units_known, n_boundary_edge, n_nonmanifold_edge, n_degenerate_triangle;
    uint32_t cube, engine, n_tensor;
    struct format_material material; // the first medium
    float texture_split;             // 0 in files from before textures
    uint64_t mesh_hash;
};

struct format_tensor {
    uint32_t term, storage, coupling, n_vertex, n_function, n_phase, n_cluster, n_radial;
    uint64_t u_count, n_entry;
    uint32_t n_row, n_coef, value, index_bytes;
    uint32_t n_knot, basis_kind;
};

_Static_assert(sizeof(struct format_header) == 64, "header");
_Static_assert(sizeof(struct format_section) == 32, "section");
_Static_assert(sizeof(struct format_material) == 76, "material");
_Static_assert(sizeof(struct format_info) == 144, "info");
_Static_assert(sizeof(struct format_tensor) == 72, "tensor");
_Static_assert(sizeof(struct prt_block) == 24, "block");
_Static_assert(sizeof(struct prt_surface) == 92, "surface");
_Static_assert(sizeof(struct prt_texture_image) == 48, "texture image");
_Static_assert(sizeof(struct prt_surface_maps) == 5 * 36 + 16, "surface maps");
_Static_assert(sizeof(struct prt_mesh_camera) == 104, "camera");
_Static_assert(sizeof(struct prt_object) == 64, "object");
_Static_assert(sizeof(struct prt_mesh_variant) == 64, "variant");
_Static_assert(sizeof(struct prt_volume) == 36, "volume");
_Static_assert(sizeof(struct prt_cluster) == 24, "cluster");

static inline uint64_t format_padded(uint64_t bytes)
{
    return (bytes + FORMAT_ALIGN - 1) & ~(uint64_t)(FORMAT_ALIGN - 1);
}

// PRT_FORMAT unless everything that is used unchecked later is valid: ranges, orders,
// permutations, finite numbers. The caller has already held the sections' lengths to the
// counts. `name` opens the error line.
int prt_transport_check(const struct prt_context *ctx, const char *name,
                        const struct prt_transport *transport);

#endif
