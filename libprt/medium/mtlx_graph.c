// SPDX-License-Identifier: MIT
// MaterialX graphs of constants and arithmetic. Positions are taken at the origin and noise at
// its mean, 0, so that a pattern has one representative value; images have none.
#include "mtlx_graph.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_DEPTH = 128 }; // a node adds three

static bool evaluate(struct mtlx_graph *g, int node, const char *output, int depth,
                     struct mtlx_value *out);

static bool fail(struct mtlx_graph *g, const char *tag, const char *name)
{
    if (!g->missing[0])
        snprintf(g->missing, sizeof g->missing, "%.40s \"%.40s\"", tag, name ? name : "");
    return false;
}

static bool fail_at(struct mtlx_graph *g, int node)
{
    return fail(g, g->tree->node[node].tag, prt_xml_attribute(g->tree, node, "name"));
}

static bool numbers(const char *text, struct mtlx_value *out)
{
    char *end;
    if (!strcmp(text, "true") || !strcmp(text, "false")) {
        *out = (struct mtlx_value){.v = {!strcmp(text, "true")}, .n = 1};
        return true;
    }
    *out = (struct mtlx_value){.n = 0};
    while (out->n < 4) {
        double v = strtod(text, &end);
        if (end == text || !isfinite(v) || fabs(v) > 1e12) return false;
        out->v[out->n++] = v;
        text = end + strspn(end, " \t\r\n");
        if (!*text) return true;
        if (*text != ',') return false;
        text++;
    }
    return false;
}

static double srgb_linear(double v)
{
    return v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4);
}

// A colour of the element's colour space, or that of an element around it, to linear Rec. 709.
static void to_linear(const struct mtlx_graph *g, int node, struct mtlx_value *value)
{
    static const double ap1[3][3] = {{1.70505, -0.62179, -0.08326},
                                     {-0.13026, 1.14080, -0.01055},
                                     {-0.02400, -0.12897, 1.15297}};
    const char *type = prt_xml_attribute(g->tree, node, "type"), *space = NULL;
    if (value->n < 3 || !type || strncmp(type, "color", 5)) return;
    for (int i = node; i != XML_NONE && !space; i = g->tree->node[i].parent)
        space = prt_xml_attribute(g->tree, i, "colorspace");
    if (space && !strcmp(space, "srgb_texture"))
        for (int c = 0; c < 3; c++) value->v[c] = srgb_linear(value->v[c]);
    if (!space || (strcmp(space, "acescg") && strcmp(space, "lin_ap1"))) return;
    double in[3] = {value->v[0], value->v[1], value->v[2]};
    for (int r = 0; r < 3; r++)
        value->v[r] = ap1[r][0] * in[0] + ap1[r][1] * in[1] + ap1[r][2] * in[2];
}

static double length_mm(const char *unit)
{
    static const struct {
        const char *word;
        double mm;
    } units[] = {{"nanometer", 1e-6}, {"micron", 1e-3},   {"millimeter", 1}, {"centimeter", 10},
                 {"meter", 1000},     {"kilometer", 1e6}, {"inch", 25.4},    {"foot", 304.8},
                 {"yard", 914.4},     {"mile", 1609344}};
    for (size_t i = 0; unit && i < sizeof units / sizeof *units; i++)
        if (!strcmp(unit, units[i].word)) return units[i].mm;
    return 0;
}

// The nearest element of this name in the scopes around `from`.
static int find(const struct mtlx_graph *g, int from, const char *tag, const char *name)
{
    for (int i = g->tree->node[from].parent; i != XML_NONE; i = g->tree->node[i].parent) {
        int found = prt_xml_child(g->tree, i, tag, name);
        if (found != XML_NONE) return found;
    }
    return XML_NONE;
}

int prt_mtlx_source(struct mtlx_graph *g, int input)
{
    const char *graph = prt_xml_attribute(g->tree, input, "nodegraph");
    const char *node = prt_xml_attribute(g->tree, input, "nodename");
    const char *face = prt_xml_attribute(g->tree, input, "interfacename");
    // an output's scope is the graph that holds it; an input's is the scope of its node
    int holder = g->tree->node[input].parent;
    if (!strcmp(g->tree->node[input].tag, "output")) holder = input;
    if (holder == XML_NONE) return XML_NONE;
    if (graph) return find(g, holder, "nodegraph", graph);
    if (node) return find(g, holder, NULL, node);
    return face ? find(g, holder, "input", face) : XML_NONE;
}

