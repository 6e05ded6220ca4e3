// SPDX-License-Identifier: MIT
// MaterialX: the materials of a document and their open_pbr_surface or standard_surface.
#include "import.h"
#include "mtlx_graph.h"

#include <math.h>

#define MM_PER_UNIT 10.0 // of lengths without a unit: centimetres

// One shader being read.
struct reading {
    struct import_list *list;
    struct prt_import *item;
    struct mtlx_graph *graph;
    struct import_shader *to;
    int shader;
};

// Value of the shader's input, or `otherwise` [3] where it has none; `unread` stands for one
// that cannot be evaluated. Returns mm of its unit, 0 without one.
static double read_input(const struct reading *r, const char *name, const double otherwise[3],
                         double unread, double out[3])
{
    struct mtlx_value v;
    struct mtlx_graph *g = r->graph;
    int input = prt_xml_child(g->tree, r->shader, "input", name);
    memcpy(out, otherwise, 3 * sizeof *out);
    if (input == XML_NONE) return 0;
    g->varies[0] = 0;
    if (!prt_mtlx_input(g, input, &v)) {
        prt_import_append(r->to->unread, "%s (%s)", name, g->missing);
        for (int c = 0; c < 3 && unread >= 0; c++) out[c] = unread;
        return 0;
    }
    for (int c = 0; c < 3; c++) out[c] = v.v[v.n == 1 ? 0 : c];
    if (g->varies[0]) prt_import_append(r->to->varies, "%s (%s)", name, g->varies);
    return g->unit_mm;
}

static void read_color(const struct reading *r, const char *name, const double otherwise[3],
                       double out[3])
{
    (void)read_input(r, name, otherwise, IMPORT_UNREAD_COLOR, out);
}

static double read_number(const struct reading *r, const char *name, double otherwise)
{
    double out[3];
    (void)read_input(r, name, (double[]){otherwise, otherwise, otherwise}, -1, out);
    return out[0];
}

// The share of an interior: one that an image gives is there.
static double read_weight(const struct reading *r, const char *name)
{
    double out[3];
    (void)read_input(r, name, (double[]){0, 0, 0}, IMPORT_UNREAD_WEIGHT, out);
    return out[0];
}

// A length in mm.
static double read_length(const struct reading *r, const char *name, double otherwise)
{
    double out[3];
    double unit = read_input(r, name, (double[]){otherwise, otherwise, otherwise}, -1, out);
    if (!(unit > 0)) unit = r->list->mm_per_unit > 0 ? r->list->mm_per_unit : MM_PER_UNIT;
    return out[0] * unit;
}

static void read_opacity(const struct reading *r, const char *name, struct import_shader *s)
{
    double opacity[3];
    (void)read_input(r, name, (double[]){1, 1, 1}, -1, opacity);
    prt_import_lost(s, "opacity below 1", 1 - fmin(fmin(opacity[0], opacity[1]), opacity[2]));
}

// The names of equal inputs in OpenPBR Surface and Autodesk Standard Surface, and the defaults
// that differ.
struct names {
    const char *base_weight, *metal, *ior, *specular, *transmission, *scatter_g, *subsurface,
        *subsurface_g, *anisotropy, *dispersion, *thin_walls, *emission, *opacity;
    double roughness, subsurface_color; // defaults
};
static const struct names open_pbr = {.base_weight = "base_weight",
                                      .metal = "base_metalness",
                                      .ior = "specular_ior",
                                      .specular = "specular_weight",
                                      .transmission = "transmission_weight",
                                      .scatter_g = "transmission_scatter_anisotropy",
                                      .subsurface = "subsurface_weight",
                                      .subsurface_g = "subsurface_scatter_anisotropy",
                                      .anisotropy = "specular_roughness_anisotropy",
                                      .dispersion = "transmission_dispersion_scale",
                                      .thin_walls = "geometry_thin_walled",
                                      .emission = "emission_luminance",
                                      .opacity = "geometry_opacity",
                                      .roughness = 0.3,
                                      .subsurface_color = 0.8};
static const struct names standard_surface = {.base_weight = "base",
                                              .metal = "metalness",
                                              .ior = "specular_IOR",
                                              .specular = "specular",
                                              .transmission = "transmission",
                                              .scatter_g = "transmission_scatter_anisotropy",
                                              .subsurface = "subsurface",
                                              .subsurface_g = "subsurface_anisotropy",
                                              .anisotropy = "specular_anisotropy",
                                              .dispersion = "transmission_dispersion",
                                              .thin_walls = "thin_walled",
                                              .emission = "emission",
                                              .opacity = "opacity",
                                              .roughness = 0.2,
                                              .subsurface_color = 1};

static void read_common(const struct reading *r, const struct names *n, struct import_shader *s)
{
    static const double grey[3] = {0.8, 0.8, 0.8}, white[3] = {1, 1, 1}, none[3] = {0, 0, 0};
    const double inside = n->subsurface_color, weight = read_number(r, n->base_weight, 1);
    read_color(r, "base_color", grey, s->base);
    for (int c = 0; c < 3; c++) s->base[c] *= weight;
    s->metal = read_number(r, n->metal, 0);
    s->ior = read_number(r, n->ior, 1.5);
    s->specular = read_number(r, n->specular, 1);
    s->roughness = read_number(r, "specular_roughness", n->roughness);
    s->transmission = read_weight(r, n->transmission);
    read_color(r, "transmission_color", white, s->transmission_color);
    s->depth = read_length(r, "transmission_depth", 0);
    read_color(r, "transmission_scatter", none, s->scatter);
    s->scatter_g = read_number(r, n->scatter_g, 0);
    s->subsurface = read_weight(r, n->subsurface);
    read_color(r, "subsurface_color", (double[]){inside, inside, inside}, s->subsurface_color);
    s->subsurface_g = read_number(r, n->subsurface_g, 0);
    prt_import_lost(s, "emission", read_number(r, n->emission, 0));
    prt_import_lost(s, "dispersion", read_number(r, n->dispersion, 0));
    prt_import_lost(s, "anisotropic roughness", read_number(r, n->anisotropy, 0));
    prt_import_lost(s, "thin walls", read_number(r, n->thin_walls, 0));
    read_opacity(r, n->opacity, s);
}

