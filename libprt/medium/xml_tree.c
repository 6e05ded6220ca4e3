// SPDX-License-Identifier: MIT
// XML into an array of elements, by expat. Text between elements is not kept.
#include "xml_tree.h"

#include <expat.h>
#include <string.h>

struct reading {
    struct xml_tree *tree;
    XML_Parser parser;
    int open[XML_MAX_DEPTH]; // elements around the current one
    int last[XML_MAX_DEPTH]; // their last child
    int depth;
    size_t used, room, n_pointer, pointer_room;
    const char *refused; // why parsing was stopped, or NULL
};

static void stop(struct reading *r, const char *why)
{
    if (!r->refused) r->refused = why;
    XML_StopParser(r->parser, XML_FALSE);
}

static const char *keep(struct reading *r, const char *text)
{
    size_t n = strlen(text) + 1;
    if (n > r->room - r->used) {
        stop(r, "is too large");
        return "";
    }
    char *at = memcpy(r->tree->text + r->used, text, n);
    r->used += n;
    return at;
}

static void begin(void *user, const XML_Char *tag, const XML_Char **attribute)
{
    struct reading *r = user;
    struct xml_tree *t = r->tree;
    size_t n = 0;
    while (attribute[n]) n++;
    if (r->refused) return; // expat may report an element more
    if (r->depth == XML_MAX_DEPTH) return stop(r, "is nested too deeply");
    if (t->n == XML_MAX_NODE) return stop(r, "has too many elements");
    if (n + 1 > r->pointer_room - r->n_pointer) return stop(r, "has too many attributes");
    int me = t->n++, parent = r->depth ? r->open[r->depth - 1] : XML_NONE;
    t->node[me] = (struct xml_node){.tag = keep(r, tag),
                                    .attribute = t->pointer + r->n_pointer,
                                    .parent = parent,
                                    .child = XML_NONE,
                                    .next = XML_NONE};
    for (size_t i = 0; i < n; i++) t->pointer[r->n_pointer++] = keep(r, attribute[i]);
    t->pointer[r->n_pointer++] = NULL;
    if (parent != XML_NONE) {
        int *last = &r->last[r->depth - 1];
        if (*last == XML_NONE) t->node[parent].child = me;
        else t->node[*last].next = me;
        *last = me;
    }
    r->last[r->depth] = XML_NONE;
    r->open[r->depth++] = me;
}

static void end(void *user, const XML_Char *tag)
{
    struct reading *r = user;
    if (r->depth && !r->refused) r->depth--;
}

static void doctype(void *user, const XML_Char *name, const XML_Char *system,
                    const XML_Char *public, int internal)
{
    stop(user, "has a document type, which is not read: remove <!DOCTYPE …>");
}

void prt_xml_tree_finish(struct xml_tree *tree)
{
    prt_free(tree->node);
    prt_free(tree->text);
    prt_free(tree->pointer);
    *tree = (struct xml_tree){.n = 0};
}

// The first form is deprecated where the second is there.
static unsigned long line_of(XML_Parser parser)
{
#if XML_MAJOR_VERSION > 2 || XML_MINOR_VERSION >= 9
    return (unsigned long)XML_GetCurrentLineNumber64(parser);
#else
    return (unsigned long)XML_GetCurrentLineNumber(parser);
#endif
}

static int parse(const struct prt_context *ctx, const char *what, const char *bytes, size_t n,
                 struct reading *r)
{
    XML_SetUserData(r->parser, r);
    XML_SetElementHandler(r->parser, begin, end);
    XML_SetStartDoctypeDeclHandler(r->parser, doctype);
    enum XML_Status status = XML_Parse(r->parser, bytes, (int)n, 1);
    if (r->refused) return prt_fail(ctx, PRT_LIMIT, "%s: %s", what, r->refused);
    if (status == XML_STATUS_OK) return PRT_OK;
    return prt_fail(ctx, PRT_FORMAT, "%s: not valid XML in line %lu: %s", what,
                    line_of(r->parser), XML_ErrorString(XML_GetErrorCode(r->parser)));
}

int prt_xml_tree_parse(const struct prt_context *ctx, const char *what, const char *bytes,
                       size_t n, struct xml_tree *out)
{
    struct xml_tree tree = {.n = 0};
    // UTF-16 and Latin-1 grow as they become UTF-8; each tag and value adds a 0 byte.
    struct reading r = {.tree = &tree, .room = 3 * n + 64, .pointer_room = 2 * n + 64};
    if (n > 1u << 30) return prt_fail(ctx, PRT_LIMIT, "%s: is too large", what);
    if (r.pointer_room > 16 * XML_MAX_NODE) r.pointer_room = 16 * XML_MAX_NODE;
    tree.node = prt_alloc(XML_MAX_NODE, sizeof *tree.node);
    tree.text = prt_alloc(r.room, 1);
    tree.pointer = prt_alloc(r.pointer_room, sizeof *tree.pointer);
    r.parser = XML_ParserCreate(NULL);
    int status = tree.node && tree.text && tree.pointer && r.parser
                     ? parse(ctx, what, bytes, n, &r)
                     : prt_fail(ctx, PRT_NOMEM, "%s: no memory", what);
    if (r.parser) XML_ParserFree(r.parser);
    if (status) prt_xml_tree_finish(&tree);
    else *out = tree;
    return status;
}

const char *prt_xml_attribute(const struct xml_tree *tree, int node, const char *name)
{
    for (const char **a = tree->node[node].attribute; *a; a += 2)
        if (!strcmp(*a, name)) return a[1];
    return NULL;
}

int prt_xml_child(const struct xml_tree *tree, int parent, const char *tag, const char *name)
{
    for (int i = tree->node[parent].child; i != XML_NONE; i = tree->node[i].next) {
        const char *own = prt_xml_attribute(tree, i, "name");
        if ((!tag || !strcmp(tree->node[i].tag, tag)) && own && !strcmp(own, name)) return i;
    }
    return XML_NONE;
}