static bool input_at(struct mtlx_graph *g, int input, int depth, struct mtlx_value *out)
{
    const char *value = prt_xml_attribute(g->tree, input, "value");
    const char *output = prt_xml_attribute(g->tree, input, "output");
    if (depth > MAX_DEPTH || g->budget-- <= 0) return fail(g, "graph", "too deep or too large");
    bool refers = prt_xml_attribute(g->tree, input, "nodegraph") ||
                  prt_xml_attribute(g->tree, input, "nodename") ||
                  prt_xml_attribute(g->tree, input, "interfacename");
    if (refers) {
        int source = prt_mtlx_source(g, input);
        if (source == XML_NONE)
            return fail(g, "missing node of input", prt_xml_attribute(g->tree, input, "name"));
        return evaluate(g, source, output, depth + 1, out);
    }
    if (!value || !numbers(value, out)) return fail_at(g, input);
    g->unit_mm = length_mm(prt_xml_attribute(g->tree, input, "unit"));
    to_linear(g, input, out);
    return true;
}

bool prt_mtlx_input(struct mtlx_graph *g, int input, struct mtlx_value *out)
{
    g->missing[0] = 0;
    g->unit_mm = 0;
    return input_at(g, input, 0, out);
}

// An operand; `otherwise` where the node does not have it.
static bool operand(struct mtlx_graph *g, int node, const char *name, double otherwise,
                    int depth, struct mtlx_value *out)
{
    int input = prt_xml_child(g->tree, node, "input", name);
    *out = (struct mtlx_value){.v = {otherwise, otherwise, otherwise, otherwise}, .n = 1};
    return input == XML_NONE || input_at(g, input, depth, out);
}

static double component(const struct mtlx_value *a, int i)
{
    return a->v[a->n == 1 ? 0 : i];
}

static double apply(const char *op, double a, double b, double t)
{
    if (!strcmp(op, "add")) return a + b;
    if (!strcmp(op, "subtract")) return a - b;
    if (!strcmp(op, "multiply")) return a * b;
    if (!strcmp(op, "divide")) return b != 0 ? a / b : 0;
    if (!strcmp(op, "power")) return pow(fmax(a, 0), b);
    if (!strcmp(op, "min")) return fmin(a, b);
    if (!strcmp(op, "max")) return fmax(a, b);
    if (!strcmp(op, "mix")) return a + t * (b - a);
    if (!strcmp(op, "clamp")) return fmin(fmax(t, a), b);
    if (!strcmp(op, "invert")) return b - a;
    if (!strcmp(op, "sin")) return sin(a);
    if (!strcmp(op, "cos")) return cos(a);
    if (!strcmp(op, "sqrt")) return sqrt(fmax(a, 0));
    if (!strcmp(op, "absval")) return fabs(a);
    return a; // constant, dot, convert
}

// Arithmetic component by component: the names of its operands and their defaults.
static const struct operation {
    const char *tag, *a, *b, *t;
    double default_a, default_b;
} operations[] = {
    {"constant", "value", NULL, NULL, 0, 0}, {"dot", "in", NULL, NULL, 0, 0},
    {"convert", "in", NULL, NULL, 0, 0},     {"add", "in1", "in2", NULL, 0, 0},
    {"subtract", "in1", "in2", NULL, 0, 0},  {"multiply", "in1", "in2", NULL, 0, 1},
    {"divide", "in1", "in2", NULL, 0, 1},    {"power", "in1", "in2", NULL, 0, 1},
    {"min", "in1", "in2", NULL, 0, 0},       {"max", "in1", "in2", NULL, 0, 0},
    {"mix", "bg", "fg", "mix", 0, 0},        {"clamp", "low", "high", "in", 0, 1},
    {"invert", "in", "amount", NULL, 0, 1},  {"sin", "in", NULL, NULL, 0, 0},
    {"cos", "in", NULL, NULL, 0, 0},         {"sqrt", "in", NULL, NULL, 0, 0},
    {"absval", "in", NULL, NULL, 0, 0},
};

