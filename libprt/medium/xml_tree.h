/* SPDX-License-Identifier: MIT */
/* Internal to materials: an XML document as an array of elements. */
#ifndef MEDIUM_XML_TREE_H
#define MEDIUM_XML_TREE_H

#include "prt/base.h"

enum { XML_MAX_NODE = 8192, XML_MAX_DEPTH = 64, XML_NONE = -1 };

/* attribute: name, value, name, value, …, NULL. Indices into xml_tree.node, or XML_NONE. */
struct xml_node {
    const char *tag;
    const char **attribute;
    int parent, child, next;
};
struct xml_tree {
    struct xml_node *node; /* [n]; 0 is the root */
    int n;
    char *text;
    const char **pointer;
};
/* Elements and attributes only. A document type, and with it any entity of the document's own,
 * is refused. PRT_FORMAT, PRT_LIMIT, PRT_NOMEM after a message. */
int prt_xml_tree_parse(const struct prt_context *ctx, const char *what, const char *bytes,
                       size_t n, struct xml_tree *out);
void prt_xml_tree_finish(struct xml_tree *tree);
/* The attribute's value, or NULL. */
const char *prt_xml_attribute(const struct xml_tree *tree, int node, const char *name);
/* The child of this tag (NULL: any) and name, or XML_NONE. */
int prt_xml_child(const struct xml_tree *tree, int parent, const char *tag, const char *name);

#endif