static void read_open_pbr(const struct reading *r, struct import_shader *s)
{
    double scale[3];
    double radius = read_length(r, "subsurface_radius", 1);
    (void)read_input(r, "subsurface_radius_scale", (double[]){1, 0.5, 0.25}, -1, scale);
    for (int c = 0; c < 3; c++) s->free_path[c] = radius * scale[c];
    prt_import_lost(s, "coat", read_number(r, "coat_weight", 0));
    prt_import_lost(s, "fuzz", read_number(r, "fuzz_weight", 0));
    prt_import_lost(s, "thin film", read_number(r, "thin_film_weight", 0));
    read_common(r, &open_pbr, s);
}

static void read_standard(const struct reading *r, struct import_shader *s)
{
    double radius[3];
    (void)read_input(r, "subsurface_radius", (double[]){1, 1, 1}, -1, radius);
    double scale = read_length(r, "subsurface_scale", 1);
    for (int c = 0; c < 3; c++) s->free_path[c] = radius[c] * scale;
    prt_import_lost(s, "coat", read_number(r, "coat", 0));
    prt_import_lost(s, "sheen", read_number(r, "sheen", 0));
    prt_import_lost(s, "thin film", read_number(r, "thin_film_thickness", 0));
    read_common(r, &standard_surface, s);
}

static int read_shader(struct import_list *list, struct mtlx_graph *g, const char *name,
                       int shader)
{
    struct prt_import *item = prt_import_add(list, name);
    if (!item) return PRT_LIMIT;
    if (shader == XML_NONE) {
        prt_import_none(item, "it has no surface shader");
        return PRT_OK;
    }
    struct import_shader s = {.ior = 1.5, .specular = 1};
    struct reading r = {list, item, g, &s, shader};
    const char *tag = g->tree->node[shader].tag;
    snprintf(item->format, sizeof item->format, "%.31s", tag);
    if (!strcmp(tag, "open_pbr_surface")) {
        read_open_pbr(&r, &s);
    } else if (!strcmp(tag, "standard_surface")) {
        read_standard(&r, &s);
    } else {
        prt_import_none(
            item, "its shader is %.40s: open_pbr_surface and standard_surface are read", tag);
        return PRT_OK;
    }
    prt_import_lost(&s, "normal map",
                    prt_xml_child(g->tree, shader, "input", "normal") != XML_NONE ||
                        prt_xml_child(g->tree, shader, "input", "geometry_normal") != XML_NONE);
    prt_import_shader(list, &s, item);
    return PRT_OK;
}

// The shader that a material's input names, through the outputs of node graphs.
static int shader_of(struct mtlx_graph *g, int material)
{
    int at = prt_xml_child(g->tree, material, "input", "surfaceshader");
    for (int steps = 0; at != XML_NONE && steps < 8; steps++) {
        const char *tag = g->tree->node[at].tag;
        if (!strcmp(tag, "nodegraph")) {
            for (at = g->tree->node[at].child; at != XML_NONE; at = g->tree->node[at].next)
                if (!strcmp(g->tree->node[at].tag, "output")) break;
            if (at == XML_NONE) return at;
        } else if (strcmp(tag, "input") && strcmp(tag, "output")) {
            return at;
        }
        at = prt_mtlx_source(g, at);
    }
    return XML_NONE;
}

static int read_document(struct import_list *list, struct mtlx_graph *g)
{
    const struct xml_tree *t = g->tree;
    bool any = false;
    if (strcmp(t->node[0].tag, "materialx"))
        return prt_fail(list->ctx, PRT_FORMAT, "%s: its root is <%.40s>, not <materialx>",
                        list->what, t->node[0].tag);
    for (int i = t->node[0].child; i != XML_NONE; i = t->node[i].next) {
        const char *name = prt_xml_attribute(t, i, "name");
        if (strcmp(t->node[i].tag, "surfacematerial")) continue;
        any = true;
        if (read_shader(list, g, name ? name : "material", shader_of(g, i))) return PRT_LIMIT;
    }
    for (int i = t->node[0].child; !any && i != XML_NONE; i = t->node[i].next) {
        const char *type = prt_xml_attribute(t, i, "type"),
                   *name = prt_xml_attribute(t, i, "name");
        if (!type || strcmp(type, "surfaceshader")) continue;
        if (read_shader(list, g, name ? name : "material", i)) return PRT_LIMIT;
    }
    if (!list->n)
        return prt_fail(list->ctx, PRT_FORMAT, "%s: holds no <surfacematerial>", list->what);
    return PRT_OK;
}

int prt_import_mtlx(struct import_list *list, const char *text, size_t n)
{
    struct xml_tree tree;
    int status = prt_xml_tree_parse(list->ctx, list->what, text, n, &tree);
    if (status) return status;
    struct mtlx_graph graph = {.tree = &tree, .budget = MTLX_MAX_STEP};
    status = read_document(list, &graph);
    prt_xml_tree_finish(&tree);
    return status;
}