static bool arithmetic(struct mtlx_graph *g, int node, const struct operation *op, int depth,
                       struct mtlx_value *out)
{
    struct mtlx_value a, b = {.n = 1}, t = {.n = 1};
    if (!operand(g, node, op->a, op->default_a, depth, &a) ||
        (op->b && !operand(g, node, op->b, op->default_b, depth, &b)) ||
        (op->t && !operand(g, node, op->t, 0, depth, &t)))
        return false;
    out->n = a.n > b.n ? a.n : b.n;
    if (t.n > out->n) out->n = t.n;
    for (int i = 0; i < out->n; i++)
        out->v[i] = apply(op->tag, component(&a, i), component(&b, i), component(&t, i));
    return true;
}

static bool combine(struct mtlx_graph *g, int node, int n, int depth, struct mtlx_value *out)
{
    char name[8];
    out->n = n;
    for (int i = 0; i < n; i++) {
        struct mtlx_value one;
        snprintf(name, sizeof name, "in%d", i + 1);
        if (!operand(g, node, name, 0, depth, &one)) return false;
        out->v[i] = one.v[0];
    }
    return true;
}

static bool reduce(struct mtlx_graph *g, int node, const char *tag, int depth,
                   struct mtlx_value *out)
{
    struct mtlx_value a, b = {.v = {0.2126, 0.7152, 0.0722}, .n = 3};
    bool dot = !strcmp(tag, "dotproduct");
    if (!operand(g, node, dot ? "in1" : "in", 0, depth, &a)) return false;
    if (dot && !operand(g, node, "in2", 0, depth, &b)) return false;
    *out = (struct mtlx_value){.n = 1};
    if (!strcmp(tag, "extract")) {
        struct mtlx_value index;
        if (!operand(g, node, "index", 0, depth, &index)) return false;
        out->v[0] = component(&a, (int)fmin(fmax(index.v[0], 0), 3));
        return true;
    }
    for (int i = 0; i < 3; i++) out->v[0] += component(&a, i) * component(&b, i);
    if (dot) return true;
    out->n = 3; // luminance is a grey colour
    out->v[1] = out->v[2] = out->v[0];
    return true;
}

// Nodes that vary over the surface, at the origin; noise at its mean.
static bool is_pattern(const char *tag)
{
    static const char *const tags[] = {"position", "texcoord",  "noise2d",
                                       "noise3d",  "fractal2d", "fractal3d"};
    for (size_t i = 0; i < sizeof tags / sizeof *tags; i++)
        if (!strcmp(tag, tags[i])) return true;
    return false;
}

static int output_of(const struct mtlx_graph *g, int graph, const char *output)
{
    if (output) return prt_xml_child(g->tree, graph, "output", output);
    for (int i = g->tree->node[graph].child; i != XML_NONE; i = g->tree->node[i].next)
        if (!strcmp(g->tree->node[i].tag, "output")) return i;
    return XML_NONE;
}

static bool evaluate(struct mtlx_graph *g, int node, const char *output, int depth,
                     struct mtlx_value *out)
{
    const char *tag = g->tree->node[node].tag;
    if (depth > MAX_DEPTH) return fail(g, "graph", "too deep");
    if (!strcmp(tag, "input")) return input_at(g, node, depth + 1, out);
    if (!strcmp(tag, "nodegraph")) {
        int end = output_of(g, node, output);
        return end == XML_NONE ? fail_at(g, node) : input_at(g, end, depth + 1, out);
    }
    for (size_t i = 0; i < sizeof operations / sizeof *operations; i++)
        if (!strcmp(tag, operations[i].tag))
            return arithmetic(g, node, &operations[i], depth + 1, out);
    if (!strcmp(tag, "combine2")) return combine(g, node, 2, depth + 1, out);
    if (!strcmp(tag, "combine3")) return combine(g, node, 3, depth + 1, out);
    if (!strcmp(tag, "combine4")) return combine(g, node, 4, depth + 1, out);
    if (!strcmp(tag, "dotproduct") || !strcmp(tag, "luminance") || !strcmp(tag, "extract"))
        return reduce(g, node, tag, depth + 1, out);
    if (!is_pattern(tag)) return fail_at(g, node);
    const char *name = prt_xml_attribute(g->tree, node, "name");
    if (!g->varies[0])
        snprintf(g->varies, sizeof g->varies, "%.40s \"%.40s\"", tag, name ? name : "");
    *out = (struct mtlx_value){.n = 1};
    return true;
}
