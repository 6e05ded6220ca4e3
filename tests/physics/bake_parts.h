/* SPDX-License-Identifier: MIT */
/* bake_parts.h owns bakes in several processes: in shards, and killed again and again. Each
 * must write what one process writes, byte for byte. */
#ifndef PHYSICS_BAKE_PARTS_H
#define PHYSICS_BAKE_PARTS_H

#include "bake/cluster_records.h"
#include "bake_files.h"
#include "prt/bake.h"

#include <signal.h>
#include <sys/wait.h>

/* Three shards, the last first; only the one that ends last leaves a .prt. */
static inline void parts_make_the_whole(const struct prt_mesh *mesh, struct prt_bake_options o)
{
    assert_int_equal(prt_bake(&context, mesh, &o, file("whole.prt")), PRT_OK);
    uint32_t missing = 99;
    o.n_shard = 3;
    o.parts_missing = &missing;
    for (uint32_t i = 3; i-- > 0;) {
        o.shard = i;
        assert_false(is_there(file("parts.prt")));
        assert_int_equal(prt_bake(&context, mesh, &o, file("parts.prt")), PRT_OK);
        assert_int_equal(missing, i);
    }
    same_bytes(file("whole.prt"), file("parts.prt"));
    for (uint32_t i = 0; i < 3; i++) {
        char name[64];
        snprintf(name, sizeof name, "parts.prt.%u-of-3.part", i);
        assert_false(is_there(file(name)));
    }
    assert_false(is_there(file("parts.prt.0-of-3.assembling")));
    unlink(file("parts.prt"));
}

/* Number of records; asserts that none is there twice. *end: bytes up to the last whole one. */
static inline unsigned count_records(const char *path, uint64_t *end)
{
    enum { MOST = 4096, HEADER = 16, SLOT_ROWS = 1000 };
    static uint32_t seen[MOST][2];
    unsigned n = 0;
    struct record r;
    uint64_t at = HEADER;
    int fd = open(path, O_RDONLY);
    while (fd >= 0 && prt_read_at(fd, &r, sizeof r, at) && prt_record_whole(&r) && n < MOST) {
        for (unsigned i = 0; i < n; i++)
            assert_false(seen[i][0] == r.slot && seen[i][1] == r.cluster);
        seen[n][0] = r.slot, seen[n++][1] = r.cluster;
        at += sizeof r + (r.slot == SLOT_ROWS ? 0 : r.bytes);
    }
    if (fd >= 0) close(fd);
    *end = at;
    return n;
}

/* Begins a bake in a child. */
static inline pid_t bake_in_child(const struct prt_mesh *mesh, const struct prt_bake_options *o,
                                  const char *out)
{
    pid_t child = fork();
    assert_true(child >= 0);
    if (child) return child;
    struct prt_context c;
    prt_context_init(&c);
    prt_pool_create(0, &c.pool);
    _exit(prt_bake(&c, mesh, o, out));
}

/* Bakes in a child, which is killed once it has recorded `more` pieces of work. True: it ended.
 */
static inline bool bake_and_kill(const struct prt_mesh *mesh, const struct prt_bake_options *o,
                                 unsigned more)
{
    uint64_t end;
    unsigned before = count_records(o->checkpoint, &end);
    pid_t child = bake_in_child(mesh, o, file("parts.prt"));
    for (int how;;) {
        if (waitpid(child, &how, WNOHANG) == child) {
            assert_true(WIFEXITED(how) && WEXITSTATUS(how) == PRT_OK);
            return true;
        }
        if (count_records(o->checkpoint, &end) >= before + more) break;
        usleep(500);
    }
    kill(child, SIGKILL);
    assert_int_equal(waitpid(child, NULL, 0), child);
    /* Finished work is there, and the rest of a record that was being written. */
    assert_true(count_records(o->checkpoint, &end) >= before + more);
    return false;
}

/* Killed whenever it has recorded `more` pieces of work; at least twice. */
static inline void killed_makes_the_whole(const struct prt_mesh *mesh,
                                          struct prt_bake_options o, unsigned more)
{
    unsigned killed = 0;
    char path[256];
    assert_int_equal(prt_bake(&context, mesh, &o, file("whole.prt")), PRT_OK);
    snprintf(path, sizeof path, "%s", file("checkpoint"));
    o.checkpoint = path;
    while (!bake_and_kill(mesh, &o, more)) assert_true(++killed < 100);
    assert_true(killed >= 2);
    same_bytes(file("whole.prt"), file("parts.prt"));
    assert_false(is_there(file("checkpoint")));
    assert_false(is_there(file("checkpoint.rows")));
    unlink(file("parts.prt"));
}

#endif
