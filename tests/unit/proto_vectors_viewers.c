// SPDX-License-Identifier: MIT
// What viewers draw with, in the vectors: planes of exit, colours of fewer vertices, variants.
#include "proto_vectors.h"

enum { LAST = RELIGHT_FRAME_LAST, ANSWER = RELIGHT_TYPE_ANSWER };

// Three vertices, one cluster of one row in each of two tensors.
static unsigned add_exit_factors(struct vector *out, unsigned n)
{
    static Relight__FactorsRequest ask;
    static Relight__FactorsAnswer factors;
    static Relight__FactorTensor tensor[2], *tensors[2];
    static union {
        uint32_t words[96];
        int16_t u[192];
    } sections = {{3, 1, [16] = 0, 1, 2, [48] = 3, 1, [64] = 2, 1, 0}};
    relight__factors_request__init(&ask);
    relight__factors_answer__init(&factors);
    ask.model = "3f9ad2c1";
    ask.exits = true;
    for (int v = 0; v < 3; v++) {
        sections.u[64 + 2 * v] = (int16_t)(1 << (14 - v));
        sections.u[160 + 2 * v] = (int16_t)(1 << (10 + v));
    }
    for (size_t i = 0; i < 2; i++) {
        relight__factor_tensor__init(tensors[i] = &tensor[i]);
        tensor[i].term = RELIGHT__TERM__TERM_SINGLE;
        tensor[i].n_cluster = 1;
        tensor[i].clusters_offset = 192 * i;
        tensor[i].order_offset = 192 * i + 64;
        tensor[i].u_offset = 192 * i + 128;
        tensor[i].u_bytes = 64;
        tensor[i].exit = i == 1;
    }
    factors.factors = UINT64_C(0x1122334455667788);
    factors.n_vertex = 3;
    factors.n_tensors = 2;
    factors.tensors = tensors;
    n = vector_add(out, n, "factors_exits", "C: FACTORS with planes of exit", 27, LAST, 23,
                   &ask.base, NULL, 0);
    return vector_add(
        out, n, "factors_exits_answer",
        "S: FACTORS, single: U/2^-20 16384 8192 4096 of vertices 0 1 2; planes of "
        "exit: 1024 2048 4096 of vertices 2 1 0",
        27 | ANSWER, LAST, 23, &factors.base, &sections, sizeof sections);
}

static unsigned add_exit_coefficients(struct vector *out, unsigned n)
{
    static Relight__ColorsRequest request;
    static Relight__Light even, *all[] = {&even};
    static Relight__ColorsAnswer answer;
    static Relight__Coefficients coefficients;
    static Relight__CoefficientLayer layer[2], *layers[2];
    static Relight__Outgoing outgoing, *outgoings[] = {&outgoing};
    static float one = 1;
    // halves: S_0 of the row; from 64 bytes on P_0 to P_8
    static const uint16_t rows[32 + 27] = {0x3c00, 0x3800, 0x3400, [32] = 0x3800, 0, 0,
                                           0xbc00, 0,      0,      [56] = 0,      0, 0x4000};
    relight__colors_request__init(&request);
    relight__light__init(&even);
    relight__colors_answer__init(&answer);
    relight__coefficients__init(&coefficients);
    relight__outgoing__init(&outgoing);
    even.env = "constant";
    request.model = "3f9ad2c1";
    request.n_lights = 1;
    request.lights = all;
    request.format = RELIGHT__COLOR_FORMAT__COLOR_COEFFICIENTS;
    request.phases = request.exits = true;
    for (uint32_t i = 0; i < 2; i++) {
        relight__coefficient_layer__init(layers[i] = &layer[i]);
        layer[i].tensor = i;
        layer[i].n_phase = i ? 9 : 1;
        layer[i].n_row = 1;
        layer[i].offset = 64 * i;
        layer[i].n_scales = 1;
        layer[i].scales = &one;
    }
    outgoing.eta = 1.3f;
    outgoing.roughness = 0.25f;
    outgoing.mean = outgoing.divisor = 1;
    outgoing.view_slope = 0.5f;
    coefficients.factors = UINT64_C(0x1122334455667788);
    coefficients.n_layers = 2;
    coefficients.layers = layers;
    coefficients.n_outgoing = 1;
    coefficients.outgoing = outgoings;
    answer.n_vertex = 3;
    answer.n_plane = 1;
    answer.plane_bytes = sizeof rows;
    answer.format = request.format;
    answer.generation = 1;
    answer.coefficients = &coefficients;
    n = vector_add(out, n, "coefficients_exits", "C: COLORS, coefficients with planes of exit",
                   12, LAST, 24, &request.base, NULL, 0);
    return vector_add(out, n, "coefficients_exits_answer",
                      "S: COLORS: S_0 (1 .5 .25), P_0 (.5 0 0), P_1 (-1 0 0), P_8 (0 0 2); S_0 "
                      "of vertex 0 is (1 .5 .25)/64, its P_1 (-1 0 0)/256",
                      12 | ANSWER, LAST, 24, &answer.base, rows, sizeof rows);
}

