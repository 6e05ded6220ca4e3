/* SPDX-License-Identifier: MIT */
/* bcf_xml.h owns the reading of a BCF file's XML: elements one after another with their text.
 * Thread-safety: one thread at a time for one file. */
#ifndef RELIGHT_CLI_BCF_XML_H
#define RELIGHT_CLI_BCF_XML_H

#include <expat.h>
#include <stdbool.h>
#include <stddef.h>

/* Begins the struct that the handlers get; they count depth and set n to 0. */
struct bcf_xml {
    XML_Parser parser;
    char text[8193]; /* [n] of the element that is open; the rest is dropped */
    size_t n;
    unsigned depth;
};
/* False: this is no XML, or it has a document type. */
bool bcf_parse(struct bcf_xml *xml, const void *bytes, size_t n, XML_StartElementHandler begins,
               XML_EndElementHandler ends);

#endif
