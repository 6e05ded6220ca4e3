/* SPDX-License-Identifier: MIT */
/* Internal to materials: the values of MaterialX inputs and of the graphs behind them. */
#ifndef MEDIUM_MTLX_GRAPH_H
#define MEDIUM_MTLX_GRAPH_H

#include "xml_tree.h"

enum { MTLX_MAX_STEP = 20000 }; /* nodes evaluated for one document */

struct mtlx_graph {
    const struct xml_tree *tree;
    int budget;       /* steps left */
    char missing[96]; /* the node that has no value: "image \"wood\"", or "" */
    char varies[96];  /* a node that varies over space, taken at the origin or its mean */
    double unit_mm;   /* of the last value read; 0: it names no unit of length */
};
/* One to four numbers, a single one repeated. */
struct mtlx_value {
    double v[4];
    int n;
};
/* The value of an <input> element. false: graph->missing has the node that has none. */
bool prt_mtlx_input(struct mtlx_graph *graph, int input, struct mtlx_value *out);
/* The element that an input refers to by nodename, nodegraph or interfacename, or XML_NONE. */
int prt_mtlx_source(struct mtlx_graph *graph, int input);

#endif