// Four vertices: 2 and 0 are roots, 3 is between them, 1 between 3 and 0.
static unsigned add_coarse(struct vector *out, unsigned n)
{
    static Relight__GeometryRequest ask;
    static Relight__GeometryAnswer order;
    static Relight__ViewFrame frame;
    static Relight__ColorsAnswer colors;
    static Relight__Cost cost;
    static const uint32_t sections[16 + 8] = {2, 0, 3, 1, [16] = 0, 0, 1, 1, 0, 1, 2, 1};
    static const uint32_t two[2] = {24u << 27 | 8, 24u << 27 | 4}; // RGB9E5: red 8, red 4
    relight__geometry_request__init(&ask);
    relight__geometry_answer__init(&order);
    relight__view_frame__init(&frame);
    relight__colors_answer__init(&colors);
    relight__cost__init(&cost);
    ask.model = "3f9ad2c1";
    ask.coarse = true;
    order.n_vertex = 4;
    order.n_coarse_root = 2;
    order.coarse_parents_offset = 64;
    order.coarse_order = UINT64_C(0x0123456789abcdef);
    n = vector_add(out, n, "geometry_coarse", "C: GEOMETRY, the coarse order", 11, LAST, 25,
                   &ask.base, NULL, 0);
    n = vector_add(out, n, "geometry_coarse_answer",
                   "S: GEOMETRY, vertices 2 0 3 1; 3 is between 2 and 0, 1 between 3 and 0",
                   11 | ANSWER, LAST, 25, &order.base, sections, sizeof sections);
    cost.reduced = 2;
    colors.n_vertex = 4;
    colors.n_plane = 1;
    colors.plane_bytes = sizeof two;
    colors.format = RELIGHT__COLOR_FORMAT__COLOR_RGB9E5;
    colors.generation = 1;
    colors.n_coarse = 2;
    colors.coarse_order = order.coarse_order;
    colors.cost = &cost;
    frame.frame = 3;
    frame.sequence = 2;
    frame.colors = &colors;
    return vector_add(
        out, n, "view_frame_coarse",
        "S: ViewFrame, red of vertices 2 and 0 is 8 and 4: of 3 it is 6, of 1 it is 5",
        14 | ANSWER, 0, 10, &frame.base, two, sizeof two);
}

