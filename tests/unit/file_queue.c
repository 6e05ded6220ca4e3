// SPDX-License-Identifier: MIT
// The queue of file operations runs them in order; a removed folder leaves nothing behind.
#include "store/file_queue.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

static char folder[] = "/tmp/file-queue-test-XXXXXX";
static struct loop *loop;
static struct work_pool *pool;
static struct file_queue *queue;

static int setup(void **state)
{
    return !mkdtemp(folder) || loop_create(&loop) || work_pool_create(loop, 2, 0, &pool) ||
           file_queue_create(pool, &queue);
}

static int teardown(void **state)
{
    work_pool_destroy(pool);
    file_queue_destroy(queue);
    loop_destroy(loop);
    return rmdir(folder);
}

static const char *path_of(const char *name)
{
    static char path[4][160];
    static unsigned i;
    char *out = path[i++ % 4];
    snprintf(out, sizeof path[0], "%s/%s", folder, name);
    return out;
}

static bool is_there(const char *name)
{
    struct stat st;
    return !lstat(path_of(name), &st);
}

// An operation that notes its number; the last one ends the wait.
struct numbered {
    struct file_task task; // first
    int number;
};

enum { MOST = 9 };
static int ran[MOST], n_ran, n_done, n_inside;

static int run_numbered(struct file_task *task)
{
    assert_int_equal(__atomic_add_fetch(&n_inside, 1, __ATOMIC_SEQ_CST), 1);
    usleep(1000);
    ran[n_ran++] = ((struct numbered *)task)->number;
    __atomic_sub_fetch(&n_inside, 1, __ATOMIC_SEQ_CST);
    return -((struct numbered *)task)->number;
}

static void numbered_done(struct file_task *task)
{
    const struct numbered *t = (struct numbered *)task;
    assert_int_equal(t->number, n_done++);
    assert_int_equal(task->status, -t->number);
}

static void wait_for_all(void)
{
    struct numbered last = {{.run = run_numbered, .done = numbered_done}, 0};
    n_ran = n_done = 0;
    file_queue_add(queue, &last.task);
    while (!n_done) loop_turn(loop, -1);
}

static void one_after_another(void **state)
{
    struct numbered task[MOST];
    for (int times = 0; times < 2; times++) { // the queue was empty between
        n_ran = n_done = 0;
        for (int i = 0; i < MOST; i++) {
            task[i] = (struct numbered){{.run = run_numbered, .done = numbered_done}, i};
            file_queue_add(queue, &task[i].task);
        }
        while (n_done < MOST) loop_turn(loop, -1);
        for (int i = 0; i < MOST; i++) assert_int_equal(ran[i], i);
    }
}

// A folder goes with all that is in it, hidden names too; what its links lead to stays.
static void folders_are_removed(void **state)
{
    assert_int_equal(mkdir(path_of("kept"), 0700), 0);
    assert_int_equal(mkdir(path_of("gone"), 0700), 0);
    assert_int_equal(mkdir(path_of("gone/.hidden"), 0700), 0);
    assert_int_equal(mkdir(path_of("gone/in"), 0700), 0);
    assert_int_equal(symlink(path_of("kept"), path_of("gone/link")), 0);
    static const char *const names[] = {"kept/a",   "gone/a",          "gone/.b",
                                        "gone/..c", "gone/.hidden/.d", "gone/in/e"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        file_write(queue, path_of(names[i]), strdup("text"));
    wait_for_all();
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) assert_true(is_there(names[i]));
    file_remove(queue, path_of("gone"));
    file_remove(queue, path_of("nothing"));
    wait_for_all();
    assert_false(is_there("gone"));
    assert_true(is_there("kept/a"));
    file_remove(queue, path_of("kept"));
    wait_for_all();
    assert_false(is_there("kept"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(one_after_another),
                                       cmocka_unit_test(folders_are_removed)};
    return cmocka_run_group_tests(tests, setup, teardown);
}
