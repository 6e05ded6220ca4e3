/* SPDX-License-Identifier: MIT */
/* options.h owns the table of prt's options, from which options.c makes one argp parser and one
 * --help for each subcommand. */
#ifndef PRT_TOOL_OPTIONS_H
#define PRT_TOOL_OPTIONS_H

#include "tool.h"

/* The type of an option's value, and the field of struct options that it fills. */
enum option_kind {
    OPTION_FLAG,     /* no value; bool */
    OPTION_TEXT,     /* const char *, not empty */
    OPTION_OPAQUE,   /* appended to options.opaque */
    OPTION_MATERIAL, /* appended to options.material */
    OPTION_ENVS,     /* appended to options.envs */
    OPTION_WORD,     /* const char *, one of `words` */
    OPTION_REAL,     /* double in (low, high] when low is 0, else in [low, high] */
    OPTION_SIGNED,   /* double in [low, high] */
    OPTION_WHOLE,    /* uint64_t in [low, high] */
    OPTION_VECTOR,   /* struct vector_option */
    OPTION_SIZE,     /* WxH into width and height */
    OPTION_SIDE,     /* N or WxH into width and height */
    OPTION_CUBE,     /* N or full */
    OPTION_SHARD,    /* I/N */
    OPTION_FD,       /* a file descriptor */
};

struct option_row {
    const char *name; /* without the dashes */
    char letter;      /* short form, or 0 */
    const char *label;
    enum option_kind kind;
    size_t field; /* offset in struct options */
    double low, high;
    const char *const *words; /* of OPTION_WORD, ends with NULL */
    unsigned commands;        /* bits 1 << enum command: which subcommands take it */
    const char *help;
};
extern const struct option_row option_table[];
extern const unsigned n_option_row;

/* Stores one value. Returns -1, or EXIT_USAGE after a message with the allowed values. */
int option_set(struct options *options, const struct option_row *row, const char *value);

#endif