// Two levels: 2 x 1, the second texel of which is all 0, and 1 x 1.
static unsigned add_texture_files(struct vector *out, unsigned n)
{
    static Relight__GeometryRequest ask;
    static Relight__GeometryAnswer answer;
    static Relight__TextureImage image, *images[] = {&image};
    static char hash[] = "00112233445566778899aabbccddeeff";
    static uint32_t sizes[2] = {77, 73};
    static const uint8_t files[77 + 73] = {
        0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48,
        0x44, 0x52, 0x00, 0x00, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01, 0x08, 0x06, 0x00, 0x00,
        0x00, 0xf4, 0x22, 0x7f, 0x8a, 0x00, 0x00, 0x00, 0x14, 0x49, 0x44, 0x41, 0x54, 0x78,
        0x01, 0x01, 0x09, 0x00, 0xf6, 0xff, 0x01, 0xc8, 0x64, 0x32, 0xff, 0x38, 0x9c, 0xce,
        0x01, 0x13, 0x86, 0x04, 0x02, 0xf6, 0x41, 0x11, 0x54, 0x00, 0x00, 0x00, 0x00, 0x49,
        0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82, 0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a,
        0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44, 0x52, 0x00, 0x00, 0x00, 0x01, 0x00,
        0x00, 0x00, 0x01, 0x08, 0x06, 0x00, 0x00, 0x00, 0x1f, 0x15, 0xc4, 0x89, 0x00, 0x00,
        0x00, 0x10, 0x49, 0x44, 0x41, 0x54, 0x78, 0x01, 0x01, 0x05, 0x00, 0xfa, 0xff, 0x00,
        0x64, 0x32, 0x19, 0x80, 0x02, 0xdd, 0x01, 0x30, 0xfb, 0x4c, 0xf1, 0xbb, 0x00, 0x00,
        0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82};
    relight__geometry_request__init(&ask);
    relight__geometry_answer__init(&answer);
    relight__texture_image__init(&image);
    ask.model = "3f9ad2c1";
    ask.image = image.hash = hash;
    ask.png = true;
    image.width = 2;
    image.height = 1;
    image.bytes = 12;
    image.n_png_bytes = 2;
    image.png_bytes = sizes;
    answer.images = images;
    answer.n_images = 1;
    n = vector_add(out, n, "geometry_png", "C: GEOMETRY, an image as PNG files", 11, LAST, 37,
                   &ask.base, NULL, 0);
    return vector_add(
        out, n, "geometry_png_answer",
        "S: GEOMETRY, texels 200 100 50 255 and 0 0 0 0; level 1 is 100 50 25 128", 11 | ANSWER,
        LAST, 37, &answer.base, files, sizeof files);
}

static unsigned add_variants(struct vector *out, unsigned n)
{
    static Relight__ListRequest list;
    static Relight__ListAnswer listed;
    static Relight__ModelInfo model, *models[] = {&model};
    static char *variants[] = {"night", "day"};
    static Relight__ColorsRequest request;
    static Relight__Light even, *all[] = {&even};
    static Relight__Shade shade;
    relight__list_request__init(&list);
    relight__list_answer__init(&listed);
    relight__model_info__init(&model);
    relight__colors_request__init(&request);
    relight__light__init(&even);
    relight__shade__init(&shade);
    model.model = "3f9ad2c1";
    model.name = "lamp.glb";
    model.state = RELIGHT__MODEL_STATE__MODEL_READY;
    model.n_variants = 2;
    model.variants = variants;
    listed.n_models = 1;
    listed.models = models;
    n = vector_exchange(out, n, "list", 3, 26, "C: LIST", &list.base,
                        "S: LIST, a model with the variants night and day", &listed.base);
    even.env = "constant";
    shade.variant = "night";
    request.model = model.model;
    request.n_lights = 1;
    request.lights = all;
    request.shade = &shade;
    return vector_add(out, n, "colors_variant", "C: COLORS of the variant night", 12, LAST, 27,
                      &request.base, NULL, 0);
}

unsigned vectors_add_viewers(struct vector *out, unsigned n)
{
    n = add_exit_factors(out, n);
    n = add_exit_coefficients(out, n);
    n = add_coarse(out, n);
    n = add_texture_files(out, n);
    return add_variants(out, n);
}
