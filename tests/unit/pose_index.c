// SPDX-License-Identifier: MIT
// Many poses of a tiny model beside a full cache (server/render/shared/poses.h), without a
// daemon: looking up, evicting and forgetting them must not search all of either.
#include "core/options.h"
#include "prt/base.h"
#include "render/shared/poses.h"
#include "store/models.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <cmocka.h>

enum { N_POSE = 20000, N_ENTRY = 20000 };
// Vertices, and what a pose costs beside them.
#define EACH poses_bytes(1)
// Of processor time: searching all of the cache for each pose takes ten times that.
static const double most_s = 4;

static double cpu_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static struct pose *make_pose(unsigned i)
{
    struct pose *pose = calloc(1, sizeof *pose);
    assert_non_null(pose);
    pose->refs = 1;
    pose->n = 1;
    pose->position = prt_calloc(1, sizeof *pose->position);
    pose->normal = prt_calloc(1, sizeof *pose->normal);
    snprintf(pose->name, sizeof pose->name, "%064x", i);
    return pose;
}

static void fill_cache(struct cache *cache)
{
    char key[40];
    bool fresh;
    for (unsigned i = 0; i < N_ENTRY; i++) {
        snprintf(key, sizeof key, "light/%u", i);
        struct cache_entry *e = cache_get(cache, key, &fresh);
        cache_fill(e, NULL, 1, NULL);
        cache_release(e);
    }
}

static void many_tiny_poses(void **state)
{
    struct server server = {
        .options = {.client_poses = N_POSE * EACH, .poses = 2 * N_POSE * EACH}};
    struct model model = {.server = &server, .key = "model"}, other = {.key = "other"};
    struct poses *poses;
    struct pose *found;
    char error[256];
    int code;
    assert_non_null(server.ledger = ledger_create(&server.options));
    assert_int_equal(cache_create(1 << 30, &server.cache), 0);
    assert_int_equal(poses_create(&server, &poses), 0);
    fill_cache(server.cache);
    struct principal *ann = ledger_principal(server.ledger, "ann");
    double start = cpu_s();
    for (unsigned i = 0; i < 2 * N_POSE; i++) { // the second half takes the first one's place
        assert_int_equal(poses_add(poses, &model, make_pose(i), ann, &found, error), 0);
        pose_release(found);
    }
    assert_int_equal(ann->held[LEDGER_POSES], N_POSE * EACH);
    for (unsigned i = 0; i < 2 * N_POSE; i++) {
        struct pose *name = make_pose(i);
        found = poses_find(poses, &model, name->name, &code, error);
        assert_int_equal(found != NULL, i >= N_POSE);
        assert_int_equal(poses_known(poses, name->name) != NULL, i >= N_POSE);
        pose_release(found);
        pose_release(name);
    }
    poses_forget(poses, &other);
    assert_int_equal(ann->held[LEDGER_POSES], N_POSE * EACH);
    poses_forget(poses, &model);
    double took = cpu_s() - start;
    assert_int_equal(ann->held[LEDGER_POSES], 0);
    print_message("%d poses beside %d entries took %.2f s, at most %.0f\n", 2 * N_POSE, N_ENTRY,
                  took, most_s);
    assert_true(took < most_s);
    poses_destroy(poses);
    principal_release(ann);
    cache_destroy(server.cache);
    ledger_destroy(server.ledger);
}

// One that is drawn stays, and another goes for it.
static void drawn_poses_stay(void **state)
{
    struct server server = {.options = {.client_poses = 3 * EACH, .poses = 10 * EACH}};
    struct model model = {.server = &server, .key = "model"};
    struct poses *poses;
    struct pose *drawn, *found;
    char error[256];
    assert_non_null(server.ledger = ledger_create(&server.options));
    assert_int_equal(cache_create(1 << 20, &server.cache), 0);
    assert_int_equal(poses_create(&server, &poses), 0);
    struct principal *ann = ledger_principal(server.ledger, "ann");
    assert_int_equal(poses_add(poses, &model, make_pose(0), ann, &drawn, error), 0);
    for (unsigned i = 1; i < 10; i++) {
        assert_int_equal(poses_add(poses, &model, make_pose(i), ann, &found, error), 0);
        pose_release(found);
        assert_ptr_equal(poses_known(poses, drawn->name), drawn);
    }
    pose_release(drawn);
    poses_destroy(poses);
    assert_int_equal(ann->held[LEDGER_POSES], 0);
    principal_release(ann);
    cache_destroy(server.cache);
    ledger_destroy(server.ledger);
}

// A client that is full of poses gives way to itself, though another has the oldest pose.
static void poses_of_others_stay(void **state)
{
    struct server server = {.options = {.client_poses = 3 * EACH, .poses = 10 * EACH}};
    struct model model = {.server = &server, .key = "model"};
    struct poses *poses;
    struct pose *found;
    char error[256], name[65];
    assert_non_null(server.ledger = ledger_create(&server.options));
    assert_int_equal(cache_create(1 << 20, &server.cache), 0);
    assert_int_equal(poses_create(&server, &poses), 0);
    struct principal *ann = ledger_principal(server.ledger, "ann");
    struct principal *bob = ledger_principal(server.ledger, "bob");
    for (unsigned i = 0; i < 6; i++) {
        struct principal *owner = i ? bob : ann;
        assert_int_equal(poses_add(poses, &model, make_pose(i), owner, &found, error), 0);
        pose_release(found);
    }
    for (unsigned i = 0; i < 6; i++) {
        snprintf(name, sizeof name, "%064x", i);
        assert_int_equal(poses_known(poses, name) != NULL, i == 0 || i > 2);
    }
    poses_destroy(poses);
    principal_release(ann);
    principal_release(bob);
    cache_destroy(server.cache);
    ledger_destroy(server.ledger);
}

// A pose of one vertex holds some hundred bytes more: they are charged.
static void tiny_poses_cost_their_records(void **state)
{
    assert_true(poses_bytes(1) >= 24 + sizeof(struct pose) + 64);
    assert_int_equal(poses_bytes(1001) - poses_bytes(1), 24000);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(many_tiny_poses),
                                       cmocka_unit_test(drawn_poses_stay),
                                       cmocka_unit_test(poses_of_others_stay),
                                       cmocka_unit_test(tiny_poses_cost_their_records)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
